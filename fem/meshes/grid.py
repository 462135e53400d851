"""Grids of hexahedra between lines along x, y and z, upright or sheared as one, and where points lie in them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from skfem import MeshHex

from geometry.layout import FloatArray

IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Grid:
    """All hexahedra between lines along x, y and z [mm], which are stated at the base z = 0."""

    lines: Sequence[FloatArray]  #: increasing, one array an axis
    lean: tuple[float, float] = (0.0, 0.0)  #: x and y by which points shift per mm of height

    @cached_property
    def mesh(self) -> MeshHex:
        mesh = MeshHex.init_tensor(*self.lines)
        if not any(self.lean):
            return mesh
        return MeshHex(self.shear @ mesh.p, mesh.t)

    @cached_property
    def shear(self) -> FloatArray:
        """∂x/∂x₀ of the places x₀ before they are sheared, (3, 3)."""
        out = np.eye(3)
        out[:2, 2] = self.lean
        return out

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of elements along each axis."""
        x, y, z = (len(line) - 1 for line in self.lines)
        return x, y, z

    @cached_property
    def element(self) -> IntArray:
        """The number of the element between each three intervals, of `shape`."""
        middles = self.mesh.p[:, self.mesh.t].mean(axis=1)
        places = np.linalg.inv(self.shear) @ middles
        found = np.empty(self.shape, dtype=np.int64)
        at = tuple(np.searchsorted(line, along) - 1 for line, along in zip(self.lines, places, strict=True))
        found[at] = np.arange(self.mesh.nelements)
        return found

    def located(self, points_mm: FloatArray, among: NDArray[np.bool_] | None = None) -> tuple[IntArray, FloatArray]:
        """The element that holds each of points (k, 3), (k,), and where in it, (3, k) in 0..1; `among` is not asked.

        A point outside is taken for the nearest one inside, along each axis.
        """
        places, at = points_mm @ np.linalg.inv(self.shear).T, []
        for axis, line in enumerate(self.lines):
            places[:, axis] = np.clip(places[:, axis], line[0], line[-1])
            at.append(np.clip(np.searchsorted(line, places[:, axis], side="right") - 1, 0, len(line) - 2))
        element, (origin, pull) = self.element[tuple(at)], self._frames
        return element, np.einsum("kij,kj->ik", pull[element], places @ self.shear.T - origin[element])

    @cached_property
    def _frames(self) -> tuple[FloatArray, FloatArray]:
        """Place of local (0, 0, 0) and ∂ξ/∂x of every element, (m, 3) and (m, 3, 3)."""
        mapping = self.mesh.mapping()
        return mapping.F(np.zeros((3, 1)))[..., 0].T, mapping.invDF(np.full((3, 1), 0.5))[..., 0].transpose(2, 0, 1)


def mirrored(lines: FloatArray, place_mm: float = 0.0) -> FloatArray:
    """Lines from a plane on, and their mirror images before it."""
    return np.concatenate([2 * place_mm - lines[:0:-1], lines])
