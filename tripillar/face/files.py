"""Write what the other functions give."""

from pathlib import Path
from typing import TYPE_CHECKING

from geometry.design import SensorDesign
from geometry.errors import ArgumentError

if TYPE_CHECKING:
    from dataset.samples import Samples
    from decoupler.model.decoupler import Decoupler
    from fem.array.response import ArrayResponse


def write(thing: "SensorDesign | ArrayResponse | Samples | Decoupler", path: Path | str) -> None:
    """Write a file, whole or not at all.

    Parameters
    ----------
    thing : SensorDesign, ArrayResponse, Samples or Decoupler
        A design is written as TOML, a response or samples as NetCDF, a model as its path ends: .onnx, .h (C for a
        microcontroller), else safetensors.
    path : path

    Raises
    ------
    ArgumentError
        If it is something else.
    NotWrittenError
        If the disk is full or the folder may not be written to.

    Examples
    --------
    >>> import tripillar as tp
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> folder = Path(mkdtemp())
    >>> tp.write(tp.SensorDesign(), folder / "sensor.toml")
    >>> [path.name for path in folder.iterdir()]
    ['sensor.toml']
    """
    from dataset.samples import Samples
    from decoupler.export import export_model
    from decoupler.model.decoupler import Decoupler
    from decoupler.model.model_file import write_model
    from fem.array.response import ArrayResponse, write_response
    from geometry.design_file import write_design

    path = Path(path)
    if isinstance(thing, SensorDesign):
        write_design(thing, path)
    elif isinstance(thing, ArrayResponse):
        write_response(thing, path)
    elif isinstance(thing, Samples):
        thing.write(path)
    elif not isinstance(thing, Decoupler):
        raise ArgumentError(
            f"a {type(thing).__name__} cannot be written: give a design, a response, samples or a model."
        )
    elif path.suffix in (".onnx", ".h"):
        export_model(thing, path)
    else:
        write_model(thing, path)
