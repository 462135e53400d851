"""Eq. 17, RMSE and % of full scale on numbers worked out by hand; the PCA floor against closed forms."""

import numpy as np
import pytest

from decoupler import SampleError, component_errors, component_named, force_errors, pca_floor
from tests.decoupler.synthetic_sensor import labelled, sensor

FZ = component_named("fz")


def test_errors_by_hand_and_what_means_nothing_is_none():
    """Below a thousandth of full scale eq. 17 says nothing; no force at all has no full scale."""
    errors = force_errors(np.array([[11.0, -17.0]]), np.array([[10.0, -20.0]]))
    assert errors.rel_err == pytest.approx((0.1 + 0.15) / 2, rel=1e-14)
    assert errors.rmse_n == pytest.approx(np.sqrt((1 + 9) / 2), rel=1e-14)
    assert errors.full_scale_pct == pytest.approx(100 * np.sqrt(5) / 20, rel=1e-14)
    for smallest in (0.0, 0.05, -0.1):
        assert force_errors(np.array([1.0, 101.0]), np.array([smallest, 100.0])).rel_err is None
    errors = force_errors(np.ones(3), np.zeros(3))
    assert (errors.rel_err, errors.rmse_n, errors.full_scale_pct) == (None, 1.0, None)
    with pytest.raises(SampleError, match="give both alike"):
        force_errors(np.ones(3), np.ones((3, 1)))


def test_each_axis_is_measured_by_itself():
    """An error on Fy of every unit shows under fy and nowhere else."""
    data = labelled(sensor(2, 3), "xyz", n_samples=4, seed=0)
    errors = component_errors(data.force_n + np.array([0.0, 2.0, 0.0]), data, component_named("all"))
    assert {name: value.rmse_n for name, value in errors.items()} == pytest.approx({"fx": 0, "fy": 2, "fz": 0})


def test_a_projection_leaves_what_a_narrow_net_cannot_pass():
    """36 uniform forces through 17 nodes leave 0.157, half of the variance of 1/3; those of three patterns nothing."""
    assert pca_floor(labelled(sensor(), "z", 2000, 0).force_n, FZ, 17).scaled_mse == pytest.approx(0.157, abs=0.001)
    generator = np.random.default_rng(0)
    force_n = np.zeros((50, 2, 3, 3))
    force_n[..., 2] = 100 + (generator.standard_normal((50, 3)) @ generator.standard_normal((3, 6))).reshape(50, 2, 3)
    assert pca_floor(force_n, FZ, 3).projection["fz"].rmse_n < 1e-12
    discarded = np.linalg.svd((force_n - force_n.mean(axis=0)).reshape(50, -1), compute_uv=False)[2]
    assert pca_floor(force_n, FZ, 2).projection["fz"].rmse_n == pytest.approx(discarded / np.sqrt(300), rel=1e-9)
