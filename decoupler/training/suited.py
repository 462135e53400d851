"""The component, network and training that suit samples, the response that explains them, and pillars that move.

Loads no torch.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from common.errors import require_type
from dataset.samples import AnySamples, SampleError, Samples, drawn
from decoupler.data.columns import Columns, Component, acting_component, component_named
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.network import form_named
from decoupler.model.settings import NetworkConfig, TrainingConfig
from geometry.design import SensorDesign
from geometry.layout import FloatArray

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

DRIFTS = 1  #: number of the stream of random drifts that the readings are given beside their own
#: smallest share of the lengths' variance that a sensor's own response explains: one with pads a third smaller
#: explains 0.83, with pads an eighth smaller 0.99; noise of 1 % leaves 0.93 and more
MIN_EXPLAINED = 0.9
SLOPES = (0.8, 1.25)  #: range of the measured lengths' slope over the model's; beyond, the body is softer or stiffer
MIN_MOVED = 0.3  #: smallest motion of a living pillar over the expected one; usual are 0.8 to 1.25
SURE = 3.0  #: standard errors between a slope and `MIN_MOVED`
MAX_JUDGED = 5000  #: samples, spread over the data; more say no more of whether a pillar moves
ENOUGH_FOR_ERRORS = 10  #: samples, for a standard error; of fewer only a pillar that always reads the same is stuck
SAME = 1e-12  #: relative spread of readings that differ by rounding alone
MIN_LOADED = 0.1  #: expected motion of a pillar over the usual one, below which errors of the response outweigh it
NOISE_TIMES = 1.5  #: the stated noise; readings within it show no load


@dataclass(frozen=True, kw_only=True, eq=False)
class Prepared:
    """All that a network is trained on and by."""

    columns: Columns
    form: NetworkConfig
    training: TrainingConfig
    design: SensorDesign | None
    forward: SensorModel | None = None  #: of the feature `inverse` alone
    samples: Samples | None = None  #: that the columns are of; None of drawn ones


def suited(
    data: AnySamples,
    component: str | None,
    network: NetworkConfig | None,
    training: TrainingConfig | None,
    response: "ArrayResponse | None",
) -> Prepared:
    """Complete what a training is asked for with what suits the samples, and take what it learns from them.

    Of more than `ENOUGH` samples a random draw is taken. One that is given twice counts once, readings are given the
    drifts that the design states, and pillars that do not follow their loads are taken for dead. The feature `auto` is
    `inverse` for a network that sees its inputs if the response explains linear samples, else `root`. An argument of
    another type is an `ArgumentError`.
    """
    if network is not None:
        require_type("network", network, NetworkConfig, "give its form, or None for one that suits the samples")
    if training is not None:
        require_type("training", training, TrainingConfig, "say how to train, or give None")
    form, training, forward = network or NetworkConfig(), training or TrainingConfig(), None
    few = drawn(data, training.seed)
    parts = component_named(acting_component(few.force_n) if component is None else component)
    few = few[Columns.of(few, parts).distinct()]
    if len(few) < 2:
        raise SampleError(f"{len(few)} samples cannot train a network: give at least 2 that differ.")
    columns = Columns.of(few.drifted(np.random.default_rng([training.seed, DRIFTS])), parts)
    columns = without_stuck(columns, None if response is None else SensorModel.of(response, parts))
    if form.feature == "inverse":
        forward = explaining(response, columns)
    elif form.feature == "auto" and response is not None and not few.is_finite.any():
        with suppress(SampleError):
            forward = explaining(response, columns) if form_named(form.net).sees_inputs else None
    if form.feature == "auto":
        form = replace(form, feature="root" if forward is None else "inverse")
    return Prepared(columns=columns, form=form, training=training, design=few.design, forward=forward, samples=few)


def explaining(response: "ArrayResponse | None", data: Columns) -> SensorModel:
    """The forward model of a response, if it explains the lengths of training samples up to a pillar's own gain.

    No response, or one of an array of another size or that explains too little, is a `SampleError`: other loads act
    than the component's own, or the sensor is another.
    """
    if response is None:
        raise SampleError("the feature 'inverse' needs the array's response, and none is known: use 'root'.")
    forward = SensorModel.of(response, data.component)
    if (forward.n_pillars, forward.n_forces) != (len(data.readable), data.force_n.shape[1]):
        raise SampleError(
            f"the response is of {forward.n_pillars} pillars, the samples of {len(data.readable)}: "
            "give the response of this array, or use the feature 'root'."
        )
    lengths = forward.lengths_of(data.resistance_ohm)[:, data.readable]
    modelled = forward.lengths(data.force_n)[:, data.readable]
    mean = modelled.mean(axis=0)  # which each column is given first: its own gain or resistivity is no misfit
    moved = lengths * (mean / lengths.mean(axis=0)) - mean
    total = (moved**2).sum()
    share = float(1.0 - (residuals(moved, modelled - mean) ** 2).sum() / total) if total > 0 else 1.0
    if share < MIN_EXPLAINED:
        raise SampleError(
            f"the response explains {max(share, 0.0):.0%} of the resistances' variance, too little to start from: "
            "use the feature 'root', or the component that holds all loads ('all')."
        )
    return forward


def residuals(moved: FloatArray, expected: FloatArray) -> FloatArray:
    """Residuals of measured motions beside expected ones, both (n, n_columns) [mm] or relative, slopes in `SLOPES`."""
    both, own = (moved * expected).sum(axis=0), (expected**2).sum(axis=0)
    slope = np.divide(both, own, out=np.ones_like(own), where=own > 0).clip(*SLOPES)
    return moved - slope * expected


def without_stuck(data: Columns, forward: SensorModel | None, most: float = MIN_MOVED) -> Columns:
    """Mark pillars that do not follow their loads as dead: they move by less than this share of what they should.

    A pillar that hardly moves in training carries no information, but scaled to the others' range its noise counts as
    much as their signal, and it would give wild forces once it moves. It is held stuck if its readings spread far less
    than those that the forward model gives for the loads, or no more than noise, and do not follow these. Without a
    model they are expected to follow the loads of their own unit as most pillars of their kind do. If more than half
    seem stuck, the expectation is wrong and none is.
    """
    some = data[np.linspace(0, len(data) - 1, min(MAX_JUDGED, len(data))).astype(int)]
    mean = some.resistance_ohm.mean(axis=0, keepdims=True)
    moved = some.resistance_ohm / mean - 1.0
    if forward is not None and (forward.n_pillars, forward.n_forces) == (moved.shape[1], some.force_n.shape[1]):
        modelled = forward.resistances(some.force_n)
        expected = modelled / modelled.mean(axis=0) - 1.0
    else:
        expected = _as_most(moved, some.force_n, some.component)
    noise = (some.errors.total(mean, *some.shape) / mean)[0]
    stuck = some.readable & _unmoved(moved, expected, noise, most)
    return data.without(stuck) if 0 < stuck.sum() <= some.readable.sum() / 2 else data


def _unmoved(moved: FloatArray, expected: FloatArray, noise: FloatArray, most: float) -> NDArray[np.bool_]:
    """Which columns (n_columns,) stay where they are though both (n, n_columns), relative to their means, should agree.

    `noise` (n_columns,) is that of the readings, relative; they move by `most` of what is expected, noise aside.
    """
    n, spread = len(moved), moved.std(axis=0)
    energy = (expected**2).sum(axis=0)
    judged = (energy > 0) & (energy >= MIN_LOADED**2 * np.median(energy))
    if n < ENOUGH_FOR_ERRORS:
        return judged & (spread <= SAME) & (n > 2)  # two steps of a converter are soon alike
    energy = np.where(judged, energy, 1.0)
    slope = (moved * expected).sum(axis=0) / energy
    error = np.sqrt(((moved - slope * expected) ** 2).sum(axis=0) / (n - 2) / energy)
    within = np.hypot(most * np.sqrt(energy / n), NOISE_TIMES * noise)
    return judged & (spread <= within) & (slope + SURE * error < MIN_MOVED)


def _as_most(moved: FloatArray, force_n: FloatArray, component: Component) -> FloatArray:
    """Expected motions (n, n_columns) of pillars that follow their own unit's forces as most of their kind do."""
    n = len(moved)
    F = (force_n - force_n.mean(axis=0)).reshape(n, -1, len(component.axes))
    y = moved.reshape(n, F.shape[1], -1)
    G = np.einsum("nua,nub->uab", F, F)
    loaded = G.trace(axis1=1, axis2=2)
    loaded = (loaded > 0) & (loaded >= 0.25 * np.median(loaded))  # half of the usual loads and more
    by_force = np.linalg.pinv(G) @ np.einsum("nua,nup->uap", F, y)
    usual = np.median(by_force[loaded], axis=0) if loaded.any() else np.zeros(by_force.shape[1:])
    return (loaded[:, None] * np.einsum("nua,ap->nup", F, usual)).reshape(n, -1)
