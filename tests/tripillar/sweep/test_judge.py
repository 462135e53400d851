"""Metrics against closed forms: an array of springs whose response is known."""

import numpy as np
import pytest

from decoupler.data.columns import component_named
from decoupler.inverse.sensor_model import SensorModel
from fem.array.response import ArrayResponse
from geometry.design import Array, SensorDesign
from tripillar.sweep.judge import (
    crosstalk,
    largest_pressures,
    loads_at_cap,
    metrics_of,
    noise_limited_errors,
    relative_slopes,
    self_sensitivities,
)

C = 1e-3  #: compliance of the springs [mm/N]
FALL = 0.3  #: of the influence, each pitch
SPRINGS = SensorDesign(array=Array(rows=2, cols=5))


def springs(design=SPRINGS, fall=FALL):
    """1 N on a pad moves the electrodes under it by C along its axis, those n pitches away by C·fall^n."""
    rows, cols = np.indices((design.array.rows, design.array.cols)).reshape(2, -1)
    apart = np.abs(rows[:, None] - rows) + np.abs(cols[:, None] - cols)
    influence = np.einsum("uv,e,ab->ueavb", C * float(fall) ** apart, np.ones(2), np.eye(3))
    shape = (design.array.rows, design.array.cols)
    return ArrayResponse(
        design=design,
        influence_mm_per_n=influence.reshape(*shape, 2, 3, *shape, 3),
        residual=0.0,
        unknowns=0,
        seconds={},
    )


def slopes(response):
    return relative_slopes(SensorModel.of(response, component_named("all")))


def test_sensitivity_of_a_spring():
    """R ∝ l²: dR/R = 2 dl/l. The z pillar shortens by C, the oblique one by C·s/l with l² = s² + h², s = h."""
    own = self_sensitivities(slopes(springs()), SPRINGS.n_units)
    assert own == pytest.approx(np.tile([2 * C / 10, C / 10, C / 10], (10, 1)), rel=1e-12)


def test_crosstalk_is_that_of_the_neighbour_along_rows_and_columns():
    """Over the loaded unit's own: that some pads press harder than others makes no difference."""
    G = slopes(springs()) * np.repeat(np.arange(1.0, 11.0), 3)
    found = crosstalk(G, SPRINGS)
    assert found == pytest.approx(np.tile([FALL, FALL**2, FALL**3], (3, 1)), rel=1e-12)
    small = SensorDesign(array=Array(rows=2, cols=1))
    assert np.isnan(crosstalk(slopes(springs(small)), small)[:, 1:]).all()


def test_noise_limited_error_of_alone_standing_springs():
    """z: σ/|Gzz|. The x pillar shortens by C/√2 under Fz as under Fx, so Fx takes up the error of both readings."""
    forward = SensorModel.of(springs(fall=0), component_named("all"))
    sigma, z, x = 1e-3, 2 * C / 10, C / 10
    expected = [np.hypot(sigma / x, sigma / z), np.hypot(sigma / x, sigma / z), sigma / z]
    errors = noise_limited_errors(forward, np.zeros((1, forward.n_forces)), sigma, None)
    assert errors == pytest.approx(expected, rel=1e-12)


def test_the_largest_pressure_of_a_spring_brings_its_upright_pillar_to_the_cap():
    """On one pad: C·A·p = cap·h. On all pads the middle ones are pressed by what their neighbours add."""
    one, everywhere = largest_pressures(springs(), cap=0.3)
    assert one == pytest.approx(0.3 * 10 / (C * 144), rel=1e-12)
    most = (1 + FALL) * (1 + 2 * FALL + 2 * FALL**2)  # the other row; two units on either side
    assert everywhere == pytest.approx(one / most, rel=1e-12)


def test_loads_end_where_the_range_does():
    response = springs()
    forward = SensorModel.of(response, component_named("all"))
    force_n = loads_at_cap(response, 0.3, n=8, seed=0)[0].reshape(8, -1)
    lengths = forward.lengths(force_n)
    assert np.abs(lengths / forward.lengths(np.zeros((1, 30))) - 1).max() == pytest.approx(0.3, rel=1e-9)
    assert force_n.reshape(8, -1, 3)[..., 2].min() > 0  # compression


def test_an_array_that_differs_in_scale_alone_has_the_same_shares():
    """A softer spring: error, range and sensitivity scale; crosstalk, condition and error in % of range do not."""
    stiff = metrics_of(springs(), noise=1e-3, bits=None, cap=0.3)
    response = springs()
    soft = ArrayResponse(**{**vars(response), "influence_mm_per_n": 2 * response.influence_mm_per_n})
    soft = metrics_of(soft, noise=1e-3, bits=None, cap=0.3)
    for name in ("error_n", "error_x_n", "range_n", "pressure_all_mpa"):
        assert soft[name] == pytest.approx(stiff[name] / 2, rel=1e-9)
    for name in ("error_pct", "crosstalk_1", "crosstalk_x_2", "condition", "area_cm2"):
        assert soft[name] == pytest.approx(stiff[name], rel=1e-9)
    assert soft["sensitivity_z_pct_per_n"] == pytest.approx(2 * stiff["sensitivity_z_pct_per_n"], rel=1e-9)
