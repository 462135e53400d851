"""How strongly weights are held to what is known before training: ridge regression chosen by its own errors."""

import numpy as np

from geometry.layout import FloatArray

RIDGES = np.logspace(-10, 3, 27)  #: per sample, of inputs and targets scaled to [-1, 1]


def best_ridge(A: FloatArray, targets: FloatArray, readings: float = 1.0) -> float:
    """The λ of min ‖A W − T‖² + λ‖W‖² that promises the least error on new samples.

    Parameters
    ----------
    A : array, shape (n_samples, n_features)
    targets : array, shape (n_samples, n_out)
    readings : float
        Samples a load, in the mean: they share their misfit, so all of a load count as left out together.

    Notes
    -----
    Generalised cross-validation (Golub, Heath & Wahba, Technometrics 21, 1979): the λ with the least
    ‖residual‖²/(n − readings · effective number of weights)², from one eigendecomposition of AᵀA.
    """
    n = len(A)
    energies, directions = np.linalg.eigh(A.T @ A)
    energies = np.maximum(energies, 1e-15 * energies[-1])
    fitted = ((directions.T @ (A.T @ targets)) ** 2).sum(axis=1) / energies  # explained by each direction
    unfitted = max(float((targets**2).sum() - fitted.sum()), 0.0)
    kept = energies / (energies + RIDGES[:, None] * n)  # (n_ridges, n_features)
    residual = unfitted + ((1.0 - kept) ** 2 * fitted).sum(axis=1)
    score = residual / np.maximum(n - readings * kept.sum(axis=1), 0.5) ** 2
    return float(RIDGES[score.argmin()] * n)
