"""A first guess of pillars' vectors and influence, from readings and forces alone."""

import numpy as np

from geometry.layout import FloatArray

RIDGE = 1e-6  #: of the linear part, over the mean energy of its features
SQUARE_RIDGE = 1e-4  #: the same of the squares
NEAR = 9  #: pads whose forces' squares count: those that move a unit's pillars most


def started(readings_ohm: FloatArray, force_n: FloatArray, n_units: int) -> tuple[FloatArray, FloatArray]:
    """Vectors at rest (P, 3) and influence (P, 3, Q) of R = |d + B F|², lengths in √Ω.

    Parameters
    ----------
    readings_ohm : array, shape (n, P)
    force_n : array, shape (n, Q)
    n_units : int

    Notes
    -----
    To first order √R = d₁ + B₁ F, a ridge regression. The other rows of B are the leading directions of the squares
    that are left, as functions of the forces on the `NEAR` pads: from 0 no Gauss-Newton step would find them.
    """
    (n, P), Q = readings_ohm.shape, force_n.shape[1]
    scale_n = max(float(force_n.std()), 1e-9)
    F = force_n / scale_n
    linear = np.column_stack([np.ones(n), F])
    first = _ridge(linear, readings_ohm, RIDGE)
    rest = np.sqrt(np.maximum(first[0], 0.1 * readings_ohm.mean(axis=0)))
    B = np.zeros((P, 3, Q))
    B[:, 0] = (first[1:] / (2.0 * rest)).T
    strength = (B[:, 0].reshape(n_units, -1, n_units, Q // n_units) ** 2).sum(axis=(1, 3))
    for unit, pads in enumerate(np.argsort(-strength, axis=1)[:, :NEAR]):
        columns = (pads[:, None] * (Q // n_units) + np.arange(Q // n_units)).ravel()
        i, j = np.triu_indices(len(columns))
        squares = F[:, columns[i]] * F[:, columns[j]]
        pillars = np.arange(unit * (P // n_units), (unit + 1) * (P // n_units))
        left = readings_ohm[:, pillars] - (rest[pillars] + F @ B[pillars, 0].T) ** 2
        found = _ridge(np.column_stack([squares, linear]), left, SQUARE_RIDGE)[: len(i)]
        for pillar, weights in zip(pillars, found.T, strict=True):
            square = np.zeros((len(columns), len(columns)))
            square[i, j] = weights / 2.0
            energies, directions = np.linalg.eigh(square + square.T)
            for row in (1, 2):
                B[pillar, row, columns] = directions[:, -row] * np.sqrt(max(energies[-row], 1e-12))
    vectors = np.zeros((P, 3))
    vectors[:, 0] = rest
    return vectors, B / scale_n


def _ridge(features: FloatArray, targets: FloatArray, ridge: float) -> FloatArray:
    """Weights (n_features, n_targets) of a ridge regression."""
    G = features.T @ features
    G.flat[:: len(G) + 1] += ridge * np.trace(G) / len(G)
    return np.asarray(np.linalg.solve(G, features.T @ targets), dtype=np.float64)
