"""Write what the other functions give."""

from pathlib import Path
from typing import TYPE_CHECKING

from geometry.design import SensorDesign
from geometry.errors import ArgumentError

if TYPE_CHECKING:
    from dataset.samples import Samples
    from decoupler.model.decoupler import Decoupler
    from decoupler.twin.identification import Twin
    from fem.array.response import ArrayResponse


def write(thing: "SensorDesign | ArrayResponse | Samples | Decoupler | Twin", path: Path | str) -> None:
    """Write a file, whole or not at all.

    Parameters
    ----------
    thing : SensorDesign, ArrayResponse, Samples, Decoupler or Twin
        A design is written as TOML, a response or samples as NetCDF, samples as a zarr directory where the path ends in
        .zarr, a model as its path ends: .onnx, .h (C for a microcontroller), else safetensors. A twin is a design as
        TOML with its decoder beside it, as safetensors.
    path : path

    Raises
    ------
    ArgumentError
        If it is something else.
    DesignError
        If it is a twin of no design: write its decoder.
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
    from decoupler.twin.identification import Twin
    from decoupler.twin.twin_file import most_probable, write_twin
    from fem.array.response import ArrayResponse, write_response
    from geometry.design_file import write_design

    path = Path(path)
    if isinstance(thing, SensorDesign):
        write_design(thing, path)
    elif isinstance(thing, ArrayResponse):
        write_response(thing, path)
    elif isinstance(thing, Samples):
        thing.write(path)
    elif isinstance(thing, Twin):
        most_probable(thing)  # refuses one of no design before anything is written
        decoder = path.with_suffix(".safetensors")
        if decoder == path:
            raise ArgumentError(f"{path} is the name of the twin's decoder: give the twin one that ends in .toml.")
        write_model(thing.decoder, decoder)
        write_twin(thing, path, decoder)
    elif not isinstance(thing, Decoupler):
        raise ArgumentError(
            f"a {type(thing).__name__} cannot be written: give a design, a response, samples, a model or a twin."
        )
    elif path.suffix in (".onnx", ".h"):
        export_model(thing, path)
    else:
        write_model(thing, path)
