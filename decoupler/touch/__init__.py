"""Forces from whatever presses on bare rubber: a library of presses, and how one of them is fitted to a scan.

In the order of the data: `presses.py` (contacts of rigid shapes as fields of traction, and what they do to the sensor),
`regression.py` (the fast answer, from the nearest of them), `morph.py` (presses moved, stretched, turned and dragged
until they explain a scan), `decoder.py` (both as one decoder; open this file first), `touch_file.py`, `assessment.py`.
"""

from decoupler.touch.assessment import TouchAssessment, assess_touch
from decoupler.touch.decoder import TouchDecoder
from decoupler.touch.presses import touch_library
from decoupler.touch.touch_file import AnyDecoder, read_model, write_touch

__all__ = [
    "AnyDecoder",
    "TouchAssessment",
    "TouchDecoder",
    "assess_touch",
    "read_model",
    "touch_library",
    "write_touch",
]
