"""Which load to measure next: the arithmetic of Bayes, and what it prefers."""

from dataclasses import replace

import numpy as np
import pytest

from dataset.measurement import ReadingError
from decoupler.data.columns import component_named
from decoupler.twin.expectation import Expectation
from decoupler.twin.next_load import KITCHEN, Knowledge, as_columns, choose, loads_at_hand
from tests.decoupler.synthetic_sensor import response, sensor, softness

DESIGN = sensor(3, 3)
EVERYTHING = component_named("all")
EXPECTED = Expectation.of(response(DESIGN), softness(DESIGN), EVERYTHING)
BEFORE = Knowledge.before(EXPECTED, EXPECTED.mean(), ReadingError(noise=1e-3, bits=12))
LOADS = {load.name: as_columns(load, EVERYTHING) for load in loads_at_hand(KITCHEN, DESIGN)}
USUAL_N = np.random.default_rng(0).uniform(0.0, 1.0, (30, 27)) * np.tile([140.0, 140.0, 700.0], 9)


def test_pairs_one_by_one_are_pairs_at_once():
    """The covariance after two pairs is (1 + Σ Hᵀ Σ⁻¹ H)⁻¹, whatever their order."""
    loads = [LOADS["15kg on 0 1"][0], LOADS["string 3kg along x, 15kg on 1 0"][0]]
    precision = np.eye(len(BEFORE.covariance))
    for force_n in loads:
        H, _, deviation = BEFORE.derivatives(force_n)
        precision += (H / deviation[:, None] ** 2).T @ H
    exact = np.zeros((0, 27))
    after = BEFORE.after(loads[1], exact).after(loads[0], exact)
    assert after.covariance == pytest.approx(np.linalg.inv(precision), rel=1e-8, abs=1e-8)


def test_derivatives_are_those_of_the_readings():
    """By the rubber's modulus, the resistivity, a gain, an offset and a force, against differences."""
    force_n, state, step = USUAL_N[0], BEFORE.state, 1e-5
    by_unknown, by_force, _ = BEFORE.derivatives(force_n)
    own, shared = np.zeros((2, *state.own.shape)), np.zeros((2, len(state.shared)))
    own[[0, 1], 0, [0, 1]] = shared[[0, 1], [0, 1]] = step
    moved = [replace(state, shared=each) for each in shared] + [replace(state, own=each) for each in own]
    pressed = [(other, force_n) for other in moved] + [(state, force_n + step * np.eye(27)[0])]
    here, *there = (EXPECTED.sensor(each).resistances(given[None])[0] for each, given in [(state, force_n), *pressed])
    derivatives = [*by_unknown[:, [0, 1, 2, 29]].T, by_force[:, 0]]
    for derivative, ohms, error in zip(derivatives, there, [1e-2] * 4 + [1e-4], strict=True):
        assert derivative == pytest.approx((ohms - here) / step, rel=1e-3, abs=error)


def test_what_is_not_known_of_a_load_tells_nothing_and_chosen_loads_tell_more_than_random_ones():
    """Five chosen ones leave a smaller expected error than any of ten random fives; none is chosen twice."""
    T, (force_n, unknown_n) = BEFORE.error_matrix(USUAL_N), LOADS["60kg on 1 1"]
    errors = [np.sum(T * BEFORE.after(force_n, times * unknown_n).covariance) for times in (0.0, 1.0, 100.0)]
    assert errors[0] < errors[1] < errors[2] < np.sum(T * BEFORE.covariance)
    candidates = list(LOADS.values())
    numbers, errors = choose(BEFORE, candidates, USUAL_N, 5)
    assert len(set(numbers)) == 5
    assert errors == sorted(errors, reverse=True)
    for seed in range(10):
        known = BEFORE
        for number in np.random.default_rng(seed).choice(len(candidates), 5, replace=False):
            known = known.after(*candidates[number])
        assert np.sqrt(np.sum(T * known.covariance)) > errors[-1]
