"""Learns forces at finite strain from few samples, on top of the linear response."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dataset.samples import SampleError
from decoupler.inverse.effective_forces import N_FEATURES, EffectiveForces, neighbours
from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.limits import exact_inverse
from decoupler.model.uncertainty import leverage
from decoupler.training.error_bars import MIN_FREEDOM
from geometry.layout import FloatArray

RIDGES = (1e-7, 1e-6, 1e-5, 1e-4)  #: per row, of features of root mean square 1


def at_finite_strain(
    forward: ForwardModel,
    size: tuple[int, int],
    resistance_ohm: FloatArray,
    force_n: FloatArray,
    electrodes_mm_per_n: FloatArray | None = None,
) -> ForwardModel:
    """The forward model of a linear array with what samples at finite strain add.

    Parameters
    ----------
    forward : ForwardModel
        Of all forces and pillars.
    size : tuple
        Rows and columns of the array.
    resistance_ohm, force_n : arrays, shapes (n, n_pillars) and (n, n_forces)
        Samples at finite strain [Ω], [N], of a sensor as designed.
    electrodes_mm_per_n : array, shape (n_forces, 6·n_units), optional
        Influence on the electrodes, where the model's own is of conduction: that of the model by eq. 1.

    Raises
    ------
    SampleError
        If the model is of conduction and the electrodes' influence is not given.
        If some sample's resistances are none that the linear array can have.

    Notes
    -----
    Every unit of every sample is one equation an axis, by ridge regression, each feature scaled to its root mean
    square; the ridge is the one with the least errors had each equation been left out.
    """
    linear = replace(forward, correction=None)
    influence = linear.influence if electrodes_mm_per_n is None else electrodes_mm_per_n
    if linear.sign is not None and electrodes_mm_per_n is None:
        raise SampleError("a model of conduction does not tell how electrodes move: give electrodes_mm_per_n.")
    effective_n = exact_inverse(linear, resistance_ohm, force_n.mean(axis=0))
    k = linear.n_forces // 3
    moved = (effective_n @ influence).reshape(-1, 3, k, 2).transpose(0, 2, 3, 1).reshape(-1, 6)
    sizes = np.concatenate([effective_n.reshape(-1, 3).std(axis=0), moved.std(axis=0)])
    empty = EffectiveForces(
        influence=linear.influence,
        near=neighbours(*size),
        sizes=sizes,
        weights=np.zeros((N_FEATURES, 3)),
        misfit_n=np.zeros(3),
    )
    A = empty.features(effective_n).reshape(-1, N_FEATURES)
    targets = (force_n - effective_n).reshape(-1, 3)
    root_mean_square = np.sqrt((A**2).mean(axis=0))
    there = root_mean_square > 0  # not neighbours that no pad has
    A = A[:, there] / root_mean_square[there]
    fits = [_ridge(A, targets, ridge * len(A)) for ridge in RIDGES]
    best = min(fits, key=lambda fit: float((fit.left_out**2).sum()))
    weights = np.zeros((N_FEATURES, 3))
    weights[there] = best.weights / root_mean_square[there, None]
    misfit_n = np.sqrt((best.left_out**2).mean(axis=0))
    return replace(linear, correction=replace(empty, weights=weights, misfit_n=misfit_n))


class _Fit(NamedTuple):
    weights: FloatArray
    left_out: FloatArray  #: errors had each row been left out


def _ridge(A: FloatArray, targets: FloatArray, ridge: float) -> _Fit:
    M = A.T @ A
    M.flat[:: len(M) + 1] += ridge
    inverse = np.linalg.inv(M).astype(np.float64)
    weights = inverse @ (A.T @ targets)
    freedom = np.maximum(1.0 - leverage(A, inverse), MIN_FREEDOM)
    return _Fit(weights, (targets - A @ weights) / freedom[:, None])
