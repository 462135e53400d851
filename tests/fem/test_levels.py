"""Estimates are exact where errors fall as they assume."""

import numpy as np
import pytest

from fem.levels import CHANCE, DRIFT, SAFETY, Convergence, limits

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


def test_values_whose_errors_follow_the_indicators_are_extrapolated():
    """J = J₀ + C η in every component is J₀, whatever meshes show of it, and what does not move stays."""
    exact, slope = np.array([[0.0, 0.0, -2.0], [0.1, 0.0, -1.0]]), np.array([[0.0, 0.0, 0.3], [0.2, 0.0, 0.0]])
    eta = np.array([0.4, 0.3, 0.1])[:, None, None] * np.ones((2, 3))
    found, deviation = limits(exact + slope * eta, eta)
    assert found == pytest.approx(exact, abs=1e-12)
    assert (deviation < 0.02).all()  # of 0.03
    unmoved, sure = limits(np.array([exact] * 3), 0.0 * eta)
    assert (unmoved == exact).all()
    assert (sure == 0.0).all()


def test_limits_are_within_two_deviations_where_the_ratio_is_off_by_chance():
    """Of 3 to 6 meshes, ratios of error and η that are random by `CHANCE` and drift by `DRIFT`: 95 % of 1000 series."""
    generator = np.random.default_rng(0)
    for k in (3, 6):
        chance = CHANCE * generator.standard_normal((k, 1000, 3))
        drift = np.cumsum(DRIFT * generator.standard_normal((k, 1000, 3)), axis=0)
        eta = np.broadcast_to(0.5 ** np.arange(k)[:, None, None], chance.shape)
        found, deviation = limits(1 - 0.1 * eta * (1 + chance + drift), eta)
        assert 0.93 < (np.linalg.norm(found - 1, axis=1) < 2 * deviation).mean() < 1.0
