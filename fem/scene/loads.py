"""Loads of a scene, each on a rectangle of the top face at rest: dead, following and stiff.

Directions are the axes' and do not turn, but for the pressure of a `FollowerLoad`. All grow from 0 in proportion.
"""

from dataclasses import dataclass, field, fields, replace
from typing import Self

import numpy as np

from fem.scene.checks import LARGEST_MPA, SceneError, is_finite, require_extents, require_vectors, shown
from geometry.layout import FloatArray
from geometry.prism import Pair, Triple

Rectangle = tuple[float, float, float, float]  #: x0, y0, x1, y1 [mm]


def rectangle_of(center_mm: Pair, size_mm: Pair) -> Rectangle:
    """The rectangle of a centre and an extent."""
    (x, y), (a, b) = center_mm, size_mm
    return x - a / 2, y - b / 2, x + a / 2, y + b / 2


@dataclass(frozen=True, kw_only=True)
class _OnRectangle:
    """A load on a rectangle of the top face."""

    center_mm: Pair = field(metadata={"meaning": "centre of the loaded rectangle: x, y, in mm"})
    size_mm: Pair = field(metadata={"meaning": "extent of the loaded rectangle along x and y, in mm"})

    def __post_init__(self) -> None:
        require_vectors(self, {"center_mm": 2, "size_mm": 2})
        require_extents(self, "size_mm")

    def times(self, share: float) -> Self:
        """The same load, a share as large."""
        own = {one.name: getattr(self, one.name) for one in fields(self) if not one.name.endswith("_mm")}
        return replace(self, **{name: (np.array(value) * share).tolist() for name, value in own.items()})

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

    @property
    def rectangle(self) -> Rectangle:
        return rectangle_of(self.center_mm, self.size_mm)


@dataclass(frozen=True, kw_only=True)
class DeadLoad(_OnRectangle):
    """A uniform traction per area at rest, whose direction stays; where such loads overlap they add up.

    At finite strain it has no equilibrium beyond about half of Young's modulus: elements at its edges turn inside out.
    """

    kind = "dead"
    traction_mpa: Triple = field(metadata={"meaning": "traction along x, y, z, in MPa; z negative pushes down"})

    def __post_init__(self) -> None:
        super().__post_init__()
        require_vectors(self, {"traction_mpa": 3}, LARGEST_MPA)

    @property
    def components(self) -> tuple[float, ...]:
        """Traction along x, y, z."""
        return self.traction_mpa

    @property
    def spread(self) -> tuple["DeadLoad", ...]:
        """The load as small strain sees it."""
        return (self,)


@dataclass(frozen=True, kw_only=True)
class FollowerLoad(_OnRectangle):
    """A pressure along the deformed surface's normal, per deformed area, and a dead tangential traction.

    It has no potential: how far it moves the body may depend on the way to it, and its stiffness is not symmetric.
    Linear elasticity knows no deformed normal: there the pressure pushes along −z.
    """

    kind = "follower"
    pressure_mpa: float
    traction_mpa: Pair = field(default=(0.0, 0.0), metadata={"meaning": "traction along x and y, in MPa at rest"})

    def __post_init__(self) -> None:
        super().__post_init__()
        require_vectors(self, {"traction_mpa": 2}, LARGEST_MPA)
        if not is_finite(self.pressure_mpa) or abs(self.pressure_mpa) > LARGEST_MPA:
            raise SceneError(
                f"pressure_mpa={shown(self.pressure_mpa)} must be a finite number of at most {LARGEST_MPA:g}; above 0 "
                "it pushes."
            )
        object.__setattr__(self, "pressure_mpa", float(self.pressure_mpa))

    @property
    def components(self) -> tuple[float, ...]:
        """Traction along x, y, z at rest."""
        return (*self.traction_mpa, -self.pressure_mpa)

    @property
    def spread(self) -> tuple[DeadLoad, ...]:
        """The load as small strain sees it."""
        traction = (*self.traction_mpa, -self.pressure_mpa)
        return (DeadLoad(center_mm=self.center_mm, size_mm=self.size_mm, traction_mpa=traction),)

    def _signs(self, signs: FloatArray, axial: FloatArray) -> list[tuple[str, FloatArray]]:
        return [("traction_mpa", signs[:2]), ("pressure_mpa", signs[2])]


@dataclass(frozen=True, kw_only=True)
class StiffLoad(_OnRectangle):
    """A rigid plate bonded to a rectangle, loaded at the middle of its underside."""

    kind = "stiff"
    force_n: Triple = field(metadata={"meaning": "force along x, y, z, in N; z negative pushes down"})
    moment_nmm: Triple = field(default=(0.0, 0.0, 0.0), metadata={"meaning": "moment about x, y, z, in N mm"})

    def __post_init__(self) -> None:
        super().__post_init__()
        require_vectors(self, {"force_n": 3, "moment_nmm": 3}, LARGEST_MPA)

    def _signs(self, signs: FloatArray, axial: FloatArray) -> list[tuple[str, FloatArray]]:
        return [("force_n", signs), ("moment_nmm", axial)]

    @property
    def components(self) -> tuple[float, ...]:
        """Force and moment."""
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
LOAD_KINDS: dict[str, type[Load]] = {load.kind: load for load in (DeadLoad, FollowerLoad, StiffLoad)}
