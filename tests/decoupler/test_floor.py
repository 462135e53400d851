"""The PCA floor against closed forms."""

import numpy as np
import pytest

from decoupler import component_named, pca_floor
from tests.decoupler.synthetic_sensor import labelled, sensor

FZ = component_named("fz")


def test_independent_loads_at_the_papers_width():
    """36 independent uniform forces, 2000 samples: 0.157, half of the scaled variance of 1/3."""
    floor = pca_floor(labelled(sensor(), "z", n_samples=2000, seed=0).force_n, FZ, 17)
    assert floor.scaled_mse == pytest.approx(0.157, abs=0.001)
    assert floor.variance_share == pytest.approx(0.157 * 3, abs=0.004)


def test_low_dimensional_loads_pass_a_narrow_net():
    """Forces made of three patterns have no floor from width 3 on, and one below."""
    generator = np.random.default_rng(0)
    force_n = np.zeros((50, 2, 3, 3))
    force_n[..., 2] = 100 + (generator.standard_normal((50, 3)) @ generator.standard_normal((3, 6))).reshape(50, 2, 3)
    assert pca_floor(force_n, FZ, 3).rmse_n < 1e-12
    assert pca_floor(force_n, FZ, 2).rmse_n > 0.1


def test_projection_reaches_the_bound_in_newtons():
    """Eckart and Young: the projection's error is the discarded energy; found by two routes."""
    floor = pca_floor(labelled(sensor(2, 3), "z", n_samples=30, seed=1).force_n, FZ, 4)
    assert floor.projection["fz"].rmse_n == pytest.approx(floor.rmse_n, rel=1e-10)


def test_width_beyond_the_outputs_has_no_floor():
    assert pca_floor(labelled(sensor(2, 3), "z", n_samples=30, seed=1).force_n, FZ, 9).scaled_mse == 0.0
