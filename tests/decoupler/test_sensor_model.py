"""The forward model against the dataset's own lengths, and its inverse: near the forces, where it explains the data."""

from dataclasses import replace

import numpy as np
import pytest

from dataset.measurement import ReadingError
from dataset.resistance import conducted_lengths
from decoupler import NetworkConfig, SampleError, component_named
from decoupler.data.columns import COMPONENTS, Columns, force_columns
from decoupler.data.pairs import Pairs
from decoupler.inverse.sensor_model import ModelInverse, SensorModel
from decoupler.training.suited import explaining, suited
from decoupler.twin import identify
from fem.array.response import ArrayResponse, ConductedPillars
from geometry.layout import pillar_ends
from tests.decoupler.synthetic_sensor import labelled, noisy, response, sensor, softness

SENSOR = sensor(2, 3)
RESPONSE = response(SENSOR)
ALL = component_named("all")
DATA = labelled(SENSOR, "xyz", n_samples=300, seed=0)
FORWARD = SensorModel.of(RESPONSE, ALL)
READABLE = np.ones(FORWARD.n_pillars, dtype=bool)
TRAINING = Columns.of(DATA, ALL)
COLUMNS, FORCES = TRAINING.resistance_ohm, TRAINING.force_n
SHUFFLED = np.random.default_rng(0).permutation(DATA.force_n)  #: resistances of other loads


def conducted(factor: float) -> ArrayResponse:
    """The response with resistances as by conduction: eq. 1 with components turned, one more whose square counts −1."""
    B = RESPONSE.influence_mm_per_n[:, :, SENSOR.unit.layout.pillar_top]  # (rows, cols, 3 pillars, 3, ...)
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


@pytest.mark.parametrize("name", COMPONENTS)
def test_gives_the_resistances_that_the_dataset_has(name):
    """Two routes from forces to ohms; by conduction in components that are those of eq. 1 as well. Rounding only."""
    component = component_named(name)
    data = labelled(SENSOR, "".join(component.axes), n_samples=20, seed=0)
    force_n, expected = force_columns(data.force_n, component), Columns.of(data, component).resistance_ohm
    for given in (RESPONSE, conducted(0.0)):
        forward = SensorModel.of(given, component)
        np.testing.assert_allclose(forward.resistances(force_n), expected, rtol=1e-13)
    np.testing.assert_allclose(forward.lengths_of(expected) ** 2 * forward.ohm_per_mm2, expected, rtol=1e-14)


@pytest.mark.parametrize("given", [RESPONSE, conducted(0.5)], ids=["eq. 1", "conduction"])
def test_derivatives_of_lengths_are_those_of_the_forces(given):
    """Central differences of a step of 1e-3 N err by its square times the third derivative: far below 1e-8."""
    forward, force = SensorModel.of(given, ALL), FORCES[:5]
    lengths, J = forward.jacobian(force)
    np.testing.assert_array_equal(lengths, forward.lengths(force))
    along = np.random.default_rng(1).standard_normal(force.shape)
    differences = (forward.lengths(force + 1e-3 * along) - forward.lengths(force - 1e-3 * along)) / 2e-3
    np.testing.assert_allclose(np.einsum("npf,nf->np", J, along), differences, rtol=0, atol=1e-8)
    if given.conducted is not None:
        newtons = DATA.force_n.reshape(len(DATA), -1, 3) * np.array([1.0, 1.0, -1.0])
        by_dataset = conducted_lengths(given.conducted, newtons).reshape(len(DATA), -1)
        np.testing.assert_allclose(by_dataset, forward.lengths(FORCES), rtol=1e-12)


@pytest.mark.parametrize("given", [RESPONSE, conducted(0.5)], ids=["eq. 1", "conduction"])
def test_what_readings_err_by_is_what_squares_err_by(given):
    """As differences of squares of lengths that resistances stand for, which are linear in these: rounding only."""
    errors, deviation_ohm = ReadingError(noise=1e-3, bits=12, drift=0.005), np.full(FORWARD.n_pillars, 30.0)
    sensor = replace(SensorModel.of(given, ALL), deviation_ohm=deviation_ohm)
    at = sensor.at(FORCES[:4])
    ohms, (own, shared) = at.resistance_ohm, sensor.errors_mm2(at.resistance_ohm, errors, DATA.shape)
    np.testing.assert_allclose(sensor.squares_of(ohms), at.squares, rtol=1e-14)
    off_ohm = np.hypot(errors.deviation(ohms), deviation_ohm)
    np.testing.assert_allclose(own, sensor.squares_of(ohms + off_ohm) - at.squares, rtol=1e-9)
    drifted = ohms + errors.shared(ohms, *DATA.shape)[..., 0]
    np.testing.assert_allclose(shared[..., 0], sensor.squares_of(drifted) - at.squares, rtol=1e-9)


@pytest.mark.parametrize("name", ["fz", "all"])
def test_a_sensor_that_conducts_is_identified_whatever_its_forces(name):
    """By one axis, whose pillar alone has components, as by all: twice the 1.6 N that noise leaves of up to 720 N."""
    given, component = conducted(0.5), component_named(name)
    data = labelled(SENSOR, "".join(component.axes), 60, seed=0)
    ohms = SensorModel.of(given, ALL).resistances(data.force_n.reshape(60, -1)).reshape(data.resistance_ohm.shape)
    data = noisy(replace(data, resistance_ohm=1.1 * ohms), 1e-3)
    found = identify(Pairs.of(data[:20]), given, softness(SENSOR), name).decoder
    off_n = found.forces(data[20:].resistance_ohm)[..., -1] - data[20:].force_n[..., 2]
    assert np.sqrt(np.mean(off_n**2)) < 3.0


@pytest.mark.parametrize("noise", [0.0, 1e-2])
def test_corrections_come_near_the_forces_and_are_right_at_rest(noise):
    """A linear estimate is percents off; for loads that they never saw, the corrections leave 1 % of that.

    Fitted to pads of 144 to 720 N, exact readings: 0.05 N is what a press of 10 N is to be read to at best.
    """
    inverse = ModelInverse.about(FORWARD, FORCES[:200], READABLE, noise)
    touches = np.vstack([np.zeros(FORWARD.n_forces), 10.0 * np.eye(FORWARD.n_forces)])
    assert np.abs(inverse.values(FORWARD.resistances(touches)) - touches).max() < 0.05
    if noise == 0.0:
        others, columns = FORCES[200:], COLUMNS[200:]
        linear = inverse.centre_n + (FORWARD.lengths_of(columns) - inverse.centre_mm) @ inverse.correctors[0]
        assert np.std(linear - others) > 0.01 * others.std()
        assert np.std(inverse.values(columns) - others) < 0.01 * np.std(linear - others)


def test_the_feature_needs_a_response_that_explains_the_data():
    """A body half as stiff is another, and so are resistances of other loads."""
    softer = replace(RESPONSE, influence_mm_per_n=0.5 * RESPONSE.influence_mm_per_n)
    unpaired = replace(TRAINING, force_n=SHUFFLED.reshape(FORCES.shape))
    for given, data, said in (
        (None, TRAINING, "needs the array's response"),
        (response(sensor(2, 2)), TRAINING, "the response is of 12 pillars, the samples of 18"),
        (RESPONSE, unpaired, r"explains .* of the resistances' variance"),
        (softer, TRAINING, r"explains .* of the resistances' variance"),
    ):
        with pytest.raises(SampleError, match=said):
            explaining(given, data)
    for data, net, given, feature in (
        (DATA, "skip", RESPONSE, "inverse"),
        (DATA, "plain", RESPONSE, "root"),
        (DATA, "skip", None, "root"),
        (replace(DATA, force_n=SHUFFLED), "skip", RESPONSE, "root"),
    ):
        assert suited(data, "all", NetworkConfig(net=net), None, given)[1].feature == feature
