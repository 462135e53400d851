"""Estimates are exact where errors fall as they assume."""

import numpy as np
import pytest

from fem.levels import SAFETY, Convergence, richardson_factor
from fem.tetrahedra.adapted import estimated_error

LIMIT, SLOPE = np.array([0.1, 0.0, -2.0]), np.array([0.2, 0.0, 0.3])


def answer(level: float, rate: float = 1.8) -> dict[str, np.ndarray]:
    return {"top": LIMIT + SLOPE * level**-rate}


def converged(n_levels: int, rate: float = 1.8, is_extrapolated: bool = False) -> Convergence:
    found = Convergence((1.0, 4.0), is_extrapolated)
    for level in range(1, n_levels + 1):
        found.add(level, answer(level, rate))
    return found


def test_a_clean_rate_is_extrapolated_to_its_limit():
    coarse, fine = 3 * 2**-3.5, 3 * 5**-3.5
    assert (coarse - fine) * richardson_factor(2, 5, rate=3.5) == pytest.approx(fine)


def test_three_levels_show_the_rate_and_the_error():
    """The estimate is the error times the one safety factor; with two levels, at the least rate, it is larger."""
    found = converged(3)
    assert found.rate == pytest.approx(1.8)
    error = np.linalg.norm(SLOPE * 3**-1.8) / np.linalg.norm(answer(3)["top"])
    assert found.estimate == pytest.approx(SAFETY * error)
    assert converged(2).estimate > SAFETY * error
    assert converged(1).estimate == np.inf
    assert np.allclose(converged(3, is_extrapolated=True).answer["top"], LIMIT)


def test_rates_are_kept_within_what_is_believed():
    """Coarse levels may show any: changes that grow, or that fall as by chance."""
    assert (converged(3, -1.0).rate, converged(3, 9.0).rate) == (1.0, 4.0)


def test_errors_that_follow_the_indicators_are_known():
    """J = J₀ + C η in every component: the estimate is the error, relative to the last answer."""
    exact, slope = np.array([[0.0, 0.0, -2.0], [0.1, 0.0, -1.0]]), np.array([[0.0, 0.0, 0.3], [0.2, 0.0, 0.0]])
    history = [(eta, exact + slope * eta) for eta in (0.4, 0.3, 0.2, 0.1)]
    assert estimated_error(history[:2]) == np.inf
    assert estimated_error(history) == pytest.approx(SAFETY * max(0.03 / 1.97, 0.02 / np.hypot(0.12, 1.0)))
    assert estimated_error([(0.0, exact)] * 4) == 0.0
