"""The page's controls: which values each may take, and the loads that they stand for.

A browser's word is taken if a control can say it, and refused otherwise.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from reprlib import repr as shortened
from typing import Any

import numpy as np

from common.errors import TriPillarError
from dataset.loads import Loads
from geometry.design import SensorDesign
from geometry.layout import FloatArray
from tripillar.viewer.page.scene import TITLES

STEPS = 100  #: of a load's slider
SCALES = (1, 2, 5, 10)  #: of displacements
NOISES = {0.0: "exact", 0.001: "0.1 % noise", 0.005: "0.5 % noise", 0.01: "1 % noise"}  #: of the readings, relative
WIDTH_MM = (5.0, 40.0)  #: of the indenter; further where the pitch is


class ControlError(TriPillarError, ValueError):
    """A message of a browser that no control of the page can send."""


@dataclass(frozen=True, kw_only=True)
class Range:
    """A slider."""

    start: float
    min: float = 0.0
    max: float
    step: float

    def taken(self, name: str, value: object) -> float:
        """The value as a number from min to max; ControlError if it is none."""
        return number(name, value, self.min, self.max)


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One of several values."""

    start: Any
    among: tuple[Any, ...]
    titles: tuple[str, ...] = ()  #: as the page shows them

    def taken(self, name: str, value: object) -> Any:
        """The value among those; ControlError if it is none of them, as true is no 1."""
        for one in self.among:
            if value == one and isinstance(value, bool) == isinstance(one, bool):
                return one
        raise ControlError(f"{name}={shortened(value)} is none of its {len(self.among)} values.")


Controls = dict[str, Range | Choice]


def controls_of(design: SensorDesign, has_sensor: bool, loads: Loads) -> Controls:
    """The controls for an array, each with its start value; loads end where those of its datasets do."""
    colours = {name: title.split(" [")[0] for name, title in TITLES.items()}
    half_x, half_y = design.slab_mm[0] / 2, design.slab_mm[1] / 2
    middle = design.array.rows // 2 * design.array.cols + design.array.cols // 2
    pitch = design.array.pitch_mm
    pressure, shear = (
        Range(start=0.0, max=high, step=high / STEPS) for _, high in (loads.normal_mpa, loads.tangential_mpa)
    )
    angle = Range(start=0.0, max=360.0, step=5.0)
    sources = ("pads", "indenter", "sensor") if has_sensor else ("pads", "indenter")
    return {
        "source": Choice(start=sources[-1], among=sources),  # of the loads
        "pad": Choice(start=middle, among=tuple(range(design.n_units))),
        "pressure": pressure,
        "shear": shear,
        "angle": angle,
        "cone": Choice(start=True, among=(True, False)),  # whether shear is held within friction
        "peak": replace(pressure, start=loads.middle_mpa),
        "at_x": Range(start=0.0, min=-half_x, max=half_x, step=0.5),
        "at_y": Range(start=0.0, min=-half_y, max=half_y, step=0.5),
        "width": Range(start=pitch, min=min(WIDTH_MM[0], pitch), max=max(WIDTH_MM[1], pitch), step=0.5),
        "drag": shear,
        "drag_angle": angle,
        "colour": Choice(start="displacement", among=tuple(colours), titles=tuple(colours.values())),
        "scale": Choice(start=1, among=SCALES, titles=tuple(f"{scale} ×" for scale in SCALES)),
        "noise": Choice(start=0.0, among=tuple(NOISES), titles=tuple(NOISES.values())),
        "dark": Choice(start=False, among=(True, False)),
        "tab": Choice(start="maps", among=("maps", "table", "time")),  # of the numbers
    }


def taken(controls: Controls, said: object) -> dict[str, Any]:
    """The values that a browser gives controls; ControlError, and none is taken, if one is not sound."""
    given = mapping("values of controls", said)
    unknown = [name for name in given if name not in controls]
    if unknown:
        raise ControlError(f"there is no control {shortened(unknown[0])}.")
    return {name: controls[name].taken(name, value) for name, value in given.items()}


def mapping(name: str, value: object) -> Mapping[str, Any]:
    """A JSON object; ControlError if it is none."""
    if not isinstance(value, dict):
        raise ControlError(f"{name} must be an object, not {shortened(value)}.")
    return value


def numbers_of(name: str, value: object, count: int, least: float, most: float) -> list[float]:
    """A list of `count` numbers, each from least to most; ControlError if it is none."""
    if not isinstance(value, list) or len(value) != count:
        raise ControlError(f"{name} must be a list of {count}, not {shortened(value)}.")
    return [number(name, one, least, most) for one in value]


def number(name: str, value: object, least: float, most: float) -> float:
    """A number from least to most; ControlError if it is text, true, NaN or out of bounds."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ControlError(f"{name}={shortened(value)} must be a number.")
    if not least <= value <= most:  # no NaN is
        raise ControlError(f"{name}={shortened(value)} must be from {least:g} to {most:g}.")
    return float(value)


def traction_of(pressure_mpa: float, shear_mpa: float, angle_deg: float) -> FloatArray:
    """Traction along x, y, z, shape (3,) [MPa], z negative pushing down; the angle is that of shear, from +x to +y."""
    angle = math.radians(angle_deg)
    return np.array([shear_mpa * math.cos(angle), shear_mpa * math.sin(angle), -pressure_mpa])


def sliders_of(traction_mpa: FloatArray, loads: Loads) -> tuple[float, float, float]:
    """Pressure, shear [MPa] and angle [°] of a traction (3,), cut to the ends of the sliders and rounded like them."""
    tx, ty, tz = traction_mpa.tolist()
    pressure, shear = (
        min(round(size, 2 - math.floor(math.log10(high))), high)
        for size, (_, high) in ((max(-tz, 0.0), loads.normal_mpa), (math.hypot(tx, ty), loads.tangential_mpa))
    )
    return pressure, shear, float(round(math.degrees(math.atan2(ty, tx)) % 360.0))
