"""Faults of pillars and wires are named from a window of scans; sound sensors raise no alarm."""

import numpy as np
import pytest

from dataset import Samples
from dataset.measurement import measured
from decoupler.data.columns import component_named
from decoupler.evaluation.faults import WINDOW, FaultTest
from decoupler.inverse.sensor_model import SensorModel
from decoupler.training.trainer import train
from tests.decoupler.synthetic_sensor import response, sensor

SENSOR = sensor(3, 3)
FORWARD = SensorModel.of(response(SENSOR), component_named("all"))
NOISE = 1e-3
SMOOTH = np.exp(-0.5 * np.subtract.outer(np.arange(3), np.arange(3)) ** 2 / 1.5**2)  # indenters as wide as two pads


def loads(n, seed):
    """Presses of round indenters on all pads of a 3 × 3 array, each with its drag, (n, 27) [N]."""
    generator = np.random.default_rng(seed)
    strength = generator.uniform(0.0, 1.0, (n, 3, 3)) ** 2
    pressed = np.einsum("ki,nij,lj->nkl", SMOOTH, strength, SMOOTH) * 200.0
    drag = generator.uniform(-0.2, 0.2, (n, 1, 1, 2))
    return np.concatenate([pressed[..., None] * drag, pressed[..., None]], axis=-1).reshape(n, -1)


def readings(force_n, seed=1):
    """What the sensor shows under forces (n, 27), with noise and a converter."""
    ohms = FORWARD.resistances(force_n).reshape(-1, 3, 3, 3)
    return measured(ohms, NOISE, 12, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def expected():
    force_n = loads(400, 5)
    own = Samples(
        force_n=force_n.reshape(-1, 3, 3, 3), resistance_ohm=readings(force_n), design=SENSOR, noise=NOISE, bits=12
    )
    return FaultTest.of(train(own, "all", response=response(SENSOR)))


def stuck(ohms):
    ohms[:, 1, 2, 0] = ohms[0, 1, 2, 0]


def stuck_wire(ohms):
    ohms[:, 2, :, [0, 1]] = ohms[:1, 2, :, [0, 1]].mean()


def swapped(ohms):
    ohms[:, [0, 1]] = ohms[:, [1, 0]]


def swapped_wires(ohms):
    ohms[:, :, [0, 1], 1] = ohms[:, :, [1, 0], 1]


def opened(ohms):
    ohms[:, 0, 1, 1] = np.inf


def opened_wire(ohms):
    ohms[:, 1, :, 2] = 1e9


def no_number(ohms):
    ohms[::2, 2, 2, 0] = np.nan
    ohms[1::2, 2, 2, 0] = 1e9


FAULTS = {
    stuck: "pillar z of row 1, col 2 stuck",
    stuck_wire: "row wire 4 stuck",
    swapped: "rows 0 and 1 swapped",
    swapped_wires: "column wires 1 and 3 swapped",
    opened: "pillar x of row 0, col 1 open",
    opened_wire: "row wire 3 open",
    no_number: "pillar z of row 2, col 2 open",
}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_each_fault_is_named_by_pillar_or_wire(fault, expected):
    for seed in range(2):
        ohms = readings(loads(WINDOW, 100 + seed), seed)
        fault(ohms)
        assert [str(found) for found in expected.named(ohms)] == [FAULTS[fault]]


def test_sound_sensors_raise_no_alarm(expected):
    """Under usual loads, under loads held still, at rest, under one press that grows and under light touches.

    Nor a pillar that reads the same at rest, where nothing says that it should move, nor one of another gain, since
    forces on its pad move it as well.
    """
    touch, rest = np.zeros((2, WINDOW, 27))
    touch[:, 14] = np.linspace(0.0, 300.0, WINDOW)
    light = np.random.default_rng(3).uniform(0.0, 5.0, (WINDOW, 27))
    kinds = [touch, light, rest]
    for seed in range(12):
        usual = loads(WINDOW, 1000 + seed)
        for force_n in (usual, np.repeat(usual[:4], WINDOW // 4, axis=0), kinds[seed % 3]):
            assert expected.named(readings(force_n, seed)) == ()
    still, other = readings(rest), readings(loads(WINDOW, 100))
    stuck(still)
    other[:, 1, 1, 0] *= 1.02
    assert expected.named(still) == expected.named(other) == ()
