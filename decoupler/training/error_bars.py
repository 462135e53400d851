"""Errors that a model will make on new samples: those on its training set, had each sample been left out."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from decoupler.data.columns import Columns
from decoupler.model.decoupler import Decoupler
from decoupler.model.uncertainty import WITHIN, Uncertainty, leverage
from geometry.layout import FloatArray

ENOUGH_SAMPLES = 500  #: number of samples for the effect of noise and for the widths
MIN_FREEDOM = 0.05  #: 1 − leverage below which a training sample's own error says nothing
LIGHT = 0.05  #: share of the training samples, the lightest, that do not count as loaded
MIN_DEVIATION = 1e-12  #: over a force's range, so that nothing is divided by 0


def with_uncertainty(
    decoupler: Decoupler,
    data: Columns,
    inputs: FloatArray,
    ridge: float,
    n_light: int,
    judged: NDArray[np.int64] | None = None,
) -> Decoupler:
    """A model with its uncertainty, from its training set, of which the last `n_light` samples are light.

    `inputs` (n, k) are those of its network, `ridge` is λ on the output weights; `judged` (n_judged,) are the samples
    that say the errors of those under load, by default all.

    Notes
    -----
    A training sample's own error is divided by 1 − leverage: its error if it had been left out (the PRESS
    residual of linear regression); the hidden weights, shared by all outputs, add their share to every leverage.
    Readings of one load are left out together: their leverages add up, which is exact where they are alike. A
    sample that the network meets whatever its force is (fewer samples than weights) has none; it is taken to be as
    unknown as before training.
    """
    columns_ohm, force_n = data.resistance_ohm, data.force_n
    A = decoupler.network.activations(inputs)
    M = A.T @ A
    M.flat[:: len(M) + 1] += ridge
    G = np.linalg.inv(M).astype(np.float64)
    of_weights = leverage(A, G).clip(0.0, 1.0)
    shared = decoupler.network.below / force_n.size
    freedom = 1.0 - np.bincount(data.load, of_weights + shared)[data.load]
    told_n = decoupler.output_scaling.unscale(A @ decoupler.network.output.T)
    errors = (told_n - force_n) / np.maximum(freedom, MIN_FREEDOM)[:, None]
    errors = np.where((freedom > MIN_FREEDOM)[:, None], errors, force_n - force_n.mean(axis=0))
    n = len(A) - n_light
    loaded = np.arange(n) if judged is None else np.sort(judged[judged < n])
    unexplained = (errors[loaded] ** 2).mean(axis=0)
    n_axes = len(decoupler.component.axes)
    smallest = (MIN_DEVIATION * np.ptp(force_n, axis=0)) ** 2 + 1e-300
    drift_factor = _drift_factor(decoupler, data[loaded], errors[loaded])
    decoupler = replace(decoupler, uncertainty=replace(decoupler.uncertainty, drift_factor=drift_factor))
    light = np.arange(n, len(A)) if n_light else loaded
    misfits, widths = [], []
    for part in (light, loaded):
        some = part[np.linspace(0, len(part) - 1, min(ENOUGH_SAMPLES, len(part))).astype(int)]
        through = decoupler.noise_variance(columns_ohm[some])
        left = np.maximum((errors[part] ** 2).mean(axis=0) - through.mean(axis=0), 0.0)
        if n_light and part is light:  # few outputs are touched often: all of an axis together tell more
            left = np.tile(left.reshape(-1, n_axes).mean(axis=0), len(left) // n_axes)
        misfits.append(left + smallest)
        weights_n2 = np.minimum(unexplained * of_weights[some, None], decoupler.output_scaling.half_range**2)
        deviation = np.sqrt(through + misfits[-1] + weights_n2)
        ratio = np.abs(errors[some] / deviation).reshape(-1, n_axes)
        widths.append([np.quantile(ratio, share, axis=0) / (k + 1) for k, share in enumerate(WITHIN)])
    uncertainty = Uncertainty(
        inverse_matrix=G,
        misfit_n2=np.stack(misfits),
        unexplained_n2=unexplained,
        widths=np.array(widths),
        light_n2=np.quantile((force_n[:n] ** 2).mean(axis=1), [LIGHT]),
        drift_factor=drift_factor,
    )
    return replace(decoupler, uncertainty=uncertainty)


def _drift_factor(decoupler: Decoupler, data: Columns, errors_n: FloatArray) -> FloatArray | None:
    """`Uncertainty.drift_factor` by samples of training and the forces' errors (n, n_out) [N]; None without drift.

    Notes
    -----
    A linear estimate S of least mean square under readings with a deviation U of shared drifts errs by S U P^(-1/2) of
    a unit normal number, P the covariance that the drifts keep when the readings are known, beside what readings err by
    on their own: it holds some drift for load and some load for drift, both along S U. So P⁻¹ is the covariance of the
    errors' coefficients of S U by weighted least squares, less the share in it of what readings err by on their own.
    """
    n, P = data.resistance_ohm.shape
    m = data.errors.shared(data.resistance_ohm[:1], *data.shape).shape[2]
    if not m:
        return None
    some, covariance = np.linspace(0, n - 1, min(ENOUGH_SAMPLES, n)).astype(int), np.zeros((m, m))
    for chunk, factors in decoupler.error_factors(data.resistance_ohm[some]):
        for own, A, error_n in zip(factors[..., :P], factors[..., P : P + m], errors_n[some][chunk], strict=True):
            weighted = A / np.maximum((own**2).sum(axis=1), 1e-300)[:, None]
            H = np.linalg.solve(weighted.T @ A, weighted.T)
            covariance += (np.outer(H @ error_n, H @ error_n) - (H @ own) @ (H @ own).T) / len(some)
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(np.linalg.cholesky((vectors * np.maximum(values, 1.0)) @ vectors.T), dtype=np.float64)
