"""From labelled data to a trained `Decoupler`. Loads torch."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

from common.threads import one_blas_thread
from dataset.samples import AnySamples, SampleError
from decoupler.data.columns import Columns
from decoupler.data.enough import drawn
from decoupler.data.usual_loads import light_loads
from decoupler.inverse.sensor_model import ModelInverse, SensorModel
from decoupler.model.baseline import LeastSquares
from decoupler.model.decoupler import Decoupler
from decoupler.model.settings import METHODS, NetworkConfig, Progress, TrainingConfig
from decoupler.model.uncertainty import leverage
from decoupler.model_file import model_cache_key
from decoupler.readings import MIN_WHOLE_OHM
from decoupler.training.error_bars import MIN_FREEDOM, best_ridge, fitted_uncertainty
from decoupler.training.finite_strain import trained_at_strain
from decoupler.training.network import Network, TrainingSet
from decoupler.training.suited import explaining, suited_training, without_stuck
from decoupler.training.varpro import RIDGE, SCARCE_RIDGE, train_varpro
from geometry.design import SensorDesign
from geometry.layout import FloatArray

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

DRIFTS = 1  #: number of the stream of random drifts that the readings are given beside their own
MAX_UNEXPLAINED = 3e-3  #: share of the variance of √R that light samples' resistances may leave


def _silent(iteration: int, mse: float) -> None:
    """The progress callback of whoever does not want one."""


@one_blas_thread()  # on matrices this small two are slower
def train(
    data: AnySamples,
    component: str | None = None,
    network: NetworkConfig | None = None,
    training: TrainingConfig | None = None,
    progress: Progress = _silent,
    response: "ArrayResponse | None" = None,
    judged: bool = True,
) -> Decoupler:
    """Train one network on all samples of `data`; leave test samples out beforehand.

    Parameters
    ----------
    data : Samples or StoredSamples
        At least two samples that differ; one that is given twice counts once.
    component : str, optional
        fz, fx, fy or all; default: the forces that act.
    network : NetworkConfig, optional
        Default: a skip net of 17 hidden nodes, which starts from the response if one is given that explains the data.
    training : TrainingConfig, optional
    progress : callable
        Called as progress(iteration, mse) once an iteration; mse is of the outputs scaled to [-1, 1].
    response : ArrayResponse, optional
        Of the sensor; the feature `inverse` needs it, the others do not heed it.
    judged : bool
        Find the uncertainty of its forces, too, which takes a third of the time.

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
    Readings are given the drifts that the design states, where they have less. Of more than `ENOUGH` samples a random
    draw is learned from: more would change the errors by half a percent.
    """
    seed = training.seed if isinstance(training, TrainingConfig) else 0  # another type is refused below
    given, data = data, drawn(data, seed)
    parts, network, training = suited_training(data, component, network, training, response)
    if data.is_finite.any() and parts.name == "all" and response is not None:
        data = data[data.is_finite]
        trained = trained_at_strain(data, response, training, progress)
    else:
        data = data[Columns.of(data, parts).distinct()]
        if len(data) < 2:
            raise SampleError(f"{len(data)} samples cannot train a network: give at least 2 that differ.")
        columns = Columns.of(data.drifted(np.random.default_rng([seed, DRIFTS])), parts)
        columns = without_stuck(columns, None if response is None else SensorModel.of(response, parts))
        forward = explaining(response, columns) if network.feature == "inverse" else None
        trained = fitted_network(columns, network, training, data.design, forward, progress, judged)
    story = {
        "recipe": model_cache_key(given, parts.name, network, training, response),
        "data_hash": given.content_hash,
        "n_samples": len(data),
    }
    of_twin = {name: data.made_from[name] for name in ("twin",) if name in data.made_from}
    return replace(trained, made_from=of_twin | trained.made_from | story)


def fitted_network(
    data: Columns,
    network: NetworkConfig,
    training: TrainingConfig,
    design: SensorDesign | None = None,
    forward: SensorModel | None = None,
    progress: Progress = _silent,
    judged: bool = True,
) -> Decoupler:
    """The network that a training set gives; with the sensor's model, if it has the feature `inverse`.

    Without its uncertainty if that is not `judged`.

    Notes
    -----
    With the feature `inverse` and a skip net the network learns what the response does not say: its targets are the
    forces less those of the response's inverse, which are added back to the linear weights at the end. What it learns
    must not move rest, which data under load do not hold: light samples are added.

    Hidden nodes learn single draws of drifts by heart: errors then are those on the samples kept for validation.
    """
    known, inverse, n_light = forward is not None and network.net == "skip", None, 0
    if forward is not None:
        forward = forward.calibrated(data)
        read = None if data.errors.is_exact or forward.n_pillars <= forward.n_forces else _as_read(forward, data)
        inverse = ModelInverse.about(forward, data.force_n, data.readable, data.errors.noise, read)
    untrained = Decoupler.untrained(data, network, design, inverse)
    untrained = replace(untrained, least_squares=LeastSquares.fitted(data))
    if known:
        n = len(data)
        data = _with_light_samples(untrained, data)
        n_light = len(data) - n
    inputs, targets = untrained.inputs(data.resistance_ohm), untrained.output_scaling.scale(data.force_n)
    if known:
        targets = targets - inputs
    samples = TrainingSet(torch.from_numpy(inputs), torch.from_numpy(targets), skip=network.net == "skip")
    start, kept = Network(network, inputs.shape[1], targets.shape[1], training.seed), None
    with _one_torch_thread(), torch.no_grad():
        hidden, output = start.hidden.detach(), start.output.detach()
        if known:
            output.zero_()  # what is known is the start
        readings = len(data) / (data.load.max() + 1)
        ridge = best_ridge(samples.linear.numpy(), targets, readings) if known else _ridge(network, len(inputs))
        if training.trainer == "varpro":
            order = _mixed(data.load, training)
            held_out = _n_held_out(data.load[order], training) if start.skip else 0  # a plain net has no linear map
            kept = order[len(order) - held_out :] if data.errors.has_drift and held_out else None
            mixed = samples[torch.from_numpy(order)]
            point, outcome = train_varpro(mixed, hidden, ridge, held_out, training, progress)
        else:
            home, _, name = METHODS[training.trainer].partition(":")
            method = getattr(import_module(f"decoupler.training.{home}"), name)
            point, outcome = method(samples, hidden, output, training, progress)
    # in the order of a file's, since products round by it
    hidden_weights, output_weights = (np.array(part.numpy(), order="C") for part in (point.hidden, point.output))
    if known:
        output_weights[:, network.hidden : -1] += np.eye(len(output_weights))
    trained = replace(untrained, hidden_weights=hidden_weights, output_weights=output_weights)
    uncertainty = fitted_uncertainty(trained, data, ridge, n_light, kept) if judged else None
    return replace(
        trained, uncertainty=uncertainty, made_from={"training": asdict(training), "outcome": asdict(outcome)}
    )


def _as_read(forward: SensorModel, data: Columns) -> Callable[[FloatArray], FloatArray]:
    """What gives lengths (n, P) [mm] as they are read under forces (n, Q) [N], with errors as the samples have."""
    generator = np.random.default_rng(0)

    def read(force_n: FloatArray) -> FloatArray:
        return forward.lengths_of(data.errors.scattered(forward.resistances(force_n), *data.shape, generator))

    return read


def _ridge(network: NetworkConfig, n_samples: int) -> float:
    """λ on the output weights of a net that knows no response: stronger where it could meet any forces whatever."""
    scarce = network.net == "plain" and n_samples <= network.hidden + 1
    return (SCARCE_RIDGE if scarce else RIDGE) * n_samples


def _with_light_samples(untrained: Decoupler, data: Columns) -> Columns:
    """Training samples with light ones added at the end.

    None are added where their resistances leave more than noise and `MAX_UNEXPLAINED` of the variance of the readings'
    roots unexplained.

    Notes
    -----
    √R is what response and calibration give, and what these leave of it that is linear in the forces, by a ridge. With
    the sensor's own response only noise is left, and the ridge takes it for nothing. With another's, gains and offsets
    fitted under load make up for it there and not at rest; the linear part puts rest right.
    """
    assert untrained.inverse is not None
    generator = np.random.default_rng(0)
    light_n = light_loads(data.force_n, generator)
    all_n, root = np.concatenate([data.force_n, light_n]), np.sqrt(data.resistance_ohm)
    modelled_ohm = untrained.inverse.forward.resistances(all_n)
    modelled, light = np.split(np.sqrt(np.maximum(modelled_ohm, MIN_WHOLE_OHM)), [len(data)])  # √Ω
    A, A_light = np.split(np.column_stack([untrained.output_scaling.scale(all_n), np.ones(len(all_n))]), [len(data)])
    left = np.where(data.readable, root - modelled, 0.0)
    G = np.linalg.inv(A.T @ A + best_ridge(A, left) * np.eye(A.shape[1])).astype(np.float64)
    linear = G @ (A.T @ left)
    left_out = (left - A @ linear) / np.maximum(1.0 - leverage(A, G), MIN_FREEDOM)[:, None]
    by_noise = (0.5 * data.errors.total(data.resistance_ohm, *data.shape) / root) ** 2
    excess = (left_out**2 - by_noise)[:, data.readable].mean(axis=0)
    if excess.mean() > MAX_UNEXPLAINED * root[:, data.readable].var(axis=0).mean():
        return data
    light_ohm = ((light + A_light @ linear) ** 2).reshape(len(light), *data.shape, -1)
    light_ohm = data.errors.read(light_ohm, generator).reshape(light.shape)
    return replace(
        data,
        resistance_ohm=np.concatenate([data.resistance_ohm, light_ohm]),
        force_n=all_n,
        load=np.concatenate([data.load, data.load.max() + 1 + np.arange(len(light))]),
    )


@contextmanager
def _one_torch_thread() -> Iterator[None]:
    """One torch thread meanwhile: on matrices this small, two are slower as soon as a core is shared."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _mixed(load: NDArray[np.int64], training: TrainingConfig) -> NDArray[np.int64]:
    """A random order of the samples in which readings of one load stay together; files may be sorted by load."""
    by_load = np.random.default_rng(training.seed).permutation(load.max() + 1).argsort()
    return np.argsort(by_load[load], kind="stable")


def _n_held_out(load: NDArray[np.int64], training: TrainingConfig) -> int:
    """Number of samples, the last in order of load, that are kept for validation; no load is split."""
    held_out = int(training.held_out * len(load))
    while 0 < held_out < len(load) and load[-held_out] == load[-held_out - 1]:
        held_out -= 1
    return held_out
