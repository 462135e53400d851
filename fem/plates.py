"""Plates bonded to rectangles of the top face, and pressures that follow it.

A plate has six motions. A node at X of a plate whose middle was at C moves to c + R (X − C). Rotations are matrices R,
and small changes of them spins δω: δR = [δω] R. The forces f of the nodes are as strong as their sum and
their moment Σ R (X − C) × f.

Per unit of pressure the forces on a face's nodes are −∫ φₐ x,ξ × x,η dξ dη, x the deformed positions; at rest the
normals x,ξ × x,η point up.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from skfem import Basis, ElementTriP2
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTri

from common.errors import SceneError
from fem.boxes.boxes import Boxes, gauss_points, shape_functions
from fem.kernel.loads import FollowerLoad, Load, Rectangle
from fem.tetrahedra.patch import top_triangles
from geometry.layout import FloatArray

IntArray = NDArray[np.int64]
ON_LINE = 1e-9  #: of the body's extent: how far rounding may put a line off a rectangle's edge
CUT_ORDER = 8  #: of integration on triangles, which loads' edges may cut


@dataclass(frozen=True, eq=False)
class Plates:
    """Plates on a body; k of them, with n bonded nodes in all."""

    node: IntArray  #: bonded nodes, (n,)
    plate: IntArray  #: the plate of each, (n,)
    arm_mm: FloatArray  #: X − C of each, (n, 3)
    half_mm: FloatArray  #: half the larger side of each plate, (k,): the arm that makes a spin a length

    @classmethod
    def on(
        cls, points_mm: FloatArray, nodes: Sequence[IntArray], rectangles: Sequence[Rectangle], middles_mm: FloatArray
    ) -> "Plates":
        """Plates on rectangles of the top face that bind these nodes of a body; they turn about `middles_mm` (k, 2).

        `SceneError` if two share a node: together they would be a hinge, which is not modelled.
        """
        node = np.concatenate([np.zeros(0, dtype=np.int64), *nodes])
        if len(np.unique(node)) < len(node):
            raise SceneError("two stiff loads touch or overlap: part them by at least one element.")
        plate = np.repeat(np.arange(len(nodes)), np.array([len(own) for own in nodes], dtype=np.int64))
        centre = np.column_stack([middles_mm, np.full(len(middles_mm), points_mm[:, 2].max())])
        half = np.array([max(x1 - x0, y1 - y0) / 2 for x0, y0, x1, y1 in rectangles])
        return cls(node=node, plate=plate, arm_mm=points_mm[node] - centre[plate], half_mm=half)

    @property
    def count(self) -> int:
        return len(self.half_mm)

    @cached_property
    def starts(self) -> IntArray:
        """First bonded node of each plate."""
        return np.searchsorted(self.plate, np.arange(self.count))

    def turned(self, rotation: FloatArray) -> FloatArray:
        """R (X − C) of every bonded node, (..., n, 3), of rotations, or turns, (..., k, 3, 3)."""
        return np.einsum("...nij,nj->...ni", rotation[..., self.plate, :, :], self.arm_mm)

    def spins(self, rotation: FloatArray) -> FloatArray:
        """Displacement of every bonded node by spin times half width of its plate, (n, 3, 3)."""
        return -skew(self.turned(rotation)) / self.half_mm[self.plate][:, None, None]

    def displacements(self, shift: FloatArray, turn: FloatArray) -> FloatArray:
        """Of every bonded node, (..., n, 3), for shifts (..., k, 3) of the middles and turns R − I [mm]."""
        return shift[..., self.plate, :] + self.turned(turn)

    def resultants(self, forces: FloatArray, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sum (..., k, 3) [N] and moment about the middles (..., k, 3) [N mm] of forces (..., n, 3) on the nodes."""
        if not self.count:
            return np.zeros((*forces.shape[:-2], 0, 3)), np.zeros((*forces.shape[:-2], 0, 3))
        moments = np.cross(self.turned(rotation), forces)
        return np.add.reduceat(forces, self.starts, axis=-2), np.add.reduceat(moments, self.starts, axis=-2)


@dataclass(frozen=True, eq=False)
class FollowingFaces:
    """Element faces of the top under the pressures of loads: f faces of k nodes, with q points of integration."""

    nodes: IntArray  #: of every face, (f, k)
    pressure_mpa: FloatArray  #: (f,)
    n_nodes: int  #: of the body
    values: FloatArray  #: of the functions at the points, (q, k)
    slopes: FloatArray  #: by ξ and by η, (2, q, k)
    weights: FloatArray  #: (q,), or (f, q)

    @classmethod
    def on_boxes(cls, boxes: Boxes, loads: Sequence[Load]) -> "FollowingFaces":
        """On boxes with sides along the edges of the following ones of loads."""
        rectangles, pressures = _following(loads)
        for rectangle in rectangles.tolist():
            top_nodes(boxes, tuple(rectangle))  # refuses one without lines
        k, top = boxes.order + 1, np.flatnonzero(boxes.high[:, 2] == boxes.height_mm)
        faces = boxes.nodes[top].reshape(len(top), k, k, k)[..., -1].reshape(len(top), -1)
        middle = ((boxes.low + boxes.high) / 2)[top, :2] + np.array(boxes.lean) * boxes.height_mm
        load, face = np.nonzero(_within(middle, rectangles[:, None]))
        x, w = gauss_points(k)
        values, slopes = shape_functions(boxes.order, x)
        pairs = (values, values), (slopes, values), (values, slopes)
        at, *along = (np.einsum("pi,qj->pqij", *pair).reshape(len(x) ** 2, -1) for pair in pairs)
        weights = np.outer(w, w).ravel()
        return cls(faces[face], pressures[load], boxes.n_nodes, at, np.stack(along), weights)

    @classmethod
    def on_tetrahedra(cls, basis: Basis, loads: Sequence[Load]) -> "FollowingFaces":
        """On quadratic tetrahedra; of a face that a load's edge cuts, the points of integration within count.

        These are scaled to the load's area, so that the force at rest is whole.
        """
        rectangles, pressures = _following(loads)
        corners, faces = top_triangles(basis)
        turned = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
        faces[turned] = faces[turned][:, [0, 2, 1, 5, 4, 3]]
        corners[turned] = corners[turned][:, [0, 2, 1]]
        points, rule = get_quadrature(RefTri, CUT_ORDER)
        shares = np.stack([1 - points.sum(axis=0), *points], axis=1)
        twice_mm2 = np.linalg.det(corners[:, 1:] - corners[:, :1])
        weights = rule * _within(shares @ corners, rectangles[:, None, None])  # (n_loads, n_faces, q)
        area_mm2 = np.prod(rectangles[:, 2:] - rectangles[:, :2], axis=1)
        weights *= (area_mm2 / (weights.sum(axis=2) @ twice_mm2))[:, None, None]
        load, face = np.nonzero(weights.any(axis=2))
        values, slopes = zip(*(ElementTriP2().lbasis(points, function) for function in range(6)), strict=True)
        at, along = np.stack(values, axis=-1), np.stack(slopes, axis=-1)
        return cls(faces[face], pressures[load], int(basis.N), at, along, weights[load, face])

    def forces(self, x: FloatArray) -> FloatArray:
        """Nodal forces (n_nodes, 3) at full load on deformed positions (n_nodes, 3) [N]."""
        t1, t2 = self._tangents(x)
        normal = np.cross(t1, t2) * (self.weights * -self.pressure_mpa[:, None])[:, :, None]
        own = np.einsum("qa,fqi->fai", self.values, normal)
        out = np.zeros((self.n_nodes, 3))
        np.add.at(out, self.nodes.ravel(), own.reshape(-1, 3))
        return out

    def stiffness(self, x: FloatArray) -> FloatArray:
        """Derivative of the forces by the positions at full load, (f, n, n, 3, 3): [f, a, b, i, j] [N/mm].

        From d(t₁ × t₂) = −[t₂] dt₁ + [t₁] dt₂, where [t] v = t × v; not symmetric.
        """
        t1, t2 = self._tangents(x)
        change = np.einsum("qb,fqij->fqbij", self.slopes[1], skew(t1))
        change -= np.einsum("qb,fqij->fqbij", self.slopes[0], skew(t2))
        weight = self.weights * -self.pressure_mpa[:, None]
        return np.einsum("qa,fq,fqbij->fabij", self.values, weight, change, optimize=True)

    def _tangents(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x,ξ and x,η at the points of the faces, each (f, q, 3)."""
        own = x[self.nodes]
        return np.einsum("qa,fai->fqi", self.slopes[0], own), np.einsum("qa,fai->fqi", self.slopes[1], own)


def _following(loads: Sequence[Load]) -> tuple[FloatArray, FloatArray]:
    """Rectangles (k, 4) and pressures (k,) of the following ones of loads."""
    following = [load for load in loads if isinstance(load, FollowerLoad)]
    rectangles = np.array([load.rectangle for load in following]).reshape(-1, 4)
    return rectangles, np.array([load.pressure_mpa for load in following])


def _within(places: FloatArray, rectangles: FloatArray) -> NDArray[np.bool_]:
    """Whether places (..., 2) lie within rectangles (..., 4), edges excluded."""
    return np.asarray(((places > rectangles[..., :2]) & (places < rectangles[..., 2:])).all(axis=-1))


def top_nodes(boxes: Boxes, rectangle: Rectangle) -> IntArray:
    """Independent nodes of the top face within a rectangle and on its edges; `SceneError` if these are no lines."""
    points, height = boxes.points_mm, boxes.height_mm
    slack = ON_LINE * float(np.ptp(points, axis=0).max())
    for k, place in enumerate(rectangle):
        line = boxes.lines[k % 2] + boxes.lean[k % 2] * height
        if np.abs(line - place).min() > slack:
            where = f"{'xy'[k % 2]} = {place:g} mm, an edge of a following or stiff load"
            raise SceneError(f"the grid has no line at {where}: give it one.")
    x0, y0, x1, y1 = rectangle
    inside = (points[:, 0] > x0 - slack) & (points[:, 0] < x1 + slack)
    inside &= (points[:, 1] > y0 - slack) & (points[:, 1] < y1 + slack)
    return np.flatnonzero(inside & (np.abs(points[:, 2] - height) <= slack) & boxes.is_independent)


def turns(spin: FloatArray) -> FloatArray:
    """exp [ω] − I, (..., 3, 3), of vectors ω (..., 3) (Rodrigues): what rotations R change, exact to rounding of ω.

    >>> np.round(turns(np.array([0.0, 0.0, np.pi / 2])) @ np.array([1.0, 0.0, 0.0]), 12)
    array([-1.,  1.,  0.])
    """
    angle = np.linalg.norm(spin, axis=-1)[..., None, None]
    W = skew(spin)
    return np.sinc(angle / np.pi) * W + np.sinc(angle / (2 * np.pi)) ** 2 / 2 * (W @ W)


def skew(v: FloatArray) -> FloatArray:
    """Matrices [v] (..., 3, 3) for which [v] w = v × w, of vectors (..., 3).

    >>> skew(np.array([0.0, 0.0, 1.0])) @ np.array([1.0, 0.0, 0.0])
    array([0., 1., 0.])
    """
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out
