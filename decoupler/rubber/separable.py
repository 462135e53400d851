"""Least squares of models that are linear in most of their numbers, with a prior, outliers and correlated errors.

A model is columns (n, m) that depend on k other numbers; a sum of them meets the target. Errors have tails as those of
Student's distribution, and what follows them slowly is taken out by differences over `CORRELATION_S`. What is then left
of their correlation makes readings worth less: n of them count as n / inflation.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from geometry.layout import FloatArray

CORRELATION_S = 1.0  #: over which errors are taken as alike; chosen by parts of series that were not fitted
TAILS = 2.0  #: degrees of freedom of Student's distribution
UNCORRELATED = 0.05  #: correlation that ends the sum of correlations
ROUNDS = 8  #: of weights and variances
LEAST_DEVIATION = 1e-6  #: deviation of errors, relative to the target's: arithmetic has them
STEP = 1e-4  #: of differences for slopes, and the last one of a search
TOLERANCE = 1e-6  #: of a sum of squares

Columns = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """Numbers that meet a target best, and how well they are known."""

    numbers: FloatArray  #: (m + k,)
    covariance: FloatArray  #: (m + k, m + k)
    noise: float  #: standard deviation of the target about the model
    correlation_s: float  #: time over which these errors are alike [s]
    count: float  #: independent readings that n are worth


def fitted(columns: Columns, target: FloatArray, seconds: FloatArray, prior: FloatArray, starts: FloatArray) -> Fit:
    """The most probable numbers for a target (n,) with steps (n − 1,) [s] between; `starts` are others' (s, k).

    `prior` (m + k, 2) has mean and deviation of the linear numbers and of the others.
    """
    problems = [_Problem(columns, target, seconds, prior, start) for start in starts]
    if len(problems) > 1:
        for problem in problems:
            problem.solve(rounds=1)
    best = min(problems, key=lambda problem: problem.cost)
    best.solve(ROUNDS)
    return best.found()


class _Problem:
    """A fit under way: others (k,) that are not linear, the root weight of each reading, and an error's variance."""

    def __init__(
        self, columns: Columns, target: FloatArray, seconds: FloatArray, prior: FloatArray, others: FloatArray
    ) -> None:
        self.columns, self.target, self.seconds, self.others = columns, target, seconds, others
        self.keep = np.exp(-seconds / CORRELATION_S)[:, None]
        self.own = np.sqrt(1 - self.keep**2)
        (self.mean, self.deviation), self.m = prior.T, len(prior) - len(others)
        self.weight, self.variance, self.inflation, self.cost = np.ones(len(target)), 1e-3, 20.0, 0.0

    def whitened(self, values: FloatArray) -> FloatArray:
        """Values (n, p) less what of each is known by the one before, weighted."""
        rest = (values[1:] - self.keep * values[:-1]) / self.own
        return np.concatenate([values[:1], rest]) * self.weight[:, None]

    def linear(self, others: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Columns as weighted, the best linear numbers, and the residuals with the prior's, in standard deviations."""
        m, scale = self.m, np.sqrt(self.variance * self.inflation)
        A, y = self.whitened(self.columns(others)), self.whitened(self.target[:, None])[:, 0]
        precise = scale / self.deviation
        N = A.T @ A + np.diag(precise[:m] ** 2)
        right = A.T @ y + precise[:m] ** 2 * self.mean[:m]
        equal = 1 / np.sqrt(N.diagonal())
        numbers = equal * np.linalg.solve(N * np.outer(equal, equal), equal * right)
        return A, numbers, np.r_[A @ numbers - y, precise * (np.r_[numbers, others] - self.mean)] / scale

    def solve(self, rounds: int) -> None:
        """Find numbers, weights and variances that belong together."""
        from scipy.optimize import least_squares

        low, high = (self.mean + sign * 5 * self.deviation for sign in (-1, 1))
        settings = {"bounds": (low[self.m :], high[self.m :]), "diff_step": STEP, "ftol": TOLERANCE, "xtol": STEP}
        for _ in range(rounds):
            before = self.others
            answer = least_squares(lambda others: self.linear(others)[2], before, **settings)
            error = self.error(answer.fun)
            self.variance, self.weight = _of_tails(error, LEAST_DEVIATION * float(np.std(self.target)))
            self.others, self.inflation = answer.x, max(1.0, inflation(error * self.weight))
            self.cost = 2 * answer.cost  # −2 ln of the posterior's density, but for a constant
            if np.abs(self.others - before).max() < 10 * STEP:
                break

    def error(self, residual: FloatArray) -> FloatArray:
        """Errors (n,) of residuals, without weights."""
        return residual[: len(self.target)] * np.sqrt(self.variance * self.inflation) / self.weight

    def found(self) -> Fit:
        """The fit with its covariance H⁻¹ (Jᵀ C J + P) H⁻¹: H and P the precision after and before, C of the scores."""
        A, numbers, residual = self.linear(self.others)
        slopes = [
            (self.columns(self.others + step) - self.columns(self.others - step)) @ numbers / (2 * STEP)
            for step in STEP * np.eye(len(self.others))
        ]
        J = np.concatenate([A, self.whitened(np.stack(slopes, axis=1))], axis=1) / self.weight[:, None]
        worth, P = self.variance * self.inflation, np.diag(self.deviation**-2)
        error = self.error(residual)
        u = error**2 / self.variance  # of Student's score ψ = w u^½: its slope, and its square
        slope, square = np.mean((TAILS + 1) * (TAILS - u) / (TAILS + u) ** 2), np.mean(self.weight**4 * u)
        told = max(float(slope), LEAST_DEVIATION) * J.T @ J / worth
        count = len(error) / self.inflation
        used_up = count / max(count - float(np.trace(np.linalg.solve(told + P, told))), 1.0)  # by the numbers found
        H = np.linalg.inv(told / used_up + P)
        spread = square * _correlated(J, self.weight**2 * error) / (worth * self.inflation * used_up)
        covariance = H @ (spread + P) @ H
        error = self.target - self.columns(self.others) @ numbers
        return Fit(
            numbers=np.r_[numbers, self.others], covariance=(covariance + covariance.T) / 2, count=count,
            noise=float(np.std(error)), correlation_s=inflation(error) * float(np.median(self.seconds)) / 2,
        )  # fmt: skip


def _of_tails(error: FloatArray, least: float) -> tuple[float, FloatArray]:
    """Variance of errors (n,) of Student's distribution, and the roots of the weights that it gives them."""
    weight = np.ones_like(error)
    for _ in range(21):
        variance = float(np.mean(weight * error**2)) + least**2
        weight = (TAILS + 1) / (TAILS + error**2 / variance)
    return variance, np.sqrt(weight)


def correlations(error: FloatArray) -> FloatArray:
    """Correlations of errors (n,) with those before, from 1 on until they end."""
    n = len(error)
    spectrum = np.fft.rfft(error - error.mean(), 2 * n)
    found = np.fft.irfft(spectrum * spectrum.conj())[:n]
    found = found / found[0] if found[0] > 0 else np.eye(1, n)[0]
    over = found < UNCORRELATED
    return found[: max(1, int(over.argmax()) if over.any() else n)]


def inflation(error: FloatArray) -> float:
    """Of how many errors (n,) one is worth: 1 + 2 Σ of their correlations."""
    return float(2 * correlations(error).sum() - 1)


def _correlated(J: FloatArray, error: FloatArray) -> FloatArray:
    """Jᵀ C J (p, p) of slopes (n, p) and errors' correlations C, none of its directions below 0."""
    from scipy.linalg import matmul_toeplitz

    rho, size = correlations(error), np.sqrt((J**2).sum(axis=0)) + 1e-150
    found = J.T @ matmul_toeplitz(np.r_[rho, np.zeros(len(J) - len(rho))], J) / np.outer(size, size)
    values, directions = np.linalg.eigh((found + found.T) / 2)
    return (directions * np.maximum(values, 0.0)) @ directions.T * np.outer(size, size)
