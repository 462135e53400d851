"""The plane top of a body: integrals over rectangles of it, wherever its faces lie, and pressures that follow it.

A load on a pad and the mean displacement of an electrode are the same integral ∫ φ dA of each function over a
rectangle. Faces, triangles or quadrilaterals, are clipped to the rectangle and integrated exactly, so that a load never
misses a part of its force and no outline has to conform to the mesh.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from skfem.quadrature import get_quadrature
from skfem.refdom import RefHex, RefTri

from common.errors import SceneError, TriPillarError
from fem.kernel.elements import Basis
from fem.kernel.loads import FollowerLoad, Load, Rectangle
from fem.kernel.plates import skew
from fem.kernel.reference import IntArray, local_places
from geometry.layout import FloatArray

ON_TOP = 1e-9  #: of the mesh's extent: how far rounding may take a point off the top, or off a rectangle's edge
COVERED = 1e-9  #: of a rectangle's area, that the top may lack


class PatchError(TriPillarError, ValueError):
    """A rectangle that does not lie wholly on the top face."""


@dataclass(frozen=True, eq=False)
class Covered:
    """Points of integration on the top within a rectangle, in t triangles of s faces; k functions are shown there."""

    nodes: IntArray  #: of the functions, (t, k)
    values: FloatArray  #: of the functions, (t, q, k)
    slopes: FloatArray  #: by x and by y, (2, t, q, k) [1/mm]
    weight_mm2: FloatArray  #: (t, q)

    @property
    def area_mm2(self) -> float:
        return float(self.weight_mm2.sum())


class Top:
    """The faces of a mesh on its highest plane."""

    def __init__(self, basis: Basis) -> None:
        mesh = basis.mesh
        self.basis, self.z = basis, float(mesh.p[2].max())
        self.slack_mm = ON_TOP * float(np.ptp(mesh.p, axis=1).max())
        facets = np.flatnonzero((mesh.p[2, mesh.facets] > self.z - self.slack_mm).all(axis=0))
        self.element = mesh.f2t[0, facets]
        #: x, y of the corners of every face, in turn around it, (f, 3 or 4, 2)
        self.corners = mesh.p[:2, mesh.facets[:, facets]].transpose(2, 1, 0)
        if mesh.refdom is RefHex:
            self.corners = _in_turn(self.corners)
        #: nodes on the top
        self.is_node = basis.doflocs[2] > self.z - self.slack_mm
        nodes = basis.element_dofs.T.astype(np.int64)[self.element]
        #: functions of an element that show on the top of any
        self._shown = np.flatnonzero(self.is_node[nodes].any(axis=0))
        self._nodes = nodes[:, self._shown]

    def _rule(self, following: bool) -> tuple[FloatArray, FloatArray]:
        """Shares of a triangle's corners in its points (q, 3), and their weights (q,), whose sum is 1.

        Exact for the functions, or for their products with two slopes, of which following pressures consist.
        """
        order = self.basis.elem.maxdeg
        if self.basis.mesh.refdom is RefHex:
            degree = 6 * order - 2 if following else 2 * order
        else:
            degree = 2 * order + 1
        points, weights = get_quadrature(RefTri, degree)
        return np.column_stack([1 - points.sum(axis=0), *points]), 2 * weights

    def over(self, rectangle: Rectangle | FloatArray, following: bool = False) -> Covered:
        """The top within a rectangle x0, y0, x1, y1 [mm], exactly; for what `_rule` says."""
        x0, y0, x1, y1 = np.asarray(rectangle, dtype=float).tolist()
        low, high = self.corners.min(axis=1), self.corners.max(axis=1)
        near = np.flatnonzero(((high > (x0, y0)) & (low < (x1, y1))).all(axis=1))
        within = ((low[near] >= (x0, y0)) & (high[near] <= (x1, y1))).all(axis=1)
        triangles, face = [], []
        for some, is_whole in ((near[within], True), (near[~within], False)):
            polygons = self.corners[some]
            sides = () if is_whole else ((0, 1.0, x0), (0, -1.0, -x1), (1, 1.0, y0), (1, -1.0, -y1))
            for axis, sign, limit in sides:
                polygons = _clip(polygons, sign * polygons[:, :, axis] - limit)
            for k in range(1, polygons.shape[1] - 1):
                triangles.append(polygons[:, [0, k, k + 1]])
                face.append(some)
        corners, own = np.concatenate(triangles), np.concatenate(face)
        area = np.abs(_cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])) / 2
        kept = area > 0
        corners, own, area = corners[kept], own[kept], area[kept]
        shares, weights = self._rule(following)
        places = np.concatenate([shares @ corners, np.full((len(own), len(weights), 1), self.z)], axis=2)
        values, slopes = self._functions(own, places.transpose(2, 0, 1))
        return Covered(self._nodes[own], values, slopes, area[:, None] * weights)

    def _functions(self, face: IntArray, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Functions at places (3, t, q) on faces (t,), (t, q, k), and their slopes by x and y, (2, t, q, k)."""
        X, pull = local_places(self.basis.mesh, self.element[face], places)
        values = np.empty((*X.shape[1:], len(self._shown)))
        slopes = np.empty((2, *values.shape))
        for column, i in enumerate(self._shown.tolist()):
            value, local = self.basis.elem.lbasis(X, i)
            values[..., column] = value
            for axis in range(2):
                slopes[axis, ..., column] = sum(local[d] * pull[d, axis] for d in range(3))
        return values, slopes

    def integrals(self, rectangles: FloatArray, whole: bool = False) -> sp.csr_matrix:
        """∫ φ dA of every function over rectangles (k, 4) of the top, (k, n_nodes) [mm²].

        A row sums to the area of the top that its rectangle covers; `whole`: a `PatchError` unless that is all of it.
        """
        rectangles = np.asarray(rectangles, dtype=float).reshape(-1, 4)
        rows, columns, values = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)]
        for number, rectangle in enumerate(rectangles):
            own = self.over(rectangle)
            x0, y0, x1, y1 = rectangle.tolist()
            if whole and abs(own.area_mm2 - (x1 - x0) * (y1 - y0)) > COVERED * (x1 - x0) * (y1 - y0):
                raise PatchError(
                    f"the rectangle x {x0:g} to {x1:g}, y {y0:g} to {y1:g} mm has {own.area_mm2:g} of its "
                    f"{(x1 - x0) * (y1 - y0):g} mm² on the body's top face: move or shrink it."
                )
            values.append(np.einsum("tqk,tq->tk", own.values, own.weight_mm2).ravel())
            columns.append(own.nodes.ravel())
            rows.append(np.full(own.nodes.size, number))
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        return sp.csr_matrix(entries, shape=(len(rectangles), self.basis.N))

    def nodes_in(self, rectangle: Rectangle | FloatArray) -> IntArray:
        """Nodes of the top within a rectangle and on its edges; `SceneError` if an edge of it cuts a face."""
        x0, y0, x1, y1 = np.asarray(rectangle, dtype=float).tolist()
        s = self.slack_mm
        low, high = self.corners.min(axis=1), self.corners.max(axis=1)
        for axis, place in ((0, x0), (1, y0), (0, x1), (1, y1)):
            beside = np.delete([[x0, x1], [y0, y1]], axis, axis=0)[0]
            other = 1 - axis
            meets = (low[:, other] < beside[1] - s) & (high[:, other] > beside[0] + s)
            if (meets & (low[:, axis] < place - s) & (high[:, axis] > place + s)).any():
                where = f"{'xy'[axis]} = {place:g} mm, an edge of a following or stiff load"
                raise SceneError(f"the mesh has no line at {where}: give it one.")
        x, y, _ = self.basis.doflocs
        return np.flatnonzero(self.is_node & (x > x0 - s) & (x < x1 + s) & (y > y0 - s) & (y < y1 + s))


def _in_turn(quads: FloatArray) -> FloatArray:
    """Corners (f, 4, 2) of convex quadrilaterals in turn around their middles."""
    off = quads - quads.mean(axis=1, keepdims=True)
    order = np.argsort(np.arctan2(off[..., 1], off[..., 0]), axis=1)
    return np.take_along_axis(quads, order[..., None], axis=1)


def _clip(polygons: FloatArray, inside: FloatArray) -> FloatArray:
    """The parts of convex polygons (n, k, 2) where linear functions of values `inside` (n, k) are not negative.

    Shape (n, k + 1, 2): a half plane adds a corner at most, missing ones repeat the last, outside all are one point.
    """
    n, k = inside.shape
    beyond, following = np.roll(inside, -1, axis=1), np.roll(polygons, -1, axis=1)
    crosses = (inside < 0) != (beyond < 0)
    share = inside / np.where(crosses, inside - beyond, 1.0)
    corners = np.stack([polygons, polygons + (following - polygons) * share[..., None]], axis=2).reshape(n, 2 * k, 2)
    kept = np.stack([inside >= 0, crosses], axis=2).reshape(n, 2 * k)
    first = np.argsort(~kept, axis=1, kind="stable")[:, : k + 1]
    last = np.clip(kept.sum(axis=1) - 1, 0, k)
    order = np.take_along_axis(first, np.minimum(np.arange(k + 1), last[:, None]), axis=1)
    return np.take_along_axis(corners, order[..., None], axis=1)


def _cross(u: FloatArray, v: FloatArray) -> FloatArray:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


@dataclass(frozen=True, eq=False)
class FollowingPressures:
    """Pressures along the deformed top's normals: per unit of pressure forces −∫ φ x,₁ × x,₂ dA, x the places."""

    parts: Sequence[tuple[float, Covered]]  #: pressures [MPa] and what they press
    n_nodes: int  #: of the body

    @classmethod
    def of(cls, top: Top, loads: Sequence[Load]) -> "FollowingPressures":
        """Those of the following ones of loads."""
        following = [load for load in loads if isinstance(load, FollowerLoad)]
        return cls([(load.pressure_mpa, top.over(load.rectangle, following=True)) for load in following], top.basis.N)

    def pressing_n(self, x: FloatArray) -> float:
        """Force down at full load on deformed positions (n_nodes, 3) [N]."""
        return float(-self.forces(x)[:, 2].sum())

    @property
    def nodes(self) -> list[IntArray]:
        """Of each part, (t, k)."""
        return [own.nodes for _, own in self.parts]

    def forces(self, x: FloatArray) -> FloatArray:
        """Nodal forces (n_nodes, 3) at full load on deformed positions (n_nodes, 3) [N]."""
        out = np.zeros((self.n_nodes, 3))
        for pressure_mpa, own in self.parts:
            t1, t2 = own.slopes @ x[own.nodes]
            push = np.cross(t1, t2) * (-pressure_mpa * own.weight_mm2[..., None])
            np.add.at(out, own.nodes, own.values.swapaxes(1, 2) @ push)
        return out

    def stiffness(self, x: FloatArray) -> list[FloatArray]:
        """Derivative of each part's forces by the positions at full load, (t, k, k, 3, 3): [t, a, b, i, j] [N/mm].

        From d(t₁ × t₂) = −[t₂] dt₁ + [t₁] dt₂, where [t] v = t × v; not symmetric.
        """
        found = []
        for pressure_mpa, own in self.parts:
            t1, t2 = own.slopes @ x[own.nodes]
            change = np.einsum("tqb,tqij->tqbij", own.slopes[1], skew(t1))
            change -= np.einsum("tqb,tqij->tqbij", own.slopes[0], skew(t2))
            weight = -pressure_mpa * own.weight_mm2
            found.append(np.einsum("tqa,tq,tqbij->tabij", own.values, weight, change, optimize=True))
        return found
