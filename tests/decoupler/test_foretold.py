"""Some of many normal numbers by the others: by the closed form of their covariance, alone and in groups."""

import numpy as np
import pytest

from decoupler.model.foretold import Foretold

generator = np.random.default_rng(0)
S = np.cov(generator.standard_normal((7, 7)) @ generator.standard_normal((7, 200)))
MEAN = np.arange(7.0)


@pytest.mark.parametrize("which", [[2], [0, 5], [6, 1, 3]])
def test_the_conditional_mean_and_covariance_are_those_of_the_others(which):
    """S_go S_oo⁻¹ (y_o − mean_o) and S_gg − S_go S_oo⁻¹ S_og, whatever stands in the places of the group."""
    known = Foretold.by(np.linalg.inv(S), np.array(which), MEAN)
    others = np.setdiff1d(np.arange(7), which)
    by_others = np.linalg.solve(S[np.ix_(others, others)], S[np.ix_(others, which)])
    y = np.random.default_rng(1).standard_normal((5, 7))
    expected = MEAN[which] + (y - MEAN)[:, others] @ by_others
    y[:, which] = 1e3
    assert known.told(y) == pytest.approx(expected, rel=1e-9)
    left = S[np.ix_(which, which)] - by_others.T @ S[np.ix_(others, which)]
    assert known.covariance == pytest.approx(left, rel=1e-9)


def test_groups_are_foretold_as_each_alone():
    groups, K = np.array([[0, 5], [2, 3], [6, 1]]), np.linalg.inv(S)
    together = Foretold.by(K, groups)
    for number, which in enumerate(groups):
        alone = Foretold.by(K, which)
        assert together.weights[number] == pytest.approx(alone.weights, rel=1e-9, abs=1e-12)
        assert together.covariance[number] == pytest.approx(alone.covariance, rel=1e-9)
