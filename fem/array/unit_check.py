"""One unit by another way: meshed whole by pytetwild, solved with Taylor-Hood elements on scikit-fem's bases.

The array's response comes from condensed cells, of hexahedra where there is one rubber; a run prints how far the two
are apart.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np
import scipy.sparse as sp
from skfem import MeshTet

from common.storage.cache import kept
from common.storage.files import digest
from fem.array.meshed import lone_unit, plate_on
from fem.array.response import ArrayResponse, read_response, write_response
from fem.array.substructured import PADS, answered, electrode_means, refined_cell, usual_tolerance
from fem.kernel.elements import taylor_hood
from fem.kernel.factor import Factor, checked_solve
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from geometry.design import SensorDesign, bent
from geometry.layout import electrode_squares, pad_squares
from geometry.mesh import TetMesh, sensor_mesh, suited_settings

VERSION = 1  #: raise when the same mesh gives another solution, so that cached ones are not reused


@dataclass(frozen=True, kw_only=True)
class UnitCheck:
    """Difference between the cell of an array's response and a unit solved by other tools."""

    difference: float  #: of the electrodes' displacements per newton on the pad, relative to the response's own
    cells: int  #: tetrahedra of the unit's mesh
    unknowns: int
    files: tuple[Path, ...]  #: the mesh and the solution, as far as the cache could keep them
    reused: bool  #: whether both were there already


def check_unit(design: SensorDesign, progress: Callable[[str], None] = lambda step: None) -> UnitCheck:
    """Compare the refined cell of a design's response, standing alone, with the unit solved by `meshed_response`.

    `progress` is called with the name of each step as it begins. A `GeometryError` or `SolverError` says that a mesh or
    an answer cannot be trusted.
    """
    alone = lone_unit(design)
    progress("mesh")
    mesh, mesh_path, meshed_before = sensor_mesh(alone, suited_settings(alone))
    cache_key = digest("unit", VERSION, bent(alone), mesh.content_hash)

    def make() -> ArrayResponse:
        progress("Taylor-Hood")
        return replace(meshed_response(alone, mesh), cache_key=cache_key)

    unit, path, solved_before = kept("unit.nc", cache_key, make, read_response, write_response)
    progress("cell")
    refined = refined_cell(design, usual_tolerance(design), cached=True)
    alone_mm_per_n = answered(refined.cells, lambda kinds: next(iter(kinds.values())).free_compliance)
    ours = alone_mm_per_n[electrode_means(design)][:, PADS]
    return UnitCheck(
        difference=float(np.linalg.norm(unit.influence_mm_per_n.reshape(ours.shape) - ours) / np.linalg.norm(ours)),
        cells=len(mesh.cells),
        unknowns=unit.unknowns,
        files=tuple(file for file in (mesh_path, path) if file.exists()),
        reused=meshed_before and solved_before,
    )


def meshed_response(design: SensorDesign, mesh: TetMesh) -> ArrayResponse:
    """Response of a meshed sensor by Taylor-Hood elements, of one unit or of as many as have been meshed."""
    start = perf_counter()
    tets = MeshTet(mesh.points_mm.T.copy(), mesh.cells.T.copy())  # scikit-fem keeps points as (3, n)
    body = Rubber.of(tets, taylor_hood(), [design.matrix_material, design.pillar_material], mesh.region)
    plates = [plate for square in pad_squares(design) for plate in plate_on(square)]
    system = System(body, plates if design.pad.kind == "stiff" else [])
    pads, electrodes = (
        sp.diags_array(1 / (some[:, 2:] - some[:, :2]).prod(axis=1)) @ system.integrals(some)
        for some in (pad_squares(design), electrode_squares(design))
    )
    forces = np.einsum("kn,ij->kinj", pads.toarray(), np.eye(3)).reshape(-1, body.n_nodes, 3)
    x, residual = checked_solve(Factor(system.rest_matrix(), upper=True), system.rest_loads(forces))
    moved = np.stack([electrodes @ u for u in system.displaced(x)], axis=-1)  # (electrodes, 3, loads)
    rows, cols = design.array.rows, design.array.cols
    return ArrayResponse(
        design=design,
        influence_mm_per_n=moved.reshape(rows, cols, -1, 3, rows, cols, 3),
        residual=residual,
        unknowns=system.n_unknowns,
        mesh_hash=mesh.content_hash,
        seconds={"solve": perf_counter() - start},
        method="taylor-hood",
    )
