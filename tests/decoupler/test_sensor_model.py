"""The forward model against the dataset's own lengths, and its inverse: near the forces, where it explains the data."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from dataset.resistance import conducted_lengths
from decoupler import (
    NetworkConfig,
    SampleError,
    TrainingConfig,
    component_named,
    evaluate,
    train,
)
from decoupler.data.columns import Columns, force_columns, pillar_columns
from decoupler.inverse.limits import exact_inverse
from decoupler.inverse.sensor_model import ModelInverse, SensorModel
from decoupler.training.suited import explaining, suited_feature
from fem.array.response import ArrayResponse, ConductedPillars
from geometry.layout import PILLAR_TOP, pillar_ends
from tests.decoupler.synthetic_sensor import labelled, response, sensor, split

CC = shutil.which("cc")
SENSOR = sensor(2, 3)
RESPONSE = response(SENSOR)
ALL = component_named("all")
DATA = labelled(SENSOR, "xyz", n_samples=300, seed=0)
TRAIN, TEST = split(DATA, 200)
FORWARD = SensorModel.of(RESPONSE, ALL)
READABLE = np.ones(FORWARD.n_pillars, dtype=bool)
TRAINING = Columns.of(DATA, ALL)
COLUMNS, FORCES = TRAINING.resistance_ohm, TRAINING.force_n


@pytest.mark.parametrize(("name", "axes"), [("fx", "x"), ("fy", "y"), ("fz", "z"), ("all", "xyz")])
def test_gives_the_resistances_that_the_dataset_has(name, axes):
    """Two routes from forces to ohms; rounding only."""
    component = component_named(name)
    data = labelled(SENSOR, axes, n_samples=20, seed=0)
    forward = SensorModel.of(RESPONSE, component)
    found = forward.resistances(force_columns(data.force_n, component))
    np.testing.assert_allclose(found, pillar_columns(data.resistance_ohm, component), rtol=1e-13)
    np.testing.assert_allclose(forward.lengths_of(found) ** 2 * forward.ohm_per_mm2, found, rtol=1e-14)


def test_derivatives_of_lengths():
    """Central differences of a step of 1e-3 N err by its square times the third derivative: far below 1e-8."""
    force = np.random.default_rng(0).uniform(10.0, 300.0, (3, FORWARD.n_forces))
    lengths, J = FORWARD.jacobian(force)
    np.testing.assert_array_equal(lengths, FORWARD.lengths(force))
    along = np.random.default_rng(1).standard_normal(force.shape)
    step = 1e-3 * along
    differences = (FORWARD.lengths(force + step) - FORWARD.lengths(force - step)) / 2e-3
    np.testing.assert_allclose(np.einsum("npf,nf->np", J, along), differences, rtol=0, atol=1e-8)


def test_corrections_come_near_the_forces():
    """A linear estimate is percents off; for loads that they never saw, the corrections leave 1 % of that."""
    inverse = ModelInverse.about(FORWARD, FORCES[:200], READABLE, noise=0.0)
    others, columns = FORCES[200:], COLUMNS[200:]
    linear = inverse.centre_n + (FORWARD.lengths_of(columns) - inverse.centre_mm) @ inverse.correctors[0]
    assert np.std(linear - others) > 0.01 * others.std()
    assert np.std(inverse.forces(columns) - others) < 0.01 * np.std(linear - others)


@pytest.mark.parametrize("noise", [0.0, 1e-2])
def test_at_rest_and_under_a_light_touch_forces_are_right(noise):
    """Fitted to pads of 144 to 720 N, exact readings: 0.05 N is what a press of 10 N is to be read to at best."""
    inverse = ModelInverse.about(FORWARD, FORCES[:200], READABLE, noise)
    touches = np.zeros((1 + FORWARD.n_forces, FORWARD.n_forces))
    touches[1:] = 10.0 * np.eye(FORWARD.n_forces)
    missed = np.abs(inverse.forces(FORWARD.resistances(touches)) - touches)
    assert missed.max() < 0.05


def test_an_unreadable_pillar_is_not_looked_at():
    readable = READABLE.copy()
    readable[4] = False
    inverse = ModelInverse.about(FORWARD, FORCES, readable, noise=0.0)
    garbled = COLUMNS.copy()
    garbled[:, 4] = 1e4
    once = inverse.forces(garbled)
    garbled[:, 4] = 7.0
    np.testing.assert_array_equal(inverse.forces(garbled), once)
    assert np.std(once - FORCES) < 0.5 * FORCES.std()


def test_a_net_on_the_inverse_beats_one_on_the_root():
    config = TrainingConfig(goal_mse=1e-12, max_iterations=20)
    known = train(TRAIN, "all", NetworkConfig(hidden=6, feature="inverse"), config, response=RESPONSE)
    unknown = train(TRAIN, "all", NetworkConfig(hidden=6, feature="root"), config)
    for name, errors in evaluate(known, TEST).items():
        assert errors.rmse_n < evaluate(unknown, TEST)[name].rmse_n / 3


def test_the_feature_needs_a_response_that_explains_the_data():
    with pytest.raises(SampleError, match="needs the array's response"):
        train(TRAIN, "all", NetworkConfig(feature="inverse"), TrainingConfig())
    with pytest.raises(SampleError, match="the response is of 12 pillars, the samples of 18"):
        explaining(response(sensor(2, 2)), TRAINING)
    shuffled = np.random.default_rng(0).permutation(FORCES)  # resistances of other loads
    with pytest.raises(SampleError, match=r"explains .* of the resistances' variance"):
        explaining(RESPONSE, replace(TRAINING, force_n=shuffled))


def test_another_resistivity_or_gains_are_explained_and_a_softer_body_is_not():
    """Ohms ten times as many say the same of the forces; a body half as stiff does not."""
    gains = 10.0 * np.random.default_rng(0).uniform(0.8, 1.2, COLUMNS.shape[1])
    explaining(RESPONSE, replace(TRAINING, resistance_ohm=gains * COLUMNS))
    other = replace(DATA, resistance_ohm=DATA.resistance_ohm * gains.reshape(2, 3, 3))
    model = train(other, "all", NetworkConfig(hidden=4, feature="inverse"), TrainingConfig(), response=RESPONSE)
    own = train(DATA, "all", NetworkConfig(hidden=4, feature="inverse"), TrainingConfig(), response=RESPONSE)
    for name, errors in evaluate(model, other).items():
        assert errors.rmse_n < 1.1 * evaluate(own, DATA)[name].rmse_n  # what the prior on gains costs
    softer = replace(RESPONSE, influence_mm_per_n=0.5 * RESPONSE.influence_mm_per_n)
    with pytest.raises(SampleError, match=r"explains .* of the resistances' variance"):
        explaining(softer, TRAINING)


def test_the_suited_feature():
    assert suited_feature(DATA, ALL, "skip", RESPONSE) == "inverse"
    assert suited_feature(DATA, ALL, "plain", RESPONSE) == "root"
    assert suited_feature(DATA, ALL, "skip", None) == "root"
    shuffled = np.random.default_rng(0).permutation(DATA.force_n)
    assert suited_feature(replace(DATA, force_n=shuffled), ALL, "skip", RESPONSE) == "root"


def conducted(factor: float) -> ArrayResponse:
    """The response with resistances as by conduction: eq. 1 with components turned, one more whose square counts −1."""
    B = RESPONSE.influence_mm_per_n[:, :, list(PILLAR_TOP)]  # (rows, cols, 3 pillars, 3, ...)
    d = np.broadcast_to(np.diff(pillar_ends(SENSOR.unit), axis=1)[:, 0], B.shape[:4])
    turn = np.linalg.qr(np.random.default_rng(4).standard_normal((3, 3)))[0]
    more = factor * B[..., :1, :, :, :]
    return replace(
        RESPONSE,
        conducted=ConductedPillars(
            rest_mm=np.concatenate([d @ turn.T, 0 * d[..., :1]], axis=3),
            influence_mm_per_n=np.concatenate([np.einsum("kb,ijpbrca->ijpkrca", turn, B), more], axis=3),
            sign=np.broadcast_to([1.0, 1.0, 1.0, -1.0], (*d.shape[:3], 4)),
            error_estimate=0.0,
        ),
    )


@pytest.mark.parametrize("name", ["fx", "all"])
def test_conduction_in_components_that_are_eq_1_is_eq_1(name):
    """However its components are turned; rounding only."""
    component = component_named(name)
    one, other = (SensorModel.of(given, component) for given in (RESPONSE, conducted(0.0)))
    force = np.random.default_rng(0).uniform(10.0, 300.0, (3, one.n_forces))
    for ours, theirs in zip(one.jacobian(force), other.jacobian(force), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12)


def test_conduction_is_differentiated_and_inverted():
    """A component of sign −1: central differences, and Gauss-Newton back to the forces."""
    given = conducted(0.5)
    forward = SensorModel.of(given, ALL)
    force = FORCES[:5]
    _, J = forward.jacobian(force)
    along = np.random.default_rng(1).standard_normal(force.shape)
    differences = (forward.lengths(force + 1e-3 * along) - forward.lengths(force - 1e-3 * along)) / 2e-3
    np.testing.assert_allclose(np.einsum("npf,nf->np", J, along), differences, rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        exact_inverse(forward, forward.resistances(force), FORCES.mean(axis=0)), force, rtol=1e-9
    )
    newtons = DATA.force_n.reshape(len(DATA), -1, 3) * np.array([1.0, 1.0, -1.0])
    np.testing.assert_allclose(
        conducted_lengths(given.conducted, newtons).reshape(len(DATA), -1), forward.lengths(FORCES), rtol=1e-12
    )
