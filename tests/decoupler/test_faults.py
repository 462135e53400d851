"""Faults of pillars and wires are named, loads that the model does not know are loud; sound sensors raise no alarm."""

from functools import partial

import numpy as np
import pytest

from dataset import Samples
from dataset.measurement import measured
from decoupler.evaluation.faults import WINDOW, FaultTest
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.foretold import Foretold
from decoupler.model.settings import NetworkConfig
from decoupler.model.usual import FALSE_ALARMS, LoadTest, UsualLoads
from decoupler.training.trainer import train
from tests.decoupler.synthetic_sensor import ALL, response, sensor

SENSOR = sensor(3, 3)
FORWARD = SensorModel.of(response(SENSOR), ALL)
NOISE = 1e-3
SMOOTH = np.exp(-0.5 * np.subtract.outer(np.arange(3), np.arange(3)) ** 2 / 1.5**2)  # indenters as wide as two pads


def presses(n, seed):
    """Presses of round indenters on all pads of a 3 × 3 array, each with its drag, (n, 27) [N]."""
    generator = np.random.default_rng(seed)
    strength = generator.uniform(0.0, 1.0, (n, 3, 3)) ** 2
    pressed = np.einsum("ki,nij,lj->nkl", SMOOTH, strength, SMOOTH) * 200.0
    drag = generator.uniform(-0.2, 0.2, (n, 1, 1, 2))
    return np.concatenate([pressed[..., None] * drag, pressed[..., None]], axis=-1).reshape(n, -1)


def loads(n, seed):
    """Presses of 0 to 720 N on each pad, with shears within a cone of 0.2."""
    force_n = np.random.default_rng(seed).uniform(0.0, 1.0, (n, 9, 3)) * [0.14, 0.14, 1.0]
    force_n = force_n * 720.0 * np.random.default_rng(seed + 1).uniform(0.0, 1.0, (n, 1, 1))
    force_n[..., :2] *= force_n[..., 2:] / 720.0
    return force_n.reshape(n, -1)


def readings(force_n, seed=1, bits=12, forward=FORWARD):
    """What the sensor shows under forces (n, 27), with noise and a converter."""
    ohms = forward.resistances(force_n).reshape(len(force_n), 3, 3, -1)
    return measured(ohms, NOISE, bits, np.random.default_rng(seed))


def trained(force_n, bits=12):
    own = {"force_n": force_n.reshape(-1, 3, 3, 3), "resistance_ohm": readings(force_n, bits=bits)}
    return train(Samples(**own, design=SENSOR, noise=NOISE, bits=bits), "all", response=response(SENSOR))


@pytest.fixture(scope="module")
def expected():
    return FaultTest.of(trained(presses(400, 5)))


STILL = np.s_[:, 1, 2, 0]
FAULTS = [  #: pillars, what they read, and what is said
    (STILL, lambda ohms: ohms[0, 1, 2, 0], "pillar z of row 1, col 2 stuck"),
    (np.s_[:, 2, :, [0, 1]], lambda ohms: ohms[:1, 2, :, [0, 1]].mean(), "row wire 4 stuck"),
    (np.s_[:, [0, 1]], lambda ohms: ohms[:, [1, 0]], "rows 0 and 1 swapped"),
    (np.s_[:, :, [0, 1], 1], lambda ohms: ohms[:, :, [1, 0], 1], "column wires 1 and 3 swapped"),
    (np.s_[:, 0, 1, 1], lambda ohms: np.inf, "pillar x of row 0, col 1 open"),
    (np.s_[:, 1, :, 2], lambda ohms: 1e9, "row wire 3 open"),
    (np.s_[:, 2, 2, 0], lambda ohms: np.resize([np.nan, 1e9], len(ohms)), "pillar z of row 2, col 2 open"),
]


@pytest.mark.parametrize(("where", "reads", "said"), FAULTS, ids=[said for _, _, said in FAULTS])
def test_each_fault_is_named_by_pillar_or_wire(where, reads, said, expected):
    for seed in range(2):
        ohms = readings(presses(WINDOW, 100 + seed), seed)
        ohms[where] = reads(ohms)
        assert [str(found) for found in expected.named(ohms)] == [said]


def test_sound_sensors_raise_no_alarm(expected):
    """Under usual loads, under loads held still, at rest, under one press that grows and under light touches."""
    touch, rest = np.zeros((2, WINDOW, 27))
    touch[:, 14] = np.linspace(0.0, 300.0, WINDOW)
    light = np.random.default_rng(3).uniform(0.0, 5.0, (WINDOW, 27))
    kinds = [touch, light, rest]
    for seed in range(12):
        usual = presses(WINDOW, 1000 + seed)
        for force_n in (usual, np.repeat(usual[:4], WINDOW // 4, axis=0), kinds[seed % 3]):
            assert expected.named(readings(force_n, seed)) == ()
    still, other = readings(rest), readings(presses(WINDOW, 100))
    still[STILL] = still[0, 1, 2, 0]  # at rest nothing says that it should move
    other[:, 1, 1, 0] *= 1.02  # forces on its pad move it as well
    assert expected.named(still) == expected.named(other) == ()


def test_usual_loads_raise_no_alarm_and_what_no_load_explains_is_told():
    """At rest, under one pad's press and under loads as in training few in a thousand are beyond the limit."""
    model = trained(loads(400, 5), bits=None)
    one_pad, rest = np.zeros((2, 2000, 27))
    one_pad[np.arange(2000), 3 * np.random.default_rng(0).integers(9, size=2000) + 2] = 300.0
    for force_n in (rest, one_pad, loads(2000, 9)):
        assert np.greater(*model.consistency(readings(force_n, bits=None))).mean() <= 3 * FALSE_ALARMS
    broken = readings(loads(200, 9), bits=None)
    broken[:, 1, 1, 0] = 1e9
    pads = [0.0, 0.0, 936.0], [0.0, 0.0, -20.0], [40.0, 0.0, 0.0]  # beyond the range, tension, shear alone
    beyond = [readings(np.tile(pad, (200, 9)), bits=None) for pad in pads]
    assert model.lost(broken)[:, 1, 1, 0].all()  # left out, and what the others show is a usual load
    assert np.less(*model.consistency(broken)).mean() > 0.9
    for reading in (1.02 * readings(rest[:200], bits=None), *beyond):
        assert np.greater(*model.consistency(reading)).all()


@pytest.mark.parametrize("layout", ["song2018", "six-pillar"])
def test_a_net_without_a_response_tells_another_sensor_by_its_readings(layout):
    """Gains of 0.9 to 1.1 of each pillar; its own under usual and light loads, at rest and without a pillar pass."""
    design = sensor(3, 3, layout)
    read_ohm = partial(readings, forward=SensorModel.of(response(design), ALL))
    force_n, unseen_n = presses(400, 5), presses(1000, 6)
    own = {"force_n": force_n.reshape(-1, 3, 3, 3), "resistance_ohm": read_ohm(force_n)}
    data = Samples(**own, design=design, noise=NOISE, bits=12)
    model = train(data, "all", NetworkConfig(hidden=4, net="plain", feature="root"))
    own = read_ohm(unseen_n, 2)
    broken = own[:100].copy()
    broken[:, 1, 1, 0] = 1e9
    passing = own, read_ohm(0.1 * unseen_n, 3), read_ohm(0.0 * unseen_n, 4), broken
    assert [np.greater(*model.consistency(ohms)).mean() <= 3 * FALSE_ALARMS for ohms in passing] == [True] * 4
    for seed in range(4):
        gains = np.random.default_rng(seed).uniform(0.9, 1.1, own.shape[1:])
        assert np.greater(*model.consistency(gains * own[:200])).mean() > 0.95


@pytest.mark.parametrize("common", [0.0, 0.5, 0.99])
def test_the_limit_is_the_quantile_of_correlated_errors(common):
    """Of errors that all go together χ² has one degree of freedom, of independent ones all, of a mixture some."""
    usual = UsualLoads(low_n=np.zeros(1), high_n=np.zeros(1), friction=np.zeros(1))
    correlation = (1.0 - common) * np.eye(30) + common
    test = LoadTest.by(usual, correlation, np.ones(30))
    errors = np.random.default_rng(0).standard_normal((100_000, 30)) @ np.linalg.cholesky(correlation).T
    # 100 of 100,000 ± 30 by chance, and a quarter by the approximation
    assert (test.chi2(errors) > test.limit).mean() == pytest.approx(FALSE_ALARMS, rel=0.4)


GENERATOR = np.random.default_rng(0)
S = np.cov(GENERATOR.standard_normal((7, 7)) @ GENERATOR.standard_normal((7, 200)))
MEAN = np.arange(7.0)


@pytest.mark.parametrize("which", [[2], [0, 5], [6, 1, 3]])
def test_the_conditional_mean_and_covariance_are_those_of_the_others(which):
    """S_go S_oo⁻¹ (y_o − mean_o) and S_gg − S_go S_oo⁻¹ S_og, whatever stands in the places of the group."""
    known = Foretold.by(np.linalg.inv(S), np.array(which), MEAN)
    others = np.setdiff1d(np.arange(7), which)
    by_others = np.linalg.solve(S[np.ix_(others, others)], S[np.ix_(others, which)])
    y = np.random.default_rng(1).standard_normal((5, 7))
    expected = MEAN[which] + (y - MEAN)[:, others] @ by_others
    y[:, which] = 1e3
    assert known.told(y) == pytest.approx(expected, rel=1e-9)
    left = S[np.ix_(which, which)] - by_others.T @ S[np.ix_(others, which)]
    assert known.covariance == pytest.approx(left, rel=1e-9)


def test_groups_are_foretold_as_each_alone():
    groups, K = np.array([[0, 5], [2, 3], [6, 1]]), np.linalg.inv(S)
    together = Foretold.by(K, groups)
    for number, which in enumerate(groups):
        alone = Foretold.by(K, which)
        assert together.weights[number] == pytest.approx(alone.weights, rel=1e-9, abs=1e-12)
        assert together.covariance[number] == pytest.approx(alone.covariance, rel=1e-9)
