"""Boxes of one order, upright or sheared as one: their nodes, and rows that take nodal values to what is asked of them.

Nodes lie on Gauss-Lobatto points. On a grid all are independent; where fine boxes meet coarse ones (`splitting.py`) the
nodes on a larger box's face take what its functions give there (`constraint`). A field is given by its values at all
nodes, dependent ones included: `at`, `slopes` and `integrals` are sparse rows on them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre
from numpy.typing import NDArray

from geometry.layout import FloatArray

IntArray = NDArray[np.int64]

#: VTK's nodes of a triquadratic hexahedron in half steps: corners, lower edges, upper edges, uprights, the middles of
#: the sides across x, y and z, and of the whole
VTK_PLACES = np.array(
    [
        *[(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)],
        *[(1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2)],
        *[(0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)],
        *[(0, 1, 1), (2, 1, 1), (1, 0, 1), (1, 2, 1), (1, 1, 0), (1, 1, 2), (1, 1, 1)],
    ]
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Boxes:
    """m boxes of (order + 1)³ nodes each, n nodes in all; the base is z = 0."""

    cell_type = 29  #: VTK's number of boxes of order 2

    low: FloatArray  #: (m, 3), lowest corners before they are sheared [mm]
    high: FloatArray  #: (m, 3), highest corners
    order: int  #: of the functions along each axis
    nodes: IntArray  #: (m, (order + 1)³), numbers of the nodes, z fastest
    region: IntArray  #: (m,), which material fills each box
    lean: tuple[float, float] = (0.0, 0.0)  #: x and y by which points shift per mm of height
    constraint: sp.csr_matrix | None = None  #: (n, n), values of all nodes from those of the independent ones

    @classmethod
    def between(cls, lines: Sequence[FloatArray], order: int = 2, lean: tuple[float, float] = (0.0, 0.0)) -> "Boxes":
        """All boxes between lines along x, y and z [mm], of region 0."""
        shape = tuple(len(line) - 1 for line in lines)
        low, high = (
            np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(-1, 3)
            for ends in ([line[:-1] for line in lines], [line[1:] for line in lines])
        )
        start = order * np.indices(shape).reshape(3, -1, 1)
        local = np.indices((order + 1,) * 3).reshape(3, 1, -1)
        nodes = np.ravel_multi_index(tuple(start + local), [order * count + 1 for count in shape])
        return cls(low=low, high=high, order=order, nodes=nodes, region=np.zeros(len(low), np.int64), lean=lean)

    @cached_property
    def size(self) -> FloatArray:
        """Extents of the boxes, (m, 3) [mm]."""
        return self.high - self.low

    @cached_property
    def n_nodes(self) -> int:
        return int(self.nodes.max()) + 1

    @cached_property
    def is_independent(self) -> NDArray[np.bool_]:
        """Which nodes hang on no others, (n,)."""
        if self.constraint is None:
            return np.ones(self.n_nodes, dtype=bool)
        return np.asarray(self.constraint.diagonal() == 1)

    @cached_property
    def lines(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Every place along x, y and z at which a box ends [mm]."""
        x, y, z = (np.unique(np.concatenate([self.low[:, d], self.high[:, d]])) for d in range(3))
        return x, y, z

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of intervals between the lines along each axis; on a grid, of boxes."""
        x, y, z = (len(line) - 1 for line in self.lines)
        return x, y, z

    @property
    def height_mm(self) -> float:
        return float(self.lines[2][-1])

    @cached_property
    def shear(self) -> FloatArray:
        """∂x/∂ξ of the boxes' sides, (3, 3): the identity but for the lean; its inverse has the opposite lean."""
        out = np.eye(3)
        out[:2, 2] = self.lean
        return out

    def hung(self, owner: IntArray) -> "Boxes":
        """The same with nodes that take what the functions of a larger box give there; `owner` (n,), −1 for none."""
        hanging = np.flatnonzero(owner >= 0)
        if not len(hanging):
            return self
        box = owner[hanging]
        local = 2 * (self._places[hanging] - self.low[box]) / self.size[box] - 1
        values = cube_functions(self.order, local)
        values[np.abs(values) < 1e-14] = 0.0  # what is zero but for rounding would couple distant nodes
        rows = sp.csr_matrix((np.ones(len(hanging)), (hanging, range(len(hanging)))), shape=(len(owner), len(hanging)))
        direct = (sp.diags(1.0 * (owner < 0)) + rows @ self._rows(box, values)).tocsr()
        direct.eliminate_zeros()
        constraint = direct
        while (owner[constraint.indices] >= 0).any():  # a larger face may itself hang on a yet larger one
            constraint = constraint @ direct
        return replace(self, constraint=constraint)

    @cached_property
    def points_mm(self) -> FloatArray:
        """Positions of the nodes, (n, 3) [mm]."""
        return self._places @ self.shear.T

    @cached_property
    def _places(self) -> FloatArray:
        """The same before they are sheared."""
        share = (lobatto_points(self.order) + 1) / 2
        local = share[np.indices((self.order + 1,) * 3).reshape(3, -1).T]
        points = np.empty((self.n_nodes, 3))
        points[self.nodes] = self.low[:, None] + local * self.size[:, None]
        ends = local == 1  # exact on the highest faces: clamps, mirrors and plates are found by position
        points[self.nodes] = np.where(ends, self.high[:, None], points[self.nodes])
        return points

    def located(self, points_mm: FloatArray, region: int | None = None) -> tuple[IntArray, FloatArray]:
        """The box that holds each of points (k, 3), (k,), and where in it, (k, 3) in −1..1; whatever its region.

        A point outside is taken for the nearest one inside, along each axis.
        """
        places = points_mm @ np.linalg.inv(self.shear).T
        cells = []
        for d, line in enumerate(self.lines):
            places[:, d] = np.clip(places[:, d], line[0], line[-1])
            cells.append(np.clip(np.searchsorted(line, places[:, d], side="right") - 1, 0, len(line) - 2))
        box = self._box_of_cell[tuple(cells)]
        return box, 2 * (places - self.low[box]) / self.size[box] - 1

    @cached_property
    def _box_of_cell(self) -> IntArray:
        """The box that each cell between the lines lies in, of the shape of the cells."""
        found = np.zeros(self.shape, dtype=np.int64)
        first, last = (
            np.column_stack([np.searchsorted(line, ends[:, d]) for d, line in enumerate(self.lines)])
            for ends in (self.low, self.high)
        )
        for box, ((i, j, k), (i1, j1, k1)) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
            found[i:i1, j:j1, k:k1] = box
        return found

    def at(self, points_mm: FloatArray, region: int | None = None) -> sp.csr_matrix:
        """Rows that take nodal values to those at points (k, 3), shape (k, n); whatever the region."""
        box, local = self.located(points_mm)
        return self._rows(box, cube_functions(self.order, local))

    def slopes(self, points_mm: FloatArray) -> sp.csr_matrix:
        """Rows that take nodal values to derivatives at points (k, 3): all by x, then by y, then by z, (3 k, n)."""
        box, local = self.located(points_mm)
        along = cube_slopes(self.order, local) * (2 / self.size[box]).T[:, :, None]
        along = np.tensordot(np.linalg.inv(self.shear), along, (0, 0))
        return sp.vstack([self._rows(box, values) for values in along], format="csr")

    @property
    def cells(self) -> IntArray:
        """Nodes of boxes of order 2 as VTK orders them, (m, 27)."""
        return self.nodes[:, VTK_PLACES @ (9, 3, 1)]

    @property
    def cell_places(self) -> FloatArray:
        """Where they lie in a box, (27, 3) in −1..1."""
        return VTK_PLACES - 1.0

    @property
    def corners(self) -> IntArray:
        """Numbers of the corner nodes, (m, 8), z fastest."""
        k, p = self.order + 1, self.order
        return self.nodes.reshape(-1, k, k, k)[:, ::p, ::p, ::p].reshape(-1, 8)

    @property
    def volumes_mm3(self) -> FloatArray:
        """Shape (m,)."""
        return np.asarray(self.size.prod(axis=1), np.float64)

    def linear(self, local: FloatArray) -> FloatArray:
        """Linear functions of the corners at places (k, 3) in −1..1, shape (k, 8)."""
        return cube_functions(1, local)

    def corner_slopes(self) -> list[sp.csr_matrix]:
        """Linear part of derivatives along x, y and z at boxes' corners, from nodal values of order 2, (8 m, n)."""
        corners = 2.0 * np.indices((2, 2, 2)).reshape(3, -1).T - 1
        gauss = corners / np.sqrt(3)
        fitted = (1 + 3 * corners @ gauss.T) / 8  # values at Gauss points to those of a linear function at corners
        along = (fitted @ cube_slopes(self.order, gauss))[:, None] * (2 / self.size).T[:, :, None, None]
        along = np.tensordot(np.linalg.inv(self.shear), along, (0, 0)).reshape(3, 8 * len(self.nodes), -1)
        return [self._rows(np.repeat(np.arange(len(self.nodes)), 8), values) for values in along]

    def _rows(self, box: IntArray, values: FloatArray) -> sp.csr_matrix:
        rows = np.repeat(np.arange(len(box)), values.shape[1])
        return sp.csr_matrix((values.ravel(), (rows, self.nodes[box].ravel())), shape=(len(box), self.n_nodes))

    def integrals(self, rectangles: FloatArray) -> sp.csr_matrix:
        """∫ φ dA of every function over rectangles x0, y0, x1, y1 of the top face, shape (k, n) [mm²].

        Exact wherever the boxes' sides lie; a row sums to the area of the top that its rectangle covers.
        """
        rectangles = np.asarray(rectangles, dtype=float).reshape(-1, 4)
        shift = np.tile(np.array(self.lean) * self.height_mm, 2)
        top = np.flatnonzero(self.high[:, 2] == self.height_mm)
        upper = np.arange((self.order + 1) ** 3).reshape((self.order + 1,) * 3)[:, :, -1].ravel()
        rows, columns, values = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)]
        for number, rectangle in enumerate(rectangles - shift):
            start = np.maximum(self.low[top, :2], rectangle[:2])
            end = np.minimum(self.high[top, :2], rectangle[2:])
            some = (end > start).all(axis=1)
            own = top[some]
            X, Y = (
                interval_integrals(self.order, self.low[own, d], self.high[own, d], start[some, d], end[some, d])
                for d in range(2)
            )
            values.append(np.einsum("mi,mj->mij", X, Y).ravel())
            columns.append(self.nodes[own][:, upper].ravel())
            rows.append(np.full(len(columns[-1]), number))
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        return sp.csr_matrix(entries, shape=(len(rectangles), self.n_nodes))


@cache
def lobatto_points(order: int) -> FloatArray:
    """The order + 1 Gauss-Lobatto points of [-1, 1], read-only: nodes of the Lagrange functions."""
    inner = np.sort(legendre.legroots(legendre.legder([0.0] * order + [1.0]))) if order > 1 else np.zeros(0)
    return _read_only(np.concatenate([[-1.0], inner, [1.0]]))


@cache
def gauss_points(count: int) -> tuple[FloatArray, FloatArray]:
    """Gauss points of [-1, 1] and their weights, read-only."""
    x, weights = legendre.leggauss(count)
    return _read_only(x), _read_only(weights)


def _read_only(values: FloatArray) -> FloatArray:
    values.flags.writeable = False
    return values


@cache
def _to_legendre(order: int) -> tuple[FloatArray, FloatArray]:
    """Legendre coefficients of the Lagrange functions, and of their derivatives; columns are functions."""
    coefficients: FloatArray = np.asarray(np.linalg.inv(legendre.legvander(lobatto_points(order), order)), np.float64)
    return coefficients, np.asarray(legendre.legder(coefficients), np.float64)


def shape_functions(order: int, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lagrange functions and their derivatives at x in [-1, 1], both of shape (..., order + 1).

    >>> shape_functions(1, np.array([0.0]))
    (array([[0.5, 0.5]]), array([[-0.5,  0.5]]))
    """
    functions, derivatives = _to_legendre(order)
    powers = legendre.legvander(x, order)
    return powers @ functions, powers[..., :order] @ derivatives


def cube_functions(order: int, places: FloatArray) -> FloatArray:
    """Functions of a box at places (k, 3) of [-1, 1]³, shape (k, (order + 1)³); nodes run z fastest."""
    X, Y, Z = (shape_functions(order, places[:, d])[0] for d in range(3))
    return np.einsum("ki,kj,kl->kijl", X, Y, Z).reshape(len(places), -1)


def cube_slopes(order: int, places: FloatArray) -> FloatArray:
    """Their derivatives along each axis of [-1, 1]³, shape (3, k, (order + 1)³)."""
    along = [shape_functions(order, places[:, d]) for d in range(3)]
    return np.stack([
        np.einsum("ki,kj,kl->kijl", *(along[axis][int(axis == d)] for axis in range(3))).reshape(len(places), -1)
        for d in range(3)
    ])  # fmt: skip


def interval_integrals(
    order: int, left: FloatArray, right: FloatArray, start: FloatArray, end: FloatArray
) -> FloatArray:
    """∫ φₐ dx over [start, end] of the functions of elements [left, right] that hold it, (m, order + 1); exact."""
    x, weights = gauss_points(order // 2 + 1)
    half = (end - start) / 2
    places = (2 * (start[:, None] + half[:, None] * (x + 1)) - (left + right)[:, None]) / (right - left)[:, None]
    return half[:, None] * np.einsum("q,mqa->ma", weights, shape_functions(order, places)[0])
