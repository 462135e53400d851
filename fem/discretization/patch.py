"""Exact integrals over rectangles of the top face, wherever its triangles lie.

A load on a pad and the mean displacement of an electrode are the same integral ∫ φ dA of each shape function over a
rectangle. Triangles are clipped to the rectangle and integrated exactly, so a load never misses a part of its force and
no outline has to conform to the mesh.
"""

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from skfem import Basis

from geometry.errors import TriPillarError
from geometry.layout import FloatArray


class PatchError(TriPillarError, ValueError):
    """A rectangle that does not lie wholly on the top face."""


def patch_means(basis: Basis, rectangles: FloatArray) -> sp.csr_matrix:
    """Rows that take nodal displacements to mean displacements of rectangles (k, 4) of the top face.

    Shape (k·3, n_displacement): rows run over rectangles, then axes. A row is also the nodal load vector of a
    unit force spread evenly over that rectangle.
    """
    area_mm2 = (rectangles[:, 2] - rectangles[:, 0]) * (rectangles[:, 3] - rectangles[:, 1])
    return sp.kron(sp.diags_array(1 / area_mm2) @ patch_integrals(basis, rectangles), sp.eye_array(3), format="csr")


def patch_integrals(basis: Basis, rectangles: FloatArray) -> sp.csr_matrix:
    """Integral of every scalar shape function over rectangles of the plane top face.

    Parameters
    ----------
    basis : Basis
        Scalar P2 basis on a MeshTet whose highest points form the plane top face.
    rectangles : array, shape (n_rectangles, 4)
        x0, y0, x1, y1 of each [mm].

    Returns
    -------
    csr_matrix, shape (n_rectangles, basis.N)
        ∫ φₙ dA [mm²]; each row sums to the rectangle's area.

    Raises
    ------
    PatchError
        If a rectangle is not covered by the top face to a relative 1e-9 of its area.
    """
    corners, dofs = _top_triangles(basis)  # (n, 3, 2), (n, 6)
    low, high = corners.min(axis=1), corners.max(axis=1)
    rows, cols, values = [], [], []
    for number, (x0, y0, x1, y1) in enumerate(rectangles):
        near = np.flatnonzero(((high > (x0, y0)) & (low < (x1, y1))).all(axis=1))
        weights = [_clipped_integrals(corners[t], (x0, y0, x1, y1)) for t in near]
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


def _top_triangles(basis: Basis) -> tuple[FloatArray, NDArray[np.int64]]:
    """Corners (n, 3, 2) of the top face's triangles, and the degrees of freedom (n, 6) on each."""
    mesh = basis.mesh
    boundary = mesh.boundary_facets()
    z = mesh.p[2, mesh.facets[:, boundary]]
    top = boundary[(z == mesh.p[2].max()).all(axis=0)]
    vertices = mesh.facets[:, top]
    # scikit-fem's facet edges run (0,1), (1,2), (0,2)
    dofs = np.vstack([basis.nodal_dofs[0, vertices], basis.edge_dofs[0, mesh.f2e[:, top]]])
    return mesh.p[:2, vertices].transpose(2, 1, 0), dofs.T


def _clipped_integrals(triangle: FloatArray, rectangle: tuple[float, ...]) -> FloatArray:
    """∫ φₐ dA over the part of a triangle (3, 2) inside a rectangle, shape (6,)."""
    polygon = triangle
    x0, y0, x1, y1 = rectangle
    for axis, sign, limit in ((0, 1.0, x0), (0, -1.0, -x1), (1, 1.0, y0), (1, -1.0, -y1)):
        polygon = _clip(polygon, sign * polygon[:, axis] - limit)
        if len(polygon) < 3:
            return np.zeros(6)
    fan = np.stack([np.broadcast_to(polygon[0], (len(polygon) - 2, 2)), polygon[1:-1], polygon[2:]], axis=1)
    area = np.abs(_cross(fan[:, 1] - fan[:, 0], fan[:, 2] - fan[:, 0])) / 2
    midpoints = (fan + np.roll(fan, -1, axis=1)) / 2  # mid-edge rule: exact for quadratics
    return np.einsum("t,tqa->a", area / 3, _shape_functions(triangle, midpoints))


def _clip(polygon: FloatArray, inside: FloatArray) -> FloatArray:
    """The part of a convex polygon (n, 2) where the linear function with vertex values `inside` is not negative."""
    corners = []
    for here, there, a, b in zip(polygon, np.roll(polygon, -1, axis=0), inside, np.roll(inside, -1), strict=True):
        if a >= 0:
            corners.append(here)
        if (a < 0) != (b < 0):
            corners.append(here + (there - here) * (a / (a - b)))
    return np.array(corners).reshape(-1, 2)


def _shape_functions(triangle: FloatArray, points: FloatArray) -> FloatArray:
    """P2 shape functions of a triangle (3, 2) at points (..., 2), shape (..., 6)."""
    a, b, c = triangle
    twice = _cross(b - a, c - a)
    L1, L2 = _cross(points - a, c - a) / twice, _cross(b - a, points - a) / twice
    L0 = 1.0 - L1 - L2
    return np.stack(
        [L0 * (2 * L0 - 1), L1 * (2 * L1 - 1), L2 * (2 * L2 - 1), 4 * L0 * L1, 4 * L1 * L2, 4 * L0 * L2], axis=-1
    )


def _cross(u: FloatArray, v: FloatArray) -> FloatArray:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
