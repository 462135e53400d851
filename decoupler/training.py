"""From labelled data to a trained `Decoupler`. Loads torch."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass

import torch

from dataset import LabelledData
from decoupler.components import component_named, force_columns, pillar_columns
from decoupler.damping import Outcome, Point, Progress, Stop
from decoupler.decoupler import Decoupler, features
from decoupler.errors import SampleError, TrainingError
from decoupler.gauss_newton import Samples
from decoupler.levenberg_marquardt import train_lm
from decoupler.model_file import model_recipe
from decoupler.momentum import Momentum
from decoupler.network import Network
from decoupler.scaling import Scaling
from decoupler.settings import NetworkConfig, TrainingConfig
from decoupler.varpro import train_varpro


@dataclass(frozen=True, kw_only=True)
class History:
    """How a training went."""

    iterations: int
    mse: float  #: mean squared error of the outputs scaled to [-1, 1], on the training set
    reason: str  #: why it stopped: goal, iterations or stagnation
    seconds: float


def _silent(iteration: int, mse: float) -> None:
    """The progress callback of whoever does not want one."""


def train(
    data: LabelledData,
    component: str,
    network: NetworkConfig,
    training: TrainingConfig,
    progress: Progress = _silent,
) -> tuple[Decoupler, History]:
    """Train one network on all samples of `data`; leave test samples out beforehand.

    Parameters
    ----------
    data : LabelledData
        At least two samples.
    component : str
        fz, fx, fy or all.
    network, training : NetworkConfig, TrainingConfig
    progress : callable
        Called as progress(iteration, mse) once an iteration.

    Raises
    ------
    SampleError
        If there are too few samples, or a resistance or force is no number.
    TrainingError
        If the momentum rule's learning rate makes the error grow without bound.
    """
    started = time.perf_counter()
    parts = component_named(component)
    if len(data.resistance_ohm) < 2:
        raise SampleError(f"{len(data.resistance_ohm)} samples cannot train a network: give at least 2.")
    inputs = features(pillar_columns(data.resistance_ohm, parts), network.feature)
    targets = force_columns(data.force_n, parts)
    input_scaling, output_scaling = Scaling.fitted(inputs), Scaling.fitted(targets)
    x = torch.from_numpy(input_scaling.scale(inputs))
    t = torch.from_numpy(output_scaling.scale(targets))
    model = Network(network, x.shape[1], t.shape[1], training.seed)
    with _one_torch_thread():
        point, outcome = _TRAINERS[training.trainer](model, x, t, training, progress)
    decoupler = Decoupler(
        component=parts,
        rows=data.resistance_ohm.shape[1],
        cols=data.resistance_ohm.shape[2],
        network=network,
        input_scaling=input_scaling,
        output_scaling=output_scaling,
        hidden_weights=point.hidden.numpy(),
        output_weights=point.output.numpy(),
        design=data.design,
        made_from={
            "recipe": model_recipe(data.content_hash, component, network, training),
            "data_hash": data.content_hash,
            "n_samples": len(inputs),
            "training": asdict(training),
            "outcome": asdict(outcome),
        },
    )
    return decoupler, History(**asdict(outcome), seconds=time.perf_counter() - started)


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
    model: Network, x: torch.Tensor, t: torch.Tensor, training: TrainingConfig, progress: Progress
) -> tuple[Point, Outcome]:
    return train_varpro(Samples(x, t, model.skip), model.hidden.detach(), training, progress)


@torch.no_grad()
def _lm(
    model: Network, x: torch.Tensor, t: torch.Tensor, training: TrainingConfig, progress: Progress
) -> tuple[Point, Outcome]:
    samples = Samples(x, t, model.skip)
    return train_lm(samples, model.hidden.detach(), model.output.detach(), training, progress)


def _momentum(
    model: Network, x: torch.Tensor, t: torch.Tensor, training: TrainingConfig, progress: Progress
) -> tuple[Point, Outcome]:
    optimizer = Momentum(model.parameters(), training.learning_rate, training.momentum)
    stop, iteration = Stop(training), 0
    while True:
        optimizer.zero_grad()
        loss = torch.mean((model(x) - t) ** 2)
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
