"""A sensor on the table: what is connected, its forces, recordings, its state at rest."""

import math
import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from geometry.errors import DesignError
from tripillar.face.caller import current
from tripillar.face.exporting import damage
from tripillar.face.inputs import (
    File,
    ModelLike,
    model_of,
    require_above_0,
    require_there,
    to_write,
)

if TYPE_CHECKING:
    from hardware.link.reception import LinkStatistics
    from hardware.readout.forces import Forces

BAUD = 1_000_000  #: as in `hardware.link.serial_ports`, which takes too long to load for a help text
TIMEOUT_S = 4.0  #: as in `hardware.link.scanner`
MODEL = "a model file of 'tripillar train' or 'identify'"


def info(
    port: str | None = None,
    /,
    *,
    seconds: float | None = None,
    model: ModelLike | None = None,
    calibration: File | None = None,
    baud: int = BAUD,
    timeout: float = TIMEOUT_S,
) -> dict[str, Any]:
    """List the serial ports of this machine; or ask a board what it is: size, rate, circuit, firmware.

    With seconds the board's link is measured: rate, losses, jitter, and latency, which is the time from the last byte
    of a scan to its forces.

    Parameters
    ----------
    port : str, optional
        Serial port, socket://host:port, or a recording; default: list the serial ports.
    seconds : float, optional
        Time to measure the link for [s]; default: only ask the board.
    model : Decoupler or path, optional
        Model file for the latency of forces, with seconds; default: frames are only read.
    calibration : path, optional
        Calibration file of this sensor; default: as designed, switches of 25 Ω.
    baud : int
        Speed of the serial port [bit/s].
    timeout : float
        Time to wait for the board's answer [s].

    Returns
    -------
    dict
        What was found, as JSON has it.
    """
    caller = current()
    require_above_0(timeout=timeout, **({} if seconds is None else {"seconds": seconds}))
    require_there(model, what=MODEL)
    if seconds is None and (model is not None or calibration is not None):
        raise DesignError("model= and calibration= are for measuring the link: add seconds= too, or leave them out.")
    if port is None:
        from serial.tools.list_ports import comports

        found = [
            {"device": each.device, "description": each.description, "hardware_id": each.hwid}
            for each in sorted(comports())
        ]
        if not found and not caller.as_json:
            caller.say("no serial port: plug the board in, or run 'tripillar board'")
        result: dict[str, Any] = {"ports": found}
        caller.answer(lambda: result, "\n".join("  ".join(each.values()) for each in found))
        return result
    from hardware.readout.forces import LiveSensor
    from hardware.session import connect, measure_link
    from tripillar.terminal.tables import plain_table

    decoupler = None if model is None else model_of(model)
    with connect(port, calibration, baud=baud, timeout=timeout) as (scanner, known):
        if seconds is None:
            told, errors = scanner.info, scanner.errors()
        else:
            sensor = None if decoupler is None else LiveSensor(scanner, decoupler, known)
            link = measure_link(scanner, sensor, seconds)
    if seconds is None:
        result = asdict(told) | ({} if errors is None else asdict(errors))
        result |= {"scan_mode": told.scan_mode.name, "firmware": ".".join(map(str, told.firmware))}
        caller.answer(lambda: result, "\n".join(f"{name:11} {value}" for name, value in result.items()))
        return result
    shown = {name: value for name, value in link.items() if name not in ("latency_ms", "statistics")}
    shown |= {f"latency_{name}_ms": value for name, value in (link["latency_ms"] or {}).items()}
    tables = {"The board's link": shown, "What was met": link["statistics"]}
    caller.answer(lambda: link, lambda: [plain_table(title, [row]) for title, row in tables.items()])
    return link


def watch(
    port: str,
    /,
    model: ModelLike,
    *,
    calibration: File | None = None,
    seconds: float = math.inf,
    rate_hz: int | None = None,
    baud: int = BAUD,
    timeout: float = TIMEOUT_S,
    foxglove: bool = False,
    foxglove_at: str | None = None,
    foxglove_token: str | None = None,
    mcap: File | None = None,
    rerun: bool = False,
    rerun_at: str | None = None,
    rrd: File | None = None,
    describe: bool = False,
) -> None:
    """Show the forces on a sensor as they come: heat map, shear, net load, rate, losses.

    With JSON every scan is a line; its deviations are at most 0.1 s old. Foxglove and Rerun are shown every scan. In
    Python `tripillar.live` gives the forces themselves.

    Parameters
    ----------
    port : str
        Serial port, socket://host:port, or a recording.
    model : Decoupler or path
        Model file.
    calibration
        As of `info`.
    seconds : float
        Seconds after which to stop; default: on Ctrl-C.
    rate_hz : int, optional
        Number of scans a second to ask the board for; default: its own.
    baud, timeout
        As of `info`.
    foxglove : bool
        Serve Foxglove by WebSocket, on 127.0.0.1:8765: this machine alone.
    foxglove_at : str, optional
        Address HOST:PORT to do so; 0.0.0.0 lets everybody in.
    foxglove_token : str, optional
        Token that lets in: only who opens ws://HOST:PORT/?token=TOKEN.
    mcap : path, optional
        File (.mcap) to write as well: what Foxglove is shown.
    rerun : bool
        Serve Rerun viewers by gRPC, on 127.0.0.1:9876: this machine alone.
    rerun_at : str, optional
        Address HOST:PORT to do so; 0.0.0.0 lets everybody in.
    rrd : path, optional
        File (.rrd) to write as well: what Rerun is shown.
    describe : bool
        Print first a line that describes the sensor, with JSON.
    """
    caller = current()
    require_there(model, what=MODEL)
    if rate_hz is not None and Path(port).is_file():
        raise DesignError("a recording has the rate that it was made at: leave rate_hz= out.")
    if describe and not caller.as_json:
        raise DesignError("describe=True prints a line of JSON: add --json, or leave describe=True out.")
    require_above_0(seconds=seconds, timeout=timeout)
    from hardware.session import live
    from hardware.streams.addresses import LOOPBACK
    from tripillar.face.streaming import AskedStreams
    from tripillar.terminal.force_view import print_lines, show_forces

    asked = AskedStreams(
        foxglove=foxglove_at or (LOOPBACK if foxglove else None),
        token=foxglove_token,
        mcap=None if mcap is None else Path(mcap),
        rerun=rerun_at or (LOOPBACK if rerun else None),
        rrd=None if rrd is None else Path(rrd),
    )
    asked.require()
    with live(port, model, calibration, baud=baud, timeout=timeout) as sensor:
        if rate_hz is not None:
            sensor.scanner.set_rate(rate_hz)
        with asked.opened(sensor.description) as streams:
            if caller.as_json:
                print_lines(sensor, seconds, streams, describe)
            else:
                show_forces(sensor, seconds, streams)


def record(
    port: str,
    /,
    out: File,
    seconds: float = math.inf,
    *,
    model: ModelLike | None = None,
    calibration: File | None = None,
    append: bool = False,
    baud: int = BAUD,
    timeout: float = TIMEOUT_S,
) -> int:
    """Record what a board sends, raw, as it comes; a killed recording loses one scan.

    `replay` makes forces of a recording, `export` NetCDF, MCAP or CSV.

    Parameters
    ----------
    port : str
        Serial port, socket://host:port, or a recording.
    out : path
        File to write; it ends in .frames.
    seconds : float
        Seconds after which to stop; default: on Ctrl-C.
    model : Decoupler or path, optional
        Model file that the recording is meant for: its hash goes along.
    calibration : path, optional
        Calibration file of this sensor, kept with the scans; default: as designed, switches of 25 Ω.
    append : bool
        Continue the recording, of the same board.
    baud, timeout
        As of `info`.

    Returns
    -------
    int
        Scans recorded.

    Examples
    --------
    >>> import tripillar as tp
    >>> from geometry import Array
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> design = tp.SensorDesign(array=Array(rows=1, cols=2))
    >>> with tp.board(design, chip="python") as port:
    ...     scans = tp.record(port, Path(mkdtemp()) / "press.frames", 0.2)
    >>> scans > 0
    True
    """
    caller, path = current(), Path(out)
    require_above_0(seconds=seconds, timeout=timeout)
    require_there(model, what=MODEL)
    if path.suffix in (".nc", ".mcap", ".csv"):
        raise DesignError(
            f"{path}: record to {path.with_suffix('.frames')}, then 'tripillar export' makes {path} of it."
        )
    to_write("out", path, ".frames")
    from hardware.readout.forces import LiveSensor
    from hardware.session import RECORDING_QUEUE, connect, hashes_of, record_scans

    decoupler = None if model is None else model_of(model)
    with connect(port, calibration, baud=baud, timeout=timeout, queue=RECORDING_QUEUE) as (scanner, known):
        if decoupler is not None:
            LiveSensor(scanner, decoupler, known)  # refuses a model of another sensor
        hashes = {} if decoupler is None else hashes_of(decoupler)
        advance = _progress if caller.is_typed and not caller.bars.is_quiet else None
        n, met = record_scans(scanner, path, seconds, known if calibration else None, hashes, append, advance)
    if advance is not None:
        print("\r\033[K", end="", file=sys.stderr)
    text = ", ".join([f"{n} scans, {met.lost} lost, {met.overruns_said}", *other_counts(met)])
    caller.answer(lambda: {"file": str(path), "scans": n, "statistics": asdict(met)}, text, path)
    return n


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


def _progress(seconds: float, scans: int, trouble: str | None) -> None:
    """Show a recording's progress on one line of stderr."""
    print(f"\r{seconds:.0f} s  {scans} scans  {trouble or ''}\033[K", end="", file=sys.stderr, flush=True)


def replay(
    recording: File,
    /,
    model: ModelLike,
    *,
    calibration: File | None = None,
    speed: float | None = None,
    out: File | None = None,
    ros2: bool = False,
    crosstalk: Annotated[bool, Parameter(negative="--no-crosstalk")] = True,
) -> "Forces | None":
    """Turn a recording into forces, or watch it again.

    Parameters
    ----------
    recording : path
        Recording, or what `export` made of one, or a board's bytes.
    model : Decoupler or path
        Model file, trained for this array.
    calibration : path, optional
        Calibration file to use instead of the one in the recording, if any.
    speed : float, optional
        Times its own pace at which to show it, as `live` does; default: all at once.
    out : path, optional
        File for the forces of every frame: .nc, or .mcap with the counts beside.
    ros2 : bool
        Write messages of ROS 2 into the .mcap file, in place of JSON.
    crosstalk : bool
        Correct the crossbar's crosstalk.

    Returns
    -------
    Forces or None
        ``time_s`` (n,), ``force_n`` and ``deviation_n`` (n, rows, cols, axes) [N]: forces and the half-widths that hold
        68 % of their errors, and `wrench`, the net load; computed when first asked for, twenty times as long as forces.
        None where it was shown at a speed.

    Examples
    --------
    >>> import tripillar as tp
    >>> from geometry import Array
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> design, file = tp.SensorDesign(array=Array(rows=1, cols=2)), Path(mkdtemp()) / "press.frames"
    >>> with tp.board(design, chip="python") as port:
    ...     scans = tp.record(port, file, 0.2)
    >>> model = tp.train(tp.dataset(design, samples=200, noise=0.001, bits=10), hidden=4)
    >>> tp.replay(file, model).force_n.shape == (scans, 1, 2, 3)
    True
    """
    caller, source = current(), Path(recording)
    file = to_write("out", out, ".nc", ".mcap", read=(source, model, calibration))
    if ros2 and (file is None or file.suffix != ".mcap"):
        raise DesignError("ros2=True says what is in an MCAP file: add out=FILE.mcap, or leave ros2=True out.")
    require_there(source, what="a recording")
    require_there(model, what=MODEL)
    require_there(calibration, what="a calibration file")
    if speed is not None:
        if not speed >= 1e-3:
            raise DesignError(f"speed={speed:g} must be 0.001 or more; 1 is as recorded, inf as fast as can be.")
        if file is not None or not crosstalk:
            raise DesignError(
                "speed= only shows forces: leave out= and crosstalk=False out, or leave out speed= itself."
            )
    from hardware import read_calibration, read_recording, write_forces
    from hardware import replay as replay_frames
    from hardware.session import hashes_of
    from hardware.session import live as live_forces

    decoupler, recorded = model_of(model), read_recording(source)
    if speed is not None:
        from tripillar.terminal.force_view import print_lines, show_forces

        with live_forces(str(source), decoupler, calibration, speed) as sensor:
            (print_lines if caller.as_json else show_forces)(sensor, math.inf)
        return None
    own = None if calibration is None else read_calibration(Path(calibration))
    hashes = hashes_of(decoupler)
    found = replay_frames(recorded, decoupler, own, crosstalk)
    caller.say(damage(source, recorded))
    if other_design(recorded.made_from, hashes):
        caller.say("warning: recorded for a model of another design: its forces are those of the design of model=")
    frames, saturated = len(found.force_n), int(found.saturated.any(axis=(1, 2, 3)).sum())
    if file is not None:
        text = recorded.calibration if own is None else own.to_json()
        write_forces(replace(recorded, calibration=text, made_from=hashes), found, file, ros2)
    unexplained = int(found.unexplained.sum())
    result: dict[str, Any] = {"frames": frames, "saturated_frames": saturated, "unexplained_frames": unexplained}
    result["faults"] = found.faults
    result |= {"statistics": asdict(recorded.statistics), "axes": decoupler.component.axes}
    lines = [f"{frames} frames, {recorded.statistics.lost} lost, {saturated} with a saturated pillar (extrapolated)"]
    for name, newtons in zip(decoupler.component.forces, found.force_n.transpose(3, 0, 1, 2), strict=True):
        lines.append(f"{name}: {newtons.min():.1f} to {newtons.max():.1f} N, mean {newtons.mean():.1f} N")
    if unexplained:
        lines.append(f"{unexplained} that no load explains which the model knows: dead wire? another sensor?")
    lines += [f"{fault}, in {windows} windows of scans" for fault, windows in found.faults.items()]

    def told() -> dict[str, Any]:
        if file is not None:
            return result
        chi2 = None if found.chi2 is None else found.chi2.tolist()
        return result | {"time_s": recorded.time_s.tolist(), "force_n": found.force_n.tolist(), "chi2": chi2}

    caller.answer(told, "\n".join(lines), file)
    return found


def other_design(recorded: Mapping[str, str], used: Mapping[str, str]) -> bool:
    """True if both name their design, and not the same."""
    hashes = {made_from.get("design_hash") for made_from in (recorded, used)}
    return len(hashes - {None, ""}) == 2
