"""Numbers as the page shows them: cells of maps with their colours, rows of tables."""

import math
from typing import Any

import numpy as np

from fem.pictures.colours import Bar
from geometry.layout import AXES, PILLARS, FloatArray

UP, DOWN = (214, 69, 65), (47, 110, 186)  #: red above, blue below 0
ARROWS = "→↗↑↖←↙↓↘"  #: of shear, by eighths of a turn from +x
MIN_SHOWN_MPA = 0.02  #: of a pad's pressure or shear; less is not shown


def as_map(title: str, unit: str, values: FloatArray, least: float, digits: int = 1) -> dict[str, Any]:
    """A map of values (rows, cols): cells from the upper left as the array lies before you, y up.

    `least` is the value that is drawn full at least, so that noise at rest stays pale.
    """
    finite = np.abs(values[np.isfinite(values)])
    most = max(float(finite.max(initial=0.0)), least)
    rows, cols = values.shape
    cells = [
        {"unit": i * cols + j, "text": text(values[i, j], digits), "colour": colour(values[i, j] / most)}
        for i in range(rows - 1, -1, -1)
        for j in range(cols)
    ]
    return {"title": title, "unit": unit, "most": text(most, digits), "cells": cells}


def pad_cells(traction_mpa: FloatArray, cols: int, most_mpa: float) -> list[dict[str, Any]]:
    """The pads' pressures (n_units, 3) [MPa] as cells of a map, with an arrow where there is shear."""
    cells = []
    for i in range(len(traction_mpa) // cols - 1, -1, -1):
        for unit in range(i * cols, (i + 1) * cols):
            tx, ty, tz = traction_mpa[unit].tolist()
            shear = math.hypot(tx, ty)
            arrow = ARROWS[round(math.atan2(ty, tx) / (math.pi / 4)) % 8] if shear > MIN_SHOWN_MPA else ""
            pressed = text(-tz, 1) if abs(tz) > MIN_SHOWN_MPA else ""
            cells.append({"unit": unit, "text": pressed, "arrow": arrow, "colour": colour(-tz / most_mpa)})
    return cells


def table_rows(resistance_ohm: FloatArray, applied_n: FloatArray, force_n: FloatArray, cols: int) -> list[list[str]]:
    """A row a unit: its place, three resistances [kΩ], and applied and decoupled force along each axis [N]."""
    n = force_n.shape[0] * force_n.shape[1]
    kilo_ohm = 1e-3 * resistance_ohm.reshape(n, -1)
    pairs = np.stack([applied_n.reshape(n, -1), force_n.reshape(n, -1)], axis=2).reshape(n, -1)
    return [
        [f"{k // cols}, {k % cols}", *(text(v, 3) for v in kilo_ohm[k]), *(text(v, 1) for v in pairs[k])]
        for k in range(n)
    ]


def unit_rows(
    resistance_ohm: FloatArray, change: FloatArray, strain: FloatArray, applied_n: FloatArray, force_n: FloatArray
) -> dict[str, list[list[str]]]:
    """Of one unit, all (3,): its pillars, and its forces."""
    pillars = [
        [name, text(1e-3 * resistance_ohm[k], 3), text(100 * change[k], 2), text(100 * strain[k], 1)]
        for k, name in enumerate(PILLARS)
    ]
    forces = [
        [f"F{name}", text(applied_n[k], 1), text(force_n[k], 1), text(force_n[k] - applied_n[k], 2)]
        for k, name in enumerate(AXES)
    ]
    return {"pillars": pillars, "forces": forces}


def legend(bar: Bar) -> dict[str, Any]:
    """A colour bar: its title, colours from low to high, and labels with their places as fractions of it."""
    span = bar.high - bar.low
    labels = [[(value - bar.low) / span, words] for value, words in bar.labels.items()]
    return {"title": bar.title, "colours": [*bar.colours[::15], bar.colours[-1]], "labels": labels}


def sample(change: FloatArray, force_n: FloatArray) -> list[list[float | None]]:
    """For a plot over time: of each unit its forces x, y, z [N] and the changes of its pillars z, x, y [%]."""
    values = np.concatenate([force_n, 100.0 * change], axis=2).reshape(-1, 6)
    return [[None if math.isnan(number) else round(number, 3) for number in unit] for unit in values.tolist()]


def text(value: float, digits: int) -> str:
    """A number with so many decimals, a dash where there is none."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞"
    rounded = f"{value:.{digits}f}"
    return rounded.removeprefix("-") if float(rounded) == 0 else rounded.replace("-", "−")


def colour(share: float) -> str:
    """Red for shares above 0, blue below, more opaque the larger, so that it suits a pale and a dark page."""
    if math.isnan(share):
        return "transparent"
    red, green, blue = UP if share > 0 else DOWN
    return f"rgba({red},{green},{blue},{min(abs(share), 1.0):.3f})"
