"""Generalised cross-validation against its definition, and what it chooses."""

import numpy as np

from decoupler.training.error_bars import RIDGES, best_ridge


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


def test_readings_of_one_load_count_once():
    """Ten noisy readings of each of 12 loads that no linear map meets: held as strongly as the 12 loads alone.

    Counted one by one they seem to prove the fit: a tenth of the ridge and less.
    """
    generator = np.random.default_rng(0)
    A, T = generator.uniform(-1, 1, (12, 10)), generator.standard_normal((12, 30))
    often = np.repeat(A, 10, axis=0) + 1e-4 * generator.standard_normal((120, 10)), np.repeat(T, 10, axis=0)
    assert best_ridge(*often, 10.0) / 120 == best_ridge(A, T) / 12
    assert best_ridge(*often) / 120 < 0.1 * best_ridge(A, T) / 12
