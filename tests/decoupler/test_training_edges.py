"""Trainings at the edge of what can be trained: each fits as well as a mark that needs no training, or is refused."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

from dataset import DatasetSettings, Imperfections, measured_again, simulate
from decoupler import NetworkConfig, TrainingConfig, component_named, train
from decoupler.data.columns import Columns, Scaling
from decoupler.training.levenberg_marquardt import train_lm
from decoupler.training.network import Network, TrainingSet
from decoupler.training.varpro import RIDGE, train_varpro
from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, Pad, SensorDesign
from geometry.errors import TriPillarError

HIDDEN = 12  #: more nodes than the 9 outputs, so that a plain net can hold any linear map too
SMALL = 2.0**-20
RIDGED = 1.0 + 1e-6  #: what the ridge of 1e-9 a sample may cost of a mean squared error of 1e-4 or more
KINDS = pytest.mark.parametrize("kind", [(t, n) for t in ("varpro", "lm") for n in ("plain", "skip")], ids=" ".join)
#: what one input reads that tells nothing; collinear: its root is the mean of two others'
DEGENERATE = {
    "constant": lambda ohm: 1e4,
    "duplicated": lambda ohm: ohm[:, 0, 1, 0],
    "collinear": lambda ohm: np.sqrt(ohm[:, 0, 1:, 0]).mean(axis=1) ** 2,
}


@cache
def small_response(pad_mm=12.0):
    design = SensorDesign(array=Array(rows=3, cols=3), pad=Pad(size_mm=pad_mm))
    return solve_response(design, ResponseSettings(method="layer"))


@cache
def samples(n=400, seed=1, protocol="independent-fz", **faults):
    loads = simulate(small_response(), DatasetSettings(protocol=protocol, samples=n, seed=seed))
    return measured_again(loads, Imperfections(**{"noise": 1e-3, **faults}), seed).labels()


def scaled(data):
    """Roots of the readable resistances with a 1, and forces on [-1, 1]."""
    columns = Columns.of(data, component_named("fz"))
    roots = np.sqrt(columns.resistance_ohm[:, columns.readable])
    return np.hstack([roots, np.ones((len(roots), 1))]), Scaling.fitted(columns.force_n).scale(columns.force_n)


def linear_mse(data):
    A, targets = scaled(data)
    return np.mean((A @ np.linalg.lstsq(A, targets)[0] - targets) ** 2)


def trained(kind, data, **settings):
    trainer, net = kind
    return train(data, "fz", NetworkConfig(hidden=HIDDEN, net=net), TrainingConfig(trainer=trainer, **settings))


@KINDS
def test_an_input_without_information_and_noise_leave_a_linear_map(kind):
    given = [samples(noise=0.1)]
    for useless in DEGENERATE.values():
        ohm = samples().resistance_ohm.copy()
        ohm[:, 0, 0, 0] = useless(ohm)
        given.append(replace(samples(), resistance_ohm=ohm))
    for data in given:
        assert trained(kind, data).made_from["outcome"]["mse"] <= RIDGED * linear_mse(data)


@pytest.mark.parametrize("trainer", ["varpro", "lm", "momentum"])
def test_single_precision_and_what_stands_for_the_unreadable_change_no_bit(trainer):
    """Float32 arrays train like float64 ones of the same values; so do NaN and 1 Ω at a dead wire."""
    data, dead = samples(), samples(dead_cols=(2,))
    ohm, force_n = data.resistance_ohm.astype(np.float32), data.force_n.astype(np.float32)
    pairs = [
        [replace(data, resistance_ohm=ohm.astype(kept), force_n=force_n.astype(kept)) for kept in (float, np.float32)],
        [replace(dead, resistance_ohm=np.where(dead.dead, kept, dead.resistance_ohm)) for kept in (np.nan, 1.0)],
    ]
    for given in pairs:
        one, other = (trained((trainer, "skip"), each, max_iterations=20) for each in given)
        assert np.array_equal(one.forces(given[0].resistance_ohm), other.forces(given[0].resistance_ohm))


@KINDS
def test_forces_of_another_scale_give_predictions_of_that_scale(kind):
    """A power of two rounds alike: to the bit."""
    data = samples()
    one, other = (
        trained(kind, replace(data, force_n=times * data.force_n), max_iterations=20).forces(data.resistance_ohm)
        for times in (1.0, SMALL)
    )
    assert np.array_equal(SMALL * one, other)


def test_a_net_corrects_a_response_that_is_nearly_the_sensor_s_and_refuses_another():
    """The samples are of a pad of 12 mm."""
    asked = samples(protocol="three-axis"), "all", NetworkConfig(hidden=HIDDEN, feature="inverse"), TrainingConfig()
    with pytest.raises(TriPillarError):
        train(*asked, response=small_response(8.0))
    model, new = train(*asked, response=small_response(10.0)), samples(seed=2, protocol="three-axis")
    ours, linear = (each.forces(new.resistance_ohm) - new.force_n for each in (model, model.least_squares))
    assert np.linalg.norm(ours) < np.linalg.norm(linear)


@KINDS
@torch.no_grad()
def test_a_start_of_saturated_nodes_ends_no_worse_than_the_mean_or_a_linear_map(kind):
    """Hidden weights 100 times too large: nodes are ±1, their slope 0."""
    (trainer, net), (A, targets) = kind, scaled(samples())
    inputs = Scaling.fitted(A[:, :-1]).scale(A[:, :-1])
    start = Network(NetworkConfig(hidden=HIDDEN, net=net), inputs.shape[1], targets.shape[1], seed=0)
    given = TrainingSet(torch.from_numpy(inputs), torch.from_numpy(targets), skip=net == "skip")
    hidden, output = 100.0 * start.hidden.detach(), start.output.detach()
    config, n, silent = TrainingConfig(trainer=trainer), len(A), lambda *_: None
    if trainer == "varpro":
        point, _ = train_varpro(given, hidden, RIDGE * n, n // 10, config, silent)
    else:
        point, _ = train_lm(given, hidden, output, config, silent)
    assert torch.isfinite(point.hidden).all()
    assert torch.isfinite(point.output).all()
    assert point.mse <= RIDGED * (targets.var(axis=0).mean() if net == "plain" else linear_mse(samples()))
