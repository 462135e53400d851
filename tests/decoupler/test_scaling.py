"""Scaling to [-1, 1] and back."""

import numpy as np
import pytest

from decoupler.data.columns import Scaling


def test_range_becomes_minus_one_to_one_and_back():
    values = np.random.default_rng(0).uniform([-5.0, 1e3, 1e-6], [5.0, 1e6, 3e-6], (50, 3))
    scaling = Scaling.fitted(values)
    scaled = scaling.scale(values)
    np.testing.assert_allclose(scaled.min(axis=0), -1.0, rtol=1e-12)
    np.testing.assert_allclose(scaled.max(axis=0), 1.0, rtol=1e-12)
    np.testing.assert_allclose(scaling.unscale(scaled), values, rtol=1e-12)


@pytest.mark.parametrize("value", [0.0, 1e4, -3.7])
@pytest.mark.parametrize("jitter", [0.0, 1e-16])
def test_constant_column_becomes_zero_and_comes_back(value, jitter):
    """Rounding noise on a constant is not blown up to the full range."""
    values = value * (1 + jitter * np.random.default_rng(0).standard_normal((20, 1)))
    scaling = Scaling.fitted(values)
    assert not scaling.scale(values).any()
    np.testing.assert_allclose(scaling.unscale(np.full((1, 1), 5.0)), value, rtol=1e-14)
