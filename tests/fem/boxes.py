"""Small meshes on which the finite elements are put to the test."""

import numpy as np
from skfem import MeshTet


def box_mesh(n: tuple[int, int, int], size_mm: tuple[float, float, float], disorder: float = 0.0) -> MeshTet:
    """A box from the origin in 6·nx·ny·nz tetrahedra, inner points moved at random by a share of the edges."""
    grid = [np.linspace(0.0, extent, cells + 1) for cells, extent in zip(n, size_mm, strict=True)]
    mesh = MeshTet.init_tensor(*grid)
    if not disorder:
        return mesh
    points = mesh.p.copy()
    inner = np.ones(points.shape[1], dtype=bool)
    for axis, extent in enumerate(size_mm):
        inner &= (points[axis] > 0) & (points[axis] < extent)
    edges = np.array(size_mm) / np.array(n)
    moves = np.random.default_rng(7).uniform(-disorder, disorder, (3, int(inner.sum()))) * edges[:, None]
    points[:, inner] += moves
    return MeshTet(points, mesh.t)
