"""Find a board, ask it, watch its forces, measure its link, record what it says and play it again."""

import math
import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from geometry.errors import DesignError
from tripillar.cli.board.options import (
    BAUD,
    TIMEOUT_S,
    BaudOption,
    CalibrationOption,
    LinesOption,
    ModelOption,
    PortArgument,
    SecondsOption,
    TimeoutOption,
    require_positive,
)
from tripillar.cli.board.streaming import (
    AskedStreams,
    FoxgloveAtOption,
    FoxgloveOption,
    FoxgloveTokenOption,
    McapOption,
    RerunAtOption,
    RerunOption,
    RrdOption,
)
from tripillar.terminal.console import (
    JsonOption,
    VerbosityOption,
    answer,
    output_file,
    require_other,
    require_suffix,
    say,
    spelled,
)

if TYPE_CHECKING:
    from hardware.link.reception import LinkStatistics
    from hardware.recording import Recording

RecordingArgument = Annotated[
    Path, typer.Argument(help="Recording, or what 'convert' made of one, or a board's bytes.")
]
MAX_NAMED = 3  #: places of damage in one line


def ports(json_: JsonOption = False) -> None:
    """List the serial ports of this machine."""
    from hardware.link.serial_ports import list_ports

    found = list_ports()
    if found or json_:
        lines = [f"{port.device}  {port.description}  {port.hardware_id}" for port in found]
        answer(json_, {"ports": [asdict(port) for port in found]}, "\n".join(lines))
    else:
        say("no serial port: plug the board in, or run 'tripillar simulate'")


def info(
    port: PortArgument, baud: BaudOption = BAUD, timeout: TimeoutOption = TIMEOUT_S, json_: JsonOption = False
) -> None:
    """Ask a board what it is: size, rate, circuit, firmware."""
    from hardware.session import connect

    require_positive(timeout=timeout)
    with connect(port, baud=baud, timeout=timeout) as (scanner, _):
        told, errors = scanner.info, scanner.errors()
    plain = (
        asdict(told)
        | ({} if errors is None else asdict(errors))
        | {"scan_mode": told.scan_mode.name, "firmware": ".".join(map(str, told.firmware))}
    )
    answer(json_, plain, "\n".join(f"{name:11} {value}" for name, value in plain.items()))


def live(
    port: PortArgument,
    model: ModelOption,
    calibration: CalibrationOption = None,
    seconds: SecondsOption = math.inf,
    rate: Annotated[
        int | None, typer.Option(help="Number of scans a second to ask the board for; default: its own.")
    ] = None,
    baud: BaudOption = BAUD,
    timeout: TimeoutOption = TIMEOUT_S,
    foxglove: FoxgloveOption = False,
    foxglove_at: FoxgloveAtOption = None,
    foxglove_token: FoxgloveTokenOption = None,
    mcap: McapOption = None,
    rerun: RerunOption = False,
    rerun_at: RerunAtOption = None,
    rrd: RrdOption = None,
    describe: Annotated[
        bool, typer.Option("--describe", help="With --json, print first a line that describes the sensor.")
    ] = False,
    json_: LinesOption = False,
) -> None:
    """Show the forces on a sensor as they come: heat map, shear, net load, rate, losses.

    With --json every scan is a line; its deviations are at most 0.1 s old. --foxglove and --rerun show every scan to
    these viewers as well.
    """
    from hardware.session import live as live_forces
    from hardware.streams.addresses import LOOPBACK
    from tripillar.terminal.force_view import print_lines, show_forces

    if rate is not None and Path(port).is_file():
        raise DesignError("a recording has the rate that it was made at: leave --rate out.")
    if describe and not json_:
        raise DesignError("--describe prints a line of JSON: add --json, or leave --describe out.")
    require_positive(seconds=seconds, timeout=timeout)
    asked = AskedStreams(
        foxglove=foxglove_at or (LOOPBACK if foxglove else None),
        token=foxglove_token,
        mcap=mcap,
        rerun=rerun_at or (LOOPBACK if rerun else None),
        rrd=rrd,
    )
    asked.require()
    with live_forces(port, model, calibration, baud=baud, timeout=timeout) as sensor:
        if rate is not None:
            with spelled(rate_hz="--rate"):
                sensor.scanner.set_rate(rate)
        with asked.opened(sensor.description) as streams:
            if json_:
                print_lines(sensor, seconds, streams, describe)
            else:
                show_forces(sensor, seconds, streams)


def bench(
    port: PortArgument,
    model: Annotated[Path | None, typer.Option(help="Model file; default: frames are only read.")] = None,
    calibration: CalibrationOption = None,
    seconds: Annotated[float, typer.Option(help="Time to measure for [s].")] = 10.0,
    baud: BaudOption = BAUD,
    timeout: TimeoutOption = TIMEOUT_S,
    json_: JsonOption = False,
) -> None:
    """Measure a board's link: rate, losses, jitter, and latency.

    Latency is the time from the last byte of a scan to its forces.
    """
    from decoupler.model.model_file import read_model
    from hardware.readout.forces import LiveSensor
    from hardware.session import connect, measure_link
    from tripillar.terminal.tables import plain_table

    require_positive(seconds=seconds, timeout=timeout)
    decoupler = None if model is None else read_model(model)
    with connect(port, calibration, baud=baud, timeout=timeout) as (scanner, known):
        sensor = None if decoupler is None else LiveSensor(scanner, decoupler, known)
        found = measure_link(scanner, sensor, seconds)
    result = asdict(found)
    shown = {name: value for name, value in result.items() if name not in ("latency_ms", "statistics")}
    shown |= {f"latency_{name}_ms": value for name, value in (found.latency_ms or {}).items()}
    tables = {"The board's link": shown, "What was met": found.statistics}
    answer(json_, result, lambda: [plain_table(title, [row]) for title, row in tables.items()])


def record(
    port: PortArgument,
    out: Annotated[Path, typer.Option("--out", "-o", callback=output_file, help="File to write; it ends in .frames.")],
    model: Annotated[
        Path | None, typer.Option(help="Model file that the recording is meant for: its hash goes along.")
    ] = None,
    calibration: CalibrationOption = None,
    seconds: SecondsOption = math.inf,
    append: Annotated[bool, typer.Option("--append", help="Continue the recording --out, of the same board.")] = False,
    baud: BaudOption = BAUD,
    timeout: TimeoutOption = TIMEOUT_S,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Record what a board sends, raw, as it comes; a killed recording loses one scan.

    'replay' makes forces of a recording, 'convert' NetCDF, MCAP or CSV.
    """
    from decoupler.model.model_file import read_model
    from hardware.readout.forces import LiveSensor
    from hardware.session import RECORDING_QUEUE, connect, hashes_of, record_scans

    require_positive(seconds=seconds, timeout=timeout)
    if out.suffix in (".nc", ".mcap", ".csv"):
        raise DesignError(f"{out}: record to {out.with_suffix('.frames')}, then 'tripillar convert' makes {out} of it.")
    require_suffix("--out", out, ".frames")
    decoupler = None if model is None else read_model(model)
    with connect(port, calibration, baud=baud, timeout=timeout, queue=RECORDING_QUEUE) as (scanner, known):
        if decoupler is not None:
            LiveSensor(scanner, decoupler, known)  # refuses a model of another sensor
        hashes = {} if decoupler is None else hashes_of(decoupler)
        advance = None if verbosity is False else progress
        n, met = record_scans(scanner, out, seconds, known if calibration else None, hashes, append, advance)
    if advance is not None:
        print("\r\033[K", end="", file=sys.stderr)
    text = ", ".join([f"{n} scans, {met.lost} lost, {met.overruns_said}", *other_counts(met)])
    answer(json_, {"file": str(out), "scans": n, "statistics": asdict(met)}, text, out)


def other_counts(met: "LinkStatistics") -> list[str]:
    """Other events of the link, in words; those that did not happen are left out."""
    damaged = met.bad_cobs + met.bad_crc + met.bad_form
    named = {
        "damaged": damaged,
        "repeated": met.repeated,
        "of another board": met.foreign,
        "restarts": met.restarts,
        "reconnects": met.reconnects,
        "of the lost because this computer was too slow": met.dropped,
    }
    return [f"{n} {what}" for what, n in named.items() if n]


def convert(
    recording: RecordingArgument,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="File to write: .nc (NetCDF), .mcap (Foxglove, ROS) or .csv.")
    ],
    json_: JsonOption = False,
) -> None:
    """Turn a recording into NetCDF, MCAP or CSV, whole or not at all."""
    from hardware import convert as write_converted
    from hardware import read_recording

    require_suffix("--out", out, ".nc", ".mcap", ".csv")
    require_other(out, recording)
    recorded = read_recording(recording)
    say(damage(recording, recorded))
    write_converted(recorded, out)
    n, met = len(recorded.run), recorded.statistics
    answer(json_, {"file": str(out), "frames": n, "statistics": asdict(met)}, f"{n} frames, {met.lost} lost", out)


def damage(path: Path, recorded: "Recording") -> str:
    """One line on what of a file is damaged and left out; empty if nothing is."""
    found = [f"byte {at}" for at in recorded.damaged_at[:MAX_NAMED]]
    if (more := len(recorded.damaged_at) - MAX_NAMED) > 0:
        found.append(f"{more} more places")
    ends = "its last frame is cut off" if recorded.truncated_bytes else ""
    said = "; ".join(part for part in (f"damaged at {', '.join(found)}, left out" if found else "", ends) if part)
    return f"warning: {path}: {said}" if said else ""


def progress(seconds: float, scans: int, trouble: str | None) -> None:
    """Show a recording's progress on one line of stderr."""
    print(f"\r{seconds:.0f} s  {scans} scans  {trouble or ''}\033[K", end="", file=sys.stderr, flush=True)


def replay(
    recording: RecordingArgument,
    model: ModelOption,
    calibration: Annotated[
        Path | None, typer.Option(help="Calibration file to use instead of the one in the recording, if any.")
    ] = None,
    speed: Annotated[
        float | None, typer.Option(help="Times its own pace at which to show it, as 'live' does; default: all at once.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            callback=output_file,
            help="File for the forces of every frame: .nc, or .mcap with the counts beside.",
        ),
    ] = None,
    ros2: Annotated[
        bool, typer.Option("--ros2", help="Write messages of ROS 2 into the .mcap of --out, in place of JSON.")
    ] = False,
    crosstalk: Annotated[bool, typer.Option(help="Correct the crossbar's crosstalk.")] = True,
    json_: JsonOption = False,
) -> None:
    """Turn a recording into forces, or watch it again."""
    from decoupler.model.model_file import read_model
    from hardware import read_calibration, read_recording, write_forces
    from hardware import replay as replay_frames
    from hardware.session import hashes_of
    from hardware.session import live as live_forces

    require_suffix("--out", out, ".nc", ".mcap")
    if ros2 and (out is None or out.suffix != ".mcap"):
        raise DesignError("--ros2 says what is in an MCAP file: add --out FILE.mcap, or leave --ros2 out.")
    require_other(out, recording, model, calibration)
    decoupler = read_model(model)
    if speed is not None:
        if not speed >= 1e-3:
            raise DesignError(f"--speed {speed:g} must be 0.001 or more; 1 is as recorded, inf as fast as can be.")
        if out is not None or not crosstalk:
            raise DesignError("--speed only shows forces: leave --out and --no-crosstalk out, or leave out --speed.")
        from tripillar.terminal.force_view import print_lines, show_forces

        read_recording(recording)  # refuses what is none before it is taken for a port
        with live_forces(str(recording), decoupler, calibration, speed) as sensor:
            (print_lines if json_ else show_forces)(sensor, math.inf)
        return
    recorded = read_recording(recording)
    say(damage(recording, recorded))
    own = None if calibration is None else read_calibration(calibration)
    hashes = hashes_of(decoupler)
    if other_design(recorded.made_from, hashes):
        say("warning: recorded for a model of another design: its forces are those of the design of --model")
    found = replay_frames(recorded, decoupler, own, crosstalk)
    frames, saturated = len(found.force_n), int(found.saturated.any(axis=(1, 2, 3)).sum())
    if out is not None:
        text = recorded.calibration if own is None else own.to_json()
        used = replace(recorded, calibration=text, made_from=hashes)
        write_forces(used, found, out, ros2)
    unexplained = int(found.unexplained.sum())
    result: dict[str, Any] = {"frames": frames, "saturated_frames": saturated, "unexplained_frames": unexplained}
    result["faults"] = found.faults
    result |= {"statistics": asdict(recorded.statistics), "axes": decoupler.component.axes}
    if json_ and out is None:
        result |= {"time_s": recorded.time_s.tolist(), "force_n": found.force_n.tolist()}
        result["chi2"] = None if found.chi2 is None else found.chi2.tolist()
    lines = [f"{frames} frames, {recorded.statistics.lost} lost, {saturated} with a saturated pillar (extrapolated)"]
    for name, newtons in zip(decoupler.component.forces, found.force_n.transpose(3, 0, 1, 2), strict=True):
        lines.append(f"{name}: {newtons.min():.1f} to {newtons.max():.1f} N, mean {newtons.mean():.1f} N")
    if unexplained:
        lines.append(f"{unexplained} that no load explains which the model knows: dead wire? another sensor?")
    lines += [f"{fault}, in {windows} windows of scans" for fault, windows in found.faults.items()]
    answer(json_, result, "\n".join(lines), *([] if out is None else [out]))


def other_design(recorded: Mapping[str, str], used: Mapping[str, str]) -> bool:
    """True if both name their design, and not the same."""
    hashes = {made_from.get("design_hash") for made_from in (recorded, used)}
    return len(hashes - {None, ""}) == 2
