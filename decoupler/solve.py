"""Least squares: by a ridge where they are linear, by Levenberg's method on many small problems where not."""

from collections.abc import Callable, Sequence

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from geometry.layout import FloatArray

MIN_FREEDOM = 1e-9  #: of an equation, when it is left out
FACTORS = 0.1, 10.0  #: of a damping, after a fall and after a rise
RIDGES = np.logspace(-10, 3, 27)  #: per sample, of features and targets scaled to [-1, 1]


def descended(
    start: FloatArray,
    at: Callable[[FloatArray, NDArray[np.intp]], tuple[FloatArray, ...]],
    step: Callable[[tuple[FloatArray, ...], FloatArray, NDArray[np.intp]], FloatArray],
    rounds: int,
    damping: tuple[float, float] = (1e-3, 1e6),
    gained: float = 0.0,
    enough: float = -np.inf,
) -> tuple[FloatArray, tuple[FloatArray, ...]]:
    """Where n sums of squares are least, and what they are there.

    Parameters
    ----------
    start : array, shape (n, q)
    at : callable
        Arrays of points (k, q) of the problems (k,), whose first is the cost.
    step : callable
        From such a tuple, the dampings (k,) and the problems (k,) to steps (k, q).
    rounds : int
        Steps at most.
    damping : float, float
        The first one, and that beyond which a problem has ended; `FACTORS` change it.
    gained : float
        Fall of the cost below which a problem has ended, as it has with `enough` of a cost.

    Notes
    -----
    Each problem ends by itself and takes its own dampings, so that it has the same bits alone and in any batch.
    """
    on = np.arange(len(start))
    x, here, own = start.copy(), at(start, on), np.full(len(start), damping[0])
    on = on[here[0] > enough]
    for _ in range(rounds):
        if not len(on):
            break
        trial = x[on] + step(tuple(values[on] for values in here), own[on], on)
        there = at(trial, on)
        gain = here[0][on] - there[0]
        better = gain > 0
        x[on[better]] = trial[better]
        for old, new in zip(here, there, strict=True):
            old[on[better]] = new[better]
        own[on] *= np.where(better, *FACTORS)
        ended = (better & (gain < gained)) | (own[on] > damping[1]) | (here[0][on] <= enough)
        on = on[~ended]
    return x, here


def best_ridge(A: FloatArray, targets: FloatArray, readings: float = 1.0) -> float:
    """The λ of min ‖A W − T‖² + λ‖W‖² that promises the least error on new samples, A (n, n_features), T (n, n_out).

    `readings` is the mean number of samples a load: they share their misfit, so all of a load count as left out
    together.

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


def ridge(A: FloatArray, targets: FloatArray, penalty: float) -> FloatArray:
    """Weights W (n_features, m) of min ‖A W − T‖² + λ‖W‖², A (n, n_features), T (n, m)."""
    G = A.T @ A
    G.flat[:: len(G) + 1] += penalty
    return np.asarray(np.linalg.solve(G, A.T @ targets), dtype=np.float64)


def ridge_left_out(A: FloatArray, targets: FloatArray, ridges: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    """Weights (n_features, m) of targets (n, m), each by its best ridge, and errors (n, m) had each been left out.

    The best has the least such errors; `ridges` are λ / n.

    By the singular vectors of A, from the smaller of its two products with itself: one decomposition for all ridges.
    """
    n, few = len(A), len(A) < A.shape[1]
    energies, vectors = scipy.linalg.eigh(A @ A.T if few else A.T @ A, driver="evd", check_finite=False)
    energies = np.maximum(energies, MIN_FREEDOM**2 * energies[-1])
    left = vectors if few else (A @ vectors) / np.sqrt(energies)
    fitted, squared = left.T @ targets, left**2
    best, weights, left_out = np.full(targets.shape[1], np.inf), np.empty((A.shape[1], len(targets.T))), targets.copy()
    for ridge in ridges:
        kept = energies / (energies + ridge * n)
        freedom = np.maximum(1.0 - squared @ kept, MIN_FREEDOM)  # exact for a ridge; the bound is for rounding
        errors = (targets - left @ (kept[:, None] * fitted)) / freedom[:, None]
        squares = (errors**2).mean(axis=0)
        better = squares < best
        weights[:, better] = A.T @ (left @ (fitted[:, better] / (energies + ridge * n)[:, None]))
        left_out[:, better], best[better] = errors[:, better], squares[better]
    return weights, left_out
