"""A trained network for other programs: ohms in, newtons out, as an ONNX graph or a C header.

`export_model` chooses by the file's suffix. Both forms are written of the graph that `traced.py` records while the
decoder's own code runs. ONNX needs the extra `export`, and is loaded only when such a file is written.
"""

from decoupler.export.checked import Exported, export_model

__all__ = ["Exported", "export_model"]
