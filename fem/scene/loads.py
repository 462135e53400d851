"""Loads of a scene, each on a rectangle of the top face at rest: dead, following and stiff.

Directions are the axes' and do not turn, but for the pressure of a `FollowerLoad`. All grow from 0 in proportion.
What a scene consists of declares its quantities by `numbers`, and `Checked` refuses all else.
"""

import reprlib
import sys
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Any, Self

import numpy as np

from geometry.errors import TriPillarError
from geometry.layout import FloatArray
from geometry.prism import Pair, Triple

Rectangle = tuple[float, float, float, float]  #: x0, y0, x1, y1 [mm]
LENGTHS_MM = (1e-6, 1e6)  #: sizes and distances of a scene; beyond, coordinates lose their digits
LARGEST_MPA = 1e12  #: of a traction; energies go with its square


class SceneError(TriPillarError, ValueError):
    """A scene that cannot be built or makes no sense."""


def shown(value: Any) -> str:
    """A value for a message: one line, cut where it is long."""
    return f"{value:g}" if isinstance(value, float) else reprlib.repr(value)


def is_finite(value: Any) -> bool:
    """True of a number that is finite, and no bool."""
    is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return is_number and bool(abs(value) <= sys.float_info.max)  # so that NaN and endless integers are refused


def numbers(
    count: int, meaning: str, default: Any = MISSING, above_0: bool = False, largest: float = LENGTHS_MM[1]
) -> Any:
    """A dataclass field of one number, or a vector of `count`, none of them larger than `largest`."""
    metadata = {"meaning": meaning, "count": count, "above 0": above_0, "largest": largest}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Checked:
    """A part of a scene: its fields of `numbers` become floats or tuples of floats, or are refused by name."""

    def __post_init__(self) -> None:
        for spec in fields(self):
            value = getattr(self, spec.name)
            if "count" in spec.metadata and not (value is None and spec.default is None):
                object.__setattr__(self, spec.name, _sound(value, spec.name, **spec.metadata))


def _sound(value: Any, name: str, **asked: Any) -> float | tuple[float, ...]:
    count, largest = asked["count"], asked["largest"]
    listed = list(value) if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str) else []
    given = [value] if count == 1 else listed
    said = ""
    if len(given) != count or not all(map(is_finite, given)):
        said = "a finite number" if count == 1 else f"{count} finite numbers"
    elif max(map(abs, given)) > largest:
        said = f"at most {largest:g} in size"
    elif asked["above 0"] and not min(given) > 0:
        said = "above 0 along every axis"
    elif asked["above 0"] and not min(given) >= LENGTHS_MM[0]:
        said = f"from {LENGTHS_MM[0]:g} to {largest:g}"
    if said:
        raise SceneError(f"{name}={shown(value)} must be {said}; {asked['meaning']}.")
    return float(value) if count == 1 else tuple(map(float, given))


def rectangle_of(center_mm: Pair, size_mm: Pair) -> Rectangle:
    """The rectangle of a centre and an extent."""
    (x, y), (a, b) = center_mm, size_mm
    return x - a / 2, y - b / 2, x + a / 2, y + b / 2


@dataclass(frozen=True, kw_only=True)
class _OnRectangle(Checked):
    """A load on a rectangle of the top face."""

    center_mm: Pair = numbers(2, "centre of the loaded rectangle: x, y, in mm")
    size_mm: Pair = numbers(2, "extent of the loaded rectangle along x and y, in mm", above_0=True)

    @property
    def rectangle(self) -> Rectangle:
        return rectangle_of(self.center_mm, self.size_mm)

    @property
    def components(self) -> tuple[float, ...]:
        """Traction along x, y, z at rest, or force and moment."""
        raise NotImplementedError

    @property
    def spread(self) -> tuple["DeadLoad", ...]:
        """The load as small strain sees it."""
        x, y, z = self.components
        return (DeadLoad(center_mm=self.center_mm, size_mm=self.size_mm, traction_mpa=(x, y, z)),)

    def times(self, share: float) -> Self:
        """The same load, a share as large."""
        return self.image(np.array(self.rectangle), *np.full((2, 3), share))

    def plus(self, other: Self) -> Self:
        """The sum of two loads on one rectangle."""
        own = [one.name for one in fields(self) if not one.name.endswith("_mm")]
        return replace(self, **{name: np.add(getattr(self, name), getattr(other, name)).tolist() for name in own})

    def image(self, rectangle: FloatArray, signs: FloatArray, axial: FloatArray) -> Self:
        """The load as mirrors show it: on another rectangle, its vectors times signs (3,), moments times `axial`."""
        x0, y0, x1, y1 = rectangle.tolist()
        own = {name: (values * np.array(getattr(self, name))).tolist() for name, values in self._signs(signs, axial)}
        return replace(self, center_mm=((x0 + x1) / 2, (y0 + y1) / 2), size_mm=(x1 - x0, y1 - y0), **own)

    def _signs(self, signs: FloatArray, axial: FloatArray) -> list[tuple[str, FloatArray]]:
        """By what each quantity is multiplied in an image."""
        return [("traction_mpa", signs)]


@dataclass(frozen=True, kw_only=True)
class DeadLoad(_OnRectangle):
    """A uniform traction per area at rest, whose direction stays; where such loads overlap they add up.

    At finite strain it has no equilibrium beyond about half of Young's modulus: elements at its edges turn inside out.
    """

    kind = "dead"
    traction_mpa: Triple = numbers(3, "traction along x, y, z, in MPa; z negative pushes down", largest=LARGEST_MPA)

    @property
    def components(self) -> tuple[float, ...]:
        return self.traction_mpa


@dataclass(frozen=True, kw_only=True)
class FollowerLoad(_OnRectangle):
    """A pressure along the deformed surface's normal, per deformed area, and a dead tangential traction.

    It has no potential: how far it moves the body may depend on the way to it, and its stiffness is not symmetric.
    Linear elasticity knows no deformed normal: there the pressure pushes along −z.
    """

    kind = "follower"
    pressure_mpa: float = numbers(1, "pressure, in MPa; above 0 it pushes", largest=LARGEST_MPA)
    traction_mpa: Pair = numbers(2, "traction along x and y, in MPa at rest", (0.0, 0.0), largest=LARGEST_MPA)

    @property
    def components(self) -> tuple[float, ...]:
        return (*self.traction_mpa, -self.pressure_mpa)

    def _signs(self, signs: FloatArray, axial: FloatArray) -> list[tuple[str, FloatArray]]:
        return [("traction_mpa", signs[:2]), ("pressure_mpa", signs[2])]


@dataclass(frozen=True, kw_only=True)
class StiffLoad(_OnRectangle):
    """A rigid plate bonded to a rectangle, loaded at the middle of its underside."""

    kind = "stiff"
    force_n: Triple = numbers(3, "force along x, y, z, in N; z negative pushes down", largest=LARGEST_MPA)
    moment_nmm: Triple = numbers(3, "moment about x, y, z, in N mm", (0.0, 0.0, 0.0), largest=LARGEST_MPA)

    def _signs(self, signs: FloatArray, axial: FloatArray) -> list[tuple[str, FloatArray]]:
        return [("force_n", signs), ("moment_nmm", axial)]

    @property
    def components(self) -> tuple[float, ...]:
        return self.force_n + self.moment_nmm

    @property
    def spread(self) -> tuple[DeadLoad, ...]:
        """Tractions on the plate and on its halves with the same force and moment: all one to a rigid plate.

        Moments about x and y are couples of forces along z, about z of forces along y, half a plate apart.
        """
        (x, y), (a, b) = self.center_mm, self.size_mm
        mx, my, mz = self.moment_nmm
        loads = [(self.center_mm, self.size_mm, self.force_n)]
        for side in (-1, 1):
            loads.append(((x + side * a / 4, y), (a / 2, b), (0.0, side * 2 * mz / a, -side * 2 * my / a)))
            loads.append(((x, y + side * b / 4), (a, b / 2), (0.0, 0.0, side * 2 * mx / b)))
        return tuple(
            DeadLoad(center_mm=center, size_mm=(w, d), traction_mpa=tuple(n / (w * d) for n in force))  # type: ignore[arg-type]  # three
            for center, (w, d), force in loads
            if any(force)
        )


Load = DeadLoad | FollowerLoad | StiffLoad


def at_rest(loads: Sequence[Load]) -> list[Load]:
    """Loads as linear elasticity sees them: pressures push along −z."""
    return [load.spread[0] if isinstance(load, FollowerLoad) else load for load in loads]


LOAD_KINDS: dict[str, type[Load]] = {load.kind: load for load in (DeadLoad, FollowerLoad, StiffLoad)}
