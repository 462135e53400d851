"""Rectangles of the top face: exact integrals over them, wherever its triangles lie.

A load on a pad and the mean displacement of an electrode are the same integral ∫ φ dA of each shape function over a
rectangle. Triangles are clipped to the rectangle and integrated exactly, so a load never misses a part of its force and
no outline has to conform to the mesh.
"""

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from skfem import Basis

from common.errors import TriPillarError
from geometry.layout import FloatArray

ON_PLATE = 1e-9  #: of the plate's side: how far rounding may take a node off it


class PatchError(TriPillarError, ValueError):
    """A rectangle that does not lie wholly on the top face."""


def patch_means(basis: Basis, rectangles: FloatArray) -> sp.csr_matrix:
    """Rows that take nodal displacements to mean displacements of rectangles (k, 4) of the top face.

    Shape (k·3, 3·basis.N): rows run over rectangles, then axes. A row is also the nodal load vector of a
    unit force spread evenly over that rectangle.
    """
    area_mm2 = (rectangles[:, 2] - rectangles[:, 0]) * (rectangles[:, 3] - rectangles[:, 1])
    return sp.kron(sp.diags_array(1 / area_mm2) @ patch_integrals(basis, rectangles), sp.eye_array(3), format="csr")


def patch_integrals(basis: Basis, rectangles: FloatArray) -> sp.csr_matrix:
    """∫ φ dA (k, basis.N) [mm²] of every P2 shape function over rectangles x0, y0, x1, y1 (k, 4) of the plane top face.

    Each row sums to the rectangle's area; `PatchError` if the top does not cover it to a relative 1e-9.
    """
    corners, dofs = top_triangles(basis)  # (n, 3, 2), (n, 6)
    low, high = corners.min(axis=1), corners.max(axis=1)
    rows, cols, values = [], [], []
    for number, (x0, y0, x1, y1) in enumerate(rectangles):
        near = np.flatnonzero(((high > (x0, y0)) & (low < (x1, y1))).all(axis=1))
        weights = _clipped_integrals(corners[near], (x0, y0, x1, y1))
        area_mm2 = (x1 - x0) * (y1 - y0)
        covered_mm2 = float(np.sum(weights))
        if abs(covered_mm2 - area_mm2) > 1e-9 * area_mm2:
            raise PatchError(
                f"the rectangle x {x0:g} to {x1:g}, y {y0:g} to {y1:g} mm has {covered_mm2:g} of its {area_mm2:g} mm² "
                "on the body's top face: move or shrink it."
            )
        rows.append(np.full(dofs[near].size, number))
        cols.append(dofs[near].ravel())
        values.append(np.ravel(weights))
    shape = (len(rectangles), basis.N)
    return sp.csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))), shape=shape)


def top_triangles(basis: Basis) -> tuple[FloatArray, NDArray[np.int64]]:
    """Corners (n, 3, 2) of the top face's triangles, and the degrees of freedom (n, 6) on each."""
    mesh = basis.mesh
    boundary = mesh.boundary_facets()
    z = mesh.p[2, mesh.facets[:, boundary]]
    top = boundary[(z == mesh.p[2].max()).all(axis=0)]
    vertices = mesh.facets[:, top]
    # scikit-fem's facet edges run (0,1), (1,2), (0,2)
    dofs = np.vstack([basis.nodal_dofs[0, vertices], basis.edge_dofs[0, mesh.f2e[:, top]]])
    return mesh.p[:2, vertices].transpose(2, 1, 0), dofs.T


def _clipped_integrals(triangles: FloatArray, rectangle: tuple[float, ...]) -> FloatArray:
    """∫ φₐ dA over the part of each triangle (n, 3, 2) inside a rectangle, shape (n, 6)."""
    polygons = triangles
    x0, y0, x1, y1 = rectangle
    for axis, sign, limit in ((0, 1.0, x0), (0, -1.0, -x1), (1, 1.0, y0), (1, -1.0, -y1)):
        polygons = _clip(polygons, sign * polygons[:, :, axis] - limit)
    ends = np.broadcast_to(polygons[:, :1], polygons[:, 2:].shape)
    fan = np.stack([ends, polygons[:, 1:-1], polygons[:, 2:]], axis=2)  # (n, t, 3, 2)
    area = np.abs(_cross(fan[:, :, 1] - fan[:, :, 0], fan[:, :, 2] - fan[:, :, 0])) / 2
    midpoints = (fan + np.roll(fan, -1, axis=2)) / 2  # mid-edge rule: exact for quadratics
    return np.einsum("nt,ntqa->na", area / 3, _shape_functions(triangles, midpoints))


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


def _shape_functions(triangles: FloatArray, points: FloatArray) -> FloatArray:
    """P2 shape functions of triangles (n, 3, 2) at points (n, t, q, 2) of theirs, shape (n, t, q, 6)."""
    a, b, c = triangles.swapaxes(0, 1)[:, :, None, None]
    twice = _cross(b - a, c - a)
    L1, L2 = _cross(points - a, c - a) / twice, _cross(b - a, points - a) / twice
    L0 = 1.0 - L1 - L2
    return np.stack(
        [L0 * (2 * L0 - 1), L1 * (2 * L1 - 1), L2 * (2 * L2 - 1), 4 * L0 * L1, 4 * L1 * L2, 4 * L0 * L2], axis=-1
    )


def _cross(u: FloatArray, v: FloatArray) -> FloatArray:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def nodes_under(points_mm: FloatArray, rectangle: FloatArray) -> NDArray[np.bool_]:
    """Which of the nodes (n, 3) a plate on a rectangle (4,) of the top face binds, shape (n,)."""
    (x0, y0, x1, y1), (x, y, z) = rectangle, points_mm.T
    slack = ON_PLATE * (x1 - x0)
    return (x > x0 - slack) & (x < x1 + slack) & (y > y0 - slack) & (y < y1 + slack) & (z > z.max() - slack)
