"""Forces of a live sensor: drawn in the terminal for people, or one JSON object a line for pipes."""

import json
import math
import time
from collections import deque

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from geometry.layout import FloatArray
from hardware.link.reception import LinkStatistics
from hardware.readout.forces import LiveSensor
from hardware.session import scans_within

ARROWS = "→↗↑↖←↙↓↘"  #: of shear, by eighths of a turn from +x
HOT = ((13, 8, 135), (126, 3, 168), (204, 71, 120), (248, 149, 64), (240, 249, 33))  #: the colour map "plasma"
MIN_SHEAR = 0.02  #: of the largest force, to draw an arrow
SHOWN_S = 0.1  #: between two pictures
RENEWED_S = 0.1  #: between two calculations of the deviations
RATE_OVER = 64  #: scans whose pace is the rate shown
MIN_FULL_SCALE_N = 10.0  #: that is drawn brightest, so that noise at rest stays dark


def force_table(force_n: FloatArray, axes: tuple[str, ...], full_scale_n: float) -> Table:
    """Units as they lie on the table before you: y up, x to the right; forces (rows, cols, k) [N]."""
    table = Table.grid(padding=0)
    for row in force_n[::-1]:
        table.add_row(*(_cell(dict(zip(axes, unit, strict=True)), full_scale_n) for unit in row.tolist()))
    return table


def _cell(force: dict[str, float], full_scale_n: float) -> Text:
    fz, fx, fy = (force.get(axis, 0.0) for axis in "zxy")
    shear = math.hypot(fx, fy)
    arrow = ARROWS[round(math.atan2(fy, fx) / (math.pi / 4)) % 8] if shear > MIN_SHEAR * full_scale_n else " "
    number = fz if "z" in force else shear
    red, green, blue = _colour(abs(number) / full_scale_n)
    ink = "rgb(0,0,0)" if red + green + blue > 380 else "rgb(255,255,255)"
    return Text(f" {number:6.1f} {arrow} ", style=f"{ink} on rgb({red},{green},{blue})")


def _colour(share: float) -> tuple[int, int, int]:
    place = min(max(share, 0.0), 1.0) * (len(HOT) - 1)
    k = min(int(place), len(HOT) - 2)
    red, green, blue = (round(a + (place - k) * (b - a)) for a, b in zip(HOT[k], HOT[k + 1], strict=True))
    return red, green, blue


def live_view(
    force_n: FloatArray,
    deviation_n: FloatArray | None,
    axes: tuple[str, ...],
    full_scale_n: float,
    rate_hz: float,
    stats: LinkStatistics,
    notes: list[str],
) -> RenderableType:
    """The terminal's picture: the table, sums over the array, the link's counts, and what is wrong, if anything."""
    sums = "   ".join(f"ΣF{axis} {force_n[..., k].sum():8.1f} N" for k, axis in enumerate(axes))
    unsure = "" if deviation_n is None else f"   ± {float(deviation_n.mean()):.1f} N each (68 %)"
    damaged = stats.bad_crc + stats.bad_cobs + stats.bad_form
    link = (
        f"{rate_hz:5.1f} frames/s   {stats.ok} ok   {stats.lost} lost   {damaged} damaged   "
        f"{stats.overruns} overruns   {stats.dropped} dropped   {stats.reconnects} reconnects"
    )
    number = "Fz" if "z" in axes else "shear"
    head = Text(f"{number} [N], arrows: shear; {full_scale_n:.0f} N is brightest", style="dim")
    lines: list[RenderableType] = [head, force_table(force_n, axes, full_scale_n), Text(sums + unsure), Text(link)]
    return Group(*lines, *(Text(note, style="bold red") for note in notes))


def show_forces(sensor: LiveSensor, seconds: float) -> None:
    """Draw the newest forces ten times a second; scans in between are read, not drawn."""
    scanner, axes = sensor.scanner, sensor.model.component.axes
    times: deque[float] = deque(maxlen=RATE_OVER)
    full_scale, shown = MIN_FULL_SCALE_N, 0.0
    with Live(console=Console(), auto_refresh=False) as screen:
        for scan in scans_within(scanner, seconds):
            if scan is not None:
                times.append(scan.received_s)
            if time.monotonic() - shown < SHOWN_S:
                continue
            shown = time.monotonic()
            notes = [scanner.trouble] if scanner.trouble else []
            latest = scanner.latest()
            if latest is None:
                screen.update(Group("waiting for scans", *notes), refresh=True)
                continue
            found = sensor.forces(latest)
            if n_saturated := int(found.saturated.sum()):
                notes.append(f"{n_saturated} pillars at an end of the converter's range: forces extrapolated")
            if not found.is_explained:
                notes.append(
                    f"χ² {found.chi2:.3g}: no load that the model knows explains this reading; dead wire? other sensor?"
                )
            full_scale = max(full_scale, float(abs(found.force_n).max()))
            rate_hz = (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 and times[-1] > times[0] else 0.0
            view = live_view(found.force_n, found.deviation_n, axes, full_scale, rate_hz, scanner.stats, notes)
            screen.update(view, refresh=True)


def print_lines(sensor: LiveSensor, seconds: float) -> None:
    """One JSON object for every scan; one that names the trouble when scans fail to come, and when they do again.

    Deviations, which take ten times as long as forces, are `RENEWED_S` old at most. Ends quietly when the pipe's other
    end closes.
    """
    trouble, deviation, renew_s = None, "null", 0.0
    try:
        for scan in scans_within(sensor.scanner, seconds):
            if sensor.scanner.trouble != trouble:
                trouble = sensor.scanner.trouble
                print(json.dumps({"trouble": trouble}), flush=True)
            if scan is None:
                continue
            found = sensor.forces(scan)
            if scan.received_s >= renew_s:
                renew_s = scan.received_s + RENEWED_S
                deviation_n = found.deviation_n
                deviation = json.dumps(None if deviation_n is None else deviation_n.round(4).tolist())
            line = {
                "time_s": found.time_s,
                "sequence": scan.frame.sequence,
                "axes": sensor.model.component.axes,
                "force_n": found.force_n.round(4).tolist(),
                "chi2": None if found.chi2 is None else float(f"{found.chi2:.4g}"),
                "explained": found.is_explained,
                "saturated": int(found.saturated.sum()),
                "dropped": sensor.scanner.dropped,
            }
            # put in as text, which is as long again as all the rest
            print(json.dumps(line)[:-1] + f', "deviation_n": {deviation}' + "}", flush=True)
    except BrokenPipeError:
        pass
