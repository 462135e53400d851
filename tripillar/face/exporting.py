"""Write what jobs give, and models, data sets and recordings for other programs."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from geometry.design import SensorDesign
from geometry.errors import ArgumentError, DesignError
from tripillar.face.caller import current
from tripillar.face.inputs import File, ModelLike, pads_model_of, require_there, to_write

if TYPE_CHECKING:
    from dataset.samples import Samples
    from decoupler.model.decoupler import Decoupler
    from decoupler.touch.decoder import TouchDecoder
    from decoupler.twin.identification import Twin
    from fem.array.response import ArrayResponse
    from hardware.recording import Recording

OF_RECORDINGS = (".nc", ".mcap", ".csv")
MAX_NAMED = 3  #: places of damage in one line


def export(
    data: File | None = None,
    /,
    *,
    model: ModelLike | None = None,
    out: File | None = None,
    precision: Literal["float", "double"] | None = None,
) -> Path:
    """Write a model, a data set or a recording for other programs: ONNX or C, CSV, NetCDF or MCAP.

    Parameters
    ----------
    data : path, optional
        Data set (.nc or .zarr) or recording (.frames, or a board's bytes) to write.
    model : Decoupler or path, optional
        Model file to write in their place.
    out : path, optional
        File to write: of a model .onnx, or .h for a header in C; of a data set .csv; of a recording .nc (NetCDF), .mcap
        (Foxglove, ROS) or .csv.
    precision : str, optional
        Precision of a model's numbers; default: double in .onnx, float in .h.

    Returns
    -------
    Path
        The file that was written.
    """
    if (data is None) == (model is None):
        raise DesignError("give a data set, a recording or model=FILE, one of them.")
    require_there(model, what="a model file of 'tripillar train'")
    if model is not None:
        return _model_written(model, out, precision)
    assert data is not None
    if precision is not None:
        raise DesignError("precision= is for models: a table has the numbers of its data set.")
    source = Path(data)
    require_there(source, what="a data set or a recording")
    return _recording_written(source, out) if _is_recording(source) else _table_written(source, out)


def _table_written(path: Path, out: "File | None") -> Path:
    file = to_write("out", out, ".csv", read=(path,))
    if file is None:
        raise DesignError("a data set needs out=FILE that ends in .csv.")
    from dataset import read_samples
    from dataset.table import write_table

    samples = read_samples(path)
    advance = current().bars.begin("export", total=len(samples))
    columns = write_table(samples, file, lambda n: advance(n, ""))
    result = {"file": str(file), "samples": len(samples), "columns": len(columns)}
    current().answer(lambda: result, f"{len(samples)} samples, {len(columns)} columns", file)
    return file


def _model_written(model: "ModelLike", out: "File | None", precision: Literal["float", "double"] | None) -> Path:
    file = to_write("out", out, ".onnx", ".h", read=(model,))
    if file is None:
        raise DesignError("a model needs out=FILE that ends in .onnx or .h.")
    from decoupler.export import export_model

    exported = export_model(pads_model_of(model, "export"), file, precision)
    said = f"largest deviation from the model: {exported.deviation:.1e} of full scale ({exported.precision})"
    current().answer(lambda: {"file": str(file), **asdict(exported)}, said, file)
    return file


def _is_recording(path: Path) -> bool:
    """Whether a file is a recording, and no data set."""
    return path.suffix not in (".zarr", ".csv", ".nc") and not path.is_dir()


def _recording_written(path: Path, out: "File | None") -> Path:
    file = to_write("out", out, *OF_RECORDINGS, read=(path,))
    if file is None:
        raise DesignError("a recording needs out=FILE that ends in .nc, .mcap or .csv.")
    from hardware import convert, read_recording

    recorded = read_recording(path)
    current().say(damage(path, recorded))
    convert(recorded, file)
    n, met = len(recorded.run), recorded.statistics
    result = {"file": str(file), "frames": n, "statistics": asdict(met)}
    current().answer(lambda: result, f"{n} frames, {met.lost} lost", file)
    return file


def damage(path: Path, recorded: "Recording") -> str:
    """One line on what of a file is damaged and left out; empty if nothing is."""
    found = [f"byte {at}" for at in recorded.damaged_at[:MAX_NAMED]]
    if (more := len(recorded.damaged_at) - MAX_NAMED) > 0:
        found.append(f"{more} more places")
    ends = "its last frame is cut off" if recorded.truncated_bytes else ""
    said = "; ".join(part for part in (f"damaged at {', '.join(found)}, left out" if found else "", ends) if part)
    return f"warning: {path}: {said}" if said else ""


def write(thing: "SensorDesign | ArrayResponse | Samples | Decoupler | TouchDecoder | Twin", path: Path | str) -> None:
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
    from decoupler.touch.decoder import TouchDecoder
    from decoupler.touch.touch_file import write_touch
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
    elif isinstance(thing, TouchDecoder):
        write_touch(thing, path)
    elif not isinstance(thing, Decoupler):
        raise ArgumentError(
            f"a {type(thing).__name__} cannot be written: give a design, a response, samples, a model or a twin."
        )
    elif path.suffix in (".onnx", ".h"):
        export_model(thing, path)
    else:
        write_model(thing, path)
