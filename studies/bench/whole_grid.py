"""The response of a homogeneous array by one grid of the whole slab: what condensing one cell of that grid saves."""

from time import perf_counter

import numpy as np

from fem.array.response import ArrayResponse
from fem.array.substructured import cell_grid
from fem.discretization.grid import Grid
from fem.discretization.hexahedra import GridBasis, grid_body, grid_stiffness
from fem.discretization.patch import patch_means
from fem.linear.linear_solver import checked_solve, factorized
from geometry.design import SensorDesign
from geometry.layout import ELECTRODES, FloatArray, electrode_squares, pad_squares


def whole_grid_response(design: SensorDesign, level: int) -> ArrayResponse:
    """Copies of a cell's grid side by side, factored as one body, and solved for every pad and axis."""
    start = perf_counter()
    cell = cell_grid(design, level)
    rows, cols = design.array.rows, design.array.cols
    grid = Grid(x=_tiled(cell.x, cols), y=_tiled(cell.y, rows), z=cell.z)
    basis = GridBasis(grid, "Q2")
    body = grid_body(basis, grid_stiffness(basis, [design.matrix_material]))
    pads = patch_means(basis, pad_squares(design))
    electrodes = patch_means(basis, electrode_squares(design))
    assembled = perf_counter()
    factor = factorized(body.matrix, definite=True)
    factored = perf_counter()
    solution, residual = checked_solve(body.matrix, factor, body.loads(pads.T.toarray()))
    influence = electrodes @ body.displacements(solution)
    return ArrayResponse(
        design=design,
        influence_mm_per_n=influence.reshape(rows, cols, len(ELECTRODES), 3, rows, cols, 3),
        residual=residual,
        unknowns=body.matrix.shape[0],
        seconds={"assemble": assembled - start, "factor": factored - assembled, "solve": perf_counter() - factored},
        method="whole grid",
    )


def _tiled(half: FloatArray, count: int) -> FloatArray:
    """Lines of so many cells side by side, centred, from those of half a cell [0, a]."""
    cell = np.concatenate([-half[:0:-1], half])
    steps = np.tile(np.diff(cell), count)
    return np.concatenate([[0.0], np.cumsum(steps)]) - count * half[-1]
