"""Estimates are exact where errors fall as they assume."""

import numpy as np
import pytest

from fem.discretization.richardson import errors_by_indicators, richardson_factor


def test_a_clean_rate_is_extrapolated_to_its_limit():
    coarse, fine = 3 * 2**-3.5, 3 * 5**-3.5
    assert (coarse - fine) * richardson_factor(2, 5, rate=3.5) == pytest.approx(fine)


def test_errors_that_follow_the_indicators_are_known():
    """J = J₀ + C η in every component: the estimate is the error, relative to the last answer."""
    exact, slope = np.array([[0.0, 0.0, -2.0], [0.1, 0.0, -1.0]]), np.array([[0.0, 0.0, 0.3], [0.2, 0.0, 0.0]])
    history = [(eta, exact + slope * eta) for eta in (0.4, 0.3, 0.2, 0.1)]
    assert errors_by_indicators(["top", "middle"], history[:3]) == {"top": np.inf, "middle": np.inf}
    errors = errors_by_indicators(["top", "middle"], history)
    assert errors["top"] == pytest.approx(0.03 / 1.97)
    assert errors["middle"] == pytest.approx(0.02 / np.hypot(0.12, 1.0))
