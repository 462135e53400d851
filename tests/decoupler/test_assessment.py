"""An assessment: the model's errors beside limit and baselines, each as its own module gives it."""

import numpy as np
import pytest

from decoupler import (
    LeastSquares,
    NetworkConfig,
    TrainingConfig,
    assess,
    component_errors,
    component_named,
    evaluate,
    train,
)
from decoupler.data.columns import Columns, force_columns
from decoupler.evaluation.assessment import as_plain
from decoupler.inverse.limits import cramer_rao
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.baseline import hooke_forces
from tests.decoupler.synthetic_sensor import labelled, noisy, response, sensor, split

SENSOR = sensor(2, 3)
RESPONSE = response(SENSOR)
NOISE = 2e-3
ALL = component_named("all")
TRAIN, TEST = split(noisy(labelled(SENSOR, "xyz", n_samples=700, seed=0), NOISE), 600)


def test_holds_what_its_parts_say():
    """Errors within 15 % of the limit are what the project promises; the plain form starts with the contract's."""
    model = train(TRAIN, "all", NetworkConfig(hidden=6, feature="inverse"), TrainingConfig(), response=RESPONSE)
    found = assess(model, TEST, RESPONSE)
    least = component_errors(LeastSquares.fitted(Columns.of(TRAIN, ALL)).forces(TEST.resistance_ohm), TEST, ALL)
    hooke = component_errors(hooke_forces(TEST.resistance_ohm, SENSOR, ALL), TEST, ALL)
    bound = cramer_rao(SensorModel.of(RESPONSE, ALL), force_columns(TEST.force_n, ALL), NOISE, None)
    missed = np.abs(model.forces(TEST.resistance_ohm) - TEST.force_n)
    within = [(missed <= width).mean(axis=(0, 1, 2)) for width in model.half_widths(TEST.resistance_ohm)]
    for axis, name in enumerate(("fx", "fy", "fz")):
        one = found[name]
        assert one.coverage == pytest.approx([share[axis] for share in within])
        assert one.errors == evaluate(model, TEST)[name]
        assert one.baselines == {"eq. 8, each pillar alone": hooke[name], "least squares on √R": least[name]}
        limit = np.sqrt(np.mean(bound.reshape(100, 6, 3)[..., axis] ** 2))
        assert one.limits.cramer_rao_n == pytest.approx(limit, rel=1e-12)
        assert one.ratio == pytest.approx(one.errors.rmse_n / limit)
        assert one.ratio < 1.15
        assert one.limits.bayes_n < limit
    plain = as_plain(assess(model, TEST, None))["fz"]
    assert list(plain)[:3] == ["rel_err", "rmse_n", "full_scale_pct"]
    assert plain["limits"] is None


def test_no_limit_where_other_forces_act():
    """A net for Fz alone on mixed loads: the bound of Fz alone would be no bound."""
    model = train(TRAIN, "fz", NetworkConfig(hidden=4), TrainingConfig(max_iterations=3))
    assert assess(model, TEST, RESPONSE)["fz"].limits is None
