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
from fem.plates import ON_LINE, skew, top_nodes
from fem.scene.checks import SceneError
from fem.scene.loads import FollowerLoad
from fem.tetrahedra.patch import top_triangles
from geometry.layout import FloatArray


@dataclass(frozen=True, eq=False)
class FollowingFaces:
    """Element faces of the top under the pressures of loads: f faces of k nodes, with q points of integration."""

    nodes: IntArray  #: of every face, (f, k)
    pressure_mpa: FloatArray  #: (f,)
    n_nodes: int  #: of the body
    values: FloatArray  #: of the functions at the points, (q, k)
    slopes: FloatArray  #: by ξ and by η, (2, q, k)
    weights: FloatArray  #: (q,)

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
        """On quadratic tetrahedra whose faces follow the edges of the loads."""
        corners, faces = top_triangles(basis)
        turned = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
        faces[turned] = faces[turned][:, [0, 2, 1, 5, 4, 3]]
        face, pressure = _under(corners.mean(axis=1), loads)
        for load in loads:
            covered, _ = _under(corners.mean(axis=1), [load])
            area_mm2 = np.abs(np.linalg.det(corners[covered, 1:] - corners[covered, :1])).sum() / 2
            if abs(area_mm2 - np.prod(load.size_mm)) > ON_LINE * np.prod(load.size_mm):
                raise SceneError("tetrahedra do not follow the edges of a following load.")
        points, weights = get_quadrature(RefTri, 4)  # normals and functions are quadratic
        (x, y), one = points, np.ones(points.shape[1])
        z = one - x - y
        at = np.stack([z * (2 * z - 1), x * (2 * x - 1), y * (2 * y - 1), 4 * z * x, 4 * x * y, 4 * z * y], axis=1)
        by_x = np.stack([1 - 4 * z, 4 * x - 1, 0 * one, 4 * (z - x), 4 * y, -4 * y], axis=1)
        by_y = np.stack([1 - 4 * z, 0 * one, 4 * y - 1, -4 * x, 4 * x, 4 * (z - y)], axis=1)
        return cls(faces[face], pressure, int(basis.N), at, np.stack([by_x, by_y]), weights)

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
