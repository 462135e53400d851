"""More samples than are held together: a draw is learned from, all give the errors."""

import numpy as np
import pytest

from common.errors import ArgumentError
from dataset import DatasetSettings, read_samples, simulate
from decoupler import NetworkConfig, TrainingConfig, assess, component_errors, evaluate, train
from decoupler.data import enough
from decoupler.data.columns import component_named
from decoupler.data.enough import drawn
from tests.decoupler.synthetic_sensor import response, sensor

ALL = component_named("all")
OWN = response(sensor(1, 2))
MANY = 3000
TRAINING = TrainingConfig(max_iterations=5, seed=1)


def test_few_are_all_and_many_a_random_draw_from_memory_and_disk_alike(tmp_path, monkeypatch):
    """The draw trains to the bit; errors are those on all samples. Sums over blocks round otherwise: by 1e-12."""
    for module in ("data.enough", "evaluation.metrics", "evaluation.assessment"):
        monkeypatch.setattr(f"decoupler.{module}.ENOUGH", MANY)
    monkeypatch.setattr(enough.drawn, "__defaults__", (0, MANY))
    many = simulate(OWN, DatasetSettings(protocol="three-axis", samples=MANY + 7000, noise=1e-3)).labels()
    many.write(tmp_path / "many.zarr")
    stored = read_samples(tmp_path / "many.zarr")
    assert np.array_equal(drawn(many[:50]).force_n, many.force_n[:50])
    one, same, other = drawn(many, 1), drawn(stored, 1), drawn(many, 2)
    assert np.array_equal(one.force_n, same.force_n)
    assert not np.array_equal(one.force_n, other.force_n)
    assert len(np.unique(one.force_n.reshape(MANY, -1), axis=0)) == MANY  # none twice
    with pytest.raises(ArgumentError, match="samples is of type list"):
        drawn([1, 2])
    network = NetworkConfig(hidden=3, feature="inverse")
    model, again, of_draw = (train(data, "all", network, TRAINING, response=OWN) for data in (stored, many, one))
    for each in (again, of_draw):
        assert np.array_equal(each.network.output, model.network.output)
        assert np.array_equal(each.uncertainty.inverse_matrix, model.uncertainty.inverse_matrix)
    assert model.made_from["n_samples"] == MANY
    assert model.made_from["data_hash"] == stored.content_hash
    expected = component_errors(model.forces(many.resistance_ohm), many, ALL)
    for found in (evaluate(model, stored), {name: one.errors for name, one in assess(model, stored, OWN).items()}):
        for name, errors in expected.items():
            assert found[name].rmse_n == pytest.approx(errors.rmse_n, rel=1e-12)
            assert found[name].full_scale_pct == pytest.approx(errors.full_scale_pct, rel=1e-12)
            assert found[name].rel_err == (errors.rel_err and pytest.approx(errors.rel_err, rel=1e-12))
