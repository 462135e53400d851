"""Loads on the grid: nodes bonded to a plate, faces under a following pressure."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fem.discretization.lagrange import gauss_points, shape_functions
from fem.finite.rubber_body import RubberBody
from fem.scene.checks import SceneError
from fem.scene.loads import Rectangle
from geometry.layout import FloatArray

ON_LINE = 1e-9  #: of the body's extent: how far rounding may put a line off a rectangle's edge


def bonded_nodes(body: RubberBody, rectangle: Rectangle) -> NDArray[np.int64]:
    """Nodes of the top face within a rectangle, edges included.

    Raises
    ------
    SceneError
        If the grid has no lines along the rectangle's edges.
    """
    _require_lines(body, rectangle)
    points = body.basis.doflocs
    x0, y0, x1, y1 = rectangle
    slack = ON_LINE * float(np.ptp(points, axis=1).max())
    top = np.abs(points[2] - body.grid.height_mm) <= slack
    inside = (points[0] > x0 - slack) & (points[0] < x1 + slack) & (points[1] > y0 - slack) & (points[1] < y1 + slack)
    return np.flatnonzero(top & inside)


class FollowingFaces:
    """Element faces of the top under pressure: their nodal forces and the stiffness of these.

    Per unit of pressure the forces on a face's nodes are −∫ φₐ x,ξ × x,η dξ dη, x the deformed positions; at rest the
    normals x,ξ × x,η point up.
    """

    def __init__(self, body: RubberBody, rectangles: list[Rectangle], pressures_mpa: FloatArray) -> None:
        self.body = body
        nx, ny, nz = body.grid.shape
        top = np.arange(nx * ny * nz).reshape(nx, ny, nz)[:, :, -1].ravel()
        faces = body.nodes[top].reshape(-1, 3, 3, 3)[:, :, :, 2].reshape(-1, 9)
        middle = body.basis.doflocs[:2, faces[:, 4]].T
        self.nodes: list[NDArray[np.int64]] = []
        pressures = []
        for rectangle, pressure in zip(rectangles, pressures_mpa, strict=True):
            _require_lines(body, rectangle)
            x0, y0, x1, y1 = rectangle
            inside = ((middle > (x0, y0)) & (middle < (x1, y1))).all(axis=1)
            self.nodes.append(faces[inside])
            pressures.append(np.full(int(inside.sum()), pressure))
        self.faces = np.concatenate(self.nodes) if self.nodes else np.zeros((0, 9), dtype=np.int64)
        self.pressure_mpa = np.concatenate(pressures) if pressures else np.zeros(0)
        x, w = gauss_points(3)
        values, slopes = shape_functions(2, x)
        self._values, self._along_x, self._along_y = (
            np.einsum("pi,qj->pqij", *pair).reshape(9, 9)
            for pair in ((values, values), (slopes, values), (values, slopes))
        )
        self._weights = np.outer(w, w).ravel()

    def forces(self, x: FloatArray) -> FloatArray:
        """Nodal forces (n_nodes, 3) at full load on deformed positions (n_nodes, 3) [N]."""
        t1, t2 = self._tangents(x)
        normal = np.cross(t1, t2) * (self._weights * -self.pressure_mpa[:, None])[:, :, None]
        own = np.einsum("qa,fqi->fai", self._values, normal)
        out = np.zeros((self.body.n_nodes, 3))
        np.add.at(out, self.faces.ravel(), own.reshape(-1, 3))
        return out

    def stiffness(self, x: FloatArray) -> FloatArray:
        """Derivative of the forces by the positions at full load, (n_faces, 9, 9, 3, 3): [f, a, b, i, j] [N/mm].

        From d(t₁ × t₂) = −[t₂] dt₁ + [t₁] dt₂, where [t] v = t × v; not symmetric.
        """
        t1, t2 = self._tangents(x)
        change = -np.einsum("qb,fqij->fqbij", self._along_x, skew(t2)) + np.einsum(
            "qb,fqij->fqbij", self._along_y, skew(t1)
        )
        weight = self._weights * -self.pressure_mpa[:, None]
        return np.einsum("qa,fq,fqbij->fabij", self._values, weight, change, optimize=True)

    def _tangents(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x,ξ and x,η at the points of the faces, each (n_faces, 9, 3)."""
        own = x[self.faces]
        return np.einsum("qa,fai->fqi", self._along_x, own), np.einsum("qa,fai->fqi", self._along_y, own)


def skew(v: FloatArray) -> FloatArray:
    """Matrices [v] (..., 3, 3) for which [v] w = v × w, of vectors (..., 3).

    >>> skew(np.array([0.0, 0.0, 1.0])) @ np.array([1.0, 0.0, 0.0])
    array([0., 1., 0.])
    """
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def _require_lines(body: RubberBody, rectangle: Rectangle) -> None:
    lean = [share * body.grid.height_mm for share in body.grid.lean]
    lines: dict[str, Any] = {"x": body.grid.x + lean[0], "y": body.grid.y + lean[1]}
    for k, (axis, along) in enumerate(lines.items()):
        slack = ON_LINE * float(np.ptp(along))
        for place in (rectangle[k], rectangle[k + 2]):
            if np.abs(along - place).min() > slack:
                raise SceneError(
                    f"the grid has no line at {axis} = {place:g} mm, an edge of a following or stiff load: give it one."
                )
