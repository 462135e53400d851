"""Samples of arrays from uniform preloads: against Newton's method on the same grid, alone and together."""

from dataclasses import replace

import numpy as np
import pytest

from fem.finite.newton import find_equilibrium
from fem.finite.samples import SampleSolver, array_grid
from fem.finite.system import FiniteSystem
from fem.scene.loads import StiffLoad
from geometry.design import Array, Material, SensorDesign
from geometry.errors import DesignError
from geometry.layout import unit_centres

PAIR = SensorDesign(array=Array(rows=1, cols=2))
#: forces of 0.5 to 2.5 MPa with a fifth of shear [N]
FORCES_N = 144.0 * np.array([[[0.1, 0.05, -0.5], [0.0, 0.1, -1.0]], [[0.2, -0.2, -1.5], [-0.3, 0.0, -2.5]]])


@pytest.fixture(scope="module")
def solver() -> SampleSolver:
    return SampleSolver(PAIR)


def test_samples_are_newton_s(solver):
    found = solver.displacements(FORCES_N)
    assert found.change.max() <= 2e-4
    assert set(found.preload) == {0.0, 2.0}
    for number, forces in enumerate(FORCES_N):
        loads = [
            StiffLoad(center_mm=(float(x), float(y)), size_mm=(12.0, 12.0), force_n=tuple(force.tolist()))
            for (x, y), force in zip(unit_centres(PAIR), forces, strict=True)
        ]
        state = find_equilibrium(FiniteSystem(solver.body, list(loads))).state
        u = solver.body.basis.patch_integrals(np.array([[-13.5, -6.0, -11.5, -4.0]])) @ state.u / 4.0
        off = np.linalg.norm(found.displacement_mm[number, 0, 0] - u[0]) / np.linalg.norm(u)
        assert off < 5e-4  # of a few iterations more, at the tolerance of 2e-4


def test_nothing_moves_without_load(solver):
    assert np.abs(solver.displacements(np.zeros((1, 2, 3))).displacement_mm).max() == 0.0


def test_a_fine_compliance_replaces_the_grid_s_own_at_small_loads(solver):
    fine = SampleSolver(PAIR, fine_compliance=1.1 * solver.base(0.0).compliance()[:, :6])
    small = FORCES_N[:1] * 1e-5
    ratio = fine.displacements(small).displacement_mm / solver.displacements(small).displacement_mm
    assert np.allclose(ratio, 1.1, atol=1e-4)


def test_lines_follow_pads_and_units():
    grid = array_grid(replace(PAIR, pad=replace(PAIR.pad, offset_x_mm=1.0, size_mm=10.0)))
    for place in (-15.0, -11.5, -1.5, 0.0, 3.5, 13.5, 15.0):
        assert np.abs(grid.x - place).min() < 1e-9


def test_pillars_of_another_rubber_are_refused():
    with pytest.raises(DesignError, match="one rubber"):
        SampleSolver(replace(PAIR, pillar_material=Material(young_mpa=3.0)))


def test_samples_that_do_not_settle_get_a_tangent_of_their_own(solver, monkeypatch):
    monkeypatch.setattr("fem.finite.samples.MAX_ITERATIONS", 3)
    found = solver.displacements(FORCES_N[1:])
    assert 3 < found.iterations[0] <= 12
    monkeypatch.undo()
    assert found.change.max() <= 2e-4
    assert np.allclose(found.displacement_mm, solver.displacements(FORCES_N[1:]).displacement_mm, atol=2e-3)
