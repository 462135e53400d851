"""Deformation gradients at points of a grid from the displacements of its nodes."""

import numpy as np
import scipy.sparse as sp

from fem.boxes.boxes import Boxes
from fem.boxes.lagrange import shape_functions
from geometry.layout import FloatArray


class PointGradients:
    """Deformation gradients at fixed points of an upright grid of quadratic boxes.

    Parameters
    ----------
    grid : Boxes
        Without lean.
    points_mm : array, shape (n, 3)
        At rest; those outside are taken for the nearest ones inside.
    """

    def __init__(self, grid: Boxes, points_mm: FloatArray) -> None:
        node = np.zeros((len(points_mm), 27), dtype=np.int64)
        values, slopes = [], []
        for axis, line in enumerate(grid.lines):
            at = np.clip(points_mm[:, axis], line[0], line[-1])
            box = np.clip(np.searchsorted(line, at, side="right") - 1, 0, len(line) - 2)
            size = line[box + 1] - line[box]
            value, slope = shape_functions(2, (2 * at - line[box] - line[box + 1]) / size)
            values.append(value)
            slopes.append(slope * 2 / size[:, None])
            numbers = 2 * box[:, None] + np.indices((3, 3, 3))[axis].ravel()
            node = node * (2 * len(line) - 1) + numbers
        self.n_points, n_nodes = len(points_mm), int(np.prod([2 * len(line) - 1 for line in grid.lines]))
        rows = np.repeat(np.arange(self.n_points), 27)
        along = []
        for axis in range(3):
            three = [slopes[d] if d == axis else values[d] for d in range(3)]
            products = np.einsum("ni,nj,nk->nijk", *three).ravel()
            along.append(sp.csr_matrix((products, (rows, node.ravel())), shape=(self.n_points, n_nodes)))
        self._slopes = sp.vstack(along, format="csr")

    def of(self, displacement_mm: FloatArray) -> FloatArray:
        """∂u/∂X (m, n, 3, 3) of m states of the nodes (m, n_nodes, 3) [mm]; add 1 for F = ∂x/∂X."""
        m = len(displacement_mm)
        columns = displacement_mm.transpose(1, 0, 2).reshape(-1, 3 * m)
        found = (self._slopes @ columns).reshape(3, self.n_points, m, 3)
        return np.ascontiguousarray(found.transpose(2, 1, 3, 0))
