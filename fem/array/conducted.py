"""Resistances of a loaded array's pillars by conduction at linear strain: quadratic polynomials of its loads.

The displacement gradient in a unit's pillars is a linear function of all loads, known from one solved cell.
Conductivity and, by the potentials at rest, resistance follow to the second order in it. First derivatives take the
gradient as it is; second ones its part in a few modes that all units share, those that loads excite most where current
flows.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fem.array.coupled_cells import CoupledArray, TruncatedArray
from fem.array.design_cell import MAX_TESTED, CellInterior, DesignCell
from fem.array.response import ConductedPillars
from fem.conduction.potentials import (
    Conductor,
    Piezoresistivity,
    UnitConductors,
    pillars_per_mm,
    second_derivatives,
    strain_derivatives,
    unit_conductors,
)
from geometry.design import SensorDesign
from geometry.layout import FloatArray, pillar_vectors, pillar_volumes

MODES = 40  #: of the displacement gradient, for second derivatives
COMPONENTS = 8  #: of a pillar's polynomial in loads on pads, at most; see `ConductedPillars`
SHEAR = 0.2  #: of a pad's pressure: its usual shear, the protocols' friction
USUAL = np.array([SHEAR, SHEAR, 1.0])  #: loads along x, y, z, relative to each other
SPREAD = 2500  #: points that choose the modes
TRUNCATION = 1e-4  #: of a pad's own influence: what is smaller is left out, as in `solving`


def displacement_gradients(interior: CellInterior, points_mm: FloatArray, amplitudes: FloatArray) -> FloatArray:
    """Displacement gradients ∂uₐ/∂X_b at points (n, 3), shape (n, 3, 3, k) [1/mm].

    `amplitudes` has k columns of the cell's first amplitudes: of its ports, and perhaps of its first rectangle.
    """
    moved = interior.field.displacement_mm[:, :, : len(amplitudes)] @ amplitudes
    slopes = interior.field.slopes_at(points_mm) @ moved.reshape(len(moved), -1)
    return np.asarray(slopes).reshape(3, len(points_mm), 3, -1).transpose(1, 2, 0, 3)


def conducted_pillars(
    design: SensorDesign, influence_mm_per_n: FloatArray, progress: Callable[[str], None] = lambda step: None
) -> ConductedPillars:
    """Polynomials of the pillars' resistances in the loads of all pads.

    The part that eq. 1 has of them is taken from the influence, as `ArrayResponse` holds it. `progress` is called with
    the name of each step as it begins. Errors are those of `fem.conduction.meshes.unit_hexahedra`, and a
    `GeometryError` or `SolverError` if a mesh or an answer cannot be trusted.
    """
    array = TruncatedArray.of(design, TRUNCATION)
    rows, cols = array.smaller
    accurate = array.reduced(influence_mm_per_n).reshape(rows * cols, -1, 3, 3 * rows * cols)
    interior = DesignCell(design).interior(progress)
    found = conducted_by_loads(design, interior, USUAL, accurate, (rows, cols), progress)
    influence = found.influence_mm_per_n.reshape(*found.sign.shape, rows, cols, 3)
    return replace(
        found,
        rest_mm=array.representatives(found.rest_mm),
        influence_mm_per_n=array.expanded(influence),
        sign=array.representatives(found.sign),
    )


def conducted_by_loads(
    design: SensorDesign,
    interior: CellInterior,
    usual: FloatArray,
    accurate: FloatArray,
    shape: tuple[int, int],
    progress: Callable[[str], None] = lambda step: None,
    components: int = COMPONENTS,
) -> ConductedPillars:
    """The same in the first m of a cell's functionals as loads, of every cell of an array of a shape.

    `usual` (m,) are loads relative to each other: what is left out of a polynomial is small under these.

    `accurate` (n_cells, n_upper, 3, n) is the displacement of the upper electrodes by the n loads of all cells [mm/N].
    The influence has shape (rows, cols, n_pillars, n_components, n).
    """
    (rows, cols), m = shape, len(usual)
    piezo = Piezoresistivity.of(design.electrics)
    progress("conduction")
    conductors = unit_conductors(design.unit)
    at_rest = conductors.conductances()
    amplitudes, parts = _modes(interior, conductors.coarse, shape, usual)
    first = _first_derivatives(interior, conductors, piezo, m)
    gradients = displacement_gradients(interior, conductors.coarse.mesh.points_mm, amplitudes)
    second = second_derivatives(conductors.coarse, gradients, piezo)
    n_modes = second.shape[1]
    progress(f"coupling {rows} × {cols}")
    # of a cell's amplitudes: relative first derivatives of its pillars, parts of the modes, motion of its electrodes
    electrodes = np.hstack([interior.cell.transfer[:, m:].T, interior.cell.compliance[m:, :m]])
    seen, _ = CoupledArray(interior.cell, rows, cols).seen(np.vstack([first, parts, electrodes]), range(m))
    seen = seen.reshape(*seen.shape[:2], -1)
    rest, n_pillars = pillar_vectors(design.unit), len(second)
    square_mm2 = at_rest.pillars_per_mm * pillar_volumes(design.unit)  # ρ/V times that is R at rest
    scale = np.tile(usual, rows * cols)
    polynomials = [
        _components(
            square_mm2[p],
            rest[p],
            unit[p],
            (unit[n_pillars : n_pillars + n_modes], second[p]),
            accurate[k, top],
            unit[n_pillars + n_modes :].reshape(-1, 3, seen.shape[2])[top],
            scale,
            components,
        )
        for k, unit in enumerate(seen)
        for p, top in enumerate(design.unit.layout.pillar_top)
    ]
    signs = np.array([sign for _, sign in polynomials]).reshape(rows, cols, n_pillars, -1)
    rest_mm = np.zeros(signs.shape)
    rest_mm[..., 0] = np.sqrt(square_mm2)
    return ConductedPillars(
        rest_mm=rest_mm,
        influence_mm_per_n=np.array([B for B, _ in polynomials]).reshape(*signs.shape, -1),
        sign=signs,
        error_estimate=float(at_rest.error_estimate.max()),
    )


def _components(
    square_mm2: float,  # L, R V/ρ at rest
    rest_mm: FloatArray,  # d, between the electrodes, (3,)
    first: FloatArray,  # r, relative derivatives of R, (n,) [1/N]
    second: tuple[FloatArray, FloatArray],
    influence: FloatArray,
    coarse: FloatArray,
    scale: FloatArray,  # usual loads, relative to each other, (n,)
    components: int,
) -> tuple[FloatArray, FloatArray]:
    """B (n_components, n) and signs of one pillar, by its first and second derivatives in n loads.

    R V/ρ = L (1 + r·F + (r·F)² − aᵀ S a) + |d + B F|² − |d + B′F|², where the last two correct the cell's B′ (`coarse`)
    by the accurate `influence` (3, n) of the upper electrode. The first component, √L + ½ b·F/√L, holds all that is
    linear; the others diagonalise what is left of the second order, those kept that are largest under usual loads.
    """
    parts, S = second  # parts a (m, n) of m modes per load [1/N]
    b = square_mm2 * first + 2 * rest_mm @ (influence - coarse)
    root = np.sqrt(square_mm2)
    lead = b / (2 * root)
    rows = np.vstack([lead, first, parts, influence, coarse]) * scale
    m = len(parts)
    core = np.zeros((len(rows), len(rows)))
    core[0, 0], core[1, 1] = -1.0, square_mm2
    core[2 : 2 + m, 2 : 2 + m] = -square_mm2 * S
    core[2 + m :, 2 + m :] = np.diag([1.0] * 3 + [-1.0] * 3)
    Q, R = np.linalg.qr(rows.T)
    value, vector = np.linalg.eigh(R @ core @ R.T)
    kept = np.argsort(-np.abs(value))[: components - 1]
    others = (Q @ (vector[:, kept] * np.sqrt(np.abs(value[kept])))).T / scale
    return np.vstack([lead, others]), np.concatenate([[1.0], np.where(value[kept] < 0, -1.0, 1.0)])


def _modes(
    interior: CellInterior, conductor: Conductor, shape: tuple[int, int], usual: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Displacement gradients that loads excite most where current flows.

    Principal components under usual loads of an array of at most 3 × 3 units, energy weighted by current. Returns the
    cell's amplitudes in each mode (n_amplitudes, MODES), and the part of each mode in any amplitudes, transposed.
    """
    mesh = conductor.mesh
    some = np.arange(0, len(mesh.points_mm), max(1, len(mesh.points_mm) // SPREAD))
    size = np.linalg.norm(conductor.at_rest.gradients[some], axis=1)
    weight = mesh.weight_mm3[some] * sum(size[:, i] * size[:, j] for i, j in mesh.pairs)
    n, m = interior.cell.stiffness.shape[0] + len(usual), len(usual)
    gradients = displacement_gradients(interior, mesh.points_mm[some], np.eye(n))
    rows = (gradients * np.sqrt(weight)[:, None, None, None]).reshape(-1, n)
    tested = CoupledArray(interior.cell, *(min(MAX_TESTED, count) for count in shape))
    snapshots = tested.seen(np.eye(n), range(m))[0] * usual
    value, vector = np.linalg.eigh(rows.T @ rows)
    value, vector = value[value > 1e-12 * value[-1]], vector[:, value > 1e-12 * value[-1]]
    to_energy = np.sqrt(value)[:, None] * vector.T
    excited = to_energy @ snapshots.swapaxes(0, 1).reshape(n, -1)
    main = np.linalg.svd(excited, full_matrices=False)[0][:, :MODES]
    return vector / np.sqrt(value) @ main, main.T @ to_energy


def _first_derivatives(
    interior: CellInterior, conductors: UnitConductors, piezo: Piezoresistivity, m: int
) -> FloatArray:
    """Relative first derivatives of the pillars' resistances by the cell's amplitudes, (n_pillars, n_amplitudes).

    Of ports and the first m functionals.
    """
    n = interior.cell.stiffness.shape[0] + m
    found = []
    for conductor in (conductors.coarse, conductors.fine):
        at_rest = pillars_per_mm(conductor.conductances(), conductor.mesh.pairs)
        weights = strain_derivatives(conductor, piezo) / at_rest[:, None, None, None]
        slopes = interior.field.slopes_at(conductor.mesh.points_mm)
        nodal = [slopes.T @ np.concatenate(np.moveaxis(weight, 2, 0)) for weight in weights]  # (n_nodes, 3) each
        found.append(np.array([np.tensordot(part, interior.field.displacement_mm[:, :, :n], 2) for part in nodal]))
    return conductors.extrapolated(*found)
