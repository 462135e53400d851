"""What a converter cannot tell from rest is taken for rest, and nothing else is."""

from dataclasses import replace

import numpy as np
import pytest

from dataset import measured
from decoupler import NetworkConfig, TrainingConfig, train
from decoupler.data.columns import Resting
from tests.decoupler.synthetic_sensor import labelled, response, sensor

SENSOR = sensor(2, 3)
RNG = np.random.default_rng(0)
EXACT = labelled(SENSOR, "z", n_samples=300, seed=0)
DATA = replace(EXACT, resistance_ohm=measured(EXACT.resistance_ohm, 0.0, 12, RNG), bits=12)


@pytest.fixture(scope="module")
def model():
    return train(DATA, "fz", NetworkConfig(hidden=4, feature="inverse"), TrainingConfig(), response=response(SENSOR))


def test_a_sensor_at_rest_reads_nothing_though_each_pillar_is_half_a_step_off(model):
    """10 kΩ before 10 kΩ is the worst place, between two counts. The calibration of 300 samples leaves a fifth."""
    rest_ohm = np.full((1, 2, 3, 3), 1e4)
    read_ohm = measured(rest_ohm, 0.0, 12, RNG)
    assert np.abs(read_ohm - rest_ohm).min() > 4.8
    assert np.abs(model.forces(read_ohm)).max() < 0.2 * np.abs(replace(model, resting=None).forces(read_ohm)).max()


def test_only_where_most_of_a_scan_may_be_at_rest():
    resting = Resting.read_with(np.full(5, 1e4), 12)
    readings = 1e4 + np.array([[4.0, -4.0, 4.0, 500.0, 7.0], [4.0, -4.0, 500.0, 500.0, 7.0]])
    np.testing.assert_array_equal(resting.settled(readings)[0], [1e4, 1e4, 1e4, 10500.0, 10007.0])
    np.testing.assert_array_equal(resting.settled(readings)[1], readings[1])
    assert Resting.read_with(np.full(5, 1e4), None) is None
