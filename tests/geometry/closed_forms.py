"""Closed forms of the paper's unit, and the order in which a board sends."""

from math import hypot

import numpy as np

from geometry.design import Unit
from geometry.layout import SONG2018, Layout
from geometry.wiring import pillar_of_crossing


def oblique_width(unit: Unit) -> float:
    """Width of an oblique pillar's horizontal section along its tilt [mm]: w·l/h."""
    return unit.pillar_width_mm * hypot(unit.span_mm, unit.height_mm) / unit.height_mm


def union_mm3(unit: Unit) -> float:
    """V = w²(h + 2l) − w²·h·ow/s of the pillars: each oblique one loses w²·h·ow/(2s) inside the upright one."""
    w, h, s = unit.pillar_width_mm, unit.height_mm, unit.span_mm
    return w**2 * (h + 2 * hypot(s, h)) - w**2 * h * oblique_width(unit) / s


def crossings_from_pillars(values: np.ndarray, layout: Layout = SONG2018) -> np.ndarray:
    """Values of pillars (..., rows, cols, n_pillars), rearranged as sent: (..., rows·cols·n_pillars)."""
    rows, cols = values.shape[-3:-1]
    return values.reshape(*values.shape[:-3], -1)[..., pillar_of_crossing(rows, cols, layout)]
