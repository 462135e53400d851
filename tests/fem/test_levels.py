"""Estimates are exact where errors fall as they assume."""

import numpy as np
import pytest

from fem.levels import SAFETY, richardson_factor, to_tolerance
from fem.tetrahedra.adapted import errors_by_indicators

LIMIT, SLOPE = np.array([0.1, 0.0, -2.0]), np.array([0.2, 0.0, 0.3])


def answer(level: float, rate: float = 1.8) -> dict[str, np.ndarray]:
    return {"top": LIMIT + SLOPE * level**-rate}


def test_a_clean_rate_is_extrapolated_to_its_limit():
    coarse, fine = 3 * 2**-3.5, 3 * 5**-3.5
    assert (coarse - fine) * richardson_factor(2, 5, rate=3.5) == pytest.approx(fine)


def test_three_levels_show_the_rate_and_the_error():
    """The estimate is the error times the one safety factor; with two levels, at the least rate, it is larger."""
    found = to_tolerance(answer, (1, 2, 3), 0.0, (1.0, 4.0))
    assert found.rate == pytest.approx(1.8)
    error = np.linalg.norm(SLOPE * 3**-1.8) / np.linalg.norm(answer(3)["top"])
    assert found.estimate == pytest.approx(SAFETY * error)
    assert to_tolerance(answer, (1, 2), 0.0, (1.0, 4.0)).estimate > SAFETY * error
    assert to_tolerance(answer, (1,), 0.0, (1.0, 4.0)).estimate == np.inf
    limit = to_tolerance(answer, (1, 2, 3), 0.0, (1.0, 4.0), is_extrapolated=True)
    assert np.allclose(limit.answer["top"], LIMIT)


def test_refinement_ends_where_the_tolerance_or_a_limit_is_met():
    asked = []

    def limited(level: float) -> dict[str, np.ndarray] | None:
        asked.append(level)
        return answer(level) if level < 5 else None

    assert to_tolerance(limited, (1, 2, 3, 4), 0.25, (1.0, 4.0)).levels == [1, 2]
    assert to_tolerance(limited, (1, 2, 3, 4, 5, 6), 0.0, (1.0, 4.0)).levels == [1, 2, 3, 4]
    assert asked[-1] == 5


def test_rates_are_kept_within_what_is_believed():
    """Coarse levels may show any: changes that grow, or that fall as by chance."""
    grows = to_tolerance(lambda level: answer(level, -1.0), (1, 2, 3), 0.0, (1.0, 4.0))
    falls = to_tolerance(lambda level: answer(level, 9.0), (1, 2, 3), 0.0, (1.0, 4.0))
    assert (grows.rate, falls.rate) == (1.0, 4.0)


def test_errors_that_follow_the_indicators_are_known():
    """J = J₀ + C η in every component: the estimate is the error, relative to the last answer."""
    exact, slope = np.array([[0.0, 0.0, -2.0], [0.1, 0.0, -1.0]]), np.array([[0.0, 0.0, 0.3], [0.2, 0.0, 0.0]])
    history = [(eta, exact + slope * eta) for eta in (0.4, 0.3, 0.2, 0.1)]
    assert errors_by_indicators(["top", "middle"], history[:2]) == {"top": np.inf, "middle": np.inf}
    errors = errors_by_indicators(["top", "middle"], history)
    assert errors["top"] == pytest.approx(SAFETY * 0.03 / 1.97)
    assert errors["middle"] == pytest.approx(SAFETY * 0.02 / np.hypot(0.12, 1.0))
