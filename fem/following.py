"""Faces of boxes under a pressure that follows the deformed surface: nodal forces and their stiffness.

Per unit of pressure the forces on a face's nodes are −∫ φₐ x,ξ × x,η dξ dη, x the deformed positions; at rest the
normals x,ξ × x,η point up.
"""

from collections.abc import Sequence

import numpy as np

from fem.boxes.boxes import Boxes, IntArray
from fem.boxes.lagrange import gauss_points, shape_functions
from fem.plates import skew, top_nodes
from fem.scene.loads import FollowerLoad
from geometry.layout import FloatArray


class FollowingFaces:
    """Element faces of the top under the pressures of loads."""

    def __init__(self, boxes: Boxes, loads: Sequence[FollowerLoad]) -> None:
        order = boxes.order
        top = np.flatnonzero(boxes.high[:, 2] == boxes.height_mm)
        faces = boxes.nodes[top].reshape(len(top), order + 1, order + 1, order + 1)[..., -1].reshape(len(top), -1)
        middle = ((boxes.low + boxes.high) / 2)[top, :2] + np.array(boxes.lean) * boxes.height_mm
        own, pressures = [faces[:0]], [np.zeros(0)]
        for load in loads:
            top_nodes(boxes, load.rectangle)  # refuses a rectangle without lines
            x0, y0, x1, y1 = load.rectangle
            inside = ((middle > (x0, y0)) & (middle < (x1, y1))).all(axis=1)
            own.append(faces[inside])
            pressures.append(np.full(int(inside.sum()), load.pressure_mpa))
        self.nodes: IntArray = np.concatenate(own)  #: of every face, (f, (order + 1)²)
        self.pressure_mpa = np.concatenate(pressures)  #: (f,)
        self._n_nodes = boxes.n_nodes
        x, w = gauss_points(order + 1)
        values, slopes = shape_functions(order, x)
        self._values, self._along_x, self._along_y = (
            np.einsum("pi,qj->pqij", *pair).reshape(len(x) ** 2, -1)
            for pair in ((values, values), (slopes, values), (values, slopes))
        )
        self._weights = np.outer(w, w).ravel()

    def forces(self, x: FloatArray) -> FloatArray:
        """Nodal forces (n_nodes, 3) at full load on deformed positions (n_nodes, 3) [N]."""
        t1, t2 = self._tangents(x)
        normal = np.cross(t1, t2) * (self._weights * -self.pressure_mpa[:, None])[:, :, None]
        own = np.einsum("qa,fqi->fai", self._values, normal)
        out = np.zeros((self._n_nodes, 3))
        np.add.at(out, self.nodes.ravel(), own.reshape(-1, 3))
        return out

    def stiffness(self, x: FloatArray) -> FloatArray:
        """Derivative of the forces by the positions at full load, (f, n, n, 3, 3): [f, a, b, i, j] [N/mm].

        From d(t₁ × t₂) = −[t₂] dt₁ + [t₁] dt₂, where [t] v = t × v; not symmetric.
        """
        t1, t2 = self._tangents(x)
        change = np.einsum("qb,fqij->fqbij", self._along_y, skew(t1))
        change -= np.einsum("qb,fqij->fqbij", self._along_x, skew(t2))
        weight = self._weights * -self.pressure_mpa[:, None]
        return np.einsum("qa,fq,fqbij->fabij", self._values, weight, change, optimize=True)

    def _tangents(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x,ξ and x,η at the points of the faces, each (f, q, 3)."""
        own = x[self.nodes]
        return np.einsum("qa,fai->fqi", self._along_x, own), np.einsum("qa,fai->fqi", self._along_y, own)
