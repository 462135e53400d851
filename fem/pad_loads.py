"""Loads of all pads at once, as pictures use them."""

from collections.abc import Callable

import numpy as np

from geometry.design import SensorDesign
from geometry.layout import FloatArray, unit_centres


def bell_pressure(design: SensorDesign, peak_mpa: float) -> FloatArray:
    """Tractions (n_units, 3) [MPa] of a round indenter over the middle of the array, one pitch wide."""
    centres = unit_centres(design)
    traction = np.zeros((design.n_units, 3))
    squared = (centres**2).sum(axis=1)
    nearest = squared.min()
    traction[:, 2] = -peak_mpa * np.exp(-(squared - nearest) / (2 * design.array.pitch_mm**2))
    return traction


def uniform_pressure(design: SensorDesign, peak_mpa: float) -> FloatArray:
    """Tractions (n_units, 3) [MPa] of the same pressure on every pad."""
    return np.tile([0.0, 0.0, -peak_mpa], (design.n_units, 1))


PAD_LOADS: dict[str, Callable[[SensorDesign, float], FloatArray]] = {
    "indenter": bell_pressure,
    "uniform": uniform_pressure,
}
