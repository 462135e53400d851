"""Forces of a live sensor: drawn in the terminal for people, or one JSON object a line for pipes."""

import json
import math
import time
from collections import deque
from collections.abc import Sequence

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from geometry.layout import AXES, FloatArray
from hardware.link.reception import LinkStatistics, Scan
from hardware.readout.forces import Forces, LiveSensor
from hardware.readout.wrench import Wrench
from hardware.session import scans_within
from hardware.streams.scene import colours
from hardware.streams.stream import Stream
from hardware.streams.topics import wrench_content

ARROWS = "→↗↑↖←↙↓↘"  #: of shear, by eighths of a turn from +x
MIN_SHEAR = 0.02  #: of the largest force, to draw an arrow
SHOWN_S = 0.1  #: between two pictures
RENEWED_S = 0.1  #: between two calculations of the deviations, which take twenty times as long as the forces
STALE_S = 1.0  #: without a scan, after which the forces shown are no longer so, and grey
RATE_OVER = 64  #: scans whose pace is the rate shown
#: drawn brightest at least, so that noise at rest stays dark: so much, or a share of what a softer one feels
MIN_FULL_SCALE_N, MIN_FULL_SCALE = 10.0, 0.3


def digits_of(largest_n: float) -> int:
    """Decimals of forces: two below 10 N."""
    return 1 if abs(largest_n) >= 10.0 else 2


def force_table(force_n: FloatArray, axes: tuple[str, ...], full_scale_n: float, is_stale: bool = False) -> Table:
    """Units as they lie on the table before you: y up, x to the right; forces (rows, cols, k) [N]; stale ones grey."""
    table = Table.grid(padding=0)
    for row in force_n[::-1]:
        cells = [_cell(dict(zip(axes, unit, strict=True)), full_scale_n) for unit in row.tolist()]
        table.add_row(*(Text(cell.plain, style="dim") if is_stale else cell for cell in cells))
    return table


def _cell(force: dict[str, float], full_scale_n: float) -> Text:
    fz, fx, fy = (force.get(axis, 0.0) for axis in "zxy")
    shear = math.hypot(fx, fy)
    arrow = ARROWS[round(math.atan2(fy, fx) / (math.pi / 4)) % 8] if shear > MIN_SHEAR * full_scale_n else " "
    number = fz if "z" in force else shear
    red, green, blue = colours(np.array([abs(number) / full_scale_n]))[0].tolist()
    ink = "rgb(0,0,0)" if red + green + blue > 380 else "rgb(255,255,255)"
    digits = digits_of(full_scale_n) if abs(number) < 1e4 else 0  # a broken sensor's forces keep to their columns, too
    return Text(f" {round(number, digits) + 0.0:6.{digits}f} {arrow} ", style=f"{ink} on rgb({red},{green},{blue})")


def live_view(
    scan: Forces,
    axes: tuple[str, ...],
    full_scale_n: float,
    rate_hz: float,
    stats: LinkStatistics,
    notes: list[str],
    is_stale: bool = False,
) -> RenderableType:
    """The terminal's picture: the table, net load, the link's counts, and what is wrong, if anything."""
    wrench, deviation_n = scan.wrench, scan.deviation_n
    net, net_deviation, digits = wrench.force_n, wrench.force_deviation_n, digits_of(full_scale_n)
    sums = "   ".join(
        f"ΣF{axis} {net[k]:8.{digits}f}{'' if net_deviation is None else f' ± {net_deviation[k]:.{digits}f}'} N"
        for axis, k in zip(axes, (AXES.index(axis) for axis in axes), strict=True)
    )
    unsure = "" if deviation_n is None else f"; each pad ± {float(deviation_n.mean()):.{digits}f} N (68 %)"
    damaged = stats.bad_crc + stats.bad_cobs + stats.bad_form
    link = (
        f"{rate_hz:5.1f} frames/s  {stats.ok} ok  {stats.lost} lost  {damaged} damaged  "
        f"{stats.overruns_said}  {stats.dropped} dropped  {stats.reconnects} reconnects"
    )
    number = "Fz" if "z" in axes else "shear"
    arrows = "" if axes == ("z",) else ", arrows: shear"
    head = Text(f"{number} [N]{arrows}; {full_scale_n:.3g} N is brightest", style="dim")
    pressed = Text(f"centre of pressure {_centre(wrench)}{unsure}")
    lines: list[RenderableType] = [head, force_table(scan.force_n, axes, full_scale_n, is_stale), Text(sums)]
    remembered = [] if scan.memory_rise is None else [memory_line(scan)]
    lines += [pressed, *map(Text, contact_lines(scan) + remembered), Text(link)]
    return Group(*lines, *(Text(note, style="bold red") for note in notes))


def _centre(wrench: Wrench) -> str:
    (x, y), deviation = wrench.centre_mm, wrench.centre_deviation_mm
    if math.isnan(x):
        return "-"
    if deviation is None:
        return f"x {x:.1f}, y {y:.1f} mm"
    return f"x {x:.1f} ± {deviation[0]:.1f}, y {y:.1f} ± {deviation[1]:.1f} mm"


def contact_lines(scan: Forces) -> list[str]:
    """A line for each contact that a decoder of touch finds: force, place and size."""
    lines = []
    for number, each in enumerate(scan.contacts or (), 1):
        (x, y), (dx, dy), (a, b) = each.centre_mm, each.centre_deviation_mm, 2 * each.half_mm
        fz, digits = each.force_n[2], digits_of(each.force_n[2])
        force = f"Fz {fz:.{digits}f} ± {each.force_deviation_n[2]:.{digits}f} N"
        lines.append(
            f"contact {number}: {force} at x {x:.1f} ± {dx:.1f}, y {y:.1f} ± {dy:.1f} mm, {a:.0f} × {b:.0f} mm"
        )
    return lines


def memory_line(scan: Forces) -> str:
    """How much of the readings is taken for the rubber's memory, of one scan or of many, and since when."""
    assert scan.memory_rise is not None
    assert scan.memory_deviation is not None
    if not np.any(scan.memory_tested):
        return "memory: none taken out: no hold or rest has tested the rubber's law yet"
    size, unsure = (float(np.sqrt(np.mean(each**2))) for each in (scan.memory_rise, scan.memory_deviation))
    largest = float(np.abs(scan.memory_rise).max())
    said = f"memory: {100 * size:.1f} % of the readings (at most {100 * largest:.0f} %), known to {100 * unsure:.1f} %"
    n_untested = int(np.sum(np.logical_not(scan.memory_tested)))
    return f"{said}; none before frame {n_untested + 1}, which tested the law" if n_untested else said


def show_forces(sensor: LiveSensor, seconds: float, streams: Sequence[Stream] = ()) -> None:
    """Draw the newest forces ten times a second; scans in between only go to the streams."""
    scanner, axes = sensor.scanner, sensor.model.component.axes
    frame: Forces | None = None
    newest: deque[Scan] = deque(maxlen=RATE_OVER)
    usual = sensor.model.output_scaling
    full_scale = min(MIN_FULL_SCALE_N, MIN_FULL_SCALE * float((np.abs(usual.centre) + usual.half_range).max()))
    shown, heard = 0.0, time.monotonic()
    with Live(console=Console(), auto_refresh=False) as screen:
        for scan in scans_within(scanner, seconds, least=1):
            if scan is not None:
                newest.append(scan)
                heard = time.monotonic()
                if streams:
                    frame = _sent(sensor.forces(scan, RENEWED_S), streams)
            if time.monotonic() - shown < SHOWN_S:
                continue
            shown = time.monotonic()
            silent_s = shown - heard
            is_stale = silent_s > STALE_S and not scanner.ended
            since = f"no scan for {silent_s:.0f} s" if is_stale else None
            notes = [*filter(None, [since, scanner.trouble, scanner.stats.clock_said])]
            if newest and not streams:
                frame = sensor.forces(newest[-1], RENEWED_S)
            if frame is None:
                screen.update(Group("waiting for scans", *notes), refresh=True)
                continue
            notes += notes_on(frame)
            full_scale = max(full_scale, float(abs(frame.force_n).max()))
            view = live_view(frame, axes, full_scale, pace(newest), scanner.stats, notes, is_stale)
            screen.update(view, refresh=True)
    if not screen.console.is_terminal:  # on one, `Live` ends the line itself
        screen.console.line()


def notes_on(scan: Forces) -> list[str]:
    """Lines on one scan's faults: pillars left out, no known load, broken pillars and wires."""
    notes = []
    if scan.left_out.any():
        trust = ": so many that its forces are not reliable" if scan.unreliable else ""
        notes.append(f"no strain explains pillar {scan.said_out()}, left out{trust}")
    if scan.unexplained:
        notes.append(
            f"χ² {scan.chi2:.3g}: no load that the model knows explains it: dead wire, other sensor, bare rubber?"
        )
    return notes + list(scan.faults)


def pace(scans: Sequence[Scan]) -> float:
    """Scans a second of the board's own clock, however quickly they are caught up with; those of the newest run."""
    ticks = [scan.frame.device_us for scan in scans if scan.run == scans[-1].run]
    elapsed_us = (ticks[-1] - ticks[0]) % 2**32 if ticks else 0
    return 1e6 * (len(ticks) - 1) / elapsed_us if elapsed_us else 0.0


def _sent(frame: Forces, streams: Sequence[Stream]) -> Forces:
    for stream in streams:
        stream.add(frame)
    return frame


def print_lines(sensor: LiveSensor, seconds: float, streams: Sequence[Stream] = (), describes: bool = False) -> None:
    """One JSON object for every scan; one that names the trouble when scans fail to come, and when they do again.

    The first one describes the sensor if it is asked for. Deviations are 0.1 s old at most. Ends quietly when the
    pipe's other end closes.
    """
    trouble, deviation, known = None, "null", None
    try:
        if describes:
            print(json.dumps({"sensor": sensor.description.plain()}), flush=True)
        for scan in scans_within(sensor.scanner, seconds, least=1):
            if sensor.scanner.trouble != trouble:
                trouble = sensor.scanner.trouble
                print(json.dumps({"time_s": time.time(), "trouble": trouble}), flush=True)
            if scan is None:
                continue
            frame = _sent(sensor.forces(scan, RENEWED_S), streams)
            if frame.deviation_n is not known:
                known = frame.deviation_n
                deviation = json.dumps(None if known is None else known.round(4).tolist())
            line = {
                "time_s": scan.time_s,
                "sequence": int(frame.sequence),
                "axes": sensor.model.component.axes,
                "force_n": frame.force_n.round(4).tolist(),
                "chi2": None if frame.chi2 is None else float(f"{frame.chi2:.4g}"),
                "explained": not frame.unexplained,
                "faults": list(frame.faults),
                "saturated": int(frame.saturated.sum()),
                "left_out": frame.named_out(),
                "unreliable": bool(frame.unreliable),
                "dropped": sensor.scanner.stats.dropped,
                **wrench_content(frame.net()),
            }
            if frame.contacts is not None:
                line["contacts"] = [each.plain() for each in frame.contacts]
            if frame.memory_rise is not None:
                line["memory_rise"] = frame.memory_rise.round(5).tolist()
                line["memory_tested"] = bool(frame.memory_tested)
            # put in as text, which is as long again as all the rest
            print(json.dumps(line)[:-1] + f', "deviation_n": {deviation}' + "}", flush=True)
    except BrokenPipeError:
        pass
