"""A mesh of boxes, each of which can be split along any axis: fine boxes meet coarse ones, and no line runs through.

Every axis is a forest of intervals (`AxisTree`). A box is one interval of each axis, so boxes that meet have faces and
edges of which one holds the other, once `BoxMesh` has split those that would cross. Nodes on the face or edge of a
larger box are no unknowns: they take what that box's functions give there (`Boxes.constraint`), so displacements stay
continuous.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from fem.boxes.boxes import Boxes
from geometry.layout import FloatArray

IntArray = NDArray[np.int64]

TOWARD_STOP = 0.2  #: of an interval that ends at a stop, the part on that side when it is split; 0.15 and 0.3 do alike
BITS = 20  #: of a number of a vertex or an interval, in the key of an entity
#: a box's vertices, edges, faces and inside: along each axis its low end, its inside or its high end
PLACES = tuple(product(range(3), repeat=3))


class AxisTree:
    """Vertices and intervals of one axis, in one numbering; splitting an interval adds a vertex and two intervals.

    `lines` (n + 1,) are ends of the first intervals; `stops` (k,) places at which the stress may be singular: an
    interval is split at one, or near those at its ends. `shells` are places that enclose a small patch, and their
    distance from it: an interval is split at the farthest first. All in mm.
    """

    def __init__(self, lines: FloatArray, stops: FloatArray, shells: Mapping[float, float] | None = None) -> None:
        self.low: list[float] = []  #: of every vertex and interval [mm]
        self.high: list[float] = []
        self.parent: list[int] = []  #: the interval by whose splitting it came to be; −1 of the first ones
        self.ends: list[tuple[int, int]] = []  #: vertices of an interval; −1 of a vertex
        self._stops = np.sort(stops)
        self._shells = sorted((shells or {}).items(), key=lambda shell: -shell[1])
        self._children: dict[int, tuple[int, int]] = {}
        vertices = [self._vertex(float(x), -1) for x in lines]
        self.roots = [self._interval(a, b, -1) for a, b in pairwise(vertices)]

    def _vertex(self, x: float, parent: int) -> int:
        return self._add(x, x, parent, (-1, -1))

    def _interval(self, a: int, b: int, parent: int) -> int:
        return self._add(self.low[a], self.low[b], parent, (a, b))

    def _add(self, low: float, high: float, parent: int, ends: tuple[int, int]) -> int:
        self.low.append(low)
        self.high.append(high)
        self.parent.append(parent)
        self.ends.append(ends)
        return len(self.low) - 1

    def split(self, interval: int) -> tuple[int, int]:
        """The two parts of an interval: at a shell, at the stop next to its middle, near one at an end, or even."""
        if interval not in self._children:
            a, b = self.ends[interval]
            low, high = self.low[a], self.low[b]
            inside = self._stops[(self._stops > low) & (self._stops < high)]
            at_low, at_high = np.isin([low, high], self._stops)
            shell = next((place for place, _ in self._shells if low < place < high), None)
            if shell is not None:
                place = shell
            elif len(inside):
                place = float(inside[np.argmin(np.abs(inside - (low + high) / 2))])
            elif at_low == at_high:
                place = (low + high) / 2
            else:
                place = low + (TOWARD_STOP if at_low else 1 - TOWARD_STOP) * (high - low)
            middle = self._vertex(place, interval)
            self._children[interval] = self._interval(a, middle, interval), self._interval(middle, b, interval)
        return self._children[interval]


@dataclass(frozen=True, eq=False)
class Table:
    """An axis as arrays, one entry for each vertex and interval."""

    low: FloatArray
    high: FloatArray
    parent: IntArray
    ends: IntArray  #: shape (n, 2)

    @cached_property
    def is_vertex(self) -> NDArray[np.bool_]:
        return self.ends[:, 0] < 0

    @cached_property
    def depth(self) -> IntArray:
        """Number of splittings that made each entry; parents come before their children."""
        depth = np.zeros(len(self.parent), dtype=np.int64)
        for number, parent in enumerate(self.parent):
            depth[number] = 0 if parent < 0 else depth[parent] + 1
        return depth


class BoxMesh:
    """Boxes over three axes; the first ones fill the whole grid of the axes' first intervals."""

    def __init__(self, axes: tuple[AxisTree, AxisTree, AxisTree]) -> None:
        self.axes = axes
        self.boxes: IntArray = np.array(list(product(*(axis.roots for axis in axes))))  #: (n, 3), an interval an axis

    def split(self, marks: NDArray[np.bool_]) -> None:
        """Split boxes along the axes that `marks`, shape (n, 3), names; then those whose faces would cross."""
        while marks.any():
            chosen = marks.any(axis=1)
            new: list[tuple[int, ...]] = []
            for box, along in zip(self.boxes[chosen].tolist(), marks[chosen], strict=True):
                new += product(
                    *(axis.split(i) if cut else (i,) for axis, i, cut in zip(self.axes, box, along, strict=True))
                )
            self.boxes = np.vstack([self.boxes[~chosen], np.array(new)])
            marks = self._crossing()

    def tables(self) -> tuple[Table, Table, Table]:
        """The axes as arrays."""
        x, y, z = (
            Table(np.array(a.low), np.array(a.high), np.array(a.parent), np.array(a.ends, dtype=np.int64))
            for a in self.axes
        )
        return x, y, z

    @property
    def corners(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest corner of every box, each of shape (n, 3) [mm]."""
        tables = self.tables()
        low, high = (
            np.stack([getattr(t, side)[self.boxes[:, d]] for d, t in enumerate(tables)], axis=1)
            for side in ("low", "high")
        )
        return low, high

    def _crossing(self) -> NDArray[np.bool_]:
        """Boxes to split, shape (n, 3), because a face is narrower one way and wider the other than what it meets."""
        tables, n = self.tables(), len(self.boxes)
        marks = np.zeros((n, 3), dtype=bool)
        for normal in range(3):
            one, two = (d for d in range(3) if d != normal)
            plane = tables[normal].ends[self.boxes[:, normal]].T.ravel()
            i, j = np.tile(self.boxes[:, one], 2), np.tile(self.boxes[:, two], 2)
            at, up = _ancestors(tables[one].parent, i)
            wider, owner = _key(plane[at], up, j[at]), at
            at, up = _ancestors(tables[two].parent, j)
            longer = _key(plane[at], i[at], up)
            marks[owner[np.isin(wider, longer)] % n, two] = True
        return marks

    def filled(self, order: int, lean: tuple[float, float], region: IntArray) -> Boxes:
        """Functions of an order on the boxes, whose region (n,) and lean are as in `Boxes`."""
        tables, (low, high), m = self.tables(), self.corners, len(self.boxes)
        places = [
            np.column_stack([t.ends[self.boxes[:, d], 0], self.boxes[:, d], t.ends[self.boxes[:, d], 1]])
            for d, t in enumerate(tables)
        ]
        every = np.column_stack([_key(*(places[d][:, at[d]] for d in range(3))) for at in PLACES])
        keys, first, of_boxes = np.unique(every, return_index=True, return_inverse=True)
        entities = np.column_stack([keys >> (2 * BITS), (keys >> BITS) % 2**BITS, keys % 2**BITS])
        within = np.column_stack([~t.is_vertex[entities[:, d]] for d, t in enumerate(tables)])
        count = (order - 1) ** within.sum(axis=1)
        start = np.concatenate([[0], np.cumsum(count)])[of_boxes.reshape(every.shape)]
        nodes, steps = np.empty((m, *[order + 1] * 3), dtype=np.int64), [[0], range(1, order), [order]]
        for column, at in enumerate(PLACES):
            own = [steps[place] for place in at]
            number = np.arange(np.prod([len(along) for along in own])).reshape([len(along) for along in own])
            nodes[np.ix_(range(m), *own)] = start[:, column, None, None, None] + number
        boxes = Boxes(low=low, high=high, order=order, nodes=nodes.reshape(m, -1), region=region, lean=lean)
        master = _masters(tables, entities, keys, within)
        owner = np.where(master == np.arange(len(keys)), -1, first[master] // len(PLACES))
        return boxes.hung(np.repeat(owner, count))


def _key(i: IntArray, j: IntArray, k: IntArray) -> IntArray:
    """One number for a vertex or interval of each axis."""
    return (i << (2 * BITS)) | (j << BITS) | k


def _ancestors(parent: IntArray, cells: IntArray) -> tuple[IntArray, IntArray]:
    """Every ancestor of each cell: the row of the cell, and the ancestor."""
    rows, up = np.arange(len(cells)), parent[cells]
    found = [(rows[:0], up[:0])]
    while len(rows := rows[up >= 0]):
        up = up[up >= 0]
        found.append((rows, up))
        up = parent[up]
    return np.concatenate([at for at, _ in found]), np.concatenate([up for _, up in found])


def _masters(
    tables: tuple[Table, Table, Table], entities: IntArray, keys: IntArray, within: NDArray[np.bool_]
) -> IntArray:
    """The entity that gives each its values, shape (n,): itself, or the largest face or edge that holds it."""
    dimension = within.sum(axis=1)
    depth = np.sum([t.depth[entities[:, d]] for d, t in enumerate(tables)], axis=0)
    size = dimension * 1000 - depth  # a face goes before an edge, an ancestor before what was split from it
    master = np.arange(len(entities))
    best = size.copy()
    x, rows_x = entities[:, 0], np.arange(len(entities))
    while len(rows_x):
        y, rows_y, x_y = entities[rows_x, 1], rows_x, x
        while len(rows_y):
            z, rows_z, x_z, y_z = entities[rows_y, 2], rows_y, x_y, y
            while len(rows_z):
                key = _key(x_z, y_z, z)
                found = np.searchsorted(keys, key) % len(keys)
                hit = keys[found] == key
                row, holder = rows_z[hit], found[hit]
                larger = size[holder] > best[row]
                master[row[larger]], best[row[larger]] = holder[larger], size[holder[larger]]
                z = tables[2].parent[z]
                z, rows_z, x_z, y_z = (values[z >= 0] for values in (z, rows_z, x_z, y_z))
            y = tables[1].parent[y]
            y, rows_y, x_y = (values[y >= 0] for values in (y, rows_y, x_y))
        x = tables[0].parent[x]
        x, rows_x = (values[x >= 0] for values in (x, rows_x))
    return master
