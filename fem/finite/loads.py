"""Loads at finite strain on rectangles of the top face: dead, following and stiff.

Directions are the axes' and do not turn, but for the pressure of a `FollowerLoad`. All grow from 0 in proportion.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fem.discretization.lagrange import gauss_points, shape_functions
from fem.finite.rubber_body import RubberBody
from fem.scene.scene import LARGEST_MPA, Rectangle, SceneError, require_extents, require_vectors
from geometry.layout import FloatArray
from geometry.prism import Pair, Triple

CENTER = "centre of the loaded rectangle of the top face at rest: x, y, in mm"
SIZE = "extent of the loaded rectangle at rest along x and y, in mm"
ON_LINE = 1e-9  #: of the body's extent: how far rounding may put a line off a rectangle's edge


@dataclass(frozen=True, kw_only=True)
class _OnRectangle:
    """A load on a rectangle of the top face."""

    center_mm: Pair = field(metadata={"meaning": CENTER})
    size_mm: Pair = field(metadata={"meaning": SIZE})

    def __post_init__(self) -> None:
        require_vectors(self, {"center_mm": 2, "size_mm": 2})
        require_extents(self, "size_mm")

    @property
    def rectangle(self) -> Rectangle:
        (x, y), (a, b) = self.center_mm, self.size_mm
        return x - a / 2, y - b / 2, x + a / 2, y + b / 2


@dataclass(frozen=True, kw_only=True)
class DeadLoad(_OnRectangle):
    """A uniform traction per area at rest, whose direction stays: on soft rubber it ends at about half of E."""

    traction_mpa: Triple = field(metadata={"meaning": "traction along x, y, z, in MPa; z negative pushes down"})

    def __post_init__(self) -> None:
        super().__post_init__()
        require_vectors(self, {"traction_mpa": 3}, LARGEST_MPA)


@dataclass(frozen=True, kw_only=True)
class FollowerLoad(_OnRectangle):
    """A pressure along the deformed surface's normal, per deformed area, and a dead tangential traction.

    It has no potential: how far it moves the body may depend on the way to it, and its stiffness is not symmetric.
    """

    pressure_mpa: float
    traction_mpa: Pair = field(default=(0.0, 0.0), metadata={"meaning": "traction along x and y, in MPa at rest"})

    def __post_init__(self) -> None:
        super().__post_init__()
        require_vectors(self, {"traction_mpa": 2}, LARGEST_MPA)
        if not (isinstance(self.pressure_mpa, float | int) and abs(self.pressure_mpa) <= LARGEST_MPA):
            raise SceneError(f"pressure_mpa={self.pressure_mpa!r} must be a finite number; above 0 it pushes.")


@dataclass(frozen=True, kw_only=True)
class StiffLoad(_OnRectangle):
    """A rigid plate bonded to a rectangle, loaded at the middle of its underside."""

    force_n: Triple = field(metadata={"meaning": "force along x, y, z, in N; z negative pushes down"})
    moment_nmm: Triple = field(default=(0.0, 0.0, 0.0), metadata={"meaning": "moment about x, y, z, in N mm"})

    def __post_init__(self) -> None:
        super().__post_init__()
        require_vectors(self, {"force_n": 3, "moment_nmm": 3}, LARGEST_MPA)


FiniteLoad = DeadLoad | FollowerLoad | StiffLoad


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
