"""The least error that readings allow, whatever the estimator, by the response.

`cramer_rao` bounds estimators that do not lean on which forces are likely; `bayes` those that do.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dataset.measurement import ReadingError
from decoupler.inverse.sensor_model import SensorModel
from geometry.layout import FloatArray

LEAST_TOLD = 1e-12  #: of what lengths tell along a direction of forces, over the direction of which they tell most
CHUNK_SAMPLES = 64  #: samples whose derivatives are in memory together


def cramer_rao(
    forward: SensorModel,
    force_n: FloatArray,
    errors: ReadingError,
    shape: tuple[int, int],
    readable: NDArray[np.bool_] | None = None,
) -> FloatArray:
    """Least standard deviation of unbiased estimates of forces, (n, n_forces) [N] -> the same shape [N].

    Parameters
    ----------
    errors : ReadingError
        Of the readings. If these are exact the bound is 0.
    shape : int, int
        Rows and columns of the array.
    readable : array, shape (n_pillars,), optional
        Pillars that can be read; default: all. If they are fewer than the forces, every bound is infinite.

    Notes
    -----
    The diagonal of (Jᵀ Σ⁻¹ J)⁻¹, linearised about each sample's true forces: J of the lengths, Σ of their errors.
    """
    n_readable = forward.n_pillars if readable is None else int(readable.sum())
    if n_readable < forward.n_forces:
        return np.full_like(force_n, np.inf)
    found = np.zeros_like(force_n)
    if not errors.is_exact:
        for part, J, covariance in _linearised(forward, force_n, errors, shape, readable):
            told = np.linalg.solve(np.linalg.cholesky(covariance), J)
            held = LEAST_TOLD * np.linalg.norm(told, axis=(1, 2), keepdims=True) * np.eye(J.shape[2])
            root = np.linalg.qr(np.concatenate([told, held], axis=1), mode="r")  # RᵀR = Jᵀ Σ⁻¹ J
            found[part] = np.sqrt((np.linalg.inv(root) ** 2).sum(axis=2))
    return found


def bayes(
    forward: SensorModel,
    force_n: FloatArray,
    errors: ReadingError,
    shape: tuple[int, int],
    readable: NDArray[np.bool_] | None = None,
    usual_n: FloatArray | None = None,
) -> FloatArray:
    """Least standard deviation of estimates that know the mean and covariance of the usual forces, as a network does.

    `usual_n`, shape (many, n_forces), is where these are taken from; default: `force_n`. Give several times as many as
    there are forces: m samples of p forces seem to determine each other, which lowers the limit by √(1 − p/m) where
    the readings say little.

    Notes
    -----
    The diagonal of C − C Jᵀ (J C Jᵀ + Σ)⁻¹ J C with C the covariance of the forces: exact for normal forces and linear
    lengths. Forces of another distribution can be estimated better.
    """
    C = np.cov((force_n if usual_n is None else usual_n).T, bias=True).reshape(force_n.shape[1], -1)
    found = np.empty_like(force_n)
    for part, J, covariance in _linearised(forward, force_n, errors, shape, readable):
        JC = J @ C
        taken = np.einsum("nmf,nmf->nf", JC, np.linalg.solve(JC @ J.swapaxes(1, 2) + covariance, JC))
        found[part] = np.sqrt(np.maximum(C.diagonal() - taken, 0.0))
    return found


def _linearised(
    forward: SensorModel,
    force_n: FloatArray,
    errors: ReadingError,
    shape: tuple[int, int],
    readable: NDArray[np.bool_] | None,
) -> Iterator[tuple[slice, FloatArray, FloatArray]]:
    """Chunks of samples: derivatives of the readable lengths (c, P, Q) [mm/N], covariance of their errors [mm²]."""
    floor = 1e-9 * forward.rest_mm.max()  # keeps the covariance invertible without noise
    for start in range(0, len(force_n), CHUNK_SAMPLES):
        part = slice(start, start + CHUNK_SAMPLES)
        lengths, J = forward.jacobian(force_n[part])
        deviation, U = forward.errors_mm2(forward.ohms(lengths**2), errors, shape)
        deviation, U = 0.5 * deviation / lengths, 0.5 * U / lengths[..., None]
        if readable is not None:
            J, deviation, U = J[:, readable], deviation[:, readable], U[:, readable]
        alone = np.maximum(deviation, floor)[..., None] ** 2 * np.eye(deviation.shape[1])
        yield part, J, alone + U @ U.swapaxes(1, 2)
