"""Forces in a terminal: a heat map of Fz, an arrow of shear on each unit, and how the link does."""

import math
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from geometry.layout import FloatArray

if TYPE_CHECKING:
    from hardware.link.scanner import ScannerStatistics

ARROWS = "→↗↑↖←↙↓↘"  #: of shear, by eighths of a turn from +x
HOT = ((13, 8, 135), (126, 3, 168), (204, 71, 120), (248, 149, 64), (240, 249, 33))  #: the colour map "plasma"
MIN_SHEAR = 0.02  #: of the largest force, to draw an arrow


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
    stats: "ScannerStatistics",
    notes: list[str],
) -> RenderableType:
    """All that the terminal shows: the table, sums over the array, the link, and what is wrong, if anything."""
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
