"""Trainers: their algebra against dense matrices, trainers × problems, and how sure few samples make."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from decoupler import LeastSquares, NetworkConfig, SampleError, TrainingConfig, TrainingError, component_named, train
from decoupler.data.columns import Columns, Scaling, force_columns
from decoupler.evaluation.metrics import component_errors, evaluate, pca_floor
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.network import Task
from decoupler.solve import RIDGES, best_ridge
from decoupler.training import fitting
from decoupler.training.damping import Point
from decoupler.training.levenberg_marquardt import GaussNewton
from decoupler.training.momentum import momentum_step
from decoupler.training.varpro import Projected, projected, train_varpro
from decoupler.training.weights import TrainingSet, starting_weights
from tests.decoupler.synthetic_sensor import labelled, noisy, response, sensor, split

N_SAMPLES, N_IN, N_HIDDEN, N_OUT = 50, 4, 3, 5
RIDGE = 0.1


def assert_close(actual, expected):
    """1e-10 is for rounding only."""
    assert torch.linalg.norm(actual - expected) <= 1e-10 * torch.linalg.norm(expected)


def eye(n):
    return torch.eye(n, dtype=torch.float64)


def task(inputs, targets, net="skip", **training):
    """Samples of a network of a few nodes, each of a load of its own."""
    return Task(
        inputs=inputs, targets=targets, load=np.arange(len(inputs)), shape=(1, 1), is_known=False,
        form=NetworkConfig(hidden=N_HIDDEN, net=net), training=TrainingConfig(seed=2, **training),
        progress=lambda *_: None,
    )  # fmt: skip


@pytest.fixture(params=["plain", "skip"])
def problem(request):
    """Samples, and weights W₁ and W₂ away from any special point."""
    inputs, targets = (np.random.default_rng(1).uniform(-1, 1, (N_SAMPLES, n)) for n in (N_IN, N_OUT))
    samples = TrainingSet(task(inputs, targets, request.param), request.param == "skip")
    return samples, *starting_weights(samples)


def test_blocks_gradient_and_step_equal_the_dense_ones(problem):
    """K ∘ ZᵀZ, I ⊗ AᵀA and W₂ C between them, put together, are JᵀJ."""
    samples, hidden, output = problem

    def residual(hidden, output):
        A = torch.cat([torch.tanh(samples.X @ hidden.T), samples.linear], dim=1)
        return (A @ output.T - samples.targets).reshape(-1)

    J = torch.cat([J.flatten(1) for J in torch.func.jacrev(residual, argnums=(0, 1))(hidden, output)], dim=1)
    blocks, p = GaussNewton(samples, Point.at(samples, samples.activations(hidden), hidden, output)), N_IN + 1
    K = blocks.K.repeat_interleave(p, 0).repeat_interleave(p, 1)
    C = blocks.C.view(N_HIDDEN, p, -1)
    between = torch.einsum("kj,jab->jakb", blocks.W2, C).reshape(N_HIDDEN * p, -1)
    AtA = torch.kron(eye(N_OUT), blocks.AtA)
    assert_close(torch.cat([torch.cat([K * blocks.ZtZ, between], 1), torch.cat([between.T, AtA], 1)], 0), J.T @ J)
    assert blocks.scale == pytest.approx((J.T @ J).diagonal().max().item(), rel=1e-12)
    downhill = J.T @ residual(hidden, output)
    assert_close(torch.cat([blocks.gradient.flatten(), blocks.gradient_output.flatten()]), downhill)
    for damping in (1e-3, 1.0, 1e3):
        step = blocks.direction(damping)
        expected = torch.linalg.solve(J.T @ J + damping * eye(J.shape[1]), -downhill)
        assert_close(torch.cat([step[0].flatten(), step[1].flatten()]), expected)


def test_variable_projection_is_kaufmans(problem):
    """Products, blocks, gradient and steps by the dense J₁ᵀJ₁ less what the output layer can follow."""
    samples, start, _ = problem
    point, p = projected(samples, start, RIDGE), N_IN + 1

    def outputs(hidden, output):
        return (samples.activations(hidden) @ output.T).reshape(-1)

    J1, J2 = (J.flatten(1) for J in torch.func.jacrev(outputs, argnums=(0, 1))(point.hidden, point.output))
    matrix = J1.T @ J1 - J1.T @ J2 @ torch.linalg.solve(J2.T @ J2 + RIDGE * eye(J2.shape[1]), J2.T @ J1)
    model = Projected(samples, RIDGE, point)
    columns = [model.product(e.reshape(N_HIDDEN, p)).reshape(-1) for e in eye(len(matrix))]
    assert_close(torch.stack(columns, dim=1), matrix)
    assert_close(model.blocks, torch.stack([matrix[j : j + p, j : j + p] for j in range(0, N_HIDDEN * p, p)]))
    assert model.scale == pytest.approx(matrix.diagonal().max().item(), rel=1e-10)

    hidden = point.hidden.clone().requires_grad_()
    A = samples.activations(hidden)
    output = torch.linalg.solve(A.T @ A + RIDGE * eye(A.shape[1]), A.T @ samples.targets)
    cost = 0.5 * ((A @ output - samples.targets) ** 2).sum() + 0.5 * RIDGE * (output**2).sum()
    cost.backward()
    assert point.cost == pytest.approx(cost.item(), rel=1e-12)
    assert_close(model.gradient, hidden.grad)

    for damping in (1e-2, 1.0, 1e2):
        found = model.direction(damping, close_enough=0.0, most_products=3 * len(matrix))
        damped = matrix + damping * eye(len(matrix))
        assert_close(found.reshape(-1), torch.linalg.solve(damped, -model.gradient.reshape(-1)))
    trial, promised = model.step(0.1)  # which stops early: the fall of the quadratic −gᵀd − ½ dᵀHd all the same
    d = (trial.hidden - point.hidden).reshape(-1)
    assert promised == pytest.approx((-model.gradient.reshape(-1) @ d - d @ matrix @ d / 2).item(), rel=1e-8)


def test_hidden_layer_never_sees_what_is_held_out():
    """Other targets of the held-out samples leave the path of hidden layers as it was, whichever of them is chosen."""
    inputs = np.random.default_rng(3).uniform(-1, 1, (80, 2))
    targets = np.sin(2 * inputs) + inputs[:, :1] * inputs[:, 1:]
    asked = task(inputs, targets, max_iterations=6, goal_mse=0.0, patience=99)
    assert len(asked.held_out) == 8
    paths = []
    for changed in (0.0, 0.01):
        other, errors = asked.targets.copy(), []
        other[asked.held_out] += changed
        told = replace(asked, targets=other, progress=lambda _, mse, to=errors: to.append(mse))
        train_varpro(samples := TrainingSet(told, True), *starting_weights(samples))
        paths.append(errors)
    assert paths[0] == paths[1]


def test_follows_eq_15():
    """v(N+1) = v(N) + α[(1−η) g(N) + η g(N−1)] on f = Σ c v²/2 with g = −c v and g(−1) = 0, to rounding."""
    config = TrainingConfig(trainer="momentum", learning_rate=0.3, momentum=0.4)
    c = torch.tensor([0.5, 1.0, 2.0], dtype=torch.float64)
    v = by_hand = torch.tensor([1.0, -2.0, 3.0], dtype=torch.float64)
    before = g_before = torch.zeros(3, dtype=torch.float64)
    for _ in range(20):
        gradient = c * v
        v, before = momentum_step(v, gradient, before, config), gradient
        g = -c * by_hand
        by_hand, g_before = by_hand + 0.3 * ((1 - 0.4) * g + 0.4 * g_before), g
        torch.testing.assert_close(v, by_hand, rtol=1e-13, atol=0)


SENSOR = sensor(2, 3)
TRAIN, TEST = split(labelled(SENSOR, "x", n_samples=400, seed=0), 300)
FX = component_named("fx")
RIDGED = 1.0 + 1e-6  #: what the ridge of 1e-9 a sample may cost of a mean squared error of 1e-4 or more
TRAINERS = {"varpro": 200, "lm": 200, "momentum": 400}  #: and how many iterations they are given
EVERY = pytest.mark.parametrize("trainer", TRAINERS)
SECOND_ORDER = pytest.mark.parametrize("trainer", ["varpro", "lm"])
NETS = pytest.mark.parametrize("net", ["plain", "skip"])


def trained(
    data=TRAIN, progress=lambda *_: None, known=None, hidden=12, net="skip", feature="root", asked="fx", **config
):
    network = NetworkConfig(hidden=hidden, net=net, feature=feature)
    return train(data, asked, network, TrainingConfig(**config), progress, known)


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
    asked = {"net": net, "trainer": trainer, "max_iterations": TRAINERS[trainer]}
    model = trained(data, lambda *call: told.append(call[1]), **asked)
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
    """Before the first step it gives the forces of the inverse itself (rounding), and then no worse ones."""
    errors = []
    decoupler = trained(
        progress=lambda _, mse: errors.append(mse), known=response(SENSOR), hidden=4, feature="inverse",
        trainer=trainer, goal_mse=0.0, max_iterations=30,
    )  # fmt: skip
    known = decoupler.inverse.values(decoupler.columns(TRAIN.resistance_ohm))
    scaled = (known - force_columns(TRAIN.force_n, FX)) / decoupler.output_scaling.half_range
    if trainer != "varpro":  # whose output layer is never at its start; of the tenth of light samples less is missed
        assert np.mean(scaled**2) / 1.1 <= errors[0] <= np.mean(scaled**2)
    assert decoupler.made_from["outcome"]["mse"] <= np.mean(scaled**2)


def test_another_sensors_response_is_put_right_at_rest(monkeypatch):
    """Gains and offsets fitted under load leave rest a percent of the resistance off; what they miss is linear."""
    own = response(SENSOR)
    spread = 1.0 + 0.2 * np.random.default_rng(0).standard_normal(own.influence_mm_per_n.shape)
    other = replace(own, influence_mm_per_n=own.influence_mm_per_n * spread)
    columns, rest_ohm = Columns.of(TRAIN, FX), SensorModel.of(own, FX).at_rest_ohm()
    forward = SensorModel.of(other, FX).calibrated(columns)
    assert np.abs(forward.at_rest_ohm() / rest_ohm - 1.0).max() >= 1e-2
    known = forward, Scaling.fitted(columns.force_n), columns
    light = fitting._with_light_samples(*known)[len(columns) :]
    assert np.abs(light.resistance_ohm[~light.force_n.any(axis=1)] / rest_ohm - 1.0).max() < 1e-3
    model = trained(hidden=4, feature="inverse", known=other)
    assert model.made_from["n_samples"] == len(TRAIN)
    missed_n = [one.forces(TEST.resistance_ohm) - TEST.force_n[..., :1] for one in (model, model.least_squares)]
    assert np.std(missed_n[0]) < 0.1 * np.std(missed_n[1])
    monkeypatch.setattr(fitting, "MAX_UNEXPLAINED", 1e-9)
    assert fitting._with_light_samples(*known) is columns  # a response that leaves more is not asked about rest


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
    often = data[np.tile(np.arange(len(data)), 3)]
    often = replace(often, resistance_ohm=np.concatenate(data.resistance_ohm * factor))
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


EXACT = labelled(SENSOR, "xyz", n_samples=900, seed=0)
JOINT, UNSEEN = split(noisy(EXACT, 1e-3), 600)
FEATURES = pytest.mark.parametrize("feature", ["inverse", "root"])


def jointly(data, feature):
    return trained(data, known=response(SENSOR), hidden=6, feature=feature, asked="all")


@FEATURES
def test_samples_given_ten_times_are_known_no_better_and_a_sound_sensor_is_trusted(feature):
    """The same model, to the bit, as of each sample once; repeated in whatever order."""
    once, often = (jointly(JOINT[which], feature) for which in (np.arange(20), np.tile(np.arange(20), 10)))
    R = UNSEEN.resistance_ohm
    assert np.array_equal(often.forces(R), once.forces(R))
    assert np.array_equal(often.half_widths(R), once.half_widths(R))
    assert once.untrusted() == [] or feature == "root"  # of 20 samples
    unjudged = train(JOINT[:20], "all", NetworkConfig(feature=feature), response=response(SENSOR), judged=False)
    assert (unjudged.half_widths(R)[0] >= np.ptp(JOINT[:20].force_n, axis=0) / 2).all()  # as before training


@FEATURES
@pytest.mark.parametrize(("noise", "loads"), [(1e-3, 20), (1e-2, 60)])
def test_ten_readings_of_each_load_do_not_vouch_for_each_other(feature, noise, loads):
    """They share the error at their load: at least as many errors within the deviations as said; 4, 2 % is chance."""
    _, test = split(noisy(EXACT, noise), 600)
    F, R = (np.repeat(a[:loads], 10, axis=0) for a in (EXACT.force_n, EXACT.resistance_ohm))
    R = R * (1 + noise * np.random.default_rng(2).standard_normal(R.shape))
    model = jointly(replace(EXACT, force_n=F, resistance_ohm=R, noise=noise), feature)
    missed = np.abs(model.forces(test.resistance_ohm) - test.force_n)
    one, two = model.half_widths(test.resistance_ohm)
    assert np.mean(missed <= one) > 0.6827 - 0.04  # 0.13 and 0.24 before loads were left out whole
    assert np.mean(missed <= two) > 0.9545 - 0.02
    assert np.median(one) < np.ptp(EXACT.force_n, axis=(0, 1, 2)).max()


@SECOND_ORDER
@NETS
def test_few_samples_are_not_called_sure(trainer, net):
    """With more weights than samples the size of errors is known to its order, and none is absurd."""
    training, test = split(EXACT, 600)
    model = train(training[:10], "all", NetworkConfig(hidden=8, net=net), TrainingConfig(trainer=trainer))
    missed = np.sqrt(np.mean((model.forces(test.resistance_ohm) - test.force_n) ** 2, axis=(0, 1, 2)))
    deviation = np.sqrt(np.mean(model.half_widths(test.resistance_ohm)[0] ** 2, axis=(0, 1, 2)))
    assert (missed < 10 * deviation).all()
    assert (deviation < 2 * np.ptp(training.force_n, axis=(0, 1, 2))).all()


def test_the_ridge_is_that_of_the_least_score_and_readings_of_one_load_count_once():
    """By its hat matrix, as written in the paper: it believes exact data and forgets noise."""
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
    assert best_ridge(*often, 10.0) / 120 == best_ridge(A, T) / 12  # ten noisy readings of each load are as strong
    assert best_ridge(*often) / 120 < 0.1 * best_ridge(A, T) / 12
