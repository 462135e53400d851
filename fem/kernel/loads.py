"""Loads of a scene, each on a rectangle of the top face at rest: dead, following and stiff.

Directions are the axes' and do not turn, but for the pressure of a `FollowerLoad`. All grow from 0 in proportion.
"""

from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields, replace
from typing import Self

import numpy as np

from common.errors import SceneError
from common.quantity import quantity, require_sound
from fem.kernel.mirrors import Mirror, Parity, flipped_rectangles, images
from geometry.layout import FloatArray
from geometry.prism import Pair, Triple

Rectangle = tuple[float, float, float, float]  #: x0, y0, x1, y1 [mm]
ON_PLANE = 1e-9  #: of a rectangle's width: how far rounding may put its side off a mirror plane
LIMITS_MM = (1e-6, 1e6)  #: sizes and distances of a scene; beyond, coordinates lose their digits


@dataclass(frozen=True, kw_only=True)
class Checked:
    """A part of a scene, whose quantities are refused by name where they make no sense."""

    def __post_init__(self) -> None:
        require_sound(self, SceneError, LIMITS_MM)


def rectangle_of(center_mm: Pair, size_mm: Pair) -> Rectangle:
    """The rectangle of a centre and an extent."""
    (x, y), (a, b) = center_mm, size_mm
    return x - a / 2, y - b / 2, x + a / 2, y + b / 2


@dataclass(frozen=True, kw_only=True)
class _OnRectangle(Checked):
    """A load on a rectangle of the top face."""

    center_mm: Pair = quantity(MISSING, "centre of the loaded rectangle: x, y, in mm", count=2)
    size_mm: Pair = quantity(MISSING, "extent of the loaded rectangle along x and y, in mm", count=2, above_0=True)

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
    traction_mpa: Triple = quantity(MISSING, "traction along x, y, z, in MPa; z negative pushes down", count=3)

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
    pressure_mpa: float = quantity(MISSING, "pressure, in MPa; above 0 it pushes")
    traction_mpa: Pair = quantity((0.0, 0.0), "traction along x and y, in MPa at rest", count=2)

    @property
    def components(self) -> tuple[float, ...]:
        return (*self.traction_mpa, -self.pressure_mpa)

    def _signs(self, signs: FloatArray, axial: FloatArray) -> list[tuple[str, FloatArray]]:
        return [("traction_mpa", signs[:2]), ("pressure_mpa", signs[2])]


@dataclass(frozen=True, kw_only=True)
class StiffLoad(_OnRectangle):
    """A rigid plate bonded to a rectangle, loaded at the middle of its underside."""

    kind = "stiff"
    force_n: Triple = quantity(MISSING, "force along x, y, z, in N; z negative pushes down", count=3)
    moment_nmm: Triple = quantity((0.0, 0.0, 0.0), "moment about x, y, z, in N mm", count=3)

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


def folded_loads(loads: Sequence[Load], mirrors: tuple[Mirror, ...], parity: Parity) -> list[Load]:
    """The part of loads that a parity takes, on what is solved of the body.

    Each image of a load counts for its share; those of one rectangle are one load. A plane that cuts a stiff load
    leaves half of it.
    """
    found: dict[tuple[object, ...], Load] = {}
    for load in loads:
        width = max(load.size_mm)
        for flipped, signs in images(mirrors, parity):
            rectangle = flipped_rectangles(np.array(load.rectangle), flipped)
            share = 0.5 ** len(mirrors)
            for mirror in mirrors:
                ends = [mirror.axis, mirror.axis + 2]
                beyond = mirror.position_mm - rectangle[mirror.axis]
                rectangle[ends] = np.maximum(rectangle[ends], mirror.position_mm)
                share *= 0.5 if beyond > ON_PLANE * width and isinstance(load, StiffLoad) else 1.0
            if ((rectangle[2:] - rectangle[:2]) <= ON_PLANE * width).any():
                continue
            image = load.image(rectangle, share * signs, share * signs * (-1) ** len(flipped))
            key = (load.kind, *np.round(rectangle / width, 9))
            found[key] = found[key].plus(image) if key in found else image  # type: ignore[arg-type]  # of one kind
    return list(found.values())
