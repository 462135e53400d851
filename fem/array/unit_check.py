"""One unit by other tools: meshed by pytetwild, solved with scikit-fem's Taylor-Hood elements.

The array's response comes from hexahedra and condensed cells of our own. Here a single unit is solved by nothing but
public tools, so that a run can print how far the two are apart.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np
import scipy.sparse as sp
from skfem import Basis, BilinearForm, ElementTetP1, ElementTetP2, ElementVector, MeshTet
from skfem.helpers import ddot, div, sym_grad

from fem.array.meshed import lone_unit, plate_on
from fem.array.response import ArrayResponse, read_response, write_response
from fem.array.substructured import PADS, answered, electrode_means, refined_cell, usual_tolerance
from fem.factor import Factor, checked_solve
from fem.tetrahedra.mixed import taylor_hood
from fem.tetrahedra.patch import patch_means
from fem.tetrahedra.system import TetrahedralSystem
from geometry.design import SensorDesign
from geometry.layout import electrode_squares, pad_squares
from geometry.mesh import TetMesh, sensor_mesh, suited_settings
from geometry.storage.cache import kept
from geometry.storage.files import digest

VERSION = 1  #: raise when the same mesh gives another solution, so that cached ones are not reused


@dataclass(frozen=True, kw_only=True)
class UnitCheck:
    """Difference between the cell of an array's response and a unit solved by other tools."""

    difference: float  #: of the electrodes' displacements per newton on the pad, relative to the response's own
    cells: int  #: tetrahedra of the unit's mesh
    unknowns: int
    files: tuple[Path, ...]  #: the mesh and the solution, as far as the cache could keep them
    reused: bool  #: whether both were there already


# scikit-fem hands fields and parameters to these as types of its own, which it does not publish
@BilinearForm
def shear(u, v, w):  # type: ignore[no-untyped-def]
    """∫ 2μ ε(u):ε(v)"""
    return 2 * w.mu * ddot(sym_grad(u), sym_grad(v))


@BilinearForm
def dilation(u, q, w):  # type: ignore[no-untyped-def]
    """∫ div u q"""
    return div(u) * q


@BilinearForm
def compression(p, q, w):  # type: ignore[no-untyped-def]
    """∫ p q / λ"""
    return p * q / w.lame


def check_unit(design: SensorDesign, progress: Callable[[str], None] = lambda step: None) -> UnitCheck:
    """Compare the refined cell of a design's response, standing alone, with the unit solved by `meshed_response`.

    Parameters
    ----------
    design : SensorDesign
    progress : function
        Called with the name of each step as it begins.

    Raises
    ------
    GeometryError, SolverError
        If the mesh or an answer cannot be trusted.
    """
    alone = lone_unit(design)
    progress("mesh")
    mesh, mesh_path, meshed_before = sensor_mesh(alone, suited_settings(alone))
    bent = replace(alone, resistivity_ohm_mm=1.0)
    cache_key = digest("unit", VERSION, bent, mesh.content_hash)

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
    """Response of a meshed sensor by Taylor-Hood elements, assembled from forms of scikit-fem.

    Parameters
    ----------
    design : SensorDesign
        One unit, or as many as have been meshed.
    mesh : TetMesh

    Notes
    -----
    The form of `fem.tetrahedra.mixed`, assembled rubber by rubber, so that the pressure may jump between them.
    """
    start = perf_counter()
    tets = MeshTet(mesh.points_mm.T.copy(), mesh.cells.T.copy())  # scikit-fem keeps points as (3, n)
    A, B, C = [], [], []  # one of each rubber
    for region, rubber in enumerate((design.matrix_material, design.pillar_material)):
        own = np.flatnonzero(mesh.region == region)
        if not len(own):
            continue
        displacement = Basis(tets, ElementVector(ElementTetP2()), elements=own, intorder=2)
        pressure = Basis(tets, ElementTetP1(), elements=own, intorder=2)
        nodes = np.unique(pressure.element_dofs)
        lame, mu = rubber.lame_mpa
        A.append(shear.assemble(displacement, mu=mu))
        B.append(dilation.assemble(displacement, pressure)[nodes])
        C.append(compression.assemble(pressure, lame=lame)[nodes][:, nodes])
    free = np.flatnonzero(displacement.doflocs[2] > 0)  # the base is clamped
    div_u = sp.vstack(B)[:, free]
    K = sp.bmat([[sum(A)[free][:, free], div_u.T], [div_u, -sp.block_diag(C)]], format="csr")

    # one component of the displacement, for means over rectangles: component i of its node n is unknown n·3 + i
    component = Basis(tets, ElementTetP2(), intorder=2)
    pads, electrodes = (patch_means(component, squares(design)) for squares in (pad_squares, electrode_squares))
    plates = [load for square in pad_squares(design) for load in plate_on(square)] if design.pad.kind == "stiff" else []
    body = taylor_hood(tets, [design.matrix_material, design.pillar_material], mesh.region)
    system = TetrahedralSystem(body, plates)
    T = system.motions(system.rest().rotation)
    f = np.vstack([pads.T.toarray()[free], np.zeros((div_u.shape[0], pads.shape[0]))])
    K = (T.T @ K @ T).tocsr()
    x, residual = checked_solve(Factor(K), T.T @ f)
    u = np.zeros((displacement.N, f.shape[1]))
    u[free] = (T @ x)[: len(free)]
    rows, cols = design.array.rows, design.array.cols
    return ArrayResponse(
        design=design,
        influence_mm_per_n=(electrodes @ u).reshape(rows, cols, -1, 3, rows, cols, 3),
        residual=residual,
        unknowns=K.shape[0],
        mesh_hash=mesh.content_hash,
        seconds={"solve": perf_counter() - start},
        method="taylor-hood",
    )
