"""Straight-sided elements of one kind: where points lie in them, and what their shape functions are there."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skfem import Basis, Element, ElementHex1, ElementTetP1

from fem.boxes.boxes import QUADRATIC, SKFEM_NODES, Boxes
from geometry.layout import FloatArray

NEAREST = 16  #: elements by distance of their centres, tried before all of them are
ON_ELEMENT = 1e-9  #: by which rounding may put a point outside, as a share of the element


@dataclass(frozen=True, eq=False)
class Elements:
    """Tetrahedra or boxes, possibly sheared, with m elements of k nodes; corners come first, in scikit-fem's order."""

    element: Element  #: scikit-fem's, of one displacement component
    points_mm: FloatArray  #: (n, 3), positions of the nodes
    nodes: NDArray[np.int64]  #: (m, k), numbers of the nodes
    region: NDArray[np.int64]  #: (m,)

    @classmethod
    def of_basis(cls, basis: Basis, region: NDArray[np.int64]) -> "Elements":
        """The elements of a scikit-fem basis; `region` (m,)."""
        return cls(basis.elem, basis.doflocs.T.copy(), basis.element_dofs.T.astype(np.int64), region)

    @classmethod
    def of_boxes(cls, boxes: Boxes) -> "Elements":
        """Quadratic boxes."""
        return cls(QUADRATIC, boxes.points_mm, boxes.nodes[:, SKFEM_NODES], boxes.region)

    @property
    def is_box(self) -> bool:
        return len(self.element.doflocs) == 27

    @property
    def corner_element(self) -> Element:
        return ElementHex1() if self.is_box else ElementTetP1()

    @property
    def corners(self) -> NDArray[np.int64]:
        """Numbers of the corner nodes, shape (m, 4 or 8)."""
        return self.nodes[:, : 8 if self.is_box else 4]

    @cached_property
    def inverse_jacobian(self) -> FloatArray:
        """∂ξ/∂x of every element, shape (m, 3, 3): [k, i]; constant because sides are straight."""
        middle = np.full((3, 1), 0.5 if self.is_box else 0.25)
        slopes = shape_gradients(self.corner_element, middle)[0]  # (a, k)
        return np.linalg.inv(np.einsum("eai,ak->eik", self.points_mm[self.corners], slopes))

    @cached_property
    def volumes_mm3(self) -> FloatArray:
        """Shape (m,)."""
        return 1 / np.abs(np.linalg.det(self.inverse_jacobian)) / (1 if self.is_box else 6)

    def places(self, points_mm: FloatArray, region: int | None = None) -> tuple[NDArray[np.int64], FloatArray]:
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
        origin = self.points_mm[self._origin[candidates]]
        local = np.einsum("pcki,pci->pck", self.inverse_jacobian[candidates], points_mm[:, None] - origin)
        far_side = 1 - local.max(axis=2) if self.is_box else 1 - local.sum(axis=2)
        inside = np.minimum(local.min(axis=2), far_side)
        best = inside.argmax(axis=1)
        each = np.arange(len(points_mm))
        return candidates[each, best], local[each, best], inside[each, best]

    @cached_property
    def _origin(self) -> NDArray[np.int64]:
        """Number of each element's node at ξ = 0, shape (m,)."""
        return self.nodes[:, int(np.flatnonzero((self.element.doflocs == 0).all(axis=1))[0])]

    def interpolation(self, places: NDArray[np.int64], local: FloatArray) -> sp.csr_matrix:
        """Rows of shape functions at places of `places`, shape (k, n_nodes)."""
        values = shape_values(self.element, local.T)
        rows = np.repeat(np.arange(len(places)), values.shape[1])
        shape = (len(places), len(self.points_mm))
        return sp.csr_matrix((values.ravel(), (rows, self.nodes[places].ravel())), shape=shape)


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
