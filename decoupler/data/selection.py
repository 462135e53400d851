"""Choosing among samples: those that differ, and the pillars among them that say something."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dataset import Samples
from dataset.measurement import reading_deviation
from decoupler.data.components import Component, force_columns, pillar_columns, readable_columns
from decoupler.inverse.forward_model import ForwardModel
from geometry.layout import PILLARS, FloatArray

MIN_MOVED = 0.3  #: of what its loads should move a pillar; one that lives moves 0.8 to 1.25 of it
SURE = 3.0  #: standard errors between a slope and `MIN_MOVED`
MAX_JUDGED = 5000  #: samples, spread over the data; more say no more of whether a pillar moves
ENOUGH_FOR_ERRORS = 10  #: samples, for a standard error; of fewer only a pillar that always reads the same is stuck
SAME = 1e-12  #: of a reading: rounding
MIN_LOADED = 0.1  #: of the usual expected motion: below, errors of the response outweigh it
NOISE_TIMES = 1.5  #: the stated noise; readings within it show no load


def distinct(data: Samples, component: Component) -> Samples:
    """The samples without those that repeat an earlier one to the bit, in what the component takes and gives.

    A repetition tells nothing new, and where one copy is left out of training the other gives its answer away: errors
    on samples left out would be those of training, and deviations far too small.
    """
    columns = pillar_columns(data.resistance_ohm, component, data.dead)
    forces = force_columns(data.force_n, component)
    keys = [hash(ohm.tobytes() + newton.tobytes()) for ohm, newton in zip(columns, forces, strict=True)]
    first = np.unique(keys, return_index=True)[1]
    return data if len(first) == len(keys) else data[np.sort(first)]


def load_numbers(force_n: FloatArray) -> NDArray[np.int64]:
    """Which load each sample (n, ...) was taken under, shape (n,), counted from 0 as they first appear.

    Several readings of one load share what the network gets wrong about it: they must be left out together.
    """
    numbers: dict[bytes, int] = {}
    return np.array([numbers.setdefault(sample.tobytes(), len(numbers)) for sample in force_n])


def over_loads(values: FloatArray, load: NDArray[np.int64]) -> FloatArray:
    """For each sample (n,) the sum of values (n,) over all samples of its load."""
    return np.bincount(load, values)[load].astype(np.float64, copy=False)


def without_stuck(data: Samples, component: Component, forward: ForwardModel | None) -> Samples:
    """The same samples, with pillars that do not follow their loads marked as dead.

    A pillar that hardly moves in training carries no information, but scaled to the others' range its noise counts as
    much as their signal, and it would give wild forces once it moves. It is held stuck if its readings spread far less
    than those that the forward model gives for the loads, or no more than noise, and do not follow these. Without a
    model they are expected to follow the loads of their own unit as most pillars of their kind do. If more than half
    seem stuck, the expectation is wrong and none is.
    """
    some = np.linspace(0, len(data.force_n) - 1, min(MAX_JUDGED, len(data.force_n))).astype(int)
    columns = pillar_columns(data.resistance_ohm[some], component, data.dead)
    force_n = force_columns(data.force_n[some], component)
    moved = columns / columns.mean(axis=0) - 1.0
    if forward is not None and (forward.n_pillars, forward.n_forces) == (columns.shape[1], force_n.shape[1]):
        modelled = forward.resistances(force_n)
        expected = modelled / modelled.mean(axis=0) - 1.0
    else:
        expected = _as_most(moved, force_n, component)
    noise = reading_deviation(columns.mean(axis=0), data.noise, data.bits) / columns.mean(axis=0)
    readable = readable_columns(component, data.dead, columns.shape[1])
    stuck = readable & _unmoved(moved, expected, noise)
    if not 0 < stuck.sum() <= readable.sum() / 2:
        return data
    dead = np.zeros(data.resistance_ohm.shape[1:], dtype=bool) if data.dead is None else data.dead.copy()
    dead[..., [PILLARS.index(pillar) for pillar in component.pillars]] |= stuck.reshape(*dead.shape[:2], -1)
    return replace(data, dead=dead)


def _unmoved(moved: FloatArray, expected: FloatArray, noise: FloatArray) -> NDArray[np.bool_]:
    """Which columns (n_columns,) stay where they are though both (n, n_columns), relative to their means, should agree.

    `noise` (n_columns,) is that of the readings, relative.
    """
    n, spread = len(moved), moved.std(axis=0)
    energy = (expected**2).sum(axis=0)
    judged = (energy > 0) & (energy >= MIN_LOADED**2 * np.median(energy))
    if n < ENOUGH_FOR_ERRORS:
        return judged & (spread <= SAME) & (n > 2)  # two steps of a converter are soon alike
    energy = np.where(judged, energy, 1.0)
    slope = (moved * expected).sum(axis=0) / energy
    error = np.sqrt(((moved - slope * expected) ** 2).sum(axis=0) / (n - 2) / energy)
    within = np.hypot(MIN_MOVED * np.sqrt(energy / n), NOISE_TIMES * noise)
    return judged & (spread <= within) & (slope + SURE * error < MIN_MOVED)


def _as_most(moved: FloatArray, force_n: FloatArray, component: Component) -> FloatArray:
    """How pillars would move (n, n_columns) by their own unit's forces as most of their kind do; 0 if hardly loaded."""
    n = len(moved)
    F = (force_n - force_n.mean(axis=0)).reshape(n, -1, len(component.axes))
    y = moved.reshape(n, -1, len(component.pillars))
    G = np.einsum("nua,nub->uab", F, F)
    loaded = G.trace(axis1=1, axis2=2)
    loaded = (loaded > 0) & (loaded >= 0.25 * np.median(loaded))  # half of the usual loads and more
    by_force = np.linalg.pinv(G) @ np.einsum("nua,nup->uap", F, y)
    usual = np.median(by_force[loaded], axis=0) if loaded.any() else np.zeros(by_force.shape[1:])
    return (loaded[:, None] * np.einsum("nua,ap->nup", F, usual)).reshape(n, -1)
