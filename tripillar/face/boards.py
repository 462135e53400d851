"""A sensor on the table: what is connected, its forces, recordings, its state at rest; or a board that is not there."""

import math
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from geometry.design import SensorDesign
from geometry.errors import DesignError, FileFormatError
from tripillar.face.caller import Caller, current
from tripillar.face.exporting import damage
from tripillar.face.inputs import (
    DesignLike,
    File,
    ModelLike,
    SceneLike,
    design_of,
    model_of,
    require_above_0,
    require_there,
    to_write,
)

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse
    from hardware.boards.simulated import Motion
    from hardware.link.frames import Info
    from hardware.link.reception import LinkStatistics
    from hardware.readout.calibration import SensorCalibration
    from hardware.readout.forces import Forces

    SensorLike = DesignLike | ArrayResponse
else:
    SensorLike = Path

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
        from hardware.link.serial_ports import list_ports

        found = list_ports()
        lines = [f"{each.device}  {each.description}  {each.hardware_id}" for each in found]
        if not found and not caller.as_json:
            caller.say("no serial port: plug the board in, or run 'tripillar board'")
        result: dict[str, Any] = {"ports": [asdict(each) for each in found]}
        caller.answer(lambda: result, "\n".join(lines))
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
    result = asdict(link)
    shown = {name: value for name, value in result.items() if name not in ("latency_ms", "statistics")}
    shown |= {f"latency_{name}_ms": value for name, value in (link.latency_ms or {}).items()}
    tables = {"The board's link": shown, "What was met": link.statistics}
    caller.answer(lambda: result, lambda: [plain_table(title, [row]) for title, row in tables.items()])
    return result


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
        with asked.opened(sensor.description, caller) as streams:
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
    >>> from dataclasses import replace
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
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
    >>> from dataclasses import replace
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> design, file = tp.SensorDesign(), Path(mkdtemp()) / "press.frames"
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
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

    caller.answer(told, "\n".join(lines), *([] if file is None else [file]))
    return found


def other_design(recorded: Mapping[str, str], used: Mapping[str, str]) -> bool:
    """True if both name their design, and not the same."""
    hashes = {made_from.get("design_hash") for made_from in (recorded, used)}
    return len(hashes - {None, ""}) == 2


def tare(
    port: str,
    /,
    *,
    out: File,
    calibration: File | None = None,
    switch_ohm: float | None = None,
    line_ohm: float | None = None,
    seconds: float = 2.0,
    baud: int = BAUD,
    timeout: float = TIMEOUT_S,
    force: bool = False,
) -> "SensorCalibration":
    """Zero a sensor: take what it shows now, with nothing on it, as its rest.

    `identify --help` says when to identify it instead.

    Parameters
    ----------
    port : str
        Serial port, socket://host:port, or a recording.
    out : path
        Calibration file to write (.json).
    calibration : path, optional
        Calibration file of this sensor to build on; default: as designed, switches of 25 Ω.
    switch_ohm : float, optional
        Resistance of a closed switch [Ω]; default: 25.
    line_ohm : float, optional
        Resistance of a wire to the pillars [Ω]; default: 0.
    seconds : float
        Time to average over [s].
    baud, timeout
        As of `info`.
    force : bool
        Write the file even if the readings cannot be what they should be.

    Returns
    -------
    SensorCalibration
        What was known of the sensor, and its rest.
    """
    caller, path = current(), to_write("out", out)
    assert path is not None
    require_above_0(seconds=seconds, timeout=timeout)
    if path.exists() and (calibration is None or path.resolve() != Path(calibration).resolve()):
        raise FileFormatError(f"{path}: the file exists: build on it by calibration={path}, or give another name.")
    import numpy as np

    from hardware.readout.averaging import averaged, require_still
    from hardware.readout.calibration import write_calibration
    from hardware.session import connect, counts_within

    with connect(port, calibration, baud=baud, timeout=timeout) as (scanner, known):
        given = {"switch_ohm": switch_ohm, "line_ohm": line_ohm}
        electronics = replace(known.electronics, **{name: ohm for name, ohm in given.items() if ohm is not None})
        crossbar, counts = electronics.crossbar(scanner.info), counts_within(scanner, seconds)
        if not force:
            require_still(counts, crossbar, scanner.info.rate_hz, seconds)
        measured_ohm, noise = averaged(counts, crossbar)
        tared = replace(known, electronics=electronics, serial=scanner.info.serial).tared(measured_ohm)
    write_calibration(tared, path)
    rest_ohm = measured_ohm.astype(object)
    rest_ohm[np.isnan(measured_ohm)] = None  # JSON knows no NaN
    least, most = np.nanmin(measured_ohm), np.nanmax(measured_ohm)
    text = f"pillars rest at {least:.0f} to {most:.0f} Ω, known to {100 * noise:.2f} %"
    caller.answer(lambda: {"file": str(path), "noise": noise, "rest_ohm": rest_ohm.tolist()}, text, path)
    return tared


@contextmanager
def board(
    design: SensorLike | None = None,
    *,
    chip: Annotated[Literal["auto", "atmega328p", "atmega2560", "python"], Parameter(name="--board")] = "auto",
    link: File | None = None,
    scene: SceneLike | None = None,
    pressure_mpa: float | None = None,
    period_s: float = 6.0,
    mode: Literal["zero-potential", "grounded", "divider"] = "zero-potential",
    rate_hz: int = 150,
    sense_ohm: int | None = None,
    switch_ohm: float | None = None,
    line_ohm: float | None = None,
    noise: float = 0.0,
    bits: int = 10,
    gain_spread: float = 0.0,
    offset_ohm: Annotated[float, Parameter(name="--offset")] = 0.0,
    specimen: int = 0,
    serial: int = 0,
    truth: File | None = None,
) -> Iterator[str]:
    """Simulate a board: a port that sends what a real one would.

    Where simavr is installed, the very firmware runs on a simulated chip. The port is a pseudo-terminal.

    Parameters
    ----------
    design : SensorDesign, ArrayResponse or path, optional
        Design file (TOML); default: the paper's sensor.
    chip : str
        Board to be: the firmware on a simulated chip, or the same frames from Python.
    link : path, optional
        Link of this name to the port, to be kept while it runs.
    scene : Scene or path, optional
        Scene file (TOML) of an array, pressed again and again.
    pressure_mpa : float, optional
        Largest pressure of an indenter that comes down on a corner, slides to the opposite one, and lifts [MPa]; 0: at
        rest; default: 3.
    period_s : float
        Period of the press and slide, or of the scene [s].
    mode : str
        Circuit that reads the array.
    rate_hz : int
        Number of scans a second.
    sense_ohm : int, optional
        Sense or feedback resistor [Ω]; default: one that suits 10 kΩ.
    switch_ohm, line_ohm
        As of `tare`.
    noise : float
        Standard deviation of a reading, as a fraction of full scale.
    bits : int
        Bits of the converter; chips have 10.
    gain_spread, offset_ohm, specimen
        As of `samples.dataset`.
    serial : int
        Serial number of the board.
    truth : path, optional
        NetCDF file to write: the true forces of one period.

    Yields
    ------
    str
        The port's name, for `live` and `record`, as long as the with block lasts.

    Examples
    --------
    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> model = tp.train(tp.dataset(design, samples=200, noise=0.001, bits=10), hidden=4)
    >>> with tp.board(design, chip="python") as port, tp.live(port, model) as scans:
    ...     scan = next(iter(scans))
    >>> scan.force_n.shape, scan.deviation_n.shape
    ((1, 2, 3), (1, 2, 3))
    """
    caller = current()
    written = to_write("truth", truth, ".nc")
    if not 0.1 <= period_s <= 600:
        raise DesignError(f"period_s={period_s:g} must be from 0.1 to 600 s.")
    if scene is not None and (design is not None or pressure_mpa is not None):
        raise DesignError("a scene has its own design and loads: leave design= and pressure_mpa= out.")
    from dataset.imperfections import Imperfections
    from hardware.boards.simulated import counts_over_time, run_board, suited_kind, write_truth
    from hardware.boards.virtual_board import NO_TERMINALS
    from hardware.readout.calibration import Electronics

    if sys.platform == "win32":
        raise DesignError(NO_TERMINALS)
    told = info_of(mode, sense_ohm, bits=bits, rate_hz=rate_hz, serial=serial)
    wires = {"switch_ohm": switch_ohm, "line_ohm": line_ohm}
    electronics = Electronics(**{name: ohms for name, ohms in wires.items() if ohms is not None})
    replace(electronics.crossbar(told), noise=noise)  # refuses nonsense before anything takes time
    specimen_of = Imperfections(gain_spread=gain_spread, offset_ohm=offset_ohm, specimen=specimen)
    motion = _motion(design, scene, 3.0 if pressure_mpa is None else pressure_mpa, period_s, caller)
    rows, cols = motion.resistance_ohm.shape[1:3]
    told = replace(told, rows=rows, cols=cols)
    suited, why = suited_kind(told) if chip == "auto" else (chip, "")
    caller.say(why)
    counts = counts_over_time(motion, replace(electronics.crossbar(told), noise=noise), specimen_of)
    if written is not None:
        write_truth(motion, written)
    with run_board(suited, told, counts, None if link is None else Path(link)) as running:
        port = str(link or running.port)
        files = [] if written is None else [written]
        caller.answer(lambda: {"port": port, "board": suited}, f"{suited} on {port}; Ctrl-C ends it", *files)
        yield port


def info_of(mode: str = "zero-potential", sense_ohm: int | None = None, **told: Any) -> "Info":
    """INFO frame of a simulated board; its sense resistor suits pillars of 10 kΩ unless another is given."""
    from hardware.link.frames import Info
    from hardware.readout.crossbar import SUITED_SENSE_OHM, scan_mode_named

    scan_mode = scan_mode_named(mode)
    sense = round(SUITED_SENSE_OHM[scan_mode]) if sense_ohm is None else sense_ohm
    return Info(scan_mode=scan_mode, sense_ohm=sense, **told)


def _motion(
    sensor: "SensorLike | None", scene: "SceneLike | None", peak_mpa: float, period_s: float, caller: Caller
) -> "Motion":
    """One period of a scene, or of the press and slide."""
    from hardware.boards.simulated import PressAndSlide, press_and_slide, scene_motion

    script = PressAndSlide(peak_mpa=peak_mpa, seconds=period_s)
    if scene is not None:
        from fem.scene.scene_file import read_scene

        return scene_motion(read_scene(Path(scene)) if isinstance(scene, Path | str) else scene, period_s)
    from tripillar.pipeline.run import respond

    if sensor is None or isinstance(sensor, SensorDesign | Path | str):
        return press_and_slide(respond(design_of(sensor), caller.bars)[1], script)
    return press_and_slide(sensor, script)
