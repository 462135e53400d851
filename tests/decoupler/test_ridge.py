"""Generalised cross-validation against its definition, and what it chooses."""

import numpy as np

from decoupler.ridge import RIDGES, best_ridge


def scores(A, T):
    """The criterion of every ridge by its hat matrix, as written in the paper."""
    n = len(A)
    found = []
    for ridge in RIDGES * n:
        hat = A @ np.linalg.solve(A.T @ A + ridge * np.eye(A.shape[1]), A.T)
        residual = T - hat @ T
        found.append(np.sum(residual**2) / (n - np.trace(hat)) ** 2)
    return np.array(found)


def test_chooses_the_ridge_of_least_score():
    generator = np.random.default_rng(0)
    A = generator.uniform(-1, 1, (40, 6))
    T = A @ generator.standard_normal((6, 3)) * 0.1 + generator.standard_normal((40, 3))
    assert best_ridge(A, T) == RIDGES[scores(A, T).argmin()] * 40


def test_believes_exact_data_and_forgets_noise():
    generator = np.random.default_rng(0)
    A = generator.uniform(-1, 1, (50, 5))
    assert best_ridge(A, A[:, :2]) == RIDGES[0] * 50
    assert best_ridge(A, generator.standard_normal((50, 200))) >= 0.01 * 50


def test_more_features_than_samples():
    generator = np.random.default_rng(0)
    A = generator.uniform(-1, 1, (5, 20))
    assert best_ridge(A, generator.standard_normal((5, 3))) in RIDGES * 5
