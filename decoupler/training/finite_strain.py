"""Learns forces at finite strain from few samples, on top of the linear response."""

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dataset.samples import SampleError, Samples
from decoupler.data.columns import Component
from decoupler.inverse.effective_forces import N_FEATURES, EffectiveForces, neighbours
from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.limits import nearest_inverse
from decoupler.model.uncertainty import leverage
from geometry.layout import FloatArray

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

RIDGES = (1e-6, 1e-5, 1e-4, 1e-3)  #: per row, of features of root mean square 1
MIN_FREEDOM = 1e-9  #: of an equation, when it is left out

MIN_FOUND = 0.5  #: of the samples, that must be of effective forces


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
        If the model is of conduction and the electrodes' influence is not given, or some sample's resistances are none
        that the linear array can have.

    Notes
    -----
    Every unit of every sample is one equation an axis, by ridge regression, each feature scaled to its root mean
    square; the ridge is the one with the least errors had each equation been left out.
    """
    linear = replace(forward, correction=None)
    influence = linear.influence if electrodes_mm_per_n is None else electrodes_mm_per_n
    if linear.sign is not None and electrodes_mm_per_n is None:
        raise SampleError("a model of conduction does not tell how electrodes move: give electrodes_mm_per_n.")
    effective_n, found = nearest_inverse(linear, resistance_ohm, force_n.mean(axis=0))
    if found.mean() < MIN_FOUND:
        raise SampleError(
            f"{np.count_nonzero(~found)} of {len(found)} samples at finite strain have resistances that the linear "
            "array cannot have: give samples of smaller loads (--cap)."
        )
    effective_n, force_n = effective_n[found], force_n[found]
    k = linear.n_forces // 3
    moved = (effective_n @ influence).reshape(-1, 3, k, 2).transpose(0, 2, 3, 1).reshape(-1, 6)
    sizes = np.concatenate([effective_n.reshape(-1, 3).std(axis=0), moved.std(axis=0)])
    empty = EffectiveForces(
        influence=influence,
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


def as_at_finite_strain(
    forward: ForwardModel,
    response: "ArrayResponse",
    data: Samples,
    component: Component,
    columns_ohm: FloatArray,
    force_n: FloatArray,
) -> tuple[ForwardModel, FloatArray]:
    """The forward model with what the samples at finite strain among `data` add, and the forces of all samples.

    A linear sample is given the forces that cause its resistances at finite strain. Without samples at finite strain,
    for a single component and where pillars are not read, all stays as it is.
    """
    finite = data.is_finite
    if not finite.any() or component.name != "all" or (data.dead is not None and data.dead.any()):
        return forward, force_n
    rows, cols = data.force_n.shape[1:3]
    moved = ForwardModel.of(replace(response, conducted=None), component).influence
    learned = at_finite_strain(forward, (rows, cols), columns_ohm[finite], force_n[finite], moved)
    return learned, with_actual_forces(learned, finite, force_n)


def with_actual_forces(forward: ForwardModel, finite: NDArray[np.bool_], force_n: FloatArray) -> FloatArray:
    """Forces (n, n_forces) [N], those of linear samples replaced by what causes their resistances at finite strain."""
    if forward.correction is not None and not finite.all():
        force_n = force_n.copy()
        force_n[~finite] = forward.correction.actual(force_n[~finite])
    return force_n


class _Fit(NamedTuple):
    weights: FloatArray
    left_out: FloatArray  #: errors had each row been left out


def _ridge(A: FloatArray, targets: FloatArray, ridge: float) -> _Fit:
    M = A.T @ A
    M.flat[:: len(M) + 1] += ridge
    inverse = np.linalg.inv(M).astype(np.float64)
    weights = inverse @ (A.T @ targets)
    freedom = np.maximum(1.0 - leverage(A, inverse), MIN_FREEDOM)  # exact for a ridge; the bound is for rounding
    return _Fit(weights, (targets - A @ weights) / freedom[:, None])
