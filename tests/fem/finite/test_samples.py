"""Samples of arrays from uniform preloads: against Newton's method on both grids, given up, renewed, corrected."""

from dataclasses import replace

import numpy as np
import pytest

from fem.conduction import reduced
from fem.conduction.meshes import unit_hexahedra
from fem.conduction.potentials import Conductor, pillars_per_mm
from fem.conduction.reduced import pillars_of
from fem.finite.newton import find_equilibrium
from fem.finite.samples import EXTRAPOLATED, REDUCED_ERROR, SampleSolver, _mended, typical_conduction
from geometry.design import Array, Electrics, Material, SensorDesign
from geometry.errors import DesignError
from geometry.layout import pillar_ends, unit_centres

PAIR = SensorDesign(array=Array(rows=1, cols=2))
#: forces of 0.5 to 2.5 MPa with a fifth of shear [N]
FORCES_N = 144.0 * np.array([[[0.1, 0.05, -0.5], [0.0, 0.1, -1.0]], [[0.2, -0.2, -1.5], [-0.3, 0.0, -2.5]]])


@pytest.fixture(scope="module")
def solver() -> SampleSolver:
    return SampleSolver(PAIR)


@pytest.fixture(scope="module")
def found(solver):
    return solver.displacements(FORCES_N)


def by_newton(array, forces):
    state = find_equilibrium(array.system(forces)).state
    return array.electrodes(state.shift[None], state.rotation[None])[0]


def test_samples_are_newton_s_on_both_grids_and_extrapolated(solver, found):
    assert found.settled.all()
    for number, forces in enumerate(FORCES_N):
        coarse, fine = (by_newton(array, forces) for array in (solver.coarse, solver.fine))
        expected = fine + EXTRAPOLATED * (fine - coarse)
        off = np.linalg.norm(found.displacement_mm[number] - expected) / np.linalg.norm(expected)
        assert off < 4e-3  # of the fourth order, which only the coarse grid has
        assert off < found.error_estimate[number]


def test_a_fine_influence_replaces_the_grids_own_at_small_loads(solver):
    fine = SampleSolver(PAIR, influence_mm_per_n=1.1 * solver.fine.influence)
    small = FORCES_N[:1] * 1e-5
    moved = 1.1 * (solver.fine.influence @ small.ravel()).reshape(2, 2, 3)
    assert np.allclose(fine.displacements(small).displacement_mm[0], moved, rtol=2e-3, atol=1e-9)


@pytest.mark.long  # the short one: tests/fem/conduction/test_reduced.py
def test_usual_reduced_conduction_is_as_near_as_it_says(solver, shared_cache):
    """Under a stiff plate at 2.5 MPa: the largest relative difference of the reduced conductances of a loaded unit from
    those of all potentials."""
    made, centre = typical_conduction(PAIR), np.append(unit_centres(PAIR)[0], 0.0)
    (field,) = solver.fields(FORCES_N[1:])
    whole = Conductor(unit_hexahedra(PAIR.unit, *reduced.MESH))
    mesh = whole.mesh

    def deformed(points, pillar, weight_mm3):
        return _mended(np.eye(3) + field.gradients(*solver.slopes(points + centre))[1][:, None], pillar, weight_mm3)[0]

    F = deformed(mesh.points_mm, pillars_of(PAIR.unit, mesh.points_mm), mesh.weight_mm3)[0, 0]
    found = made.conductances(deformed(made.points_mm, made.pillar, made.weight_mm3)[0, 0])
    at_rest = made.conductances(np.broadcast_to(np.eye(3), (len(made.points_mm), 3, 3)))
    changes = (
        pillars_per_mm(one, mesh.pairs) / pillars_per_mm(other, mesh.pairs)
        for one, other in ((found, at_rest), (whole.conductances(lambda points: F), whole.conductances()))
    )
    assert np.abs(np.divide(*changes) - 1).max() < REDUCED_ERROR


@pytest.mark.parametrize(("low", "high"), [(0.25, 0.65), (0.7, 1.1)])  # 0.5 to 1.3 MPa in the middle, and 1.4 to 2.2
def test_resistances_have_no_jumps_along_a_path_of_loads(solver, low, high, few_potentials):
    """Fourth differences cancel cubics; what is left is noise, √70 times as large."""
    conducting = SampleSolver(replace(PAIR, electrics=Electrics(model="conduction")))
    conducting.coarse, conducting.fine = solver.coarse, solver.fine
    share = np.linspace(low, high, 9)[:, None, None]
    found = conducting.displacements(share * FORCES_N[1])
    bottom, top = pillar_ends(PAIR.unit).transpose(1, 0, 2)
    along = top - bottom + found.displacement_mm[:, :, PAIR.unit.layout.pillar_top]
    changes = (along**2).sum(axis=-1) / ((top - bottom) ** 2).sum(axis=-1) * found.resistance_ratio
    assert found.settled.all()
    assert np.ptp(changes, axis=0).max() > 0.05
    assert np.abs(np.diff(changes, 4, axis=0)).max() / np.sqrt(70) < 1e-4


def test_pillars_of_another_rubber_are_refused():
    with pytest.raises(DesignError, match="one rubber"):
        SampleSolver(replace(PAIR, pillar_material=Material(young_mpa=3.0)))


def test_samples_that_do_not_settle_get_a_tangent_of_their_own(solver, found, monkeypatch):
    monkeypatch.setattr("fem.finite.preloads.MAX_ITERATIONS", 3)
    again = solver.displacements(FORCES_N[1:])
    assert again.settled.all()
    assert again.iterations[0] > 3
    assert np.allclose(again.displacement_mm, found.displacement_mm[1:], rtol=2e-3, atol=1e-3)


def test_samples_that_are_not_wanted_are_given_up(solver, found):
    reluctant = SampleSolver(PAIR, unwanted=lambda moved: np.abs(moved).max(axis=(1, 2, 3)) > 1.0)
    reluctant.coarse, reluctant.fine = solver.coarse, solver.fine
    given_up = reluctant.displacements(FORCES_N)
    assert given_up.settled.tolist() == [True, False]
    assert given_up.iterations[1] < found.iterations[1]
    assert np.abs(given_up.displacement_mm[1]).max() > 1.0  # as its caller sees, too
