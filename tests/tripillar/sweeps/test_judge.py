"""Metrics against closed forms: an array of springs whose response is known."""

from dataclasses import replace

import numpy as np
import pytest

from dataset.measurement import ReadingError
from decoupler.data.columns import component_named
from decoupler.inverse.sensor_model import SensorModel
from fem.array.response import ArrayResponse
from geometry.design import Array, Electrics, SensorDesign, Unit
from geometry.layout import LAYOUTS, Layout
from tripillar.sweeps import judge

C = 1e-3  #: compliance of the springs [mm/N]
FALL = 0.3  #: of the influence, each pitch
SPRINGS = SensorDesign(array=Array(rows=2, cols=5))
UPRIGHT = LAYOUTS["upright-four"]


def springs(fall=FALL, compliance=C, design=SPRINGS):
    """1 N on a pad moves the electrodes under it by C along its axis, those n pitches away by C·fall^n."""
    shape, n_upper = (design.array.rows, design.array.cols), len(design.unit.layout.upper)
    rows, cols = np.indices(shape).reshape(2, -1)
    apart = np.abs(rows[:, None] - rows) + np.abs(cols[:, None] - cols)
    influence = np.einsum("uv,e,ab->ueavb", compliance * float(fall) ** apart, np.ones(n_upper), np.eye(3))
    influence = influence.reshape(*shape, n_upper, 3, *shape, 3)
    return ArrayResponse(design=design, influence_mm_per_n=influence, residual=0.0, unknowns=0, seconds={})


def forward(response):
    return SensorModel.of(response, component_named("all"))


def test_sensitivity_and_crosstalk_of_springs():
    """R ∝ l²: dR/R = 2 dl/l. The z pillar shortens by C, the oblique one by C·s/l with l² = s² + h², s = h.

    Crosstalk is over the loaded unit's own: that some pads press harder than others makes no difference.
    """
    G = judge.relative_slopes(forward(springs()))
    own = judge.self_sensitivities(G, SPRINGS)
    assert own == pytest.approx(np.tile([2 * C / 10, C / 10, C / 10], (10, 1)), rel=1e-12)
    found = judge.crosstalk(G * np.repeat(np.arange(1.0, 11.0), 3), SPRINGS)
    assert found == pytest.approx(np.tile([FALL, FALL**2, FALL**3], (3, 1)), rel=1e-12)


def test_noise_limited_error_of_alone_standing_springs():
    """z: σ/|Gzz|. The x pillar shortens by C/√2 under Fz as under Fx, so Fx takes up the error of both readings."""
    sigma, z, x = 1e-3, 2 * C / 10, C / 10
    expected = [np.hypot(sigma / x, sigma / z), np.hypot(sigma / x, sigma / z), sigma / z]
    errors = judge.noise_limited_errors(forward(springs(fall=0)), np.zeros((1, 30)), ReadingError(noise=sigma), (2, 5))
    assert errors == pytest.approx(expected, rel=1e-12)


def test_the_range_of_springs_ends_where_a_pillar_is_at_the_cap():
    """On one pad: C·A·p = cap·h. On all pads the middle ones are pressed by what their neighbours add."""
    one, everywhere = judge.largest_pressures(springs(), cap=0.3)
    assert one == pytest.approx(0.3 * 10 / (C * 144), rel=1e-12)
    most = (1 + FALL) * (1 + 2 * FALL + 2 * FALL**2)  # the other row; two units on either side
    assert everywhere == pytest.approx(one / most, rel=1e-12)
    force_n = judge.loads_at_cap(springs(), 0.3, n=8, seed=0)[0].reshape(8, -1)
    lengths = forward(springs()).lengths(force_n)
    assert np.abs(lengths / forward(springs()).lengths(np.zeros((1, 30))) - 1).max() == pytest.approx(0.3, rel=1e-9)
    assert force_n.reshape(8, -1, 3)[..., 2].min() > 0  # compression


def test_an_array_that_differs_in_scale_alone_has_the_same_shares():
    """A softer spring: error, range and sensitivity scale; crosstalk, condition and error in % of range do not."""
    stiff, soft = (judge.metrics_of(springs(compliance=c), noise=1e-3, bits=None, cap=0.3) for c in (C, 2 * C))
    for name in ("error_n", "error_x_n", "range_n", "pressure_all_mpa"):
        assert soft[name] == pytest.approx(stiff[name] / 2, rel=1e-9)
    for name in ("error_pct", "crosstalk_1", "crosstalk_x_2", "condition"):
        assert soft[name] == pytest.approx(stiff[name], rel=1e-9)
    assert soft["sensitivity_z_pct_per_n"] == pytest.approx(2 * stiff["sensitivity_z_pct_per_n"], rel=1e-9)


def test_what_a_design_cannot_tell_is_a_reason():
    """One upright pillar a unit tells pressure alone.

    Five columns in two rows have no third neighbour along y, but along x.
    No contact on bare rubber is solved with conduction.
    """
    lone = replace(SPRINGS, unit=Unit(layout=Layout(UPRIGHT.upper[:1], UPRIGHT.lower[:1], UPRIGHT.pillars[:1])))
    found = judge.metrics_of(springs(design=lone), noise=1e-3, bits=None, cap=0.3)
    assert found["error_n"] == found["error_z_n"] > 0
    assert "do not tell forces along x and y" in found["error_x_n"] == found["error_y_n"]
    pair = replace(SPRINGS, array=Array(rows=1, cols=2))
    assert judge.metrics_of(springs(design=pair), 1e-3, None, 0.3)["crosstalk_z_2"] == "no unit is 2 × pitch away"
    conducting = replace(SPRINGS, electrics=Electrics(model="conduction"))
    untold = judge.known(("net", "place"), lambda: judge.touch_limits(conducting, 20.0, ReadingError(noise=1e-3)))
    assert all("conduction under contact takes plates" in reason for reason in untold.values())


def test_what_a_design_takes_to_be_read():
    """The paper's array: 108 channels on 24 wires, 176 scans a second."""
    found = judge.made_of(SensorDesign())
    assert (found["channels"], found["wires"], found["rate_hz"]) == (108, 24, 176)
    assert (found["area_cm2"], found["volume_cm3"]) == (81, 81)
    assert found["conductive_cm3"] == pytest.approx(36 * 141.823 / 1000, rel=1e-5)
    assert judge.made_of(SensorDesign(unit=Unit(layout=UPRIGHT)))["demould_deg"] == "no pillar leans"
