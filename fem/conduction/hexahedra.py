"""Hexahedra of any order between terminals, and their Gauss points."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.boxes.lagrange import cube_functions, cube_slopes, gauss_points, lobatto_points
from fem.tetrahedra.mixed import IntArray
from geometry.layout import FloatArray

SAME = 1e-8  #: of the body's extent: nodes closer than that are one

Where = Callable[[FloatArray], NDArray[np.bool_]]  #: points (n, 3) to booleans


@dataclass(frozen=True, eq=False, kw_only=True)
class Hexahedra:
    """Trilinear hexahedra with Lagrange functions of an order along each edge; corners and nodes run z fastest."""

    order: int
    corners_mm: FloatArray  #: (n_elements, 8, 3)
    nodes_mm: FloatArray  #: (n_nodes, 3)
    elements: IntArray  #: (n_elements, (order + 1)³): nodes of each
    terminals: tuple[IntArray, ...]  #: nodes on each terminal
    constraint: sp.csr_matrix  #: (n_nodes, n_unknowns): values of the nodes from the unknowns
    pairs: tuple[tuple[int, int], ...] = ((0, 1),)  #: terminals at both ends of each pillar

    @cached_property
    def _gauss(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        x, w = gauss_points(self.order + 1)
        points = np.array(list(product(x, x, x)))
        jacobian = np.einsum("dqn,enx->eqxd", cube_slopes(1, points), self.corners_mm)  # ∂x/∂ξ
        gradient = np.linalg.inv(jacobian).swapaxes(-1, -2) @ cube_slopes(self.order, points).swapaxes(0, 1)
        weights = np.einsum("a,b,c->abc", w, w, w).ravel() * np.abs(np.linalg.det(jacobian))
        places = cube_functions(1, points) @ self.corners_mm
        return places.reshape(-1, 3), weights.ravel(), gradient.reshape(-1, *gradient.shape[-2:])

    @property
    def points_mm(self) -> FloatArray:
        """Gauss points of all elements, one after the other, (n_points, 3)."""
        return self._gauss[0]

    @property
    def weight_mm3(self) -> FloatArray:
        """Volume of each of `points_mm`, (n_points,)."""
        return self._gauss[1]

    @property
    def gradient(self) -> FloatArray:
        """Gradients of the element's functions at `points_mm`, (n_points, 3, (order + 1)³) [1/mm]."""
        return self._gauss[2]


def joined(corners_mm: FloatArray, order: int, on_terminals: Sequence[Where]) -> Hexahedra:
    """Hexahedra that share the nodes of common faces.

    Parameters
    ----------
    corners_mm : array, shape (n_elements, 8, 3)
        Of conforming elements, either orientation.
    order : int
    on_terminals : sequence of functions
        Points (n, 3) to booleans: those on each terminal.
    """
    x = lobatto_points(order)
    places = (cube_functions(1, np.array(list(product(x, x, x)))) @ corners_mm).reshape(-1, 3)
    rounded = np.round(places / (SAME * np.ptp(places, axis=0).max())).astype(np.int64)
    _, first, numbers = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    nodes = places[first]
    return Hexahedra(
        order=order,
        corners_mm=corners_mm,
        nodes_mm=nodes,
        elements=numbers.reshape(len(corners_mm), -1),
        terminals=tuple(np.flatnonzero(on(nodes)) for on in on_terminals),
        constraint=sp.eye(len(nodes), format="csr"),
    )
