"""The page's controls: what each may say. A browser's word is taken if it is one of these, and refused otherwise."""

import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from geometry.design import SensorDesign
from geometry.errors import TriPillarError
from tripillar.viewer.page.loads import MAX_PRESSURE_MPA, MAX_SHEAR_MPA
from tripillar.viewer.page.scene import TITLES

SCALES = (1, 2, 5, 10)  #: of displacements
NOISES = {0.0: "exact", 0.001: "0.1 % noise", 0.005: "0.5 % noise", 0.01: "1 % noise"}  #: of the readings, relative
WIDTH_MM = (5.0, 40.0)  #: of the indenter; further where the pitch is


class ControlError(TriPillarError, ValueError):
    """A browser said what no control of the page says."""


@dataclass(frozen=True, kw_only=True)
class Range:
    """A slider."""

    start: float
    least: float
    most: float
    step: float

    def taken(self, name: str, value: object) -> float:
        """The value as a number from least to most.

        Raises
        ------
        ControlError
            If it is none.
        """
        return number(name, value, self.least, self.most)


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One of several values."""

    start: Any
    among: tuple[Any, ...]
    titles: tuple[str, ...] = ()  #: as the page shows them

    def taken(self, name: str, value: object) -> Any:
        """The value among those.

        Raises
        ------
        ControlError
            If it is none of them; true is no 1.
        """
        for one in self.among:
            if value == one and isinstance(value, bool) == isinstance(one, bool):
                return one
        raise ControlError(f"{name}={shortened(value)} is none of its {len(self.among)} values.")


Controls = dict[str, Range | Choice]


def controls_of(design: SensorDesign, has_sensor: bool) -> Controls:
    """The controls for an array, with what they say before anyone has touched them."""
    half_x, half_y = design.slab_mm[0] / 2, design.slab_mm[1] / 2
    middle = design.array.rows // 2 * design.array.cols + design.array.cols // 2
    pitch = design.array.pitch_mm
    pressure = Range(start=0.0, least=0.0, most=MAX_PRESSURE_MPA, step=0.05)
    shear = Range(start=0.0, least=0.0, most=MAX_SHEAR_MPA, step=0.01)
    angle = Range(start=0.0, least=0.0, most=360.0, step=5.0)
    sources = ("pads", "indenter", "sensor") if has_sensor else ("pads", "indenter")
    return {
        "source": Choice(start=sources[-1] if has_sensor else "pads", among=sources),  # of the loads
        "pad": Choice(start=middle, among=tuple(range(design.n_units))),
        "pressure": pressure,
        "shear": shear,
        "angle": angle,
        "cone": Choice(start=True, among=(True, False)),  # whether shear is held within friction
        "peak": Range(start=3.0, least=0.0, most=MAX_PRESSURE_MPA, step=0.05),
        "at_x": Range(start=0.0, least=-half_x, most=half_x, step=0.5),
        "at_y": Range(start=0.0, least=-half_y, most=half_y, step=0.5),
        "width": Range(start=pitch, least=min(WIDTH_MM[0], pitch), most=max(WIDTH_MM[1], pitch), step=0.5),
        "drag": shear,
        "drag_angle": angle,
        "colour": Choice(
            start="displacement", among=tuple(TITLES), titles=tuple(title.split(" [")[0] for title in TITLES.values())
        ),
        "scale": Choice(start=1, among=SCALES, titles=tuple(f"{scale} ×" for scale in SCALES)),
        "noise": Choice(start=0.0, among=tuple(NOISES), titles=tuple(NOISES.values())),
        "dark": Choice(start=False, among=(True, False)),
        "tab": Choice(start="maps", among=("maps", "table", "time")),  # of the numbers
    }


def taken(controls: Controls, said: object) -> dict[str, Any]:
    """Values that a browser gives controls, all of them sound.

    Raises
    ------
    ControlError
        If a name or a value is none of the page's; then none is taken.
    """
    given = mapping("values of controls", said)
    unknown = [name for name in given if name not in controls]
    if unknown:
        raise ControlError(f"there is no control {shortened(unknown[0])}.")
    return {name: controls[name].taken(name, value) for name, value in given.items()}


def mapping(name: str, value: object) -> Mapping[str, Any]:
    """A JSON object.

    Raises
    ------
    ControlError
        If it is none.
    """
    if not isinstance(value, dict):
        raise ControlError(f"{name} must be an object, not {shortened(value)}.")
    return value


def numbers_of(name: str, value: object, count: int, least: float, most: float) -> list[float]:
    """A list of so many numbers, each from least to most.

    Raises
    ------
    ControlError
        If it is none.
    """
    if not isinstance(value, list) or len(value) != count:
        raise ControlError(f"{name} must be a list of {count}, not {shortened(value)}.")
    return [number(name, one, least, most) for one in value]


def number(name: str, value: object, least: float, most: float) -> float:
    """A number from least to most.

    Raises
    ------
    ControlError
        If it is none: text, true, NaN, or out of bounds.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ControlError(f"{name}={shortened(value)} must be a number.")
    if not least <= value <= most:  # no NaN is
        raise ControlError(f"{name}={shortened(value)} must be from {least:g} to {most:g}.")
    return float(value)


def shortened(value: object) -> str:
    """A value as a message shows it, however long or deep it is.

    >>> shortened("a" * 1000)
    "'aaaaaaaaaaaa...aaaaaaaaaaaaa'"
    """
    return reprlib.repr(value)
