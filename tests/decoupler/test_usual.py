"""The χ² of a reading: quiet under every load that the model knows, loud where none explains it."""

import numpy as np
import pytest

from dataset import Samples
from dataset.measurement import measured
from decoupler.data.columns import component_named
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.usual import FALSE_ALARMS, LoadTest, UsualLoads
from decoupler.training.trainer import train
from tests.decoupler.synthetic_sensor import response, sensor

SENSOR = sensor(3, 3)
FORWARD = SensorModel.of(response(SENSOR), component_named("all"))
NOISE = 1e-3


def readings(force_n, seed=1):
    """What the sensor shows under forces (n, 27), with noise."""
    return measured(FORWARD.resistances(force_n), NOISE, None, np.random.default_rng(seed)).reshape(-1, 3, 3, 3)


def loads(n, seed):
    """Presses of 0 to 720 N on each pad, with shears within a cone of 0.2."""
    force_n = np.random.default_rng(seed).uniform(0.0, 1.0, (n, 9, 3)) * [0.14, 0.14, 1.0]
    force_n = force_n * 720.0 * np.random.default_rng(seed + 1).uniform(0.0, 1.0, (n, 1, 1))
    force_n[..., :2] *= force_n[..., 2:] / 720.0
    return force_n.reshape(n, -1)


def test_usual_loads_raise_no_alarm_and_what_no_load_explains_is_told():
    """At rest, under one pad's press and under loads as in training few in a thousand are beyond the limit.

    A broken pillar, another gain, loads 1.3 times beyond the range, tension and shear without pressure always are.
    """
    force_n = loads(400, 5)
    own = Samples(force_n=force_n.reshape(-1, 3, 3, 3), resistance_ohm=readings(force_n), design=SENSOR, noise=NOISE)
    model = train(own, "all", response=response(SENSOR))
    one_pad = np.zeros((2000, 27))
    one_pad[np.arange(2000), 3 * np.random.default_rng(0).integers(9, size=2000) + 2] = 300.0
    for force_n in (np.zeros((2000, 27)), one_pad, loads(2000, 9)):
        assert (model.chi2(readings(force_n)) > model.load_test.limit).mean() <= 3 * FALSE_ALARMS
    at_rest, broken = readings(np.zeros((200, 27))), readings(loads(200, 9))
    broken[:, 1, 1, 0] = 1e9
    beyond = [readings(np.tile(pad, (200, 9))) for pad in ([0.0, 0.0, 936.0], [0.0, 0.0, -20.0], [40.0, 0.0, 0.0])]
    for reading in (broken, 1.02 * at_rest, *beyond):
        assert (model.chi2(reading) > model.load_test.limit).all()


@pytest.mark.parametrize("common", [0.0, 0.5, 0.99])
def test_the_limit_is_the_quantile_of_correlated_errors(common):
    """Of errors that all go together χ² has one degree of freedom, of independent ones all, of a mixture some."""
    usual = UsualLoads(low_n=np.zeros(1), high_n=np.zeros(1), friction=np.zeros(1))
    correlation = (1.0 - common) * np.eye(30) + common
    test = LoadTest.by(usual, correlation, np.ones(30))
    errors = np.random.default_rng(0).standard_normal((100_000, 30)) @ np.linalg.cholesky(correlation).T
    # 100 of 100,000 ± 30 by chance, and a quarter by the approximation
    assert (test.chi2(errors) > test.limit).mean() == pytest.approx(FALSE_ALARMS, rel=0.4)
