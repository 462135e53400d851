"""Eq. 17, RMSE and % of full scale on numbers worked out by hand; the PCA floor against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from decoupler import SampleError, component_errors, component_named, force_errors, pca_floor
from tests.decoupler.synthetic_sensor import labelled, sensor

FZ = component_named("fz")


def test_errors_by_hand():
    errors = force_errors(np.array([[11.0, -17.0]]), np.array([[10.0, -20.0]]))
    assert errors.rel_err == pytest.approx((0.1 + 0.15) / 2, rel=1e-14)
    assert errors.rmse_n == pytest.approx(np.sqrt((1 + 9) / 2), rel=1e-14)
    assert errors.full_scale_pct == pytest.approx(100 * np.sqrt(5) / 20, rel=1e-14)


@pytest.mark.parametrize("smallest", [0.0, 0.05, -0.1])
def test_what_means_nothing_is_none(smallest):
    """At or below a thousandth of full scale eq. 17 says nothing; no force at all has no full scale."""
    errors = force_errors(np.array([1.0, 101.0]), np.array([smallest, 100.0]))
    assert errors.rel_err is None
    assert errors.rmse_n > 0
    errors = force_errors(np.ones(3), np.zeros(3))
    assert (errors.rel_err, errors.rmse_n, errors.full_scale_pct) == (None, 1.0, None)
    with pytest.raises(SampleError, match="give both alike"):
        force_errors(np.ones(3), np.ones((3, 1)))


def test_each_axis_is_measured_by_itself():
    """An error on Fy of every unit shows under fy and nowhere else."""
    data = labelled(sensor(2, 3), "xyz", n_samples=4, seed=0)
    errors = component_errors(data.force_n + np.array([0.0, 2.0, 0.0]), data, component_named("all"))
    assert {name: value.rmse_n for name, value in errors.items()} == pytest.approx({"fx": 0, "fy": 2, "fz": 0})


def test_a_force_that_is_no_number_is_named():
    data = labelled(sensor(2, 3), "z", n_samples=4, seed=0)
    force_n = data.force_n.copy()
    force_n[3, 1, 2, 2] = np.nan
    with pytest.raises(SampleError, match="force fz in row 1, col 2 of sample 3"):
        component_errors(force_n[..., 2:], replace(data, force_n=force_n), component_named("fz"))


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
    """Eckart and Young: the projection's error is the discarded energy; none is left beyond the number of outputs."""
    force_n = labelled(sensor(2, 3), "z", n_samples=30, seed=1).force_n
    floor = pca_floor(force_n, FZ, 4)
    assert floor.projection["fz"].rmse_n == pytest.approx(floor.rmse_n, rel=1e-10)
    assert pca_floor(force_n, FZ, 9).scaled_mse < 1e-28  # rounding of numbers of size 1, squared
