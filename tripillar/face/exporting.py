"""Write what jobs give, and models, data sets, recordings and sensors for other programs."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from common.errors import ArgumentError, DesignError
from common.storage.files import write_text
from geometry.design import SensorDesign
from geometry.design_file import read_design, write_design
from geometry.wiring import wires
from tripillar.face import stages
from tripillar.face.caller import current
from tripillar.face.inputs import DesignLike, File, ModelLike, design_of, job, model_of, name_of, to_write

if TYPE_CHECKING:
    Written = SensorDesign | stages.ArrayResponse | stages.Samples | stages.Decoder | stages.Twin

MAX_NAMED = 3  #: places of damage in one line


@job(out=None)
def export(
    data: File | None = None,
    /,
    *,
    out: File,
    model: ModelLike | None = None,
    precision: Literal["float", "double"] | None = None,
    to: Literal["header"] | None = None,
    design: DesignLike | None = None,
) -> Path:
    """Write a model, a data set or a recording for other programs: ONNX or C, CSV, Parquet or NetCDF.

    Or a design for the firmware: its wires and channels.

    Parameters
    ----------
    data : path, optional
        Data set (.nc or .zarr) or recording (.frames, or a board's bytes) to write.
    out : path
        File to write: of a model .onnx or .h (C); of a data set .csv or .parquet, with its design beside; of a
        recording .nc or .csv.
    model : Decoupler or path, optional
        Model file to write in their place.
    precision : str, optional
        Precision of a model's numbers; default: double in .onnx, float in .h.
    to : str, optional
        Write header: the design's wires and channels in C, for make -C hardware/firmware SENSOR=OUT.
    design : SensorDesign or path, optional
        Design file (TOML) of that header; default: the paper's sensor.

    Returns
    -------
    Path
        The file that was written.
    """
    caller, path = current(), Path(out)
    if to is not None:
        if data is not None or model is not None or precision is not None:
            raise DesignError("to='header' is of a design: give design=FILE alone.")
        return _write_header(design_of(design), path)
    if design is not None:
        raise DesignError("design= is for to='header', the header that the firmware is built with: give it, too.")
    if (data is None) == (model is None):
        raise DesignError("give a data set, a recording or model=FILE, one of them.")
    if precision is not None and model is None:
        raise DesignError("precision= is for models: a table has the numbers of its data set.")
    result: dict[str, Any] = {"file": str(path)}
    files = [path]
    if model is not None:
        to_write("out", path, ".onnx .h", (model,))
        decoupler = model_of(model)
        if not isinstance(decoupler, stages.Decoupler):
            raise DesignError(
                f"{name_of(model, 'model')} is a decoder of touch: export takes a model of loads on pads."
            )
        exported = stages.export_model(decoupler, path, precision)
        text = f"largest deviation from the model: {exported.deviation:.1e} of full scale ({exported.precision})"
        result |= asdict(exported)
    elif not (source := Path(data or "")).is_dir() and source.suffix not in (".zarr", ".csv", ".nc"):
        if path.suffix == ".mcap":
            raise DesignError(f"{path} would hold forces: write tripillar replay {source} --model MODEL --out {path}.")
        to_write("out", path, ".nc .csv", (source,))
        recorded = stages.read_recording(source)
        caller.say(damage(source, recorded))
        stages.convert(recorded, path)
        result |= {"frames": len(recorded.run), "statistics": asdict(recorded.statistics)}
        text = f"{len(recorded.run)} frames, {recorded.statistics.lost} lost"
    else:
        to_write("out", path, " ".join(stages.TABLES), (source,))
        samples, beside = stages.read_samples(source), path.with_suffix(".toml")
        if samples.design is not None:
            if beside.exists() and read_design(beside) != samples.design:
                raise DesignError(f"{beside} is another design than that of {source}: give another name.")
            if path.suffix == ".csv":
                caller.say(f"{path} states no design: give design={beside} to what learns from it")
        advance = caller.bars.begin("export", total=len(samples))
        columns = stages.write_table(samples, path, lambda n: advance(n, ""))
        if samples.design is not None and not beside.exists():
            write_design(samples.design, beside)
            files.append(beside)
        result |= {"samples": len(samples), "columns": len(columns)}
        text = f"{len(samples)} samples, {len(columns)} columns"
    caller.answer(lambda: result, text, *files)
    return path


def _write_header(design: SensorDesign, path: Path) -> Path:
    """Write what the firmware has to know of a sensor."""
    to_write("out", path, ".h")
    array, layout = design.array, design.unit.layout
    write_text(stages.sensor_header(array.rows, array.cols, layout), path)
    (n_rows, n_columns), n = wires(array.rows, array.cols, layout), design.n_units * len(layout.pillars)
    result = {"file": str(path), "row_wires": n_rows, "column_wires": n_columns, "channels": n}
    result |= {"rate_hz": stages.usual_rate(n)}
    text = f"{n} channels on {n_rows} row and {n_columns} column wires, {result['rate_hz']} scans a second"
    current().answer(lambda: result, text, path)
    return path


def damage(path: Path, recorded: "stages.Recording") -> str:
    """One line on what of a file is damaged and left out; empty if nothing is."""
    places = [f"byte {at}" for at in recorded.damaged_at[:MAX_NAMED]]
    if (more := len(recorded.damaged_at) - MAX_NAMED) > 0:
        places.append(f"{more} more places")
    ends = "its last frame is cut off" if recorded.truncated_bytes else ""
    if recorded.received_s is None and not places and (lines := recorded.statistics.bad_form):
        ends = f"{lines} lines that are no matrix of numbers from 0 on are left out"
    said = "; ".join(part for part in (f"damaged at {', '.join(places)}, left out" if places else "", ends) if part)
    return f"warning: {path}: {said}" if said else ""


def write(thing: "Written", path: Path | str) -> None:
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
    path = Path(path)
    if isinstance(thing, SensorDesign):
        write_design(thing, path)
    elif isinstance(thing, stages.ArrayResponse):
        stages.write_response(thing, path)
    elif isinstance(thing, stages.Samples):
        thing.write(path)
    elif isinstance(thing, stages.Twin):
        decoder = path.with_suffix(".safetensors")
        if decoder == path:
            raise ArgumentError(f"{path} is the name of the twin's decoder: give the twin one that ends in .toml.")
        stages.write_model(thing.decoder, decoder)
        stages.write_twin(thing, path, decoder)
    elif isinstance(thing, stages.Decoupler) and path.suffix in (".onnx", ".h"):
        stages.export_model(thing, path)
    elif isinstance(thing, stages.Decoder):
        stages.write_model(thing, path)
    else:
        raise ArgumentError(
            f"a {type(thing).__name__} cannot be written: give a design, a response, samples, a model or a twin."
        )
