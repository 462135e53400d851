"""Straight-sided tetrahedra: where points lie in them, and what their shape functions are there."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skfem import Basis, Element

from geometry.layout import FloatArray

NEAREST = 16  #: elements by distance of their centres, tried before all of them are
ON_ELEMENT = 1e-9  #: by which rounding may put a point outside, as a share of the element


@dataclass(frozen=True, eq=False)
class Elements:
    """m tetrahedra of k nodes; corners come first, in scikit-fem's order."""

    element: Element  #: scikit-fem's, of one displacement component
    points_mm: FloatArray  #: (n, 3), positions of the nodes
    nodes: NDArray[np.int64]  #: (m, k), numbers of the nodes
    region: NDArray[np.int64]  #: (m,)
    cell_type = 24  #: VTK's number of quadratic tetrahedra

    @classmethod
    def of_basis(cls, basis: Basis, region: NDArray[np.int64]) -> "Elements":
        """The elements of a scikit-fem basis; `region` (m,)."""
        return cls(basis.elem, basis.doflocs.T.copy(), basis.element_dofs.T.astype(np.int64), region)

    @property
    def corners(self) -> NDArray[np.int64]:
        """Numbers of the corner nodes, shape (m, 4)."""
        return self.nodes[:, :4]

    @cached_property
    def inverse_jacobian(self) -> FloatArray:
        """∂ξ/∂x of every element, shape (m, 3, 3): [k, i]; constant because sides are straight."""
        corners = self.points_mm[self.corners]
        return np.asarray(np.linalg.inv((corners[:, 1:] - corners[:, :1]).swapaxes(1, 2)), np.float64)

    @cached_property
    def volumes_mm3(self) -> FloatArray:
        """Shape (m,)."""
        return 1 / np.abs(np.linalg.det(self.inverse_jacobian)) / 6

    def located(self, points_mm: FloatArray, region: int | None = None) -> tuple[NDArray[np.int64], FloatArray]:
        """The element that holds each of the points (k, 3), shape (k,), and where in it, shape (k, 3) in 0..1.

        A point in none, or in none of `region` if that is given, goes to the element that it misses by least, and may
        be outside of it.
        """
        among = np.arange(len(self.nodes)) if region is None else np.flatnonzero(self.region == region)
        centres = self.points_mm[self.corners[among]].mean(axis=1)
        _, near = cKDTree(centres).query(points_mm, k=min(NEAREST, len(among)))
        found, local, inside = self._best(points_mm, among[near.reshape(len(points_mm), -1)])
        lost = np.flatnonzero(inside < -ON_ELEMENT)
        for some in np.array_split(lost, 1 + len(lost) * len(among) // 2_000_000):  # bounds the memory
            everywhere = np.broadcast_to(among, (len(some), len(among)))
            found[some], local[some], _ = self._best(points_mm[some], everywhere)
        return found, local

    def _best(
        self, points_mm: FloatArray, candidates: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
        """The candidate (k, c) that each point is deepest in, its place there, and its depth (< 0: outside)."""
        origin = self.points_mm[self.nodes[candidates, 0]]
        local = np.einsum("pcki,pci->pck", self.inverse_jacobian[candidates], points_mm[:, None] - origin)
        inside = np.minimum(local.min(axis=2), 1 - local.sum(axis=2))
        best = inside.argmax(axis=1)
        each = np.arange(len(points_mm))
        return candidates[each, best], local[each, best], inside[each, best]

    def at(self, points_mm: FloatArray, region: int | None = None) -> sp.csr_matrix:
        """Rows that take nodal values to those at points (k, 3), found as by `located`, shape (k, n)."""
        found, local = self.located(points_mm, region)
        return self._rows(found, shape_values(self.element, local.T))

    def slopes(self, points_mm: FloatArray) -> sp.csr_matrix:
        """Rows that take nodal values to derivatives at points (k, 3): all by x, then by y, then by z, (3 k, n)."""
        found, local = self.located(points_mm)
        slopes = shape_gradients(self.element, local.T) @ self.inverse_jacobian[found]
        return sp.vstack([self._rows(found, slopes[..., axis]) for axis in range(3)], format="csr")

    @property
    def cells(self) -> NDArray[np.int64]:
        """Nodes as VTK orders them, which is scikit-fem's order, (m, k)."""
        return self.nodes

    @property
    def cell_places(self) -> FloatArray:
        """Where they lie in an element, (k, 3) in 0..1."""
        return np.asarray(self.element.doflocs, np.float64)

    def linear(self, local: FloatArray) -> FloatArray:
        """Linear functions of the corners at places (k, 3) in 0..1, shape (k, 4)."""
        return np.column_stack([1 - local.sum(axis=1), local])

    @cached_property
    def _corner_slopes(self) -> FloatArray:
        """Derivatives of an element's functions at its corners, (m, 4, k, 3) [1/mm]."""
        return shape_gradients(self.element, self.element.doflocs[:4].T) @ self.inverse_jacobian[:, None]

    def corner_slopes(self) -> list[sp.csr_matrix]:
        """Derivatives along x, y and z at elements' corners, from nodal values, (4 m, n)."""
        m = len(self.nodes)
        slopes = self._corner_slopes.reshape(4 * m, -1, 3)
        return [self._rows(np.repeat(np.arange(m), 4), slopes[..., axis]) for axis in range(3)]

    def corner_gradients(self, u: FloatArray) -> FloatArray:
        """∂ⱼuᵢ at elements' corners, [e, v, i, j], of displacements (n, 3): shape (m, 4, 3, 3)."""
        return u[self.nodes].swapaxes(1, 2)[:, None] @ self._corner_slopes

    def _rows(self, found: NDArray[np.int64], values: FloatArray) -> sp.csr_matrix:
        rows = np.repeat(np.arange(len(found)), values.shape[1])
        shape = (len(found), len(self.points_mm))
        return sp.csr_matrix((values.ravel(), (rows, self.nodes[found].ravel())), shape=shape)


def shape_values(element: Element, local: FloatArray) -> FloatArray:
    """Shape functions at local points (3, n), shape (n, k)."""
    values = [np.broadcast_to(element.lbasis(local, a)[0], local.shape[1]) for a in range(len(element.doflocs))]
    return np.stack(values, axis=-1)


def shape_gradients(element: Element, local: FloatArray) -> FloatArray:
    """Their gradients by local coordinates, shape (n, k, 3)."""
    slopes = [
        np.broadcast_to(np.asarray(element.lbasis(local, a)[1]).reshape(3, -1), local.shape)
        for a in range(len(element.doflocs))
    ]
    return np.stack(slopes).transpose(2, 0, 1)
