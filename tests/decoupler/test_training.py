"""Trainers on a small sensor: they learn, they stop for the reason they give, and a seed fixes the bits."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from decoupler import (
    Decoupler,
    LeastSquares,
    NetworkConfig,
    SampleError,
    TrainingConfig,
    TrainingError,
    component_errors,
    component_named,
    evaluate,
    pca_floor,
    train,
)
from decoupler.data.columns import Columns, force_columns
from decoupler.inverse.forward_model import ForwardModel, ModelInverse
from decoupler.training import trainer
from decoupler.training.varpro import train_varpro
from tests.decoupler.synthetic_sensor import labelled, response, sensor, split

SENSOR = sensor(2, 3)
TRAIN, TEST = split(labelled(SENSOR, "x", n_samples=400, seed=0), 300)
FX = component_named("fx")


@pytest.mark.parametrize("trainer", ["varpro", "lm"])
@pytest.mark.parametrize("net", ["plain", "skip"])
def test_second_order_trainers_reach_the_goal(trainer, net):
    """Nodes enough for six forces: the goal is reached, and unseen samples beat least squares by far."""
    config = TrainingConfig(trainer=trainer, goal_mse=1e-7, held_out=0.0)
    decoupler = train(TRAIN, "fx", NetworkConfig(hidden=12, net=net), config)
    outcome = decoupler.made_from["outcome"]
    assert outcome["reason"] == "goal"
    assert outcome["mse"] <= 1e-7
    linear = component_errors(LeastSquares.fitted(Columns.of(TRAIN, FX)).forces(TEST.resistance_ohm), TEST, FX)["fx"]
    assert evaluate(decoupler, TEST)["fx"].rel_err < linear.rel_err / 4


def test_momentum_rule_learns():
    """It creeps, but ends well below the spread of the forces (scaled variance 1/3)."""
    config = TrainingConfig(trainer="momentum", max_iterations=400)
    outcome = train(TRAIN, "fx", NetworkConfig(hidden=12), config).made_from["outcome"]
    assert outcome["reason"] == "iterations"
    assert outcome["mse"] < 0.02


@pytest.mark.parametrize(("net", "feature"), [("skip", "root"), ("plain", "resistance")])
@pytest.mark.parametrize("trainer", ["varpro", "lm", "momentum"])
def test_reported_error_is_that_of_the_model(trainer, net, feature):
    """Torch on scaled inputs, NumPy on ohms: found again in newtons; 1e-6 is for the rounding of the scaling."""
    network = NetworkConfig(hidden=4, net=net, feature=feature)
    decoupler = train(TRAIN, "fx", network, TrainingConfig(trainer=trainer, max_iterations=5))
    outcome = decoupler.made_from["outcome"]
    error_n = decoupler.forces(TRAIN.resistance_ohm)[..., 0] - TRAIN.force_n[..., 0]
    scaled = error_n.reshape(len(error_n), -1) / decoupler.output_scaling.half_range
    assert np.mean(scaled**2) == pytest.approx(outcome["mse"], rel=1e-6)


@pytest.mark.parametrize("trainer", ["varpro", "lm"])
def test_narrow_plain_net_stops_at_the_pca_floor(trainer):
    """Six independent forces through three nodes: never below the floor, and within 2 % of it."""
    config = TrainingConfig(trainer=trainer, held_out=0.0)
    outcome = train(TRAIN, "fx", NetworkConfig(hidden=3, net="plain"), config).made_from["outcome"]
    floor = pca_floor(TRAIN.force_n, FX, 3).scaled_mse
    assert outcome["reason"] == "stagnation"
    assert floor < outcome["mse"] < 1.02 * floor


@pytest.mark.parametrize("trainer", ["varpro", "lm", "momentum"])
def test_a_net_on_the_response_starts_from_its_inverse(trainer):
    """Before the first step it gives the forces of the inverse itself (rounding), and then no worse ones.

    Of the light samples that training adds, a tenth, the inverse misses less than of the others.
    """
    network = NetworkConfig(hidden=4, feature="inverse")
    config = TrainingConfig(trainer=trainer, goal_mse=0.0, max_iterations=30)
    errors = []
    decoupler = train(TRAIN, "fx", network, config, lambda _, mse: errors.append(mse), response(SENSOR))
    outcome = decoupler.made_from["outcome"]
    columns = decoupler.columns(TRAIN.resistance_ohm)
    known = decoupler.inverse.forces(columns)
    scaled = (known - force_columns(TRAIN.force_n, FX)) / decoupler.output_scaling.half_range
    if trainer != "varpro":  # whose output layer is never at its start
        assert np.mean(scaled**2) / 1.1 <= errors[0] <= np.mean(scaled**2)
    assert outcome["mse"] <= np.mean(scaled**2)


def test_stops_after_the_iterations_it_was_given():
    calls = []
    config = TrainingConfig(goal_mse=0.0, max_iterations=4)
    outcome = train(TRAIN, "fx", NetworkConfig(hidden=4), config, lambda *call: calls.append(call)).made_from["outcome"]
    assert (outcome["iterations"], outcome["reason"]) == (4, "iterations")
    assert [iteration for iteration, _ in calls] == [0, 1, 2, 3, 4]
    errors = [mse for _, mse in calls]
    assert errors == sorted(errors, reverse=True)  # damped steps only ever go down


@pytest.mark.parametrize("trainer", ["varpro", "lm", "momentum"])
def test_a_seed_fixes_the_bits(trainer):
    def weights(seed):
        config = TrainingConfig(trainer=trainer, max_iterations=3, seed=seed)
        return train(TRAIN, "fx", NetworkConfig(hidden=4), config).hidden_weights

    np.testing.assert_array_equal(weights(1), weights(1))
    assert not np.array_equal(weights(1), weights(2))


def test_the_samples_that_judge_are_drawn_from_all(monkeypatch):
    """Files may be sorted by load: not the last samples judge the hidden layer, and a seed says which."""
    seen = []

    def spy(samples, hidden, ridge, held_out, *others):
        seen.append(samples.targets[len(samples.targets) - held_out :].numpy().copy())
        return train_varpro(samples, hidden, ridge, held_out, *others)

    monkeypatch.setattr("decoupler.training.trainer.train_varpro", spy)
    for seed in (1, 1, 2):
        decoupler = train(TRAIN, "fx", NetworkConfig(hidden=2), TrainingConfig(max_iterations=1, seed=seed))
    last = decoupler.output_scaling.scale(force_columns(TRAIN.force_n, FX)[-30:])
    once, again, other = seen
    assert once.shape == last.shape
    np.testing.assert_array_equal(once, again)
    in_last = [(row == last).all(axis=1).any() for row in once]
    assert 0 <= sum(in_last) < 12  # 3 of 30 are expected; 12 or more have a chance of 1e-5
    assert not np.array_equal(once, other)


def test_readings_of_one_load_judge_together_or_not_at_all(monkeypatch):
    """Three readings of each load, a tenth held out: no load on both sides."""
    sides = []

    def spy(samples, hidden, ridge, held_out, *others):
        sides.append((samples.targets[: len(samples.targets) - held_out], samples.targets[-held_out:]))
        return train_varpro(samples, hidden, ridge, held_out, *others)

    monkeypatch.setattr("decoupler.training.trainer.train_varpro", spy)
    factor = 1 + 1e-3 * np.random.default_rng(0).standard_normal((3, *TRAIN.resistance_ohm.shape))
    often = replace(
        TRAIN,
        resistance_ohm=np.concatenate(TRAIN.resistance_ohm * factor),
        force_n=np.tile(TRAIN.force_n, (3, 1, 1, 1)),
    )
    for seed in range(3):
        train(often, "fx", NetworkConfig(hidden=2), TrainingConfig(max_iterations=1, seed=seed))
        fitted, judging = ({tuple(row) for row in side.tolist()} for side in sides[-1])
        assert 0.08 * len(TRAIN.force_n) < len(judging) <= 0.1 * len(TRAIN.force_n)
        assert not fitted & judging


def test_global_state_of_torch_is_left_alone():
    threads, state = torch.get_num_threads(), torch.random.get_rng_state()
    torch.set_num_threads(2)
    try:
        train(TRAIN, "fx", NetworkConfig(hidden=2), TrainingConfig(max_iterations=2))
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(torch.random.get_rng_state(), state)


@pytest.mark.parametrize("trainer", ["varpro", "lm", "momentum"])
def test_awkward_columns_train_to_finite_weights(trainer):
    """A constant, a doubled and a rescaled column, forces in µN: nothing divides by 0 or overflows."""
    R, F = TRAIN.resistance_ohm.copy(), TRAIN.force_n * 1e-6
    R[:, 0, 0, 1] = 20_000.0
    R[:, 0, 1, 1] = R[:, 0, 2, 1]
    R[:, 1, 0, 1] *= 1e6
    F[:, 1, 1, 0] = 3e-6
    decoupler = train(
        replace(TRAIN, resistance_ohm=R, force_n=F),
        "fx",
        NetworkConfig(hidden=4),
        TrainingConfig(trainer=trainer, max_iterations=30),
    )
    outcome = decoupler.made_from["outcome"]
    assert outcome["mse"] < 0.2
    np.testing.assert_allclose(decoupler.forces(R)[:, 1, 1, 0], 3e-6, rtol=1e-15)


@pytest.mark.parametrize("trainer", ["varpro", "lm"])
def test_fewer_samples_than_weights_still_train(trainer):
    few, _ = split(TRAIN, 5)
    outcome = train(few, "fx", NetworkConfig(hidden=12), TrainingConfig(trainer=trainer)).made_from["outcome"]
    assert outcome["reason"] == "goal"


def test_one_sample_is_too_few():
    with pytest.raises(SampleError, match="1 samples cannot train a network"):
        train(split(TRAIN, 1)[0], "fx", NetworkConfig(), TrainingConfig())


def test_a_momentum_rule_that_runs_away_says_so():
    config = TrainingConfig(trainer="momentum", learning_rate=1e3)
    with pytest.raises(TrainingError, match="learning_rate was 1000, lower it"):
        train(TRAIN, "fx", NetworkConfig(hidden=4), config)


def test_what_a_model_was_made_from_is_kept():
    decoupler = train(TRAIN, "fx", NetworkConfig(hidden=4), TrainingConfig(seed=3, max_iterations=2))
    outcome = decoupler.made_from["outcome"]
    assert decoupler.made_from["data_hash"] == TRAIN.content_hash
    assert decoupler.made_from["training"]["seed"] == 3
    assert decoupler.made_from["outcome"]["iterations"] == outcome["iterations"]
    assert decoupler.design == SENSOR


def test_another_sensors_response_is_put_right_at_rest(monkeypatch):
    """Gains and offsets fitted under load leave rest a percent of the resistance off; what they miss is linear.

    A response that leaves more than it may is not asked about rest at all.
    """
    own = response(SENSOR)
    spread = 1.0 + 0.2 * np.random.default_rng(0).standard_normal(own.influence_mm_per_n.shape)
    other = replace(own, influence_mm_per_n=own.influence_mm_per_n * spread)
    network = NetworkConfig(hidden=4, feature="inverse")
    columns = Columns.of(TRAIN, FX)
    rest_ohm = ForwardModel.of(own, FX).at_rest_ohm()
    for given, by_calibration, most in ((own, 0.0, 1e-6), (other, 1e-2, 1e-3)):
        forward = ForwardModel.of(given, FX).calibrated(columns)
        assert np.abs(forward.at_rest_ohm() / rest_ohm - 1.0).max() >= by_calibration
        inverse = ModelInverse.about(forward, columns.force_n, columns.readable, 0.0)
        untrained = Decoupler.untrained(columns, network, SENSOR, inverse)
        light = trainer._with_light_samples(untrained, columns)[len(columns) :]
        at_rest = light.resistance_ohm[~light.force_n.any(axis=1)]
        assert len(light) == 30
        assert len(at_rest) > 2
        assert np.abs(at_rest / rest_ohm - 1.0).max() < most
    model = train(TRAIN, "fx", network, response=other)
    assert model.made_from["n_samples"] == len(TRAIN.force_n)
    missed_n = [one.forces(TEST.resistance_ohm) - TEST.force_n[..., :1] for one in (model, model.least_squares)]
    assert np.std(missed_n[0]) < 0.1 * np.std(missed_n[1])
    monkeypatch.setattr(trainer, "MAX_UNEXPLAINED", 1e-9)
    assert trainer._with_light_samples(untrained, columns) is columns
