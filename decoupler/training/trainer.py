"""From labelled data to a trained `Decoupler`. Loads torch."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

from dataset import Samples, measured
from dataset.measurement import reading_deviation
from dataset.protocols import MAX_TOUCHED
from dataset.samples import SampleError
from decoupler.data.components import Component, force_columns, pillar_columns, readable_columns
from decoupler.data.errors import TrainingError
from decoupler.data.resting import Resting
from decoupler.data.scaling import Scaling
from decoupler.data.selection import distinct, load_numbers, without_stuck
from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.model_inverse import ModelInverse, explaining
from decoupler.model.baseline import LeastSquares
from decoupler.model.calibration import Calibration
from decoupler.model.decoupler import Decoupler
from decoupler.model.model_file import model_recipe
from decoupler.model.settings import NetworkConfig, TrainingConfig
from decoupler.model.uncertainty import Uncertainty
from decoupler.training.damping import Outcome, Point, Progress, Stop
from decoupler.training.gauss_newton import TrainingSet
from decoupler.training.levenberg_marquardt import train_lm
from decoupler.training.momentum import Momentum
from decoupler.training.network import Network
from decoupler.training.ridge import best_ridge
from decoupler.training.suited import suited_training
from decoupler.training.varpro import RIDGE, SCARCE_RIDGE, train_varpro
from geometry.layout import FloatArray

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

LIGHT = 0.1  #: light samples that training adds where the response is known, a share of those given
UNTOLD = 3e-3  #: of the readings' variance, what a response may leave and still be asked for light samples
TOUCH = 0.05  #: of the largest force: a light touch


def _silent(iteration: int, mse: float) -> None:
    """The progress callback of whoever does not want one."""


def train(
    data: Samples,
    component: str | None = None,
    network: NetworkConfig | None = None,
    training: TrainingConfig | None = None,
    progress: Progress = _silent,
    response: "ArrayResponse | None" = None,
) -> Decoupler:
    """Train one network on all samples of `data`; leave test samples out beforehand.

    Parameters
    ----------
    data : Samples
        At least two samples that differ; one that is given twice counts once.
    component : str, optional
        fz, fx, fy or all; default: the forces that act.
    network : NetworkConfig, optional
        Default: a skip net of 17 hidden nodes, which starts from the response if one is given that explains the data.
    training : TrainingConfig, optional
    progress : callable
        Called as progress(iteration, mse) once an iteration.
    response : ArrayResponse, optional
        Of the sensor; the feature `inverse` needs it, the others do not heed it.

    Returns
    -------
    Decoupler
        ``made_from["outcome"]`` says how its training ended: iterations, mse (of the outputs scaled to [-1, 1]) and
        reason, which is goal, iterations, stagnation or validation.

    Raises
    ------
    ArgumentError, DesignError
        If an argument is of another type, or the component is unknown.
    SampleError
        If there are too few samples, a resistance or force is no number, or the response that the feature needs is
        missing or does not explain the samples.
    TrainingError
        If the momentum rule's learning rate makes the error grow without bound.

    Notes
    -----
    With the feature `inverse` and a skip net the network learns what the response does not say: its targets are the
    forces less those of the response's inverse, which are added back to the linear weights at the end. What it learns
    must not move rest, which data under load do not hold: light samples are added.
    """
    parts, network, training = suited_training(data, component, network, training, response)
    given, data = data, distinct(data, parts)
    if len(data.resistance_ohm) < 2:
        raise SampleError(f"{len(data.resistance_ohm)} samples cannot train a network: give at least 2 that differ.")
    data = without_stuck(data, parts, None if response is None else ForwardModel.of(response, parts))
    columns = pillar_columns(data.resistance_ohm, parts, data.dead)
    forces = force_columns(data.force_n, parts)
    untrained = _untrained(data, parts, network, columns, forces, response)
    known = network.feature == "inverse" and network.net == "skip"
    n_light = 0
    if known and _foretells(untrained, columns, forces, data.noise, data.bits):
        light_ohm, light_n = _light(untrained, forces, data.noise, data.bits)
        n_light = len(light_n)
        columns, forces = np.concatenate([columns, light_ohm]), np.concatenate([forces, light_n])
    inputs = untrained.inputs(columns)
    targets = untrained.output_scaling.scale(forces)
    if known:
        targets = targets - inputs
    samples = TrainingSet(torch.from_numpy(inputs), torch.from_numpy(targets), skip=network.net == "skip")
    model = Network(network, inputs.shape[1], targets.shape[1], training.seed)
    if known:
        torch.nn.init.zeros_(model.output)  # what is known is the start
    load = load_numbers(data.force_n)
    load = np.concatenate([load, load.max() + 1 + np.arange(n_light)])
    with _one_torch_thread():
        readings = len(load) / (load.max() + 1)
        ridge = best_ridge(samples.linear.numpy(), targets, readings) if known else _ridge(network, len(inputs))
        point, outcome = _TRAINERS[training.trainer](model, samples, load, ridge, training, progress)
    output_weights = point.output.numpy().copy()
    if known:
        output_weights[:, network.hidden : -1] += np.eye(len(output_weights))
    trained = replace(untrained, hidden_weights=point.hidden.numpy(), output_weights=output_weights)
    return replace(
        trained,
        uncertainty=Uncertainty.fitted(trained, columns, forces, data.noise, data.bits, ridge, load, n_light),
        made_from={
            "recipe": model_recipe(given, parts.name, network, training, response),
            "data_hash": given.content_hash,
            "n_samples": len(data.force_n),
            "training": asdict(training),
            "outcome": asdict(outcome),
        },
    )


def _ridge(network: NetworkConfig, n_samples: int) -> float:
    """λ on the output weights of a net that knows no response: stronger where it could meet any forces whatever."""
    scarce = network.net == "plain" and n_samples <= network.hidden + 1
    return (SCARCE_RIDGE if scarce else RIDGE) * n_samples


def _untrained(
    data: Samples,
    component: Component,
    network: NetworkConfig,
    columns_ohm: FloatArray,
    force_n: FloatArray,
    response: "ArrayResponse | None",
) -> Decoupler:
    """A decoupler that has its scaling and features, but no weights yet."""
    inverse = calibration = resting = None
    output_scaling = Scaling.fitted(force_n)
    dead = None if data.dead is None or not data.dead.any() else data.dead
    if network.feature == "inverse":
        readable = readable_columns(component, dead, columns_ohm.shape[1])
        forward = explaining(response, component, columns_ohm, force_n, readable)
        calibration = Calibration.fitted(columns_ohm, forward.resistances(force_n), data.noise)
        resting = Resting.read_with(calibration.shown(forward.at_rest_ohm()), data.bits)
        inverse = ModelInverse.about(forward, force_n, readable, data.noise)
        input_scaling = output_scaling
    else:
        input_scaling = Scaling.fitted(np.sqrt(columns_ohm) if network.feature == "root" else columns_ohm)
    nothing = np.empty((0, 0))
    return Decoupler(
        component=component,
        rows=data.resistance_ohm.shape[1],
        cols=data.resistance_ohm.shape[2],
        network=network,
        input_scaling=input_scaling,
        output_scaling=output_scaling,
        hidden_weights=nothing,
        output_weights=nothing,
        design=data.design,
        inverse=inverse,
        calibration=calibration,
        resting=resting,
        dead=dead,
        least_squares=LeastSquares.fitted(data, component),
    )


def _foretells(
    untrained: Decoupler, columns_ohm: FloatArray, force_n: FloatArray, noise: float, bits: int | None
) -> bool:
    """Whether response and calibration leave no more than noise and `UNTOLD` of the readings' variance unexplained.

    What another sensor's response says of rest would be learnt as if it were measured.
    """
    assert untrained.inverse is not None
    assert untrained.calibration is not None
    left = columns_ohm - untrained.calibration.shown(untrained.inverse.forward.resistances(force_n))
    by_noise = reading_deviation(columns_ohm, noise, bits) ** 2
    readable = readable_columns(untrained.component, untrained.dead, columns_ohm.shape[1])
    excess = (left**2 - by_noise)[:, readable].mean(axis=0)
    return bool(excess.mean() <= UNTOLD * columns_ohm[:, readable].var(axis=0).mean())


def _light(untrained: Decoupler, force_n: FloatArray, noise: float, bits: int | None) -> tuple[FloatArray, FloatArray]:
    """Light samples, a quarter at rest, as response and calibration foretell them: (n, n_in) [Ω], (n, n_out) [N].

    In each, none to `MAX_TOUCHED` forces are up to `TOUCH` of the largest that training has of them.
    """
    assert untrained.inverse is not None
    assert untrained.calibration is not None
    generator = np.random.default_rng(0)
    n, n_forces = max(round(LIGHT * len(force_n)), 4), force_n.shape[1]
    touched = generator.random((n, n_forces)).argsort(axis=1) < generator.integers(0, MAX_TOUCHED + 1, (n, 1))
    least, most = np.minimum(force_n.min(axis=0), 0.0), np.maximum(force_n.max(axis=0), 0.0)
    light_n = touched * TOUCH * generator.uniform(least, most, (n, n_forces))
    ohms = untrained.calibration.shown(untrained.inverse.forward.resistances(light_n))
    return measured(ohms, noise, bits, generator), light_n


@contextmanager
def _one_torch_thread() -> Iterator[None]:
    """One torch thread meanwhile: on matrices this small, two are slower as soon as a core is shared."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@torch.no_grad()
def _varpro(
    model: Network,
    samples: TrainingSet,
    load: NDArray[np.int64],
    ridge: float,
    training: TrainingConfig,
    progress: Progress,
) -> tuple[Point, Outcome]:
    # files may be sorted by load; readings of one load stay together, on one side of what is held out
    order = np.argsort(np.random.default_rng(training.seed).permutation(load.max() + 1).argsort()[load], kind="stable")
    mixed, sorted_load = samples[torch.from_numpy(order)], load[order]
    held_out = int(training.held_out * len(load)) if model.skip else 0  # a plain net has no linear map to fall back on
    while 0 < held_out < len(load) and sorted_load[-held_out] == sorted_load[-held_out - 1]:
        held_out -= 1
    return train_varpro(mixed, model.hidden.detach(), ridge, held_out, training, progress)


@torch.no_grad()
def _lm(
    model: Network,
    samples: TrainingSet,
    load: NDArray[np.int64],
    ridge: float,
    training: TrainingConfig,
    progress: Progress,
) -> tuple[Point, Outcome]:
    return train_lm(samples, model.hidden.detach(), model.output.detach(), training, progress)


def _momentum(
    model: Network,
    samples: TrainingSet,
    load: NDArray[np.int64],
    ridge: float,
    training: TrainingConfig,
    progress: Progress,
) -> tuple[Point, Outcome]:
    optimizer = Momentum(model.parameters(), training.learning_rate, training.momentum)
    stop, iteration = Stop(training), 0
    while True:
        optimizer.zero_grad()
        loss = torch.mean((model(samples.X[:, :-1]) - samples.targets) ** 2)
        mse = loss.item()
        progress(iteration, mse)
        if not mse < 1e6:
            raise TrainingError(
                f"the momentum rule ran away (mean squared error {mse:.1e} after {iteration} iterations): "
                f"learning_rate was {training.learning_rate:g}, lower it."
            )
        reason = stop.reason(mse)
        if reason is not None:
            weights = model.hidden.detach(), model.output.detach()
            return Point(*weights, mse, mse), Outcome(iteration, mse, reason)
        loss.backward()
        optimizer.step()
        iteration += 1


_TRAINERS = {"varpro": _varpro, "lm": _lm, "momentum": _momentum}
