"""Trainers × problems on a small sensor: each lowers the error, stops for the reason it gives, and a seed fixes it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from decoupler import (
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
from decoupler.data.columns import Columns, Scaling, force_columns
from decoupler.inverse.sensor_model import SensorModel
from decoupler.training import trainer
from decoupler.training.varpro import train_varpro
from tests.decoupler.synthetic_sensor import labelled, noisy, response, sensor, split

SENSOR = sensor(2, 3)
TRAIN, TEST = split(labelled(SENSOR, "x", n_samples=400, seed=0), 300)
FX = component_named("fx")
RIDGED = 1.0 + 1e-6  #: what the ridge of 1e-9 a sample may cost of a mean squared error of 1e-4 or more
TRAINERS = {"varpro": 200, "lm": 200, "momentum": 400}  #: and how many iterations they are given
EVERY = pytest.mark.parametrize("trainer", TRAINERS)
SECOND_ORDER = pytest.mark.parametrize("trainer", ["varpro", "lm"])
NETS = pytest.mark.parametrize("net", ["plain", "skip"])


def trained(data=TRAIN, progress=lambda *_: None, known=None, hidden=12, net="skip", feature="root", **config):
    network = NetworkConfig(hidden=hidden, net=net, feature=feature)
    return train(data, "fx", network, TrainingConfig(**config), progress, known)


def changed(data, change):
    """The data with other readings of the x pillar of a unit."""
    ohms = data.resistance_ohm.copy()
    ohms[:, 0, 0, 1] = change(ohms[..., 1])
    return replace(data, resistance_ohm=ohms)


def linear_mse(data):
    """What the best linear map of the roots leaves, scaled; a constant is no input."""
    columns = Columns.of(data, FX)
    A = np.column_stack([Scaling.fitted(R := np.sqrt(columns.resistance_ohm)).scale(R), np.ones(len(R))])
    targets = Scaling.fitted(columns.force_n).scale(columns.force_n)
    return np.mean((A @ np.linalg.lstsq(A, targets, rcond=None)[0] - targets) ** 2)


REAL = noisy(TRAIN, 1e-3)
#: no node helps beyond a line where noise is all that is left; degenerate inputs, and units far from newtons
PROBLEMS = {
    "real": REAL,
    "noise": noisy(TRAIN, 0.1),
    "constant": changed(REAL, lambda ohm: 2e4),
    "doubled": changed(REAL, lambda ohm: ohm[:, 0, 1]),
    "collinear": changed(REAL, lambda ohm: np.sqrt(ohm[:, 0, 1:]).mean(axis=1) ** 2),
    "other units": replace(changed(REAL, lambda ohm: 1e6 * ohm[:, 0, 0]), force_n=1e-6 * TRAIN.force_n),
}


@EVERY
@NETS
@pytest.mark.parametrize("problem", PROBLEMS)
def test_each_trainer_solves_each_problem_as_well_as_a_line(trainer, net, problem):
    """The momentum rule creeps: it ends well below the spread of the forces, a scaled variance of 1/3."""
    data, told = PROBLEMS[problem], []
    model = trained(
        data, lambda *call: told.append(call[1]), net=net, trainer=trainer, max_iterations=TRAINERS[trainer]
    )
    outcome = model.made_from["outcome"]
    assert np.isfinite(model.forces(data.resistance_ohm)).all()
    assert told[-1] < told[0] or outcome["reason"] == "validation"
    mark = max(0.08, 2.0 * linear_mse(data)) if trainer == "momentum" else RIDGED * linear_mse(data)
    assert outcome["mse"] <= mark


@SECOND_ORDER
@NETS
def test_second_order_trainers_reach_the_goal_or_the_pca_floor(trainer, net):
    """Nodes enough for six forces: unseen samples beat least squares by far. Three nodes: within 2 % of the floor."""
    decoupler = trained(net=net, trainer=trainer, goal_mse=1e-7, held_out=0.0)
    outcome = decoupler.made_from["outcome"]
    assert (outcome["reason"], outcome["mse"] <= 1e-7) == ("goal", True)
    linear = component_errors(LeastSquares.fitted(Columns.of(TRAIN, FX)).forces(TEST.resistance_ohm), TEST, FX)["fx"]
    assert evaluate(decoupler, TEST)["fx"].rel_err < linear.rel_err / 4
    if net == "plain":
        outcome = trained(hidden=3, net="plain", trainer=trainer, held_out=0.0).made_from["outcome"]
        floor = pca_floor(TRAIN.force_n, FX, 3).scaled_mse
        assert outcome["reason"] == "stagnation"
        assert floor < outcome["mse"] < 1.02 * floor


@EVERY
@pytest.mark.parametrize(("net", "feature"), [("skip", "root"), ("plain", "resistance")])
def test_reported_error_is_that_of_the_model_and_a_seed_fixes_the_bits(trainer, net, feature):
    """Torch on scaled inputs, NumPy on ohms: found again in newtons; 1e-6 is for the rounding of the scaling."""
    told = []
    asked = {"hidden": 4, "net": net, "feature": feature, "trainer": trainer, "goal_mse": 0.0, "max_iterations": 4}
    first, again = trained(progress=lambda *call: told.append(call), **asked), trained(**asked)
    outcome = first.made_from["outcome"]
    error_n = first.forces(TRAIN.resistance_ohm)[..., 0] - TRAIN.force_n[..., 0]
    scaled = error_n.reshape(len(error_n), -1) / first.output_scaling.half_range
    assert np.mean(scaled**2) == pytest.approx(outcome["mse"], rel=1e-6)
    assert (outcome["iterations"], outcome["reason"]) == (4, "iterations")
    assert [iteration for iteration, _ in told] == [0, 1, 2, 3, 4]
    assert [mse for _, mse in told] == sorted((mse for _, mse in told), reverse=True)  # steps only ever go down
    np.testing.assert_array_equal(first.network.hidden, again.network.hidden)
    assert not np.array_equal(first.network.hidden, trained(**asked, seed=1).network.hidden)


@EVERY
def test_a_net_on_the_response_starts_from_its_inverse(trainer):
    """Before the first step it gives the forces of the inverse itself (rounding), and then no worse ones.

    Of the light samples that training adds, a tenth, the inverse misses less than of the others.
    """
    errors = []
    decoupler = trained(
        progress=lambda _, mse: errors.append(mse), known=response(SENSOR), hidden=4, feature="inverse",
        trainer=trainer, goal_mse=0.0, max_iterations=30,
    )  # fmt: skip
    known = decoupler.inverse.values(decoupler.columns(TRAIN.resistance_ohm))
    scaled = (known - force_columns(TRAIN.force_n, FX)) / decoupler.output_scaling.half_range
    if trainer != "varpro":  # whose output layer is never at its start
        assert np.mean(scaled**2) / 1.1 <= errors[0] <= np.mean(scaled**2)
    assert decoupler.made_from["outcome"]["mse"] <= np.mean(scaled**2)


def test_another_sensors_response_is_put_right_at_rest(monkeypatch):
    """Gains and offsets fitted under load leave rest a percent of the resistance off; what they miss is linear.

    A response that leaves more than it may is not asked about rest at all.
    """
    own = response(SENSOR)
    spread = 1.0 + 0.2 * np.random.default_rng(0).standard_normal(own.influence_mm_per_n.shape)
    other = replace(own, influence_mm_per_n=own.influence_mm_per_n * spread)
    columns, rest_ohm = Columns.of(TRAIN, FX), SensorModel.of(own, FX).at_rest_ohm()
    forward = SensorModel.of(other, FX).calibrated(columns)
    assert np.abs(forward.at_rest_ohm() / rest_ohm - 1.0).max() >= 1e-2
    known = forward, Scaling.fitted(columns.force_n), columns
    light = trainer._with_light_samples(*known)[len(columns) :]
    assert np.abs(light.resistance_ohm[~light.force_n.any(axis=1)] / rest_ohm - 1.0).max() < 1e-3
    model = trained(hidden=4, feature="inverse", known=other)
    assert model.made_from["n_samples"] == len(TRAIN)
    missed_n = [one.forces(TEST.resistance_ohm) - TEST.force_n[..., :1] for one in (model, model.least_squares)]
    assert np.std(missed_n[0]) < 0.1 * np.std(missed_n[1])
    monkeypatch.setattr(trainer, "MAX_UNEXPLAINED", 1e-9)
    assert trainer._with_light_samples(*known) is columns


def test_the_samples_that_judge_are_drawn_from_all_and_readings_of_one_load_stay_together(monkeypatch):
    """Files may be sorted by load: not the last samples judge, a seed says which, and no load is on both sides."""
    sides = []

    def spy(samples, *others):
        task = samples.task
        parts = np.delete(task.targets, task.held_out, axis=0), task.targets[task.held_out]
        sides.append([{tuple(row) for row in side.tolist()} for side in parts])
        return train_varpro(samples, *others)

    monkeypatch.setattr("decoupler.training.varpro.train_varpro", spy)
    data = TRAIN[1:]  # of 897 readings a tenth is no whole number of loads
    factor = 1 + 1e-3 * np.random.default_rng(0).standard_normal((3, *data.resistance_ohm.shape))
    often = replace(
        data,
        resistance_ohm=np.concatenate(data.resistance_ohm * factor),
        force_n=np.tile(data.force_n, (3, 1, 1, 1)),
    )
    for seed in (1, 1, 2):
        scaling = trained(often, hidden=2, max_iterations=1, seed=seed).output_scaling
    last = {tuple(row) for row in scaling.scale(force_columns(TRAIN.force_n, FX)[-30:]).tolist()}
    (fitted, once), (_, again), (_, other) = sides
    assert 0.08 * len(data) < len(once) <= 0.1 * len(data)
    assert not fitted & once
    assert once == again != other
    assert len(once & last) < 12  # 3 of 30 are expected; 12 or more have a chance of 1e-5


def test_a_training_leaves_torch_alone_says_where_it_runs_away_and_that_one_sample_is_none():
    threads, state = torch.get_num_threads(), torch.random.get_rng_state()
    torch.set_num_threads(2)
    try:
        assert trained(TRAIN[:5]).made_from["outcome"]["reason"] == "goal"  # fewer samples than weights
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(torch.random.get_rng_state(), state)
    for data, config, error, said in (
        (TRAIN, {"trainer": "momentum", "learning_rate": 1e3}, TrainingError, "learning_rate was 1000, lower it"),
        (TRAIN[:1], {}, SampleError, "1 samples cannot train a network"),
    ):
        with pytest.raises(error, match=said):
            trained(data, **config)
