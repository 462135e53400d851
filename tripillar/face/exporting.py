"""Write what jobs give, and models, data sets and recordings for other programs."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from geometry.design import SensorDesign
from geometry.errors import ArgumentError, DesignError
from geometry.storage.files import write_bytes
from tripillar.face.caller import current
from tripillar.face.inputs import File, ModelLike, pads_model_of, require_there, to_write

if TYPE_CHECKING:
    from dataset.samples import Samples
    from decoupler.model.decoupler import Decoupler
    from decoupler.touch.decoder import TouchDecoder
    from decoupler.twin.identification import Twin
    from fem.array.response import ArrayResponse
    from hardware.recording import Recording

ENDINGS = {"parquet": ".parquet", "csv": ".csv", "card": ".md"}  #: of the forms of a data set
OF_RECORDINGS = (".nc", ".mcap", ".csv")
MAX_NAMED = 3  #: places of damage in one line


def export(
    data: File | None = None,
    /,
    *,
    to: Literal["parquet", "csv", "card"] | None = None,
    model: ModelLike | None = None,
    out: File | None = None,
    precision: Literal["float", "double"] | None = None,
    licence: Annotated[str | None, Parameter(name="--license")] = None,
) -> Path:
    """Write a model, a data set or a recording for other programs: ONNX or C, Parquet or CSV, NetCDF or MCAP.

    A data set's card says in Markdown what it holds, how it was made and under which licence.

    Parameters
    ----------
    data : path, optional
        Data set (.nc or .zarr) or recording (.frames, or a board's bytes) to write.
    to : str, optional
        Form of a data set: a table, or the card that describes it; default: as the name of the file ends.
    model : Decoupler or path, optional
        Model file to write in their place.
    out : path, optional
        File to write: of a model .onnx, or .h for a header in C; of a data set .parquet, .csv or .md, by default beside
        it; of a recording .nc (NetCDF), .mcap (Foxglove, ROS) or .csv.
    precision : str, optional
        Precision of a model's numbers; default: double in .onnx, float in .h.
    licence : str, optional
        Licence of a data set for its card, such as cc-by-4.0.

    Returns
    -------
    Path
        The file that was written.
    """
    caller = current()
    if (data is None) == (model is None):
        raise DesignError("give a data set, a recording or model=FILE, one of them.")
    require_there(model, what="a model file of 'tripillar train'")
    if model is not None:
        if to is not None or licence is not None:
            raise DesignError("to= and licence= are for data sets: the ending of out= says the form of a model.")
        return _model_written(model, out, precision)
    assert data is not None
    if precision is not None:
        raise DesignError("precision= is for models: a table has the numbers of its data set.")
    source = Path(data)
    require_there(source, what="a data set or a recording")
    if _is_recording(source):
        return _recording_written(source, to, out)
    named = [form for form, ending in ENDINGS.items() if out is not None and Path(out).suffix == ending]
    form = to or "".join(named)
    if not form:
        raise DesignError("give to=parquet, csv or card, or out=FILE that ends in .parquet, .csv or .md.")
    if licence is not None and form != "card":
        raise DesignError("licence= is written into the card: give to=card too.")
    beside = source.with_suffix(".card.md" if form == "card" else ENDINGS[form])
    file = to_write("out", out or beside, ENDINGS[form], read=(source,))
    assert file is not None
    from dataset import read_samples
    from dataset.card import UNSTATED, card_text
    from dataset.table import columns_of, write_table

    samples = read_samples(source)
    result: dict[str, Any] = {"file": str(file), "samples": len(samples), "columns": len(columns_of(samples))}
    if form == "card":
        write_bytes(file, card_text(samples, source, licence or UNSTATED).encode())
    else:
        advance = caller.bars.begin("export", total=len(samples))
        write_table(samples, file, lambda n: advance(n, ""))
    caller.answer(lambda: result, f"{result['samples']} samples, {result['columns']} columns", file)
    return file


def _model_written(model: "ModelLike", out: "File | None", precision: Literal["float", "double"] | None) -> Path:
    file = to_write("out", out, ".onnx", ".h", read=(model,))
    if file is None:
        raise DesignError("a model needs out=FILE that ends in .onnx or .h.")
    from decoupler.export import export_model

    exported = export_model(pads_model_of(model, "export"), file, precision)
    checked = f"largest deviation from the model: {exported.deviation or 0:.1e} of full scale ({exported.precision})"
    said = f"not checked: {exported.unchecked}" if exported.deviation is None else checked
    current().answer(lambda: {"file": str(file), **asdict(exported)}, said, file)
    return file


def _is_recording(path: Path) -> bool:
    """Whether a file is a recording, and no data set."""
    return path.suffix not in (".zarr", ".parquet", ".csv", ".nc") and not path.is_dir()


def _recording_written(path: Path, to: str | None, out: "File | None") -> Path:
    if to is not None:
        raise DesignError("to= is for data sets: the ending of out= says the form of a recording.")
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
