"""The whole array as one mesh of Taylor-Hood tetrahedra: what condensed cells are held against."""

from collections.abc import Callable
from time import perf_counter

import numpy as np
from skfem import MeshTet

from fem.array.response import ArrayResponse
from fem.discretization.elasticity import ElasticBody, taylor_hood
from fem.discretization.patch import patch_means
from fem.linear.linear_solver import checked_solve, factorized
from geometry.design import SensorDesign
from geometry.layout import ELECTRODES, electrode_squares, pad_squares
from geometry.mesh import TetMesh


def whole_response(
    design: SensorDesign, mesh: TetMesh, progress: Callable[[str], None] = lambda step: None
) -> ArrayResponse:
    """Response of a meshed sensor: assemble, factor, solve for a unit force on every pad along every axis."""
    seconds = {}
    start = perf_counter()

    def done(step: str) -> None:
        nonlocal start
        now = perf_counter()
        seconds[step], start = now - start, now

    progress("assemble")
    body = elastic_body(design, mesh)
    pads = patch_means(body.basis, pad_squares(design))
    electrodes = patch_means(body.basis, electrode_squares(design))
    done("assemble")

    progress("factor")
    solve = factorized(body.matrix)
    done("factor")

    columns, residual = [], 0.0
    for row in range(design.array.rows):  # a row of pads at a time bounds the memory
        progress("solve")
        width = 3 * design.array.cols
        # a unit force spread over a pad does work on the pad's mean displacement: its load vector is that mean's
        loads = pads[row * width : (row + 1) * width].T.toarray()
        solution, misfit = checked_solve(body.matrix, solve, body.loads(loads))
        columns.append(electrodes @ body.displacements(solution))
        residual = max(residual, misfit)
    done("solve")

    rows, cols = design.array.rows, design.array.cols
    return ArrayResponse(
        design=design,
        influence_mm_per_n=np.hstack(columns).reshape(rows, cols, len(ELECTRODES), 3, rows, cols, 3),
        residual=residual,
        unknowns=body.matrix.shape[0],
        mesh_hash=mesh.content_hash,
        seconds=seconds,
        method="whole",
    )


def elastic_body(design: SensorDesign, mesh: TetMesh) -> ElasticBody:
    """The meshed sensor as a Taylor-Hood body; regions take the matrix's and the pillars' rubber."""
    skfem_mesh = MeshTet(mesh.points_mm.T.copy(), mesh.cells.T.copy())  # scikit-fem keeps points as (3, n)
    return taylor_hood(skfem_mesh, [design.matrix_material, design.pillar_material], mesh.region)
