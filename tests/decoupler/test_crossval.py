"""Cross-validation: every sample tested once, nothing of it known in training, the same however it is run."""

from dataclasses import replace

import numpy as np
import pytest

from decoupler import NetworkConfig, SampleError, TrainingConfig, cross_validate, evaluate, train
from decoupler.evaluation.crossval import jobs_of, over_folds, split_folds, summary
from tests.decoupler.synthetic_sensor import labelled, response, sensor

SENSOR = sensor(2, 3)
DATA = labelled(SENSOR, "x", n_samples=53, seed=0)
NETWORK, FEW = NetworkConfig(hidden=3), TrainingConfig(max_iterations=3, seed=4)


def test_folds_part_the_samples_and_impossible_ones_are_refused():
    parts = split_folds(53, 10, seed=1)
    assert sorted(np.concatenate(parts)) == list(range(53))
    assert {len(part) for part in parts} == {5, 6}
    assert not np.array_equal(parts[0], split_folds(53, 10, seed=2)[0])
    for folds in (1, 27):
        with pytest.raises(SampleError, match=f"folds={folds} must be from 2 to 26"):
            split_folds(53, folds, seed=0)


def test_processes_give_what_one_after_the_other_gives():
    """Eq. 17 of a network trained on the rest, to the bit, in the order of the folds."""
    done = []
    tested = cross_validate(DATA, "fx", NETWORK, FEW, folds=2, progress=done.append)
    assert sorted(done) == [0, 1]
    for fold, part in zip(tested, split_folds(53, 2, FEW.seed), strict=True):
        model = train(DATA[np.setdiff1d(np.arange(53), part)], "fx", NETWORK, FEW)
        assert fold.errors == evaluate(model, DATA[part])
        assert fold.iterations == model.made_from["outcome"]["iterations"]
        actual = DATA.force_n[part][..., :1]
        relative = np.abs(model.forces(DATA.resistance_ohm[part]) - actual) / actual
        assert fold.errors["fx"].rel_err == pytest.approx(relative.mean(), rel=1e-12)
    rel_err = [fold.errors["fx"].rel_err for fold in tested]
    found = summary(tested)
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
    for _, data, *_, trained_on, tested_on in jobs_of(again, "fx", NETWORK, FEW, 4, None):
        assert len(data.force_n) == 73
        assert not np.isin(data.force_n[tested_on, 0, 0, 0], data.force_n[trained_on, 0, 0, 0]).any()
        assert sorted([*trained_on, *tested_on]) == list(range(73))
        tested += [*tested_on]
    assert sorted(tested) == list(range(73))


@pytest.fixture
def one_process(monkeypatch):
    """Processes of their own load torch for seconds."""
    monkeypatch.setattr("decoupler.evaluation.crossval.in_parallel", lambda jobs, progress: [f(*x) for f, *x in jobs])


def test_a_fold_never_sees_its_test_samples_scaling_and_its_failure_is_said(one_process):
    """The test samples hold the largest forces and resistances by far; no scaling knows of them."""
    part = split_folds(53, 4, FEW.seed)[0]
    wild = replace(DATA, force_n=DATA.force_n.copy(), resistance_ohm=DATA.resistance_ohm.copy())
    wild.force_n[part] *= 100.0
    wild.resistance_ohm[part] *= 100.0
    rest = np.setdiff1d(np.arange(53), part)
    tame, same = (train(data[rest], "fx", NETWORK, FEW) for data in (DATA, wild))
    np.testing.assert_array_equal(tame.input_scaling.half_range, same.input_scaling.half_range)
    assert cross_validate(wild, "fx", NETWORK, FEW, folds=4)[0].errors == evaluate(same, wild[part])
    with pytest.raises(SampleError, match="needs the array's response"):
        cross_validate(DATA, "fx", NetworkConfig(feature="inverse"), FEW, folds=2)


def test_joint_summary_holds_every_force(one_process):
    data, network = labelled(SENSOR, "xyz", n_samples=60, seed=0), NetworkConfig(hidden=3, feature="inverse")
    tested = cross_validate(data, "all", network, FEW, folds=2, response=response(SENSOR))
    found = summary(tested)
    assert set(found["mean"]) == {"fx", "fy", "fz"}
    assert found["mean"]["fz"]["rmse_n"] == over_folds(tested, np.mean)["fz"].rmse_n
    assert len(found["folds"]) == 2
