"""Light loads by stored derivatives: the series' own terms, solved samples, bits that do not depend on a batch."""

import numpy as np
import pytest

from fem.finite.derivatives import second_order
from fem.finite.light import MAX_MPA, MAX_SHEAR_MPA
from fem.finite.preloads import PreloadedArray
from fem.finite.samples import COARSE, EXTRAPOLATED, SampleSolver
from geometry.design import Array, Pad, SensorDesign

DESIGN = SensorDesign(array=Array(rows=1, cols=2), pad=Pad(kind="stiff"))


@pytest.fixture(scope="module")
def forces_n():
    """Pressures up to 1 MPa with shears of up to 0.2 of them."""
    generator = np.random.default_rng(3)
    pressure = generator.uniform(0.0, MAX_MPA, (4, 2))
    shear = generator.uniform(-0.2, 0.2, (4, 2, 2)) / np.sqrt(2) * pressure[..., None]
    return 144.0 * np.concatenate([shear, -pressure[..., None]], axis=2)


@pytest.fixture(scope="module")
def solver(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TRIPILLAR_CACHE", str(tmp_path_factory.mktemp("cache")))
        first = SampleSolver(DESIGN, by_derivatives=True)
        again = SampleSolver(DESIGN, by_derivatives=True)
    assert np.array_equal(first.light.pairs, again.light.pairs)  # as kept
    return again


def test_second_derivatives_are_those_of_the_series(forces_n):
    """By the symmetry of the energy's third derivative without a solve a pair, by the series with one."""
    array = PreloadedArray(DESIGN, COARSE)
    found, terms = second_order(array, 0.5), array.series(0.5, forces_n, 2)[0].reshape(3, 4, -1)
    away = (forces_n - array.base(0.5).system.force_n).reshape(4, -1)
    assert np.allclose(terms[0], found.at_rest)
    assert np.allclose(away @ found.first.T, terms[1], atol=1e-12)
    pairs = np.einsum("mi,mj,ijo->mo", away, away, found.second)
    # modes of a thousandth of the strongest are left out
    assert np.linalg.norm(pairs - terms[2]) < 1e-3 * np.linalg.norm(terms[2])


def test_light_samples_are_those_of_both_grids_to_a_thousandth(solver, forces_n):
    found = solver.displacements(forces_n)
    assert (found.iterations == 0).all()
    for number, forces in enumerate(forces_n):
        coarse, fine = (
            array.electrodes(state.shift, state.rotation)[0]
            for array in (solver.coarse, solver.fine)
            for state in [array.solve(0.0, forces[None], 1e-6, lambda moved: np.zeros(len(moved), dtype=bool)).state]
        )
        expected = fine + EXTRAPOLATED * (fine - coarse)
        off = np.linalg.norm(found.displacement_mm[number] - expected) / np.linalg.norm(expected)
        assert off < 1e-3
        assert off < 3 * found.error_estimate[number]


def test_a_light_sample_is_the_same_alone_and_among_others(solver, forces_n):
    many = np.tile(forces_n, (100, 1, 1))
    assert np.array_equal(
        solver.displacements(many).displacement_mm[:4], solver.displacements(forces_n).displacement_mm
    )


def test_what_is_not_light_is_solved(solver):
    heavy = np.zeros((3, 2, 3))
    heavy[0, 0, 2], heavy[1, 1, 0], heavy[2, 1, 2] = 144.0 * np.array([-1.1 * MAX_MPA, 1.1 * MAX_SHEAR_MPA, 0.1])
    assert not solver.light.takes(heavy).any()
    assert (solver.displacements(heavy[:1]).iterations > 0).all()
