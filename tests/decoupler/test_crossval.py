"""Cross-validation: every sample tested once, nothing of it known in training."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from decoupler import NetworkConfig, SampleError, TrainingConfig, cross_validate, evaluate, train
from decoupler.evaluation.crossval import jobs_of, split_folds, summary
from tests.decoupler.synthetic_sensor import labelled, sensor

SENSOR = sensor(2, 3)
DATA = labelled(SENSOR, "x", n_samples=53, seed=0)
NETWORK, FEW = NetworkConfig(hidden=3), TrainingConfig(max_iterations=3, seed=4)


@pytest.fixture(autouse=True)
def one_process(monkeypatch):
    """Processes of their own load torch for seconds; the pool has tests of its own."""
    monkeypatch.setattr("decoupler.evaluation.crossval.in_parallel", lambda jobs, progress: [f(*x) for f, *x in jobs])


def test_folds_part_the_samples_and_impossible_ones_are_refused():
    parts = split_folds(53, 10, seed=1)
    assert sorted(np.concatenate(parts)) == list(range(53))
    assert {len(part) for part in parts} == {5, 6}
    assert not np.array_equal(parts[0], split_folds(53, 10, seed=2)[0])
    for folds in (1, 27):
        with pytest.raises(SampleError, match=f"folds={folds} must be from 2 to 26"):
            split_folds(53, folds, seed=0)
    with pytest.raises(SampleError, match="needs the array's response"):
        cross_validate(DATA, "fx", NetworkConfig(feature="inverse"), FEW, folds=2)


def test_a_fold_is_a_network_trained_on_the_rest_which_never_saw_its_scaling():
    """To the bit, in order; the test samples hold the largest forces and resistances by far."""
    parts = split_folds(53, 4, FEW.seed)
    wild = replace(DATA, force_n=DATA.force_n.copy(), resistance_ohm=DATA.resistance_ohm.copy())
    wild.force_n[parts[0]] *= 100.0
    wild.resistance_ohm[parts[0]] *= 100.0
    tested = cross_validate(wild, "fx", NETWORK, FEW, folds=4)
    for fold, part in zip(tested, parts, strict=True):
        model = train(wild[np.setdiff1d(np.arange(53), part)], "fx", NETWORK, FEW)
        assert fold.errors == evaluate(model, wild[part])
        assert fold.iterations == model.made_from["outcome"]["iterations"]
        actual = wild.force_n[part][..., :1]
        relative = np.abs(model.forces(wild.resistance_ohm[part]) - actual) / actual
        assert fold.errors["fx"].rel_err == pytest.approx(relative.mean(), rel=1e-12)
    rel_err, found = [fold.errors["fx"].rel_err for fold in tested], summary(tested)
    assert [fold["rel_err"] for fold in found["folds"]] == rel_err
    assert found["mean_rel_err"] == pytest.approx(np.mean(rel_err))
    assert found["spread_rel_err"] == pytest.approx(np.std(rel_err))


def test_copies_and_readings_of_one_load_come_into_one_fold():
    """No load of a test set is among those of training; a copy of a sample counts once."""
    noisy = DATA.resistance_ohm[:20] * (1 + 1e-3 * np.random.default_rng(0).standard_normal((20, 2, 3, 3)))
    again = replace(
        DATA,
        force_n=np.concatenate([DATA.force_n, DATA.force_n, DATA.force_n[:20]]),
        resistance_ohm=np.concatenate([DATA.resistance_ohm, DATA.resistance_ohm, noisy]),
    )
    tested = []
    jobs = pickle.loads(pickle.dumps(list(jobs_of(again, "fx", NETWORK, FEW, 4, None))))  # for another process
    for _, data, *_, trained_on, tested_on in jobs:
        assert len(data.force_n) == 73
        assert not np.isin(data.force_n[tested_on, 0, 0, 0], data.force_n[trained_on, 0, 0, 0]).any()
        assert sorted([*trained_on, *tested_on]) == list(range(73))
        tested += [*tested_on]
    assert sorted(tested) == list(range(73))
