"""A mesh of boxes, each of which can be split along any axis: fine boxes meet coarse ones, and no line runs through.

Every axis is a forest of intervals (`AxisTree`). A box is one interval of each axis, so boxes that meet have faces and
edges of which one holds the other, once `BoxMesh` has split those that would cross. Nodes on the face or edge of a
larger box are no unknowns: they hang, and take what that box's functions give there (`hanging`), so displacements stay
continuous.
"""

from collections.abc import Mapping
from itertools import pairwise, product

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from skfem import Dofs, Element, MeshHex
from skfem.refdom import RefHex

from fem.meshes.leaning import Leaning
from geometry.layout import FloatArray

IntArray = NDArray[np.int64]

TOWARD_STOP = 0.2  #: of an interval that ends at a stop, the part on that side when it is split; 0.15 and 0.3 do alike
BITS = 20  #: of a number of a vertex or an interval, in the key of a face
ON_FACE = 1e-9  #: of the mesh's extent: how far rounding may take a node off a face


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


class BoxMesh:
    """Boxes over three axes, whose lines lean; the first ones fill the whole grid of the axes' first intervals."""

    def __init__(self, axes: tuple[AxisTree, AxisTree, AxisTree], leaning: Leaning) -> None:
        self.axes, self.leaning = axes, leaning
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

    @property
    def corners(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest corner of every box where its lines start, each of shape (n, 3) [mm]."""
        low, high = (
            np.stack([np.array(getattr(axis, side))[self.boxes[:, d]] for d, axis in enumerate(self.axes)], axis=1)
            for side in ("low", "high")
        )
        return low, high

    @property
    def mesh(self) -> MeshHex:
        """scikit-fem's mesh; boxes that share a whole face share its vertices, local axes are along the lines."""
        ends = np.stack(
            [np.array(axis.ends)[self.boxes[:, d]] for d, axis in enumerate(self.axes)], axis=1
        )  # (n, 3, 2)
        corner = RefHex.p.T.astype(int)  # (8, 3)
        vertices = np.stack([ends[:, d, corner[:, d]] for d in range(3)], axis=-1)  # (n, 8, 3)
        _, first, number = np.unique(_key(*np.moveaxis(vertices, -1, 0)), return_index=True, return_inverse=True)
        own = vertices.reshape(-1, 3)[first]
        places = np.stack([np.array(axis.low)[own[:, d]] for d, axis in enumerate(self.axes)])
        return MeshHex(
            np.ascontiguousarray(self.leaning.placed(places.T).T),
            np.ascontiguousarray(number.reshape(len(self.boxes), 8).T),
        )

    def located(self, points_mm: FloatArray, among: NDArray[np.bool_] | None = None) -> tuple[IntArray, FloatArray]:
        """The box that holds each of points (k, 3), (k,), and where in it, (3, k) in 0..1; `among` is not asked."""
        places, (low, high) = self.leaning.starts(points_mm), self.corners
        places = np.clip(places, low.min(axis=0), high.max(axis=0))
        found = np.empty(len(places), dtype=np.int64)
        for some in np.array_split(np.arange(len(places)), 1 + places.size * len(low) // 3_000_000):
            off = np.maximum(low - places[some, None], places[some, None] - high).max(axis=2)
            found[some] = off.argmin(axis=1)
        return found, ((places - low[found]) / (high[found] - low[found])).T

    def _crossing(self) -> NDArray[np.bool_]:
        """Boxes to split, shape (n, 3), because a face is narrower one way and wider the other than what it meets."""
        n = len(self.boxes)
        marks = np.zeros((n, 3), dtype=bool)
        for normal in range(3):
            one, two = (d for d in range(3) if d != normal)
            plane = np.array(self.axes[normal].ends)[self.boxes[:, normal]].T.ravel()
            i, j = np.tile(self.boxes[:, one], 2), np.tile(self.boxes[:, two], 2)
            at, up = _ancestors(np.array(self.axes[one].parent), i)
            wider, owner = _key(plane[at], up, j[at]), at
            at, up = _ancestors(np.array(self.axes[two].parent), j)
            longer = _key(plane[at], i[at], up)
            marks[owner[np.isin(wider, longer)] % n, two] = True
        return marks


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


def hanging(boxes: BoxMesh, mesh: MeshHex, dofs: Dofs, elem: Element) -> sp.csr_matrix | None:
    """Values of all nodes (n, n) of a mesh of boxes from those of the independent ones; None where none hangs.

    A vertex, edge or face hangs on the largest box that holds it and has it not as its own: its nodes take what that
    box's functions give there.
    """
    low, high = boxes.corners
    places = boxes.leaning.starts(mesh.p.T).T
    slack, n_boxes = ON_FACE * float(np.ptp(places, axis=1).max()), len(low)
    owners, nodes = [], []
    for corners, own, numbers in (
        (np.arange(mesh.nvertices)[None], mesh.t, dofs.nodal_dofs),
        (mesh.edges, mesh.t2e, dofs.edge_dofs),
        (mesh.facets, mesh.t2f, dofs.facet_dofs),
    ):
        ends = places[:, corners]  # (3, k, count)
        start, end = ends.min(axis=1).T, ends.max(axis=1).T
        owner = np.full(len(start), -1, dtype=np.int64)
        for box in np.argsort((high - low).prod(axis=1), kind="stable"):  # the largest comes last
            inside = ((start >= low[box] - slack) & (end <= high[box] + slack)).all(axis=1)
            inside[own[:, box]] = False
            owner[inside] = box
        owners.append(np.repeat(owner, len(numbers)))
        nodes.append(numbers.T.ravel())
    owner = np.full(dofs.N, -1, dtype=np.int64)
    owner[np.concatenate(nodes)] = np.concatenate(owners)
    hung = np.flatnonzero(owner >= 0)
    if not len(hung):
        return None
    where = np.empty((3, dofs.N))
    of_box = dofs.element_dofs.T
    where[:, of_box] = (low[:, None] + elem.doflocs * (high - low)[:, None]).transpose(2, 0, 1)
    box = owner[hung]
    local = (where[:, hung].T - low[box]) / (high[box] - low[box])
    values = np.stack([elem.lbasis(local.T, i)[0] for i in range(len(elem.doflocs))], axis=1)
    values[np.abs(values) < 1e-13] = 0.0  # what is zero but for rounding would couple distant nodes
    rows = np.repeat(hung, values.shape[1])
    direct = sp.csr_matrix((values.ravel(), (rows, of_box[box].ravel())), shape=(dofs.N, dofs.N))
    direct = (direct + sp.diags_array((owner < 0).astype(float))).tocsr()
    direct.eliminate_zeros()
    constraint = direct
    for _ in range(n_boxes):  # a larger face may itself hang on a yet larger one
        if not (owner[constraint.indices] >= 0).any():
            break
        constraint = (constraint @ direct).tocsr()
        constraint.eliminate_zeros()
    return constraint
