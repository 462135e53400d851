"""More samples than are held together: a draw trains the hidden layer, all give the output layer and the errors."""

import numpy as np
import pytest

from dataset import DatasetSettings, read_samples, simulate
from decoupler import NetworkConfig, TrainingConfig, assess, component_errors, evaluate, train
from decoupler.data.columns import component_named, force_columns, pillar_columns
from decoupler.data.enough import ENOUGH, drawn
from decoupler.training.output_layer import in_order
from geometry.errors import ArgumentError
from tests.decoupler.synthetic_sensor import response, sensor

ALL = component_named("all")
OWN = response(sensor(1, 2))
NET = NetworkConfig(hidden=3, feature="inverse")
TRAINING = TrainingConfig(max_iterations=5, seed=1)


@pytest.fixture(scope="module")
def many():
    return simulate(OWN, DatasetSettings(protocol="three-axis", samples=ENOUGH + 5000, noise=1e-3)).labels()


@pytest.fixture(scope="module")
def stored(many, tmp_path_factory):
    path = tmp_path_factory.mktemp("many") / "many.zarr"
    many.write(path)
    return read_samples(path)


@pytest.fixture(scope="module")
def model(stored):
    return train(stored, "all", NET, TRAINING, response=OWN)


def test_few_are_all_and_many_a_random_draw_in_their_order(many, stored):
    assert np.array_equal(drawn(many[:50]).force_n, many.force_n[:50])
    one, same, other = drawn(many, 1), drawn(stored, 1), drawn(many, 2)
    assert len(one) == ENOUGH
    assert np.array_equal(one.force_n, same.force_n)
    assert not np.array_equal(one.force_n, other.force_n)
    rows = {row.tobytes() for row in many.force_n}
    assert len({row.tobytes() for row in one.force_n} & rows) == ENOUGH  # none twice
    with pytest.raises(ArgumentError, match="samples is of type list"):
        drawn([1, 2])


def test_output_layer_is_the_least_squares_of_all_samples(many, model):
    """Light samples stand beside the draw's, so they count as much more as there are more samples than drawn."""
    A = model.activations(pillar_columns(many.resistance_ohm, ALL))
    inputs = A[:, NET.hidden : -1]
    targets = model.output_scaling.scale(force_columns(many.force_n, ALL))
    W = model.output_weights.copy()
    W[:, NET.hidden : -1] -= np.eye(len(W))

    def cost(weights):
        return float(((A @ weights.T - (targets - inputs)) ** 2).sum())

    free = np.linalg.lstsq(A, targets - inputs)[0].T
    assert cost(free) < cost(W) < 1.001 * cost(free)  # the ridge and light samples leave it a little above
    of_draw = drawn(many, TRAINING.seed)
    alone = train(of_draw, "all", NET, TRAINING, response=OWN)
    assert np.array_equal(alone.hidden_weights, model.hidden_weights)
    own = alone.output_weights.copy()
    own[:, NET.hidden : -1] -= np.eye(len(own))
    assert cost(W) < cost(own)


def test_samples_in_memory_and_on_disk_train_the_same_bits(many, stored, model):
    again = train(many, "all", NET, TRAINING, response=OWN)
    assert np.array_equal(again.output_weights, model.output_weights)
    assert np.array_equal(again.uncertainty.inverse_matrix, model.uncertainty.inverse_matrix)
    assert model.made_from["n_samples"] == len(many)
    assert model.made_from["data_hash"] == stored.content_hash


def test_a_net_that_knows_no_response_streams_too(many, stored):
    """Its output layer is the least squares of hidden nodes and a constant; the ridge hardly moves it."""
    counts = []
    network = NetworkConfig(hidden=2, net="plain", feature="root")
    model = train(stored, "all", network, TrainingConfig(trainer="lm", max_iterations=2), counted=counts.append)
    assert sum(counts) == len(many)
    A = model.activations(pillar_columns(many.resistance_ohm, ALL))
    targets = model.output_scaling.scale(force_columns(many.force_n, ALL))
    best = np.linalg.lstsq(A, targets)[0].T
    assert np.abs(model.output_weights - best).max() < 1e-4 * np.abs(best).max()
    assert model.made_from["outcome"]["mse"] == pytest.approx(((A @ model.output_weights.T - targets) ** 2).mean())


def test_errors_are_those_on_all_samples(many, stored, model):
    """Sums over blocks round otherwise than one sum: by 1e-12."""
    expected = component_errors(model.forces(many.resistance_ohm), many, ALL)
    for found in (evaluate(model, stored), {name: one.errors for name, one in assess(model, stored, OWN).items()}):
        for name, errors in expected.items():
            assert found[name].rmse_n == pytest.approx(errors.rmse_n, rel=1e-12)
            assert found[name].full_scale_pct == pytest.approx(errors.full_scale_pct, rel=1e-12)
            assert (found[name].rel_err is None) == (errors.rel_err is None)
    assert found["fz"].rel_err == pytest.approx(expected["fz"].rel_err, rel=1e-12)


def test_half_widths_hold_their_share_of_new_errors(model):
    """Widths are quantiles of 1000 errors an axis: 0.045 and 0.02 are three standard deviations of these."""
    test = simulate(OWN, DatasetSettings(protocol="three-axis", samples=2000, noise=1e-3, seed=9))
    for one in assess(model, test, OWN).values():
        assert one.coverage[0] == pytest.approx(0.68, abs=0.045)
        assert one.coverage[1] == pytest.approx(0.954, abs=0.02)
        assert one.ratio < 1.03


def test_work_keeps_its_order_and_runs_ahead_of_nobody():
    taken = []

    def given():
        for number in range(50):
            taken.append(number)
            yield number

    for number, found in enumerate(in_order(lambda each: -each, given())):
        assert found == -number
        assert len(taken) <= number + 66  # a core each, and one that waits
