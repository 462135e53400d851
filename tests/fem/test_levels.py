"""Estimates are exact where errors fall as they assume."""

import numpy as np
import pytest

from fem.levels import SAFETY, Convergence
from fem.scene.tetrahedra import estimated_error

LIMIT, SLOPE = np.array([0.1, 0.0, -2.0]), np.array([0.2, 0.0, 0.3])


def converged(n_levels: int, rate: float = 1.8, is_extrapolated: bool = False) -> Convergence:
    found = Convergence((1.0, 4.0), is_extrapolated)
    for level in range(1, n_levels + 1):
        found.add(level, {"top": LIMIT + SLOPE * level**-rate})
    return found


def test_three_levels_show_the_rate_and_the_error_and_two_are_doubted():
    found, error = converged(3), SLOPE * 3**-1.8
    assert found.rate == pytest.approx(1.8)
    assert found.estimate == pytest.approx(SAFETY * np.linalg.norm(error) / np.linalg.norm(LIMIT + error))
    assert converged(1).estimate == np.inf > converged(2).estimate > found.estimate
    assert np.allclose(converged(3, is_extrapolated=True).answer["top"], LIMIT)
    assert (converged(3, -1.0).rate, converged(3, 9.0).rate) == (1.0, 4.0)  # no rate beyond is believed


def test_errors_that_follow_the_indicators_are_known():
    """J = J₀ + C η in every component: the estimate is the error, relative to the last answer."""
    exact, slope = np.array([[0.0, 0.0, -2.0], [0.1, 0.0, -1.0]]), np.array([[0.0, 0.0, 0.3], [0.2, 0.0, 0.0]])
    history = [(eta, exact + slope * eta) for eta in (0.4, 0.3, 0.2, 0.1)]
    assert estimated_error(history[:2]) == np.inf
    assert estimated_error(history) == pytest.approx(SAFETY * max(0.03 / 1.97, 0.02 / np.hypot(0.12, 1.0)))
    assert estimated_error([(0.0, exact)] * 4) == 0.0
