"""Copies of a condensed cell, coupled at their ports into an array.

Cells that touch share the modes of their common face and edges, so the array is a sparse system of small dense blocks.
"""

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.cell import CondensedCell
from fem.linear_solver import checked_solve, factorized
from fem.ports import EDGES, FACES, PortModes
from geometry.layout import FloatArray


def port_dofs(ports: PortModes, rows: int, cols: int) -> tuple[NDArray[np.int64], int]:
    """Global number of every cell's port degrees of freedom, shape (rows, cols, n_modes·3), and how many there are.

    Cell (i, j) lies at row i (along y) and column j (along x).
    """
    edge_size, face_size = ports.per_edge * 3, ports.per_face * 3
    edges = np.arange((rows + 1) * (cols + 1)).reshape(rows + 1, cols + 1) * edge_size
    upright = edges.size * edge_size + np.arange(rows * (cols + 1)).reshape(rows, cols + 1) * face_size
    level = edges.size * edge_size + upright.size * face_size + np.arange((rows + 1) * cols).reshape(-1, cols) * face_size
    i, j = np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij")
    starts = [edges[i + (sy > 0), j + (sx > 0)][..., None] + np.arange(edge_size) for sx, sy in EDGES]
    for axis, sign in FACES:
        first = upright[i, j + (sign > 0)] if axis == 0 else level[i + (sign > 0), j]
        starts.append(first[..., None] + np.arange(face_size))
    return np.concatenate(starts, axis=-1), edges.size * edge_size + (upright.size + level.size) * face_size


def couple(cell: CondensedCell, rows: int, cols: int, loads: NDArray[np.int64], observed: NDArray[np.int64]) -> tuple[FloatArray, float]:
    """Influence of loads on every cell upon what is observed on every cell.

    Parameters
    ----------
    cell : CondensedCell
    rows, cols : int
        Size of the array.
    loads, observed : arrays of int
        Which of the cell's functionals are unit forces, and which mean displacements.

    Returns
    -------
    array, shape (rows, cols, n_observed, rows, cols, n_loads)
        Mean displacement per newton [mm/N]: cell and functional observed, then cell and functional loaded.
    float
        Largest relative residual of the coupled solve.
    """
    dofs, n = port_dofs(cell.ports, rows, cols)
    flat = dofs.reshape(rows * cols, -1)
    width = flat.shape[1]
    matrix = sp.coo_matrix(
        (
            np.tile(cell.stiffness.ravel(), len(flat)),
            (np.repeat(flat, width, axis=1).ravel(), np.tile(flat, (1, width)).ravel()),
        ),
        shape=(n, n),
    ).tocsr()
    factor = factorized(matrix, definite=True)
    influence = np.empty((rows * cols, len(observed), rows * cols, len(loads)))
    residual = 0.0
    for row in range(rows):  # a row of cells at a time bounds the memory
        loaded = np.arange(row * cols, (row + 1) * cols)
        forces = np.zeros((n, cols, len(loads)))
        for k, unit in enumerate(loaded):
            forces[flat[unit], k] = cell.reach[:, loads]
        moved, misfit = checked_solve(matrix, factor, forces.reshape(n, -1))
        seen = np.einsum("po,upl->uol", cell.reach[:, observed], moved[flat], optimize=True)
        influence[:, :, loaded] = seen.reshape(len(flat), len(observed), cols, len(loads))
        residual = max(residual, misfit)
    unit = np.arange(rows * cols)
    influence[unit, :, unit] += cell.compliance[np.ix_(observed, loads)]
    return influence.reshape(rows, cols, len(observed), rows, cols, len(loads)), residual
