"""The network that a training set gives, beside the response of the sensor where one is known."""

from dataclasses import asdict, replace

import numpy as np

from decoupler.data.columns import Columns, Scaling
from decoupler.data.usual_loads import light_loads
from decoupler.inverse.sensor_model import ModelInverse, SensorModel
from decoupler.model.decoupler import Decoupler
from decoupler.model.front import POWERS, Front
from decoupler.model.network import Task, form_named
from decoupler.model.settings import Progress
from decoupler.model.uncertainty import leverage
from decoupler.readings import MIN_WHOLE_OHM
from decoupler.solve import best_ridge
from decoupler.training.error_bars import MIN_FREEDOM, with_uncertainty
from decoupler.training.suited import Prepared
from geometry.layout import FloatArray

MAX_UNEXPLAINED = 3e-3  #: share of the variance of √R that light samples' resistances may leave


def fitted_network(known: Prepared, progress: Progress = lambda *_: None, judged: bool = True) -> Decoupler:
    """The network that a training set gives; with the sensor's model, if it has the feature `inverse`.

    As unsure of forces as before training if that is not `judged`.

    Notes
    -----
    With the feature `inverse` the network learns what the response does not say, if it sees its inputs: its targets are
    the forces less those of the response's inverse, which are added back at the end. What it learns must not move rest,
    which data under load do not hold: light samples are added.

    Hidden nodes learn single draws of drifts by heart: errors then are those on the samples kept for validation.
    """
    data, form = known.columns, known.form
    kind, scaling = form_named(form.net), data.force_scaling
    inverse = None if known.forward is None else _inverse(known.forward, data)
    front = Front.of(data, inverse or POWERS[form.feature], scaling)
    is_known = inverse is not None and kind.sees_inputs
    if inverse is not None and is_known:
        data = _with_light_samples(inverse.forward, scaling, data)
    inputs, targets = front.inputs(data.resistance_ohm), scaling.scale(data.force_n)
    task = Task(
        inputs=inputs,
        targets=targets - inputs if is_known else targets,
        load=data.load,
        shape=data.shape,
        is_known=is_known,
        form=form,
        training=known.training,
        progress=progress,
    )
    network, outcome = kind.fitted(task)
    network = network.beside_inputs() if is_known else network
    trained = Decoupler.of(known.columns, form, front, network, known.design)
    if judged:
        kept = task.held_out if data.errors.has_drift and len(task.held_out) else None
        trained = with_uncertainty(trained, data, inputs, task.ridge, len(data) - len(known.columns), kept)
    return replace(trained, made_from={"training": asdict(known.training), "outcome": asdict(outcome)})


def _inverse(forward: SensorModel, data: Columns) -> ModelInverse:
    """The response with the gains and offsets that samples show, turned around for readings that err as theirs."""
    forward, generator = forward.calibrated(data), np.random.default_rng(0)

    def read(force_n: FloatArray) -> FloatArray:
        return forward.lengths_of(data.errors.scattered(forward.resistances(force_n), *data.shape, generator))

    is_exact = data.errors.is_exact or forward.n_pillars <= forward.n_forces
    return ModelInverse.about(forward, data.force_n, data.readable, data.errors.noise, None if is_exact else read)


def _with_light_samples(forward: SensorModel, scaling: Scaling, data: Columns) -> Columns:
    """Training samples with light ones added at the end.

    None are added where their resistances leave more than noise and `MAX_UNEXPLAINED` of the variance of the readings'
    roots unexplained.

    Notes
    -----
    √R is what response and calibration give, and what these leave of it that is linear in the forces, by a ridge. With
    the sensor's own response only noise is left, and the ridge takes it for nothing. With another's, gains and offsets
    fitted under load make up for it there and not at rest; the linear part puts rest right.
    """
    generator = np.random.default_rng(0)
    light_n = light_loads(data.force_n, generator)
    all_n, root = np.concatenate([data.force_n, light_n]), np.sqrt(data.resistance_ohm)
    modelled_ohm = forward.resistances(all_n)
    modelled, light = np.split(np.sqrt(np.maximum(modelled_ohm, MIN_WHOLE_OHM)), [len(data)])  # √Ω
    A, A_light = np.split(np.column_stack([scaling.scale(all_n), np.ones(len(all_n))]), [len(data)])
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
