"""Trainings at the edge of what can be trained: each fits as well as a mark that needs no training, or is refused."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dataset import DatasetSettings, Imperfections, measured_again, simulate
from decoupler import NetworkConfig, SampleError, TrainingConfig, component_named, evaluate, train
from decoupler.data.columns import Scaling, force_columns, pillar_columns, readable_columns
from decoupler.training.levenberg_marquardt import train_lm
from decoupler.training.network import Network, TrainingSet
from decoupler.training.varpro import RIDGE, train_varpro
from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, Pad, SensorDesign
from geometry.errors import TriPillarError

PARTS = component_named("fz")
HIDDEN = 12  #: more nodes than the 9 outputs, so that a plain net can hold any linear map too
SMALL = 2.0**-20
RIDGED = 1.0 + 1e-6  #: what the ridge of 1e-9 a sample may cost of a mean squared error of 1e-4 or more
KINDS = [(trainer, net) for trainer in ("varpro", "lm") for net in ("plain", "skip")]
#: an input without information; collinear: its root is the mean of two others'
DEGENERATE = {
    "constant": lambda ohm: 1e4,
    "duplicated": lambda ohm: ohm[:, 0, 1, 0],
    "collinear": lambda ohm: np.sqrt(ohm[:, 0, 1:, 0]).mean(axis=1) ** 2,
}


def small_response(pad_mm=12.0):
    design = SensorDesign(array=Array(rows=3, cols=3), pad=Pad(size_mm=pad_mm))
    return solve_response(design, ResponseSettings(method="layer"))


def samples(n=400, seed=1, protocol="independent-fz", **faults):
    loads = simulate(small_response(), DatasetSettings(protocol=protocol, samples=n, seed=seed))
    return measured_again(loads, Imperfections(**{"noise": 1e-3, **faults}), seed).labels()


@pytest.fixture(scope="module")
def data():
    return samples()


def scaled(data):
    """Roots of the readable resistances with a 1, and forces on [-1, 1]."""
    columns = pillar_columns(data.resistance_ohm, PARTS, data.dead)
    roots = np.sqrt(columns[:, readable_columns(PARTS, data.dead, columns.shape[1])])
    forces = force_columns(data.force_n, PARTS)
    return np.hstack([roots, np.ones((len(roots), 1))]), Scaling.fitted(forces).scale(forces)


def linear_mse(data):
    A, targets = scaled(data)
    return np.mean((A @ np.linalg.lstsq(A, targets)[0] - targets) ** 2)


def trained(kind, data, **settings):
    trainer, net = kind
    model = train(data, "fz", NetworkConfig(hidden=HIDDEN, net=net), TrainingConfig(trainer=trainer, **settings))
    return model, model.made_from["outcome"]["mse"]


@pytest.mark.parametrize("kind", KINDS, ids=" ".join)
@pytest.mark.parametrize("name", DEGENERATE)
def test_an_input_without_information_leaves_a_linear_map(kind, name, data):
    ohm = data.resistance_ohm.copy()
    ohm[:, 0, 0, 0] = DEGENERATE[name](ohm)
    given = replace(data, resistance_ohm=ohm)
    assert trained(kind, given)[1] <= RIDGED * linear_mse(given)


@pytest.mark.parametrize("kind", KINDS, ids=" ".join)
def test_noise_of_a_tenth_leaves_a_linear_map(kind):
    given = samples(noise=0.1)
    assert trained(kind, given)[1] <= RIDGED * linear_mse(given)


def test_ten_samples_state_how_little_they_know():
    """Within a factor of ten, or too large."""
    new = samples(seed=2)
    model, _ = trained(("varpro", "skip"), samples(n=10))
    stated, _ = model.half_widths(new.resistance_ohm)
    assert evaluate(model, new)["fz"].rmse_n < 10.0 * np.sqrt(np.mean(stated**2))


@pytest.mark.parametrize("trainer", ["varpro", "lm", "momentum"])
def test_single_precision_and_what_stands_for_the_unreadable_change_no_bit(trainer, data):
    """Float32 arrays train like float64 ones of the same values; so do NaN and 1 Ω at a dead wire."""
    ohm, force_n = data.resistance_ohm.astype(np.float32), data.force_n.astype(np.float32)
    dead = samples(dead_cols=(2,))
    pairs = [
        [replace(data, resistance_ohm=ohm.astype(kept), force_n=force_n.astype(kept)) for kept in (float, np.float32)],
        [replace(dead, resistance_ohm=np.where(dead.dead, kept, dead.resistance_ohm)) for kept in (np.nan, 1.0)],
    ]
    for given in pairs:
        one, other = (trained((trainer, "skip"), each, max_iterations=20)[0] for each in given)
        assert np.array_equal(one.forces(given[0].resistance_ohm), other.forces(given[0].resistance_ohm))


@pytest.mark.parametrize("kind", KINDS, ids=" ".join)
def test_forces_of_another_scale_give_predictions_of_that_scale(kind, data):
    """A power of two rounds alike: to the bit."""
    models = [
        trained(kind, replace(data, force_n=times * data.force_n), max_iterations=20)[0] for times in (1.0, SMALL)
    ]
    one, other = (model.forces(data.resistance_ohm) for model in models)
    assert np.array_equal(SMALL * one, other)


@pytest.mark.parametrize("ohm", [np.nan, np.inf, 0.0, -1.0])
def test_one_resistance_that_is_none_is_refused(ohm, data):
    resistance_ohm = data.resistance_ohm.copy()
    resistance_ohm[7, 1, 2, 0] = ohm
    with pytest.raises(SampleError):
        trained(KINDS[0], replace(data, resistance_ohm=resistance_ohm), max_iterations=1)


@pytest.mark.parametrize(("pad_mm", "is_refused"), [(10.0, False), (8.0, True)])
def test_a_net_corrects_a_response_that_is_nearly_the_sensor_s_and_refuses_another(pad_mm, is_refused):
    """The samples are of a pad of 12 mm."""
    given = samples(protocol="three-axis")
    asked = given, "all", NetworkConfig(hidden=HIDDEN, feature="inverse"), TrainingConfig()
    if is_refused:
        with pytest.raises(TriPillarError):
            train(*asked, response=small_response(pad_mm))
        return
    model, new = train(*asked, response=small_response(pad_mm)), samples(seed=2, protocol="three-axis")
    assert model.least_squares is not None
    ours, linear = (each.forces(new.resistance_ohm) - new.force_n for each in (model, model.least_squares))
    assert np.linalg.norm(ours) < np.linalg.norm(linear)


def start_of(data, net, hidden):
    A, targets = scaled(data)
    inputs = Scaling.fitted(A[:, :-1]).scale(A[:, :-1])
    start = Network(NetworkConfig(hidden=hidden, net=net), inputs.shape[1], targets.shape[1], seed=0)
    return TrainingSet(torch.from_numpy(inputs), torch.from_numpy(targets), skip=net == "skip"), start


@torch.no_grad()
def ended(kind, given, hidden, start, config):
    if kind[0] == "varpro":
        n = len(given.X)
        return train_varpro(given, hidden, RIDGE * n, int(config.held_out * n), config, lambda i, mse: None)[0]
    return train_lm(given, hidden, start.output.detach(), config, lambda i, mse: None)[0]


@pytest.mark.parametrize("kind", KINDS, ids=" ".join)
def test_a_start_of_saturated_nodes_ends_no_worse_than_the_mean_or_a_linear_map(kind, data):
    """Hidden weights 100 times too large: nodes are ±1, their slope 0."""
    given, start = start_of(data, kind[1], HIDDEN)
    point = ended(kind, given, 100.0 * start.hidden.detach(), start, TrainingConfig(trainer=kind[0]))
    assert torch.isfinite(point.hidden).all()
    assert torch.isfinite(point.output).all()
    mark = scaled(data)[1].var(axis=0).mean() if kind[1] == "plain" else linear_mse(data)
    assert point.mse <= RIDGED * mark
