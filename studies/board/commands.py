"""The commands of a connected sensor: find it, watch it, record it, calibrate it, or simulate one.

PORT is a serial port (/dev/ttyUSB0, COM3), a pseudo-terminal, socket://host:port, or a recording, which is played.
"""

import json
import math
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from geometry.errors import DesignError
from studies.console import DesignOption, JsonOption, QuietOption, chosen, progress_bars, say, show_json, wrote

if TYPE_CHECKING:
    from hardware.calibration import Electronics
    from studies.board.session import Session

board = typer.Typer()

PortArgument = Annotated[str, typer.Argument(metavar="PORT", help="Serial port, socket://host:port, or a recording.")]
ModelOption = Annotated[Path, typer.Option("--model", help="Model file.")]
CalibrationOption = Annotated[
    Path | None, typer.Option("--calibration", help="Of this sensor; default: as designed, switches of 25 Ω.")
]
SecondsOption = Annotated[float, typer.Option("--seconds", help="Stop after so long; default: on Ctrl-C.")]
BaudOption = Annotated[int, typer.Option("--baud", help="Bits a second.")]
TimeoutOption = Annotated[float, typer.Option("--timeout", help="Wait so long for the board's answer [s].")]
LinesOption = Annotated[bool, typer.Option("--json", help="One JSON object a line on stdout, for pipes.")]
SwitchOption = Annotated[float | None, typer.Option("--switch-ohm", help="Of a closed switch [Ω]; default: 25.")]
LineOption = Annotated[float | None, typer.Option("--line-ohm", help="Of a wire to the pillars [Ω]; default: 0.")]
BAUD, TIMEOUT_S, SHOWN_HZ = 1_000_000, 3.0, 10.0


@board.command()
def ports(json_: JsonOption = False) -> None:
    """List the serial ports of this machine."""
    from hardware.ports import list_ports

    found = list_ports()
    if json_:
        show_json({"ports": [asdict(port) for port in found]})
    else:
        for port in found:
            print(f"{port.device}  {port.description}  {port.hardware_id}")
        say("" if found else "no serial port: plug the board in, or run 'tripillar simulate'")


@board.command()
def info(
    port: PortArgument, baud: BaudOption = BAUD, timeout: TimeoutOption = TIMEOUT_S, json_: JsonOption = False
) -> None:
    """Ask a board what it is."""
    from studies.board.session import scanner_on

    with scanner_on(port, baud=baud, timeout=timeout) as scanner:
        told = scanner.info
    plain = asdict(told) | {"scan_mode": told.scan_mode.name, "firmware": ".".join(map(str, told.firmware))}
    if json_:
        show_json(plain)
    else:
        for name, value in plain.items():
            print(f"{name:10} {value}")


@board.command()
def live(
    port: PortArgument,
    model: ModelOption,
    calibration: CalibrationOption = None,
    seconds: SecondsOption = math.inf,
    rate: Annotated[int | None, typer.Option(help="Ask the board for so many scans a second.")] = None,
    baud: BaudOption = BAUD,
    timeout: TimeoutOption = TIMEOUT_S,
    json_: LinesOption = False,
) -> None:
    """Show the forces on the sensor as they come: heat map, shear, rate and losses."""
    from studies.board.session import scanner_on, session

    with scanner_on(port, baud=baud, timeout=timeout) as scanner:
        if rate is not None:
            scanner.set_rate(rate)
        _follow(session(scanner, model, calibration), seconds, json_)


@board.command()
def record(
    port: PortArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="File to write: .nc, or .mcap for Foxglove and ROS.")],
    model: Annotated[Path | None, typer.Option(help="Model the recording is meant for: its hash goes along.")] = None,
    calibration: CalibrationOption = None,
    seconds: SecondsOption = math.inf,
    append: Annotated[bool, typer.Option("--append", help="Continue a recording of the same board.")] = False,
    baud: BaudOption = BAUD,
    timeout: TimeoutOption = TIMEOUT_S,
    json_: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Record raw counts; a killed recording loses less than a second. MCAP holds the forces of --model, too."""
    from hardware.recording import recorder_for
    from hardware.recording.mcap_recorder import McapRecorder
    from studies.board.session import chosen_calibration, hashes_of, scanner_on, scans, session

    with scanner_on(port, baud=baud, timeout=timeout) as scanner:
        reading = None if model is None else session(scanner, model, calibration)
        text = "" if calibration is None else chosen_calibration(calibration, scanner).to_json()
        hashes = {} if reading is None else hashes_of(reading.model)
        unix_s = time.time() - time.perf_counter()
        start = told = time.monotonic()
        n = 0
        with recorder_for(out, scanner.info, text, hashes, append) as recorder:
            for scan in scans(scanner, seconds):
                now = time.monotonic()
                if scan is None:
                    recorder.append([], time.time())
                else:
                    n += 1
                    recorder.append(scan.frame, unix_s + scan.received_s)
                    if reading is not None and isinstance(recorder, McapRecorder):
                        found = reading.forces(scan)
                        recorder.append_forces(unix_s + scan.received_s, found.force_n, reading.model.component.axes)
                if not quiet and now - told > 1.0:
                    told = now
                    print(f"\r{now - start:.0f} s  {n} scans  {scanner.trouble or ''}\033[K", end="", file=sys.stderr)
                    sys.stderr.flush()
        statistics = asdict(scanner.stats)
    if not quiet:
        print("\r\033[K", end="", file=sys.stderr)
    if json_:
        show_json({"file": str(out), "scans": n, "statistics": statistics})
    else:
        print(f"{n} scans, {statistics['lost']} lost, {statistics['overruns']} overruns")
    wrote([out])


@board.command()
def replay(
    recording: Annotated[Path, typer.Argument(help="Recording: NetCDF, MCAP, or the bytes that a board sent.")],
    model: ModelOption,
    calibration: Annotated[
        Path | None, typer.Option(help="In place of the one that the recording holds, if any.")
    ] = None,
    speed: Annotated[
        float | None, typer.Option(help="Show it as 'live' does, at so many times its pace; default: all at once.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="File for the forces of every frame: .nc, or .mcap with the counts beside.")
    ] = None,
    crosstalk: Annotated[bool, typer.Option(help="Take the crossbar's crosstalk out of the counts.")] = True,
    json_: JsonOption = False,
) -> None:
    """Turn recorded frames into forces with a trained model."""
    from decoupler.model_file import read_model
    from hardware import read_calibration, read_recording, write_forces
    from hardware import replay as replay_frames

    if speed is not None:
        if not speed > 0:
            raise DesignError(f"--speed {speed:g} must be above 0; 1 is as recorded.")
        from studies.board.session import scanner_on, session

        with scanner_on(str(recording), speed=speed) as scanner:
            _follow(session(scanner, model, calibration), math.inf, json_)
        return
    decoupler, recorded = read_model(model), read_recording(recording)
    own = None if calibration is None else read_calibration(calibration)
    replayed = replay_frames(recorded, decoupler, own, crosstalk)
    frames, saturated = len(replayed.time_s), int(replayed.saturated.any(axis=(1, 2, 3)).sum())
    if out is not None and out.suffix == ".mcap":
        from hardware.recording.mcap_export import export_mcap

        export_mcap(recorded, replayed, out, decoupler.component.axes)
    elif out is not None:
        write_forces(replayed, decoupler.component.axes, out)
    if json_:
        counts = {"frames": frames, "saturated_frames": saturated, "statistics": asdict(replayed.statistics)}
        forces = {"time_s": replayed.time_s.tolist(), "force_n": replayed.force_n.tolist()}
        show_json(counts | {"axes": decoupler.component.axes} | ({} if out else forces))
    else:
        print(f"{frames} frames, {replayed.statistics.lost} lost, {saturated} with a saturated pillar (extrapolated)")
        for name, newtons in zip(decoupler.component.forces, replayed.force_n.transpose(3, 0, 1, 2), strict=True):
            print(f"{name}: {newtons.min():.1f} to {newtons.max():.1f} N, mean {newtons.mean():.1f} N")
    wrote([] if out is None else [out])


@board.command()
def tare(
    port: PortArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="Calibration file to write (JSON).")],
    calibration: CalibrationOption = None,
    switch_ohm: SwitchOption = None,
    line_ohm: LineOption = None,
    seconds: Annotated[float, typer.Option(help="Average over so long.")] = 2.0,
    baud: BaudOption = BAUD,
    timeout: TimeoutOption = TIMEOUT_S,
    json_: JsonOption = False,
) -> None:
    """Take what the sensor shows now, with nothing on it, for its state at rest."""
    from hardware.calibration import write_calibration
    from studies.board.session import chosen_calibration, mean_resistances, scanner_on

    with scanner_on(port, baud=baud, timeout=timeout) as scanner:
        before = chosen_calibration(calibration, scanner)
        before = replace(before, electronics=_electronics(before.electronics, switch_ohm, line_ohm))
        measured_ohm, noise = mean_resistances(scanner, before, seconds)
        tared = replace(before.tared(measured_ohm), serial=scanner.info.serial)
    write_calibration(tared, out)
    if json_:
        show_json({"file": str(out), "noise": noise, "rest_ohm": measured_ohm.tolist()})
    else:
        print(f"pillars rest at {measured_ohm.min():.0f} to {measured_ohm.max():.0f} Ω, noise {100 * noise:.2f} %")
    wrote([out])


@board.command()
def calibrate(
    port: PortArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="Calibration file to write (JSON).")],
    loads: Annotated[
        Path | None,
        typer.Option(help="CSV: load,row,col,fx_n,fy_n,fz_n; with from_s,to_s to find them in a recording."),
    ] = None,
    weights: Annotated[bool, typer.Option("--weights", help="Type weights in grams as you put them on.")] = False,
    design: DesignOption = None,
    switch_ohm: SwitchOption = None,
    line_ohm: LineOption = None,
    noise: Annotated[float | None, typer.Option(help="Of a resistance, relative; default: as measured.")] = None,
    seconds: Annotated[float, typer.Option(help="Average over so long under each load.")] = 1.0,
    baud: BaudOption = BAUD,
    timeout: TimeoutOption = TIMEOUT_S,
    json_: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Find gain and offset of every pillar from known loads, by least squares; one of them should be no load at all."""
    from hardware.calibration import write_calibration
    from studies.board.calibrating import calibrated, measured_in_recording, measured_live
    from studies.pipeline import respond

    if (loads is None) != weights:
        raise DesignError("give either --loads FILE or --weights.")
    sensor = chosen(design)
    electronics = _electronics(None, switch_ohm, line_ohm)
    if Path(port).is_file():
        if loads is None:
            raise DesignError("a recording needs --loads FILE with the columns from_s and to_s.")
        pairs = measured_in_recording(Path(port), loads, electronics)
    else:
        pairs = measured_live(port, loads, electronics, seconds, baud=baud, timeout=timeout)
    with progress_bars(quiet) as bars:
        _, solved = respond(sensor, bars)
    found, residual = calibrated(pairs, solved, electronics, noise)
    write_calibration(found, out)
    figures = {
        "loads": len(pairs.names),
        "noise": found.made_from["noise"],
        "gain": [float(found.gain.min()), float(found.gain.max())],
        "offset_ohm": [float(found.offset_ohm.min()), float(found.offset_ohm.max())],
        "residual": residual,
    }
    if json_:
        show_json({"file": str(out), **figures})
    else:
        print(
            f"{len(pairs.names)} loads: gains {found.gain.min():.3f} to {found.gain.max():.3f}, offsets "
            f"{found.offset_ohm.min():.0f} to {found.offset_ohm.max():.0f} Ω; what is left: {100 * residual:.2f} %"
        )
    wrote([out])


@board.command()
def simulate(
    board_: Annotated[
        Literal["auto", "atmega328p", "atmega2560", "python"],
        typer.Option("--board", help="The firmware on a simulated chip, or the same frames from Python."),
    ] = "auto",
    link: Annotated[Path | None, typer.Option(help="Keep a link of this name on the port.")] = None,
    scene: Annotated[Path | None, typer.Option(help="Scene TOML of an array, pressed again and again.")] = None,
    pressure: Annotated[float, typer.Option(help="Of the scripted press-and-slide, under its middle [MPa].")] = 3.0,
    period: Annotated[float, typer.Option(help="Of the script or the scene [s].")] = 6.0,
    mode: Annotated[
        Literal["zero-potential", "grounded", "divider"], typer.Option(help="How the crossbar is read.")
    ] = "zero-potential",
    rate: Annotated[int, typer.Option(help="Scans a second.")] = 150,
    sense_ohm: Annotated[int | None, typer.Option(help="Sense or feedback resistor [Ω]; default: suits 10 kΩ.")] = None,
    switch_ohm: SwitchOption = None,
    line_ohm: LineOption = None,
    noise: Annotated[float, typer.Option(help="Of a reading, as a share of full scale.")] = 0.0,
    bits: Annotated[int, typer.Option(help="Of the converter; chips have 10.")] = 10,
    gain_spread: Annotated[float, typer.Option(help="Each pillar's factor is uniform in 1 ± this.")] = 0.0,
    offset: Annotated[float, typer.Option(help="Standard deviation of each pillar's offset [Ω].")] = 0.0,
    specimen: Annotated[int, typer.Option(help="Seed of factors and offsets.")] = 0,
    serial: Annotated[int, typer.Option(help="The board's own number.")] = 0,
    seconds: SecondsOption = math.inf,
    truth: Annotated[Path | None, typer.Option(help="NetCDF file for one period of the forces that act.")] = None,
    design: DesignOption = None,
    json_: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Be a board: the firmware on a simulated chip where simavr is installed, on a pseudo-terminal."""
    from dataset.imperfections import Imperfections
    from hardware.crossbar import SUITED_SENSE_OHM, scan_mode_named
    from hardware.frames import Info
    from hardware.simavr_board import find_tools
    from studies.board.motion import PressAndSlide, press_and_slide, scene_motion, write_truth
    from studies.board.session import ended_by_signal
    from studies.board.simulated import counts_over_time, simulated

    scan_mode = scan_mode_named(mode)
    sense = round(SUITED_SENSE_OHM[scan_mode]) if sense_ohm is None else sense_ohm
    told = Info(bits=bits, scan_mode=scan_mode, rate_hz=rate, serial=serial, sense_ohm=sense)
    script = PressAndSlide(peak_mpa=pressure, seconds=period)
    with progress_bars(quiet) as bars:
        if scene is not None:
            from fem.scene_file import read_scene

            motion = scene_motion(read_scene(scene), period)
        else:
            from studies.pipeline import respond

            motion = press_and_slide(respond(chosen(design), bars)[1], script)
    rows, cols = motion.resistance_ohm.shape[1:3]
    told = replace(told, rows=rows, cols=cols)
    kind: Any = board_
    if kind == "auto":
        missing = find_tools() if bits == 10 else "chips have converters of 10 bits"
        kind = "python" if missing else "atmega328p"
        say(f"frames from Python: {missing}" if missing else "")
    if truth is not None:
        write_truth(motion, truth)
    crossbar = replace(_electronics(None, switch_ohm, line_ohm).crossbar(told), noise=noise)
    sensor = Imperfections(gain_spread=gain_spread, offset_ohm=offset, specimen=specimen)
    counts = counts_over_time(motion, crossbar, sensor)
    with simulated(kind, told, counts, link) as running:
        named = str(link or running.port)
        if json_:
            print(json.dumps({"port": named, "board": kind}), flush=True)
        else:
            print(f"{kind} on {named}; Ctrl-C ends it", flush=True)
        with ended_by_signal() as is_ended:
            end_s = time.monotonic() + seconds
            while not is_ended() and time.monotonic() < end_s:
                time.sleep(0.1)


@board.command()
def bench(
    port: PortArgument,
    model: Annotated[Path | None, typer.Option(help="Model file; without one frames are only read.")] = None,
    calibration: CalibrationOption = None,
    seconds: Annotated[float, typer.Option(help="Measure for so long.")] = 10.0,
    baud: BaudOption = BAUD,
    timeout: TimeoutOption = TIMEOUT_S,
    json_: JsonOption = False,
) -> None:
    """Measure a board's link: rate, losses, jitter, and how long a scan takes from its last byte to forces."""
    from studies.board.link import measured_link
    from studies.board.session import scanner_on, session

    with scanner_on(port, baud=baud, timeout=timeout) as scanner:
        found = measured_link(scanner, None if model is None else session(scanner, model, calibration), seconds)
    if json_:
        show_json(asdict(found))
    else:
        from studies.report import plain_table, show

        link = asdict(found)
        latency, statistics = link.pop("latency_ms") or {}, link.pop("statistics")
        link |= {f"latency_{name}_ms": value for name, value in latency.items()}
        show(plain_table("The board's link", [link]))
        show(plain_table("What was met", [statistics]))


def _electronics(known: "Electronics | None", switch_ohm: float | None, line_ohm: float | None) -> "Electronics":
    """What is known of a board's electronics, with what options say in its place."""
    from hardware.calibration import Electronics

    given = {"switch_ohm": switch_ohm, "line_ohm": line_ohm}
    return replace(known or Electronics(), **{name: ohms for name, ohms in given.items() if ohms is not None})


def _follow(reading: "Session", seconds: float, json_lines: bool) -> None:
    """Show forces as they come, to people or to a pipe."""
    from studies.board.follow import print_lines, show_forces

    (print_lines if json_lines else show_forces)(reading, seconds)
