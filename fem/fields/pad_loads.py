"""Loads of all pads at once, as pictures use them."""

from collections.abc import Callable

import numpy as np

from geometry.design import SensorDesign
from geometry.layout import FloatArray, unit_centres


def indenter_tractions(
    design: SensorDesign, traction_mpa: FloatArray, centre_mm: tuple[float, float], width_mm: float
) -> FloatArray:
    """Tractions (n_units, 3) [MPa] of a round indenter: exp(−r²/2w²) of the traction (3,) at its middle."""
    squared = ((unit_centres(design) - centre_mm) ** 2).sum(axis=1)
    return np.exp(-squared / (2 * width_mm**2))[:, None] * traction_mpa


def bell_pressure(design: SensorDesign, peak_mpa: float) -> FloatArray:
    """Tractions (n_units, 3) [MPa] of a round indenter over the middle of the array, one pitch wide.

    `peak_mpa` is the pressure at the indenter's middle, as on the page and in datasets: pads beside it carry less, on
    an array of even rows and columns at most exp(−1/4), 78 %.
    """
    return indenter_tractions(design, np.array([0.0, 0.0, -peak_mpa]), (0.0, 0.0), design.array.pitch_mm)


def uniform_pressure(design: SensorDesign, peak_mpa: float) -> FloatArray:
    """Tractions (n_units, 3) [MPa] of the same pressure on every pad."""
    return np.tile([0.0, 0.0, -peak_mpa], (design.n_units, 1))


#: what a pressure of each is the pressure of
WHERE = {"indenter": "at the indenter's middle", "uniform": "on every pad"}
PAD_LOADS: dict[str, Callable[[SensorDesign, float], FloatArray]] = {
    "indenter": bell_pressure,
    "uniform": uniform_pressure,
}
