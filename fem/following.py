"""Faces of boxes under a pressure that follows the deformed surface: nodal forces and their stiffness.

Per unit of pressure the forces on a face's nodes are −∫ φₐ x,ξ × x,η dξ dη, x the deformed positions; at rest the
normals x,ξ × x,η point up.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from skfem import Basis
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTri

from fem.boxes.boxes import Boxes, IntArray
from fem.boxes.lagrange import gauss_points, shape_functions
from fem.plates import skew, top_nodes
from fem.scene.loads import FollowerLoad
from fem.tetrahedra.patch import top_triangles
from geometry.layout import FloatArray

CUT_ORDER = 8  #: of integration on triangles, which loads' edges may cut


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
    def on_boxes(cls, boxes: Boxes, loads: Sequence[FollowerLoad]) -> "FollowingFaces":
        """On boxes with sides along the edges of the loads."""
        order = boxes.order
        top = np.flatnonzero(boxes.high[:, 2] == boxes.height_mm)
        faces = boxes.nodes[top].reshape(len(top), order + 1, order + 1, order + 1)[..., -1].reshape(len(top), -1)
        middle = ((boxes.low + boxes.high) / 2)[top, :2] + np.array(boxes.lean) * boxes.height_mm
        for load in loads:
            top_nodes(boxes, load.rectangle)  # refuses a rectangle without lines
        face, pressure = _under(middle, loads)
        x, w = gauss_points(order + 1)
        values, slopes = shape_functions(order, x)
        at, by_x, by_y = (
            np.einsum("pi,qj->pqij", *pair).reshape(len(x) ** 2, -1)
            for pair in ((values, values), (slopes, values), (values, slopes))
        )
        weights = np.outer(w, w).ravel()
        return cls(faces[face], pressure, boxes.n_nodes, at, np.stack([by_x, by_y]), weights)

    @classmethod
    def on_tetrahedra(cls, basis: Basis, loads: Sequence[FollowerLoad]) -> "FollowingFaces":
        """On quadratic tetrahedra; of a face that a load's edge cuts, the points of integration within count.

        These are scaled to the load's area, so that the force at rest is whole.
        """
        corners, faces = top_triangles(basis)
        turned = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
        faces[turned] = faces[turned][:, [0, 2, 1, 5, 4, 3]]
        corners[turned] = corners[turned][:, [0, 2, 1]]
        points, rule = get_quadrature(RefTri, CUT_ORDER)
        shares = np.stack([1 - points.sum(axis=0), *points], axis=1)
        places, twice_mm2 = shares @ corners, np.linalg.det(corners[:, 1:] - corners[:, :1])
        face, weights, pressure = [np.zeros(0, dtype=np.int64)], [np.zeros((0, len(rule)))], [np.zeros(0)]
        for load in loads:
            x0, y0, x1, y1 = load.rectangle
            own = rule * ((places > (x0, y0)) & (places < (x1, y1))).all(axis=2)
            own *= np.prod(load.size_mm) / (twice_mm2 @ own.sum(axis=1))
            face.append(np.flatnonzero(own.any(axis=1)))
            weights.append(own[face[-1]])
            pressure.append(np.full(len(face[-1]), load.pressure_mpa))
        (x, y), one = points, np.ones(points.shape[1])
        z = one - x - y
        at = np.stack([z * (2 * z - 1), x * (2 * x - 1), y * (2 * y - 1), 4 * z * x, 4 * x * y, 4 * z * y], axis=1)
        by_x = np.stack([1 - 4 * z, 4 * x - 1, 0 * one, 4 * (z - x), 4 * y, -4 * y], axis=1)
        by_y = np.stack([1 - 4 * z, 0 * one, 4 * y - 1, -4 * x, 4 * x, 4 * (z - y)], axis=1)
        under = faces[np.concatenate(face)]
        slopes = np.stack([by_x, by_y])
        return cls(under, np.concatenate(pressure), int(basis.N), at, slopes, np.concatenate(weights))

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


def _under(middles_mm: FloatArray, loads: Sequence[FollowerLoad]) -> tuple[IntArray, FloatArray]:
    """Faces by their middles (n, 2) that lie under loads, and their pressures; twice under two loads."""
    faces, pressures = [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
    for load in loads:
        x0, y0, x1, y1 = load.rectangle
        faces.append(np.flatnonzero(((middles_mm > (x0, y0)) & (middles_mm < (x1, y1))).all(axis=1)))
        pressures.append(np.full(len(faces[-1]), load.pressure_mpa))
    return np.concatenate(faces), np.concatenate(pressures)
