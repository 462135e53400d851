"""Half-widths of few, repeated and stuck readings, on samples that training never saw; the ridge by its definition."""

from dataclasses import replace

import numpy as np
import pytest

from decoupler import NetworkConfig, TrainingConfig, train
from decoupler.solve import RIDGES, best_ridge
from tests.decoupler.synthetic_sensor import labelled, noisy, response, sensor, split

SENSOR = sensor(2, 3)
EXACT = labelled(SENSOR, "xyz", n_samples=900, seed=0)
TRAIN, TEST = split(noisy(EXACT, 1e-3), 600)
FEATURES = pytest.mark.parametrize("feature", ["inverse", "root"])


def trained(data, feature, **config):
    return train(
        data, "all", NetworkConfig(hidden=6, feature=feature), TrainingConfig(**config), response=response(SENSOR)
    )


@FEATURES
@pytest.mark.parametrize(("at_ohm", "wanders_ohm"), [(3e3, 30.0), (1e9, 0.0)], ids=["stuck", "open"])
def test_a_pillar_stuck_in_training_is_masked_and_its_unit_named(feature, at_ohm, wanders_ohm):
    """To the bit the model of a pillar stated as dead, whether it is alive later or not; 576 N is the range."""
    dead = np.zeros((2, 3, 3), dtype=bool)
    dead[1, 2, 0] = True
    read_ohm = at_ohm + wanders_ohm * np.random.default_rng(5).uniform(-1.0, 1.0, (600, 1, 1, 1))
    stuck, later = (
        replace(data, resistance_ohm=np.where(dead, read_ohm[: len(data)], data.resistance_ohm))
        for data in (TRAIN, TEST)
    )
    model = trained(stuck, feature, max_iterations=20)
    stated = trained(replace(TRAIN, dead=dead), feature, max_iterations=20)
    assert np.array_equal(model.dead, dead)
    assert {(row, col) for row, col, _ in model.untrusted()} == {(1, 2)}
    forces = model.forces(TEST.resistance_ohm)
    assert np.array_equal(forces, stated.forces(np.where(dead, np.nan, TEST.resistance_ohm)))
    assert np.array_equal(forces, model.forces(later.resistance_ohm))
    assert np.abs(forces - TEST.force_n).max() < 576
    missed = np.sqrt(((forces - TEST.force_n) ** 2).mean(axis=0))[..., 2].reshape(-1)
    assert missed[5] > 3 * missed[:5].max()


@FEATURES
def test_samples_given_ten_times_are_known_no_better_and_a_sound_sensor_is_trusted(feature):
    """The same model, to the bit, as of each sample once; repeated in whatever order."""
    once, often = (trained(TRAIN[which], feature) for which in (np.arange(20), np.tile(np.arange(20), 10)))
    R = TEST.resistance_ohm
    assert np.array_equal(often.forces(R), once.forces(R))
    assert np.array_equal(often.half_widths(R), once.half_widths(R))
    assert once.untrusted() == [] or feature == "root"  # of 20 samples
    unjudged = train(TRAIN[:20], "all", NetworkConfig(feature=feature), response=response(SENSOR), judged=False)
    assert (unjudged.half_widths(R)[0] >= np.ptp(TRAIN[:20].force_n, axis=0) / 2).all()  # as before training


@FEATURES
@pytest.mark.parametrize(("noise", "loads"), [(1e-3, 20), (1e-2, 60)])
def test_ten_readings_of_each_load_do_not_vouch_for_each_other(feature, noise, loads):
    """They share the error at their load: at least as many errors within the deviations as said; 4 and 2 % is chance.

    Before loads were left out whole, 13 % and 24 % of errors lay within.
    """
    _, test = split(noisy(EXACT, noise), 600)
    F, R = (np.repeat(a[:loads], 10, axis=0) for a in (EXACT.force_n, EXACT.resistance_ohm))
    R = R * (1 + noise * np.random.default_rng(2).standard_normal(R.shape))
    model = trained(replace(EXACT, force_n=F, resistance_ohm=R, noise=noise), feature)
    missed = np.abs(model.forces(test.resistance_ohm) - test.force_n)
    one, two = model.half_widths(test.resistance_ohm)
    assert np.mean(missed <= one) > 0.6827 - 0.04
    assert np.mean(missed <= two) > 0.9545 - 0.02
    assert np.median(one) < np.ptp(EXACT.force_n, axis=(0, 1, 2)).max()


@pytest.mark.parametrize("trainer", ["varpro", "lm"])
@pytest.mark.parametrize("net", ["plain", "skip"])
def test_few_samples_are_not_called_sure(trainer, net):
    """With more weights than samples the size of errors is known to its order, and none is absurd."""
    training, test = split(EXACT, 600)
    model = train(training[:10], "all", NetworkConfig(hidden=8, net=net), TrainingConfig(trainer=trainer))
    missed = np.sqrt(np.mean((model.forces(test.resistance_ohm) - test.force_n) ** 2, axis=(0, 1, 2)))
    deviation = np.sqrt(np.mean(model.half_widths(test.resistance_ohm)[0] ** 2, axis=(0, 1, 2)))
    assert (missed < 10 * deviation).all()
    assert (deviation < 2 * np.ptp(training.force_n, axis=(0, 1, 2))).all()


def test_the_ridge_is_that_of_the_least_score_and_readings_of_one_load_count_once():
    """By its hat matrix, as written in the paper: it believes exact data and forgets noise.

    Ten noisy readings of each of 12 loads are held as strongly as the 12; one by one they seem to prove the fit.
    """
    generator = np.random.default_rng(0)
    A = generator.uniform(-1, 1, (40, 6))
    T = A @ generator.standard_normal((6, 3)) * 0.1 + generator.standard_normal((40, 3))
    scores = []
    for ridge in RIDGES * 40:
        hat = A @ np.linalg.solve(A.T @ A + ridge * np.eye(6), A.T)
        scores.append(np.sum((T - hat @ T) ** 2) / (40 - np.trace(hat)) ** 2)
    assert best_ridge(A, T) == RIDGES[np.argmin(scores)] * 40
    assert best_ridge(A, A[:, :2]) == RIDGES[0] * 40
    assert best_ridge(A, generator.standard_normal((40, 200))) >= 0.01 * 40
    generator = np.random.default_rng(0)
    A, T = generator.uniform(-1, 1, (12, 10)), generator.standard_normal((12, 30))
    often = np.repeat(A, 10, axis=0) + 1e-4 * generator.standard_normal((120, 10)), np.repeat(T, 10, axis=0)
    assert best_ridge(*often, 10.0) / 120 == best_ridge(A, T) / 12
    assert best_ridge(*often) / 120 < 0.1 * best_ridge(A, T) / 12
