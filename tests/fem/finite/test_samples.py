"""Samples of arrays from uniform preloads: against Newton's method on both grids, given up, renewed, corrected."""

from dataclasses import replace

import numpy as np
import pytest

from fem.finite.preloaded import PreloadedArray
from fem.finite.samples import EXTRAPOLATED, SampleSolver
from fem.kernel.newton import find_equilibrium
from fem.kernel.system import State
from geometry.design import Array, Electrics, Material, SensorDesign, with_model
from geometry.layout import pillar_ends

PAIR = SensorDesign(array=Array(rows=1, cols=2))
#: forces of 0.5 to 2.5 MPa with a fifth of shear [N]
FORCES_N = 144.0 * np.array([[[0.1, 0.05, -0.5], [0.0, 0.1, -1.0]], [[0.2, -0.2, -1.5], [-0.3, 0.0, -2.5]]])


@pytest.fixture(scope="module")
def solver() -> SampleSolver:
    return SampleSolver(PAIR)


@pytest.fixture(scope="module")
def found(solver):
    return solver.displacements(FORCES_N)


def sharing(solver, one):
    """Another solver that finds the first one's preloads."""
    one.coarse, one.fine = solver.coarse, solver.fine
    return one


def test_samples_are_newton_s_on_both_grids_and_extrapolated(solver, found):
    assert found.settled.all()
    forces = FORCES_N[1]
    states = [(array, find_equilibrium(array.system(forces)).state) for array in (solver.coarse, solver.fine)]
    coarse, fine = (
        np.stack(
            [a + (R - np.eye(3)) @ arm for a, R in zip(state.shift, state.rotation, strict=True) for arm in array.arm]
        )
        for array, state in states
    )
    expected = fine + EXTRAPOLATED * (fine - coarse)
    off = np.linalg.norm(found.displacement_mm[1].reshape(-1, 3) - expected) / np.linalg.norm(expected)
    assert off < 2e-3  # of the few iterations on the finer grid
    assert off < found.error_estimate[1]


def test_a_fine_influence_replaces_the_grids_own_at_small_loads(solver):
    fine = sharing(solver, SampleSolver(PAIR, influence_mm_per_n=1.1 * solver.fine.influence))
    small = FORCES_N[:1] * 1e-5
    moved = 1.1 * (solver.fine.influence @ small.ravel()).reshape(2, 2, 3)
    assert np.allclose(fine.displacements(small).displacement_mm[0], moved, rtol=2e-3, atol=1e-9)


def test_resistances_have_no_jumps_along_a_path_of_loads(solver, few_potentials):
    """From 0.5 to 1.3 MPa in the middle. Fourth differences cancel cubics; what is left is noise, √70-fold."""
    conducting = sharing(solver, SampleSolver(replace(PAIR, electrics=Electrics(model="conduction"))))
    found = conducting.displacements(np.linspace(0.25, 0.65, 9)[:, None, None] * FORCES_N[1])
    bottom, top = pillar_ends(PAIR.unit).transpose(1, 0, 2)
    along = top - bottom + found.displacement_mm[:, :, PAIR.unit.layout.pillar_top]
    changes = (along**2).sum(axis=-1) / ((top - bottom) ** 2).sum(axis=-1) * found.resistance_ratio
    assert found.settled.all()
    assert np.ptp(changes, axis=0).max() > 0.05
    assert np.abs(np.diff(changes, 4, axis=0)).max() / np.sqrt(70) < 1e-4


@pytest.mark.parametrize(
    "matrix_mpa", [pytest.param(1.0, marks=pytest.mark.long), 0.3], ids=["6 times as soft", "20 times as soft"]
)
def test_two_rubbers_are_a_finer_grid_s_to_the_stated_error(matrix_mpa):
    """A lone unit, lines four times as dense in each direction as at first, at strains far from linear."""
    alone = replace(PAIR, array=Array(rows=1, cols=1), matrix_material=Material(young_mpa=matrix_mpa))
    finer = PreloadedArray(alone, (0.1, 0.3, 0.5, 0.7, 0.9), (0.2, 0.4, 0.6, 0.8, 1.0))
    solver = SampleSolver(alone, influence_mm_per_n=finer.influence.reshape(1, 2, 3, 1, 3))
    force = np.array([[[0.02, -0.03, -0.25]]]) * solver.coarse.young_mpa * 144.0
    found, (moved,) = solver.displacements(force), finer.linear(force.reshape(1, 3)).shift
    state = find_equilibrium(finer.system(force[0])).state
    truth = finer.electrodes(State(*(part[None] for part in (state.u, state.p, state.shift, state.turn))))[0]
    size = np.linalg.norm(truth)
    assert np.linalg.norm(moved - state.shift) > 0.1 * np.linalg.norm(state.shift)  # linear rubber is elsewhere
    assert np.linalg.norm(found.displacement_mm[0] - truth) / size < found.error_estimate[0] < 0.05


@pytest.mark.parametrize("changes", [{"model": "yeoh", "stiffening": 0.3}, {"model": "mooney-rivlin"}], ids=str)
def test_samples_are_of_the_designs_own_law(changes):
    """The answer is Newton's by that law on both grids, extrapolated; by the neo-Hookean one it is another."""
    rubber = Material(**changes)
    alone = replace(PAIR, array=Array(rows=1, cols=1), matrix_material=rubber, pillar_material=rubber)
    solver, force = SampleSolver(alone), FORCES_N[1:, :1]
    found = solver.displacements(force)
    other = SampleSolver(with_model(alone, "neo-hookean")).displacements(force)
    moved = []
    for array in (solver.coarse, solver.fine):
        state = find_equilibrium(array.system(force[0])).state
        moved.append(state.shift + np.einsum("kij,ej->kei", state.turn, array.arm)[0])
    expected = moved[1] + EXTRAPOLATED * (moved[1] - moved[0])
    off, apart = (np.linalg.norm(one.displacement_mm[0, 0] - expected) for one in (found, other))
    assert found.settled.all()
    assert off < 2e-3 * np.linalg.norm(expected) < 0.2 * apart


def test_samples_that_do_not_settle_get_a_tangent_of_their_own(solver, found, monkeypatch):
    monkeypatch.setattr("fem.finite.preloaded.MAX_ITERATIONS", 3)
    again = solver.displacements(FORCES_N[1:])
    assert again.settled.all()
    assert again.iterations[0] > 3
    assert np.allclose(again.displacement_mm, found.displacement_mm[1:], rtol=2e-3, atol=1e-3)


def test_samples_that_are_not_wanted_are_given_up(solver, found):
    reluctant = sharing(solver, SampleSolver(PAIR, unwanted=lambda moved: np.abs(moved).max(axis=(1, 2, 3)) > 1.0))
    given_up = reluctant.displacements(FORCES_N)
    assert given_up.settled.tolist() == [True, False]
    assert given_up.iterations[1] < found.iterations[1]
    assert np.abs(given_up.displacement_mm[1]).max() > 1.0  # as its caller sees, too
