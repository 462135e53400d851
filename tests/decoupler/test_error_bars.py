"""Half-widths that hold as many errors as they say, on samples that training never saw; the ridge by its definition."""

from dataclasses import replace

import numpy as np
import pytest

from decoupler import NetworkConfig, SampleError, TrainingConfig, train
from decoupler.training.error_bars import RIDGES, best_ridge
from tests.decoupler.synthetic_sensor import labelled, noisy, response, sensor, split

SENSOR = sensor(2, 3)
RESPONSE = response(SENSOR)
EXACT = labelled(SENSOR, "xyz", n_samples=900, seed=0)


def test_a_dead_pillar_is_masked_and_its_unit_named():
    training, test = split(EXACT, 600)
    dead = np.zeros((2, 3, 3), dtype=bool)
    dead[1, 2, 0] = True
    hurt = replace(training, dead=dead)
    model = train(hurt, "all", NetworkConfig(hidden=6, feature="inverse"), TrainingConfig(), response=RESPONSE)
    R = test.resistance_ohm.copy()
    R[:, 1, 2, 0] = np.nan
    errors = np.sqrt(((model.forces(R) - test.force_n) ** 2).mean(axis=0))
    assert {(row, col) for row, col, _ in model.untrusted()} == {(1, 2)}
    assert (1, 2, "fz") in model.untrusted()
    others = np.delete(errors.reshape(6, 3), 5, axis=0)
    assert errors[1, 2, 2] > 3 * others[:, 2].max()


def with_stuck(data, places, ohm):
    """The data with some pillars that read what a function of their mean and of the number of samples says."""
    R = data.resistance_ohm.copy()
    for place in places:
        R[:, *place] = ohm(R[:, *place].mean(), len(R))
    return replace(data, resistance_ohm=R)


@pytest.mark.parametrize("feature", ["inverse", "root"])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize(
    "reading",
    [
        lambda mean, n: mean,
        lambda mean, n: mean + np.random.default_rng(5).uniform(-1, 1, n),
        lambda mean, n: 0.3 * mean + np.random.default_rng(5).uniform(-30, 30, n),
        lambda mean, n: 1e9,
    ],
    ids=["constant", "±1 Ω", "±30 Ω, elsewhere", "open"],
)
def test_a_pillar_stuck_in_training_is_masked_and_its_unit_named(feature, noise, reading):
    """To the bit the model of a pillar stated as dead, whether it is alive later or not; 576 N is the range."""
    training, test = split(noisy(EXACT, noise), 600)
    dead = np.zeros((2, 3, 3), dtype=bool)
    dead[1, 2, 0] = True
    stuck = with_stuck(training, [(1, 2, 0)], reading)
    config = NetworkConfig(hidden=6, feature=feature)
    model = train(stuck, "all", config, TrainingConfig(), response=RESPONSE)
    stated = train(replace(training, dead=dead), "all", config, TrainingConfig(), response=RESPONSE)
    assert np.array_equal(model.dead, dead)
    assert (1, 2, "fz") in model.untrusted()
    later = with_stuck(test, [(1, 2, 0)], reading).resistance_ohm
    forces = model.forces(test.resistance_ohm)
    assert np.array_equal(forces, stated.forces(test.resistance_ohm))
    assert np.array_equal(forces, model.forces(later))
    assert np.abs(forces - test.force_n).max() < 576


@pytest.mark.parametrize("feature", ["inverse", "root"])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_samples_given_ten_times_are_known_no_better(feature, noise):
    """The same model, to the bit, as of each sample once; repeated in whatever order."""
    training, test = split(noisy(EXACT, noise), 600)
    config = NetworkConfig(hidden=6, feature=feature)
    once, often = (
        train(training[which], "all", config, TrainingConfig(), response=RESPONSE)
        for which in (np.arange(20), np.tile(np.arange(20), 10))
    )
    R = test.resistance_ohm
    assert np.array_equal(often.forces(R), once.forces(R))
    assert np.array_equal(often.half_widths(R), once.half_widths(R))


@pytest.mark.parametrize("feature", ["inverse", "root"])
@pytest.mark.parametrize("noise", [1e-3, 1e-2])
@pytest.mark.parametrize("loads", [20, 60])
def test_ten_readings_of_each_load_do_not_vouch_for_each_other(feature, noise, loads):
    """They share the error at their load: at least as many errors within the deviations as said, fewer loads wider.

    4 and 2 points for chance, as above. Before loads were left out whole, 13 % and 24 % of errors lay within.
    """
    _, test = split(noisy(EXACT, noise), 600)
    F, R = (np.repeat(a[:loads], 10, axis=0) for a in (EXACT.force_n, EXACT.resistance_ohm))
    R = R * (1 + noise * np.random.default_rng(2).standard_normal(R.shape))
    training = replace(EXACT, force_n=F, resistance_ohm=R, noise=noise)
    model = train(training, "all", NetworkConfig(hidden=6, feature=feature), TrainingConfig(), response=RESPONSE)
    missed = np.abs(model.forces(test.resistance_ohm) - test.force_n)
    one, two = model.half_widths(test.resistance_ohm)
    assert np.mean(missed <= one) > 0.6827 - 0.04
    assert np.mean(missed <= two) > 0.9545 - 0.02
    assert np.median(one) < np.ptp(EXACT.force_n, axis=(0, 1, 2)).max()


def test_a_healthy_sensor_is_trusted_and_a_model_without_uncertainty_says_so():
    training, test = split(noisy(EXACT, 1e-3), 600)
    model = train(training, "all", NetworkConfig(hidden=6, feature="inverse"), TrainingConfig(), response=RESPONSE)
    assert model.untrusted() == []
    with pytest.raises(SampleError, match="knows no uncertainty"):
        replace(model, uncertainty=None).half_widths(test.resistance_ohm)


@pytest.mark.parametrize("trainer", ["varpro", "lm"])
@pytest.mark.parametrize("net", ["plain", "skip"])
@pytest.mark.parametrize("n", [10, 30, 60])
def test_few_samples_are_not_called_sure(trainer, net, n):
    """With more weights than samples, or nearly: the size of errors is known to its order, and none is absurd."""
    training, test = split(EXACT, 600)
    few = training[:n]
    model = train(few, "all", NetworkConfig(hidden=8, net=net), TrainingConfig(trainer=trainer))
    missed = np.sqrt(np.mean((model.forces(test.resistance_ohm) - test.force_n) ** 2, axis=(0, 1, 2)))
    deviation = np.sqrt(np.mean(model.half_widths(test.resistance_ohm)[0] ** 2, axis=(0, 1, 2)))
    assert (missed < 10 * deviation).all()
    assert (deviation < 2 * np.ptp(training.force_n, axis=(0, 1, 2))).all()


def scores(A, T):
    """The criterion of every ridge by its hat matrix, as written in the paper."""
    n = len(A)
    found = []
    for ridge in RIDGES * n:
        hat = A @ np.linalg.solve(A.T @ A + ridge * np.eye(A.shape[1]), A.T)
        residual = T - hat @ T
        found.append(np.sum(residual**2) / (n - np.trace(hat)) ** 2)
    return np.array(found)


def test_chooses_the_ridge_of_least_score():
    generator = np.random.default_rng(0)
    A = generator.uniform(-1, 1, (40, 6))
    T = A @ generator.standard_normal((6, 3)) * 0.1 + generator.standard_normal((40, 3))
    assert best_ridge(A, T) == RIDGES[scores(A, T).argmin()] * 40


def test_believes_exact_data_and_forgets_noise():
    generator = np.random.default_rng(0)
    A = generator.uniform(-1, 1, (50, 5))
    assert best_ridge(A, A[:, :2]) == RIDGES[0] * 50
    assert best_ridge(A, generator.standard_normal((50, 200))) >= 0.01 * 50
    fewer = generator.uniform(-1, 1, (5, 20))  # samples than features
    assert best_ridge(fewer, generator.standard_normal((5, 3))) in RIDGES * 5


def test_readings_of_one_load_count_once():
    """Ten noisy readings of each of 12 loads that no linear map meets: held as strongly as the 12 loads alone.

    Counted one by one they seem to prove the fit: a tenth of the ridge and less.
    """
    generator = np.random.default_rng(0)
    A, T = generator.uniform(-1, 1, (12, 10)), generator.standard_normal((12, 30))
    often = np.repeat(A, 10, axis=0) + 1e-4 * generator.standard_normal((120, 10)), np.repeat(T, 10, axis=0)
    assert best_ridge(*often, 10.0) / 120 == best_ridge(A, T) / 12
    assert best_ridge(*often) / 120 < 0.1 * best_ridge(A, T) / 12
