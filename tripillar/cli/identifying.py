"""The command that identifies one sensor from measured pairs, and says which to measure next."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dataset.stored import DATASETS
from geometry.design_file import read_tolerances
from geometry.errors import DesignError, FileFormatError
from tripillar.cli.board.options import BAUD, TIMEOUT_S, BaudOption, ForceOption, TimeoutOption, require_positive
from tripillar.cli.learning import Protocol, caller
from tripillar.face.identifying import checked_pairs, few_pairs, usual_loads, with_derivatives
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
    from decoupler.inverse.effective_forces import EffectiveForces
    from fem.array.response import ArrayResponse
    from fem.array.sensitivities import ResponseSensitivities
    from geometry.design import SensorDesign

MAX_NEXT = 100  #: loads that are said in advance


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
        typer.Option(help="Number of pairs to use, from the first on; default: all, of more than 1000 a draw."),
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
        Path | None, typer.Option(help="Samples of the design at finite strain (.nc): what linear rubber misses.")
    ] = None,
    next_: Annotated[int, typer.Option("--next", help="Number of loads to propose to measure next.")] = 0,
    candidates: Annotated[
        Path | None, typer.Option(help="Table (CSV) of the loads that you can make; default: docs/measuring.md's.")
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
    require_other(out, data, loads, design, candidates, finite)
    require_other(twin_file, data, loads, design, candidates, finite, out)
    if twin_file is not None and out is None:
        raise DesignError("--twin names the model file that it goes with: give --out FILE, too.")
    if pairs is not None and pairs < 1:
        raise DesignError(f"--pairs {pairs} must be at least 1.")
    if not 0 <= next_ <= MAX_NEXT:
        raise DesignError(f"--next {next_} must be from 0 to {MAX_NEXT}.")
    from decoupler.model.model_file import write_model
    from decoupler.twin.identification import identify as identified
    from decoupler.twin.twin_file import write_twin

    sensor = _sensor(data, design)
    if port is None:
        read = None if data is None else _read(data, sensor)
    else:
        assert sensor is not None
        kept = keep or (None if out is None or Path(port).is_file() else out.with_suffix(".csv"))
        read = _measured(port, loads, sensor, kept, seconds, force, baud=baud, timeout=timeout)
    if read is not None and pairs is not None:
        if pairs > len(read):
            raise DesignError(f"--pairs {pairs} must be at most {len(read)}: there are no more.")
        read = read[:pairs]
    measured: Pairs | None = None
    with progress_bars(verbosity) as bars:
        response, sensitivities = (None, None) if sensor is None else with_derivatives(sensor, bars)
    if sensitivities is not None and design is not None:
        sensitivities = sensitivities.with_tolerances(read_tolerances(design))
    if usual is None and (data is None or data.suffix not in DATASETS):
        usual = "contact"
    usual_n = None if usual is None or sensor is None else usual_loads(sensor, usual)
    forced: dict[str, str] = {}
    if read is not None:
        asked_by = caller(data or Path(str(port)), bars)
        measured, forced = checked_pairs(few_pairs(read, asked_by, pairs), response, force, asked_by)
    result: dict[str, Any] = {}
    lines = []
    known = None
    if measured is not None:
        correction = None if finite is None else _correction(finite, response)
        twin = identified(measured, response, sensitivities, loads_n=usual_n, correction=correction)
        result["pairs"] = len(measured)
        result["parameters"] = {name: list(value) for name, value in twin.parameters.items()}
        result["excess"] = twin.posterior.excess
        lines += [f"{name}: {value:.5g} ± {deviation:.2g}" for name, (value, deviation) in twin.parameters.items()]
        lines.append(f"{len(measured)} pairs; χ² of their readings over their number: {twin.posterior.excess:.3g}")
        if out is not None:
            write_model(replace(twin.decoder, made_from=twin.decoder.made_from | forced), out)
            result["file"] = str(out)
            if twin_file is not None:
                write_twin(twin, twin_file, out)
                result["twin"] = str(twin_file)
        if twin.decoder.component.name == "all":
            known = (twin.posterior.expected, twin.posterior.state)
    if next_:
        if sensor is None or response is None or sensitivities is None:
            raise DesignError("--next weighs loads by a design: give --design.")
        proposals = _next(sensor, response, sensitivities, known, measured, usual or "contact", candidates, next_)
        result["next"] = proposals
        lines.append(f"expected error of a force before: {100 * proposals[0]['error_before']:.3g} % of the usual ones")
        lines += [f"next: {each['load']}; then {100 * each['error']:.3g} %" for each in proposals]
    answer(json_, result, "\n".join(lines), *([] if out is None or measured is None else [out]))


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
    if design is not None or data is None or data.suffix not in DATASETS:
        return chosen(design)
    from dataset import read_samples

    return read_samples(data, labels_only=True).design


def _read(data: Path, sensor: "SensorDesign | None") -> "AnySamples | Pairs":
    from dataset import read_samples
    from decoupler.data.load_table import read_pairs

    if sensor is None or data.suffix in DATASETS:
        samples = read_samples(data, labels_only=True)
        if sensor is not None and samples.shape != (sensor.array.rows, sensor.array.cols):
            raise DesignError(f"{data} is of another array than the design: give this array's design.")
        return samples
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


def _correction(finite: Path, response: "ArrayResponse | None") -> "EffectiveForces | None":
    """The correction of a design's response by its samples at finite strain."""
    from dataset import in_memory, read_samples
    from decoupler.data.columns import component_named, force_columns, pillar_columns
    from decoupler.inverse.forward_model import ForwardModel
    from decoupler.training.finite_strain import at_finite_strain

    if response is None:
        raise DesignError("--finite goes with a design: give --design.")
    samples, everything = in_memory(read_samples(finite, labels_only=True)), component_named("all")
    size = response.design.array.rows, response.design.array.cols
    if samples.force_n.shape[1:3] != size:
        raise FileFormatError(f"{finite} is of another array than the design's {size[0]} × {size[1]} units.")
    columns = pillar_columns(samples.resistance_ohm, everything), force_columns(samples.force_n, everything)
    electrodes = ForwardModel.of(replace(response, conducted=None), everything).influence
    return at_finite_strain(ForwardModel.of(response, everything), size, *columns, electrodes).correction


def _next(
    sensor: "SensorDesign",
    response: "ArrayResponse",
    sensitivities: "ResponseSensitivities",
    known: Any,
    measured: "Pairs | None",
    protocol: Protocol,
    candidates: Path | None,
    count: int,
) -> list[dict[str, Any]]:
    """Loads to measure next, in order, each with the expected errors before and after it."""
    from decoupler.data.columns import component_named, force_columns
    from decoupler.twin.expectation import Expectation
    from decoupler.twin.next_load import Knowledge, as_columns, choose, kitchen_loads
    from decoupler.twin.posterior import State
    from tripillar.cli.board.measured_loads import loads_of

    everything = component_named("all")
    if known is None:
        expected = Expectation.of(response, sensitivities, everything)
        known = expected, State.as_expected(expected, 0)
    noise, bits = (1e-3, None) if measured is None else (max(measured.noise, 1e-5), measured.bits)
    expected, state = known
    knowledge = Knowledge.before(expected, state, noise, bits)
    done = 0 if measured is None else len(measured)
    for number in range(done):
        assert measured is not None
        unknown_n = measured.unknown_n[number]
        force_n = force_columns(measured.force_n[number : number + 1], everything)[0]
        knowledge = knowledge.after(force_n, unknown_n.reshape(len(unknown_n), force_n.size))
    possible = kitchen_loads(sensor) if candidates is None else loads_of(candidates, sensor)
    if measured is not None:
        possible = [load for load in possible if load.name not in measured.names]
    usual_n = force_columns(usual_loads(sensor, protocol), everything)
    numbers, errors = choose(knowledge, [as_columns(load, everything) for load in possible], usual_n, count)
    return [
        {"load": possible[number].name, "error_before": errors[k], "error": errors[k + 1]}
        for k, number in enumerate(numbers)
    ]
