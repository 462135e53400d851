"""A sensor on the table: what is connected, its forces, recordings, its state at rest."""

import math
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from common.errors import DesignError, FileFormatError
from tripillar.face import stages
from tripillar.face.caller import current
from tripillar.face.exporting import damage
from tripillar.face.inputs import BOARD, LINES, WIRES, File, ModelLike, job, model_of, to_write
from tripillar.face.streaming import FILES, STREAMS, AskedStreams

LARGE = 2**24  #: bytes of a recording that take a second or a few to read
SHORT = 10_000  #: frames of a recording whose forces take a second or a few


@job()
def info(
    port: str | None = None,
    /,
    *,
    seconds: float | None = None,
    model: ModelLike | None = None,
    **link: Annotated[Any, BOARD],
) -> dict[str, Any]:
    """List the serial ports of this machine; or ask a board what it is: size, rate, circuit, firmware.

    With seconds the link is measured: rate, losses, jitter, and latency from a scan's last byte to its forces.

    Parameters
    ----------
    port : str, optional
        Serial port, socket://host:port, or a recording; default: list the serial ports.
    seconds : float, optional
        Time to measure the link for [s]; default: only ask the board.
    model : Decoupler or path, optional
        Model file for the latency of forces, with seconds; default: frames are only read.
    **link
        Fields of `inputs.Board`: calibration, baud and timeout.

    Returns
    -------
    dict
        What was found, as JSON has it.
    """
    caller = current()
    if seconds is None and (model is not None or link.get("calibration") is not None):
        raise DesignError("model= and calibration= are for measuring the link: add seconds= too, or leave them out.")
    if port is None:
        ports = [
            {"device": each.device, "description": each.description, "hardware_id": each.hwid}
            for each in sorted(stages.comports())
        ]
        if not ports and not caller.as_json:
            caller.say("no serial port: plug the board in, or run 'tripillar board'")
        result: dict[str, Any] = {"ports": ports}
        caller.answer(lambda: result, "\n".join("  ".join(each.values()) for each in ports))
        return result
    decoupler = None if model is None else model_of(model)
    with stages.connect(port, **link) as (scanner, known):
        if seconds is not None:
            sensor = None if decoupler is None else stages.LiveSensor(scanner, decoupler, known)
            measured = stages.measure_link(scanner, sensor, seconds)
        else:
            board, errors = scanner.info, scanner.errors()
            result = board.plain() | ({} if errors is None else asdict(errors))
            caller.answer(lambda: result, "\n".join(f"{name:11} {value}" for name, value in result.items()))
            return result
    shown = {name: value for name, value in measured.items() if name not in ("latency_ms", "statistics")}
    shown |= {f"latency_{name}_ms": value for name, value in (measured["latency_ms"] or {}).items()}
    lines = [f"{name:18} {f'{value:.3g}' if isinstance(value, float) else value}" for name, value in shown.items()]
    met = [f"{name:18} {value}" for name, value in measured["statistics"].items()]
    caller.answer(lambda: measured, "\n".join([*lines, "", "what was met", *met]))
    return measured


@job(**dict.fromkeys(FILES))
def watch(
    port: str,
    /,
    model: ModelLike,
    *,
    rubber: File | None = None,
    seconds: float = math.inf,
    rate_hz: int | None = None,
    describe: bool = False,
    **more: Annotated[Any, STREAMS, BOARD],
) -> None:
    """Show the forces on a sensor as they come: heat map, shear, net load, rate, losses.

    With JSON every scan is a line; its deviations are at most 0.1 s old. In Python `tripillar.live` gives the forces.

    Parameters
    ----------
    port : str
        Serial port, socket://host:port, or a recording.
    model : Decoupler or path
        Model file.
    rubber : path, optional
        Rubber file (.toml) whose memory is taken out of the readings once a hold or a rest has shown it; default: that
        of the model's design, if any.
    seconds : float
        Seconds after which to stop; default: on Ctrl-C.
    rate_hz : int, optional
        Number of scans a second to ask the board for; default: its own.
    describe : bool
        Print first a line that describes the sensor, with JSON.
    **more
        Fields of `streaming.AskedStreams`, to be shown by other programs too, and of `inputs.Board`.
    """
    caller = current()
    if rate_hz is not None and Path(port).is_file():
        raise DesignError("a recording has the rate that it was made at: leave rate_hz= out.")
    if describe and not caller.as_json:
        raise DesignError("describe=True prints a line of JSON: add --json, or leave describe=True out.")
    asked = AskedStreams(**STREAMS.of(more))
    asked.require()
    with stages.live(port, model, rubber=rubber, **BOARD.of(more)) as sensor:
        if rate_hz is not None:
            sensor.scanner.set_rate(rate_hz)
        with asked.opened(sensor.description) as streams:
            if caller.as_json:
                stages.print_lines(sensor, seconds, streams, describe)
            else:
                if caller.is_typed and not sys.stdout.isatty():
                    caller.say("stdout is no terminal: it gets the last picture alone; --json prints a line a scan")
                stages.show_forces(sensor, seconds, streams)


@job(out=".frames")
def record(
    port: str,
    /,
    out: File,
    seconds: float = math.inf,
    *,
    model: ModelLike | None = None,
    append: bool = False,
    **link: Annotated[Any, BOARD],
) -> int:
    """Record what a board sends, raw, as it comes; a killed recording loses one scan.

    `replay` makes forces of a recording, `export` NetCDF or CSV.

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
    append : bool
        Continue the recording, of the same board.
    **link
        Fields of `inputs.Board`; the calibration is kept with the scans.

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
    caller, path, decoupler = current(), Path(out), None if model is None else model_of(model)
    with stages.connect(port, queue=stages.RECORDING_QUEUE, **link) as (scanner, known):
        if decoupler is not None:
            stages.LiveSensor(scanner, decoupler, known)  # refuses a model of another sensor
        hashes = {} if decoupler is None else stages.hashes_of(decoupler)
        advance = _progress if caller.is_typed and not caller.bars.is_quiet else None
        calibration = known if link.get("calibration") else None
        n, met = stages.record_scans(scanner, path, seconds, calibration, hashes, append, advance)
    if advance is not None:
        print("\r\033[K", end="", file=sys.stderr)
    text = ", ".join([f"{n} scans, {met.lost} lost, {met.overruns_said}", *other_counts(met)])
    caller.answer(lambda: {"file": str(path), "scans": n, "statistics": asdict(met)}, text, path)
    return n


def other_counts(met: "stages.LinkStatistics") -> list[str]:
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
    """Show a recording's progress on one line of stderr, also of one that is kept in a file."""
    print(f"\r{seconds:.0f} s  {scans} scans  {trouble or ''}\033[K", end="", file=sys.stderr, flush=True)


@job(out=None)
def replay(
    recording: File,
    /,
    model: ModelLike,
    *,
    calibration: File | None = None,
    rubber: File | None = None,
    speed: float | None = None,
    out: File | None = None,
    crosstalk: bool = True,
    **log: Annotated[Any, LINES],
) -> "stages.Forces | None":
    """Turn a recording into forces, or watch it again.

    Parameters
    ----------
    recording : path
        Recording (.frames), a board's bytes, or a log of plain numbers.
    model : Decoupler or path
        Model file, trained for this array.
    calibration : path, optional
        Calibration file to use instead of the one in the recording, if any.
    rubber : path, optional
        Rubber file (.toml) whose memory is taken out of the readings once a hold or a rest has shown it; default: that
        of the model's design, if any.
    speed : float, optional
        Pace at which to show it as `live` does, 1 being its own; default: all at once.
    out : path, optional
        File for the forces of every frame: .nc, or .mcap, of messages of ROS 2.
    crosstalk : bool
        Correct the crossbar's crosstalk.
    **log
        Fields of `inputs.Board` that say what a log of plain numbers is.

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
    to_write("out", out, ".nc .mcap", (recording, model, calibration))
    if speed is not None:
        if not speed >= 1e-3:
            raise DesignError(f"speed={speed:g} must be 0.001 or more; 1 is as recorded, inf as fast as can be.")
        if out is not None or not crosstalk:
            raise DesignError("speed= only shows forces: leave out= and crosstalk=False out, or leave speed= itself.")
    decoupler, is_large = model_of(model), source.is_file() and source.stat().st_size > LARGE
    reading = caller.bars.begin("recording", total=1) if is_large else lambda share, _: None
    recorded = stages.read_recording(source, stages.matrix_info(**LINES.of(log)))
    reading(1, "")
    if speed is not None:
        with stages.live(str(source), decoupler, calibration, speed, rubber, **log) as sensor:
            (stages.print_lines if caller.as_json else stages.show_forces)(sensor, math.inf)
        return None
    own = None if calibration is None else stages.read_calibration(Path(calibration))
    causal = stages.follows(decoupler, rubber)
    hashes, n = stages.hashes_of(decoupler), len(recorded.counts)
    advance = caller.bars.begin("forces", total=n) if n > SHORT else lambda scans, _: None
    forces = stages.replay(recorded, decoupler, own, crosstalk, causal, lambda scans: advance(scans, ""))
    caller.say(damage(source, recorded))
    if len({hashes.get("design_hash"), recorded.made_from.get("design_hash")} - {None, ""}) == 2:
        caller.say("warning: recorded for a model of another design: its forces are those of the design of model=")
    if out is not None:
        text = recorded.calibration if own is None else own.to_json()
        stages.write_forces(replace(recorded, calibration=text, made_from=hashes), forces, Path(out))
    frames, saturated = len(forces.force_n), int(forces.saturated.any(axis=(1, 2, 3)).sum())
    partial, unreliable = int(forces.left_out.any(axis=(1, 2, 3)).sum()), int(forces.unreliable.sum())
    unexplained, lost, component = int(forces.unexplained.sum()), recorded.statistics.lost, decoupler.component
    result: dict[str, Any] = {"frames": frames, "saturated_frames": saturated, "unexplained_frames": unexplained}
    result |= {"left_out": forces.named_out(), "partial_frames": partial, "unreliable_frames": unreliable}
    result |= {"faults": forces.faults, "statistics": asdict(recorded.statistics), "axes": component.axes}
    lines = [f"{frames} frames, {lost} lost, {saturated} with a saturated pillar"]
    if partial:
        lines.append(
            f"{partial} without pillars that no strain explains, {unreliable} of them not reliable: {forces.said_out()}"
        )
    for name, newtons in zip(component.forces, forces.force_n.transpose(3, 0, 1, 2), strict=True):
        lines.append(f"{name}: {newtons.min():.1f} to {newtons.max():.1f} N, mean {newtons.mean():.1f} N")
    if unexplained:
        lines.append(
            f"{unexplained} that no load explains which the model knows: dead wire, other sensor, bare rubber?"
        )
    if forces.memory_rise is not None:
        lines.append(stages.memory_line(forces))
        result["memory_untested_frames"] = int((~forces.memory_tested).sum())
    lines += [f"{fault}, in {windows} windows of scans" for fault, windows in forces.faults.items()]

    def as_json() -> dict[str, Any]:
        if out is not None:
            return result
        chi2 = None if forces.chi2 is None else forces.chi2.tolist()
        return result | {"time_s": recorded.time_s.tolist(), "force_n": forces.force_n.tolist(), "chi2": chi2}

    caller.answer(as_json, "\n".join(lines), out)
    return forces


@job(out=None)
def tare(
    port: str,
    /,
    *,
    out: File,
    seconds: float = 2.0,
    force: bool = False,
    **more: Annotated[Any, WIRES, BOARD],
) -> "stages.SensorCalibration":
    """Zero a sensor: take what it shows now, with nothing on it, as its rest.

    `identify --help` says when to identify it instead.

    Parameters
    ----------
    port : str
        Serial port, socket://host:port, or a recording.
    out : path
        Calibration file to write (.json).
    seconds : float
        Time to average over [s].
    force : bool
        Write the file even if the readings cannot be what they should be.
    **more
        Fields of `inputs.Wires` and `inputs.Board`, whose calibration is built on.

    Returns
    -------
    SensorCalibration
        What was known of the sensor, and its rest.
    """
    path, calibration = Path(out), more.get("calibration")
    to_write("out", path)
    if path.exists() and (calibration is None or path.resolve() != Path(calibration).resolve()):
        raise FileFormatError(f"{path}: the file exists: build on it by calibration={path}, or give another name.")
    with stages.connect(port, **BOARD.of(more)) as (scanner, known):
        electronics = replace(known.electronics, **WIRES.of(more))
        crossbar, counts = electronics.crossbar(scanner.info), stages.counts_within(scanner, seconds)
        if not force:
            stages.require_still(counts, crossbar, scanner.info.rate_hz, seconds)
        measured_ohm, noise = stages.averaged(counts, crossbar)
        tared = replace(known, electronics=electronics, serial=scanner.info.serial).tared(measured_ohm)
    stages.write_calibration(tared, path)
    rest_ohm = measured_ohm.astype(object)
    rest_ohm[np.isnan(measured_ohm)] = None  # JSON knows no NaN
    least, most = np.nanmin(measured_ohm), np.nanmax(measured_ohm)
    text = f"pillars rest at {least:.0f} to {most:.0f} Ω, known to {100 * noise:.2f} %"
    current().answer(lambda: {"file": str(path), "noise": noise, "rest_ohm": rest_ohm.tolist()}, text, path)
    return tared
