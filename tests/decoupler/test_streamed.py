"""More samples than are held together: a draw is learned from, all give the errors."""

import numpy as np
import pytest

from dataset import DatasetSettings, read_samples, simulate
from decoupler import NetworkConfig, TrainingConfig, assess, component_errors, evaluate, train
from decoupler.data.columns import component_named
from decoupler.data.enough import ENOUGH, drawn
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


def test_samples_in_memory_and_on_disk_train_the_same_bits(many, stored, model):
    again = train(many, "all", NET, TRAINING, response=OWN)
    of_draw = train(drawn(many, TRAINING.seed), "all", NET, TRAINING, response=OWN)
    assert np.array_equal(of_draw.output_weights, model.output_weights)
    assert np.array_equal(again.output_weights, model.output_weights)
    assert np.array_equal(again.uncertainty.inverse_matrix, model.uncertainty.inverse_matrix)
    assert model.made_from["n_samples"] == ENOUGH
    assert model.made_from["data_hash"] == stored.content_hash


def test_errors_are_those_on_all_samples(many, stored, model):
    """Sums over blocks round otherwise than one sum: by 1e-12."""
    expected = component_errors(model.forces(many.resistance_ohm), many, ALL)
    for found in (evaluate(model, stored), {name: one.errors for name, one in assess(model, stored, OWN).items()}):
        for name, errors in expected.items():
            assert found[name].rmse_n == pytest.approx(errors.rmse_n, rel=1e-12)
            assert found[name].full_scale_pct == pytest.approx(errors.full_scale_pct, rel=1e-12)
            assert (found[name].rel_err is None) == (errors.rel_err is None)
    assert found["fz"].rel_err == pytest.approx(expected["fz"].rel_err, rel=1e-12)
