"""The inside of a unit cell: what static condensation eliminates, recovered for pictures."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fem.array.cell import CondensedCell, condensation
from fem.array.port_modes import PortModes
from fem.discretization.elasticity import ElasticBody
from fem.discretization.elements import Elements
from fem.fields.stress import CornerStress, corner_stress
from fem.linear.linear_solver import checked_solve, factorized
from geometry.design import Material
from geometry.layout import FloatArray


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

    @cached_property
    def stress(self) -> CornerStress:
        """Stress per unit amplitude, worked out when first asked for."""
        return corner_stress(self.elements, self.material, self.moved_mm, self.pressure_mpa)


def cell_interior(
    body: ElasticBody, region: NDArray[np.int64], material: list[Material], ports: PortModes, rectangles: FloatArray
) -> CellInterior:
    """Condense a meshed cell and keep its inside; parameters as in `cell.condense`.

    Notes
    -----
    u_I = K_II⁻¹ (f_I − K_IB Φ q) in the notation of `cell.condense`. The same solutions give S, L and C, so that cells
    coupled by them meet exactly the displacements that are shown.
    """
    parts = condensation(body, ports, rectangles)
    n = parts.modes.shape[1]
    factor = factorized(parts.K_II, definite=body.n_pressure == 0)
    rhs = np.hstack([-(parts.K_IB @ parts.modes), parts.loads[parts.inner]])
    inner, residual = checked_solve(parts.K_II, factor, rhs)
    solution = np.zeros((body.matrix.shape[0], rhs.shape[1]))
    solution[parts.inner] = inner
    solution[parts.outer, :n] = parts.modes
    S = parts.modes.T @ (parts.K_BB @ parts.modes) - rhs[:, :n].T @ inner[:, :n]
    L = parts.modes.T @ parts.loads[parts.outer] + rhs[:, :n].T @ inner[:, n:]
    C = rhs[:, n:].T @ inner[:, n:]
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
