"""One unit cell solved inside: what every port mode and every force on its top does at each of its points."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fem.array.cell import CondensedCell, PortModes, condensation
from fem.array.substructured import cell_grid, elastic_body, lone_unit, whole_grid
from fem.discretization.elasticity import ElasticBody
from fem.discretization.elements import Elements
from fem.discretization.grid import GridBasis, grid_body, grid_stiffness
from fem.discretization.plate import Plate, without_plate
from fem.factor import Factor, checked_solve
from geometry.design import Material, SensorDesign
from geometry.layout import FloatArray
from geometry.mesh import sensor_mesh, suited_settings

#: of a homogeneous cell: electrodes of the paper's sensor err by 0.6 % (level 3: 0.3 %, in four times the time)
GRID_LEVEL, GRID_DEGREE = 2, 6
MESH_LEVEL, MESH_DEGREE = 1.0, 5  #: of a cell with pillars of another rubber


@dataclass(frozen=True, eq=False, kw_only=True)
class CellInterior:
    """A condensed cell, and what every one of its amplitudes does inside.

    An amplitude is a port displacement [mm], n_modes·3 of them, or a force on a rectangle [N], three for each.
    """

    cell: CondensedCell
    elements: Elements
    material: list[Material]  #: one per region
    moved_mm: FloatArray  #: (n_nodes, 3, n_amplitudes), displacement per unit amplitude
    pressure_mpa: FloatArray | None  #: (n_pressure, n_amplitudes) of the mixed form


def cell_interior(
    body: ElasticBody,
    region: NDArray[np.int64],
    material: list[Material],
    ports: PortModes,
    rectangles: FloatArray,
    plate: Plate | None = None,
) -> CellInterior:
    """Condense a meshed cell and keep its inside; parameters as in `cell.condense`.

    Notes
    -----
    u_I = K_II⁻¹ (f_I − K_IB Φ q) in the notation of `cell.condense`. The same solutions give S, L and C, so that cells
    coupled by them meet exactly the displacements that are shown.
    """
    parts = condensation(body, ports, rectangles, plate)
    n = parts.modes.shape[1]
    factor = Factor(parts.K_II, definite=body.n_pressure == 0)
    rhs = np.hstack([-(parts.K_IB @ parts.modes), parts.loads[parts.inner]])
    inner, residual = checked_solve(factor, rhs)
    solution = np.zeros((body.matrix.shape[0], rhs.shape[1]))
    solution[parts.inner] = inner
    solution[parts.outer, :n] = parts.modes
    S = parts.modes.T @ (parts.K_BB @ parts.modes) - rhs[:, :n].T @ inner[:, :n]
    L = parts.modes.T @ parts.loads[parts.outer] + rhs[:, :n].T @ inner[:, n:]
    C = rhs[:, n:].T @ inner[:, n:]
    if parts.has_plate:
        S, L, C, by_ports, by_loads = without_plate(S, L, C, parts.n_ports)
        moved = solution[:, parts.n_ports : n]
        solution = np.hstack([
            solution[:, : parts.n_ports] - moved @ by_ports, solution[:, n:] + moved @ by_loads
        ])  # fmt: skip
    cell = CondensedCell(
        ports=ports,
        stiffness=(S + S.T) / 2,
        reach=L,
        compliance=(C + C.T) / 2,
        unknowns=len(solution),
        residual=residual,
    )
    return CellInterior(
        cell=cell,
        elements=Elements.of_basis(body.basis, region),
        material=material,
        moved_mm=body.displacements(solution).reshape(body.basis.N, 3, -1),
        pressure_mpa=solution[len(body.free) :] if body.n_pressure else None,
    )


def design_interior(
    design: SensorDesign,
    rectangles_mm: FloatArray,
    plate: Plate | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> CellInterior:
    """Solve a design's cell inside.

    Parameters
    ----------
    design : SensorDesign
    rectangles_mm : array, shape (k, 4)
        What can be loaded on its top: x0, y0, x1, y1 in the cell's own coordinates.
    plate : Plate, optional
        Bonded to its top.
    progress : function
        Called with the name of each step as it begins.
    """
    if design.is_homogeneous:
        progress("cell")
        basis = GridBasis(whole_grid(cell_grid(design, GRID_LEVEL)))
        body = grid_body(basis, grid_stiffness(basis, [design.matrix_material]))
        region, degree = np.zeros(basis.element_dofs.shape[1], dtype=np.int64), GRID_DEGREE
    else:
        progress("mesh")
        alone = lone_unit(design)
        mesh, _, _ = sensor_mesh(alone, suited_settings(design).finer(MESH_LEVEL))
        progress("cell")
        body = elastic_body(alone, mesh)
        region, degree = mesh.region.astype(np.int64), MESH_DEGREE
    ports = PortModes(design.array.pitch_mm / 2, design.unit.height_mm, degree, degree)
    return cell_interior(body, region, [design.matrix_material, design.pillar_material], ports, rectangles_mm, plate)
