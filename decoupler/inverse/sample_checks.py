"""Checks of samples against the array's response: does it explain them, and which pillars do not follow their loads?"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dataset.samples import SampleError, Samples
from decoupler.data.columns import Component, force_columns, pillar_columns, readable_columns
from decoupler.inverse.forward_model import ForwardModel
from geometry.layout import PILLARS, FloatArray

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

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


def explaining(
    response: "ArrayResponse | None",
    component: Component,
    columns_ohm: FloatArray,
    force_n: FloatArray,
    readable: np.ndarray,
) -> ForwardModel:
    """The forward model of a response, if it explains the lengths of training samples up to a pillar's own gain.

    Raises
    ------
    SampleError
        If there is no response, or it is of an array of another size or explains too little: other loads act than the
        component's own, or the sensor is another.
    """
    if response is None:
        raise SampleError("the feature 'inverse' needs the array's response, and none is known: use 'root'.")
    forward = ForwardModel.of(response, component)
    if (forward.n_pillars, forward.n_forces) != (columns_ohm.shape[1], force_n.shape[1]):
        raise SampleError(
            f"the response is of {forward.n_pillars} pillars, the samples of {columns_ohm.shape[1]}: "
            "give the response of this array, or use the feature 'root'."
        )
    share = _explained(forward.lengths_of(columns_ohm)[:, readable], forward.lengths(force_n)[:, readable])
    if share < MIN_EXPLAINED:
        raise SampleError(
            f"the response explains {max(share, 0.0):.0%} of the resistances' variance, too little to start from: "
            "use the feature 'root', or the component that holds all loads ('all')."
        )
    return forward


def _explained(lengths: FloatArray, modelled: FloatArray) -> float:
    """Share of the variance of all columns together that a line per column, of a slope in `SLOPES`, explains.

    Each column is first given the mean of the model's: a pillar's own gain, or another resistivity, is no misfit.
    """
    lengths = lengths * (modelled.mean(axis=0) / lengths.mean(axis=0))
    lengths, modelled = lengths - lengths.mean(axis=0), modelled - modelled.mean(axis=0)
    total = (lengths**2).sum()
    return float(1.0 - (residuals(lengths, modelled) ** 2).sum() / total) if total > 0 else 1.0


def residuals(moved: FloatArray, expected: FloatArray) -> FloatArray:
    """Residuals of measured motions beside expected ones, both (n, n_columns) [mm] or relative, slopes in `SLOPES`."""
    both, own = (moved * expected).sum(axis=0), (expected**2).sum(axis=0)
    slope = np.divide(both, own, out=np.ones_like(own), where=own > 0).clip(*SLOPES)
    return moved - slope * expected


def without_stuck(data: Samples, component: Component, forward: ForwardModel | None) -> Samples:
    """Mark pillars that do not follow their loads as dead.

    A pillar that hardly moves in training carries no information, but scaled to the others' range its noise counts as
    much as their signal, and it would give wild forces once it moves. It is held stuck if its readings spread far less
    than those that the forward model gives for the loads, or no more than noise, and do not follow these. Without a
    model they are expected to follow the loads of their own unit as most pillars of their kind do. If more than half
    seem stuck, the expectation is wrong and none is.
    """
    some = np.linspace(0, len(data.force_n) - 1, min(MAX_JUDGED, len(data.force_n))).astype(int)
    columns_ohm = pillar_columns(data.resistance_ohm[some], component, data.dead)
    force_n = force_columns(data.force_n[some], component)
    moved = columns_ohm / columns_ohm.mean(axis=0) - 1.0
    if forward is not None and (forward.n_pillars, forward.n_forces) == (columns_ohm.shape[1], force_n.shape[1]):
        modelled = forward.resistances(force_n)
        expected = modelled / modelled.mean(axis=0) - 1.0
    else:
        expected = _as_most(moved, force_n, component)
    mean = columns_ohm.mean(axis=0, keepdims=True)
    noise = (data.errors.total(mean, *data.shape) / mean)[0]
    readable = readable_columns(component, data.dead, columns_ohm.shape[1])
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
    """Expected motions (n, n_columns) of pillars that follow their own unit's forces as most of their kind do."""
    n = len(moved)
    F = (force_n - force_n.mean(axis=0)).reshape(n, -1, len(component.axes))
    y = moved.reshape(n, -1, len(component.pillars))
    G = np.einsum("nua,nub->uab", F, F)
    loaded = G.trace(axis1=1, axis2=2)
    loaded = (loaded > 0) & (loaded >= 0.25 * np.median(loaded))  # half of the usual loads and more
    by_force = np.linalg.pinv(G) @ np.einsum("nua,nup->uap", F, y)
    usual = np.median(by_force[loaded], axis=0) if loaded.any() else np.zeros(by_force.shape[1:])
    return (loaded[:, None] * np.einsum("nua,ap->nup", F, usual)).reshape(n, -1)
