"""The command that identifies one sensor from measured pairs, and says which to measure next."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dataset.table import holds_samples
from geometry.errors import DesignError
from tripillar.cli.board.options import BAUD, TIMEOUT_S, BaudOption, ForceOption, TimeoutOption, require_positive
from tripillar.cli.learning import Protocol, caller
from tripillar.face import identifying
from tripillar.terminal.console import (
    JsonOption,
    VerbosityOption,
    answer,
    chosen,
    output_file,
    progress_bars,
    require_other,
)

if TYPE_CHECKING:
    from decoupler.data.enough import AnySamples
    from decoupler.data.pairs import Pairs
    from decoupler.twin.next_load import NextLoad
    from geometry.design import SensorDesign


def identify(
    data: Annotated[
        Path | None, typer.Option(help="Measured pairs: a data set (.nc), or a table of loads with readings (.csv).")
    ] = None,
    port: Annotated[
        str | None, typer.Option(help="Board to measure pairs on, or a recording; with --loads or typed weights.")
    ] = None,
    loads: Annotated[Path | None, typer.Option(help="Table (CSV) of the loads to put on, with --port.")] = None,
    keep: Annotated[
        Path | None,
        typer.Option(help="Table (CSV) that measured pairs are added to at once, with --port; default: beside --out."),
    ] = None,
    design: Annotated[
        Path | None,
        typer.Option(
            "--design",
            help="Design file (TOML); default: the one that a data set states, or none; the paper's with a table.",
        ),
    ] = None,
    pairs: Annotated[
        int | None,
        typer.Option(help="Number of pairs to use, from the first on; default: all, of more than 20000 a draw."),
    ] = None,
    usual: Annotated[
        Protocol | None, typer.Option(help="Loads that it will meet; default: of a data set its own, else contact.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", callback=output_file, help="Model file to write (safetensors)."),
    ] = None,
    twin_file: Annotated[
        Path | None,
        typer.Option(
            "--twin", callback=output_file, help="Twin to write (TOML): the design as it was found, with deviations."
        ),
    ] = None,
    finite: Annotated[
        Path | None, typer.Option(help="Samples of the design at finite strain (.nc), displacements included.")
    ] = None,
    model: Annotated[
        Path | None, typer.Option(help="Model of the design at finite strain, trained on such samples: for --finite.")
    ] = None,
    next_: Annotated[int, typer.Option("--next", help="Number of loads to propose to measure next.")] = 0,
    have: Annotated[
        str | None,
        typer.Option(
            help="List of what you have, for --next: plate:20kg,pad:15kg,string:3kg,air:30kPa; or a table (CSV)."
        ),
    ] = None,
    seconds: Annotated[float, typer.Option(help="Time to average over under each load [s].")] = 1.0,
    baud: BaudOption = BAUD,
    timeout: TimeoutOption = TIMEOUT_S,
    force: ForceOption = False,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Identify one sensor from measured pairs: its decoder, and what is known of its design and pillars.

    One pair is enough to begin with. --next says which loads tell most.
    """
    _require_sense(data, port, loads, keep, out, next_)
    require_positive(seconds=seconds, timeout=timeout)
    require_other(out, data, loads, design, finite, model)
    require_other(twin_file, data, loads, design, finite, model, out)
    if finite is not None and model is not None:
        raise DesignError("give --finite or --model, not both: each holds the design at finite strain.")
    if twin_file is not None and out is None:
        raise DesignError("--twin names the model file that it goes with: give --out FILE, too.")
    if have is not None and not next_:
        raise DesignError("--have goes with --next: it says of what the loads to propose are made.")
    if pairs is not None and pairs < 1:
        raise DesignError(f"--pairs {pairs} must be at least 1.")
    if not 0 <= next_ <= identifying.MAX_NEXT:
        raise DesignError(f"--next {next_} must be from 0 to {identifying.MAX_NEXT}.")
    from dataset import read_samples
    from decoupler.model.model_file import read_model, write_model
    from decoupler.twin.twin_file import write_twin

    sensor = _sensor(data, design)
    tolerances = None if design is None else identifying.sensor_of(design, None)[1]
    if data is not None:
        read = _read(data, sensor)
    elif port is not None:
        kept = keep or (None if out is None or Path(port).is_file() else out.with_suffix(".csv"))
        read = _measured(port, loads, _known(sensor), kept, seconds, force, baud=baud, timeout=timeout)
    else:
        with progress_bars(verbosity) as bars:
            first = identifying.next_loads_of(_known(sensor), next_, have, usual or "contact", tolerances, bars)
        answer(json_, {"next": [vars(one) for one in first]}, "\n".join(_proposed(first)))
        return
    if pairs is not None:
        if pairs > len(read):
            raise DesignError(f"--pairs {pairs} must be at most {len(read)}: there are no more.")
        read = read[:pairs]
    if next_ and sensor is None:
        raise DesignError("--next weighs loads by a design: give --design.")
    with progress_bars(verbosity) as bars:
        twin = identifying.identify(
            read,
            sensor,
            usual=usual,
            tolerances=tolerances,
            finite=read_samples(finite) if finite is not None else None if model is None else read_model(model),
            next_loads=next_,
            have=have,
            force=force,
            caller=caller(data or Path(str(port)), bars),
        )
    excess = twin.excess
    result: dict[str, Any] = {
        "pairs": twin.n_pairs,
        "parameters": {name: list(value) for name, value in twin.parameters.items()},
        "excess": excess,
    }
    lines = [f"{name}: {value:.5g} ± {deviation:.2g}" for name, (value, deviation) in twin.parameters.items()]
    lines.append(f"{twin.n_pairs} pairs; χ² of their readings over their number: {excess:.3g}")
    if out is not None:
        write_model(twin.decoder, out)
        result["file"] = str(out)
        if twin_file is not None:
            write_twin(twin, twin_file, out)
            result["twin"] = str(twin_file)
    if next_:
        result["next"] = [vars(one) for one in twin.next_loads]
        lines += _proposed(twin.next_loads)
    answer(json_, result, "\n".join(lines), *([] if out is None else [out]))


def _proposed(loads: "tuple[NextLoad, ...]") -> list[str]:
    """Proposals as lines of text."""
    if not loads:
        return ["next: every load of the list is measured"]
    before = f"expected error of a force before: {100 * loads[0].error_before:.3g} % of the usual ones"
    return [before, *(f"next: {each.load}; then {100 * each.error:.3g} %" for each in loads)]


def _known(sensor: "SensorDesign | None") -> "SensorDesign":
    assert sensor is not None  # `_sensor` gives None for data sets alone
    return sensor


def _require_sense(
    data: Path | None, port: str | None, loads: Path | None, keep: Path | None, out: Path | None, next_: int
) -> None:
    """Refuse options that do not go together."""
    if data is not None and port is not None:
        raise DesignError("give --data or --port, not both.")
    if port is None and (loads is not None or keep is not None):
        raise DesignError("--loads and --keep go with --port: pairs of --data have their loads.")
    if data is None and port is None and not next_:
        raise DesignError("give --data FILE or --port PORT; --next alone says where to begin.")
    if out is None and not next_:
        raise DesignError("give --out FILE for the model, or --next for the loads to measure.")
    if out is not None and data is None and port is None:
        raise DesignError("--out needs pairs: give --data FILE or --port PORT.")


def _sensor(data: Path | None, design: Path | None) -> "SensorDesign | None":
    """The design: the stated one, else that of a data set, which may have none, else the paper's."""
    if design is not None or data is None or _is_table(data):
        return chosen(design)
    from dataset import read_samples

    return read_samples(data, labels_only=True).design


def _is_table(data: Path) -> bool:
    """Whether a file is a table of loads, not of samples."""
    return data.suffix == ".csv" and not holds_samples(data)


def _read(data: Path, sensor: "SensorDesign | None") -> "AnySamples | Pairs":
    from dataset import read_samples
    from decoupler.data.load_table import read_pairs

    if sensor is None or not _is_table(data):
        return read_samples(data, labels_only=True)
    return read_pairs(data, sensor.array.rows, sensor.array.cols, sensor.pad.size_mm**2)


def _measured(
    port: str,
    loads: Path | None,
    sensor: "SensorDesign",
    keep: Path | None,
    seconds: float,
    force: bool,
    **settings: Any,
) -> "Pairs":
    """Pairs that are measured on a board now, or found in a recording."""
    from hardware.readout.calibration import Electronics
    from tripillar.cli.board.measured_loads import measured_in_recording, measured_live

    if not Path(port).is_file():
        return measured_live(port, loads, sensor, Electronics(), seconds, force, keep, **settings)[0]
    if loads is None:
        raise DesignError("a recording needs --loads FILE with the columns from_s and to_s.")
    return measured_in_recording(Path(port), loads, sensor, Electronics(), force)[0]
