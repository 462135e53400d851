"""Least squares of models that are linear in most of their numbers, with a prior, outliers and correlated errors.

A model is columns (n, m) that depend on k other numbers; a sum of them meets the target. Errors have tails as those of
Student's distribution, and what follows them slowly is taken out by differences over `CORRELATION_S`. What is then left
of their correlation makes readings worth less: n of them count as n / inflation.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from geometry.layout import FloatArray

CORRELATION_S = 1.0  #: over which errors are taken as alike; chosen by parts of series that were not fitted
TAILS = 2.0  #: degrees of freedom of Student's distribution
UNCORRELATED = 0.05  #: correlation that ends the sum of correlations
ROUNDS = 8  #: of weights and variances
LEAST = 1e-6  #: deviation of errors, relative to the target's: arithmetic has them
STEP = 1e-4  #: of differences for slopes, and the last one of a search
TOLERANCE = 1e-6  #: of a sum of squares

Columns = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, kw_only=True, eq=False)
class Prior:
    """What is known of m linear numbers and k others before."""

    mean: FloatArray  #: (m + k,)
    deviation: FloatArray  #: (m + k,)
    linear: int  #: m


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """Numbers that meet a target best, and how well they are known."""

    numbers: FloatArray  #: (m + k,)
    covariance: FloatArray  #: (m + k, m + k)
    error: FloatArray  #: target less model, (n,)
    noise: float  #: standard deviation of these errors
    correlation_s: float  #: time over which they are alike [s]
    count: float  #: independent readings that n are worth
    cost: float  #: −2 ln of the posterior's density, but for a constant


def fitted(columns: Columns, target: FloatArray, seconds: FloatArray, prior: Prior, starts: FloatArray) -> Fit:
    """The most probable numbers for a target (n,) with steps (n − 1,) [s] between; `starts` are others' (s, k)."""
    problems = [_Problem(columns, target, seconds, prior, start) for start in starts]
    coarse = [problem.solved(rounds=1) for problem in problems] if len(problems) > 1 else problems
    return min(coarse, key=lambda problem: problem.cost).solved(ROUNDS).found()


@dataclass(frozen=True, eq=False)
class _Problem:
    """A fit under way."""

    columns: Columns
    target: FloatArray
    seconds: FloatArray
    prior: Prior
    others: FloatArray  #: the k numbers that are not linear
    weight: FloatArray | float = 1.0  #: of each reading, root of Student's
    variance: float = 1e-3  #: of an error, as weighted
    inflation: float = 20.0
    cost: float = 0.0

    def whitened(self, values: FloatArray) -> FloatArray:
        """Values (n, ...) less what of each is known by the one before."""
        keep = np.exp(-self.seconds / CORRELATION_S).reshape(-1, *[1] * (values.ndim - 1))
        rest = (values[1:] - keep * values[:-1]) / np.sqrt(1 - keep**2)
        weight = self.weight if isinstance(self.weight, float) else self.weight.reshape(-1, *[1] * (values.ndim - 1))
        return np.concatenate([values[:1], rest]) * weight

    def linear(self, others: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Columns as weighted, the best linear numbers, and the residuals with the prior's, in standard deviations."""
        m, scale = self.prior.linear, np.sqrt(self.variance * self.inflation)
        A, y = self.whitened(self.columns(others)), self.whitened(self.target)
        precise = scale / self.prior.deviation
        N = A.T @ A + np.diag(precise[:m] ** 2)
        right = A.T @ y + precise[:m] ** 2 * self.prior.mean[:m]
        equal = 1 / np.sqrt(N.diagonal())
        numbers = equal * np.linalg.solve(N * np.outer(equal, equal), equal * right)
        from_prior = precise * (np.r_[numbers, others] - self.prior.mean)
        return A, numbers, np.r_[A @ numbers - y, from_prior] / scale

    def residuals(self, others: FloatArray) -> FloatArray:
        return self.linear(others)[2]

    def solved(self, rounds: int) -> "_Problem":
        """Numbers, weights and variances that belong together."""
        from scipy.optimize import least_squares

        problem, n = self, len(self.target)
        low, high = (self.prior.mean + sign * 5 * self.prior.deviation for sign in (-1, 1))
        bounds = low[self.prior.linear :], high[self.prior.linear :]
        for _ in range(rounds):
            before = problem.others
            answer = least_squares(problem.residuals, before, bounds=bounds, diff_step=STEP, ftol=TOLERANCE, xtol=STEP)
            error = problem.linear(answer.x)[2][:n] * np.sqrt(problem.variance * problem.inflation) / problem.weight
            variance, weight = _of_tails(error, LEAST * float(np.std(self.target)))
            problem = replace(
                problem, others=answer.x, weight=weight, variance=variance,
                inflation=max(1.0, inflation(error * weight)), cost=2 * answer.cost,
            )  # fmt: skip
            if np.abs(answer.x - before).max() < 10 * STEP:
                break
        return problem

    def found(self) -> Fit:
        """The fit with its covariance H⁻¹ (Jᵀ C J + P) H⁻¹: H and P the precision after and before, C of the scores."""
        n, (A, numbers, residual) = len(self.target), self.linear(self.others)
        slopes = [
            (self.columns(self.others + step) - self.columns(self.others - step)) @ numbers / (2 * STEP)
            for step in STEP * np.eye(len(self.others))
        ]
        weight = np.broadcast_to(self.weight, n)
        J = np.concatenate([A, self.whitened(np.stack(slopes, axis=1))], axis=1) / weight[:, None]
        worth, P = self.variance * self.inflation, np.diag(self.prior.deviation**-2)
        error = residual[:n] * np.sqrt(worth) / weight
        u = error**2 / self.variance  # of Student's score ψ = w u^½: its slope, and its square
        slope, square = np.mean((TAILS + 1) * (TAILS - u) / (TAILS + u) ** 2), np.mean(weight**4 * u)
        told = max(float(slope), LEAST) * J.T @ J / worth
        spent = float(np.trace(np.linalg.solve(told + P, told)))
        count = n / self.inflation
        used_up = count / max(count - spent, 1.0)  # what numbers take from the errors
        told = told / used_up
        H = np.linalg.inv(told + P)
        spread = square * _correlated(J, weight**2 * error) / (worth * self.inflation * used_up)
        covariance = H @ (spread + P) @ H
        error = self.target - self.columns(self.others) @ numbers
        return Fit(
            numbers=np.r_[numbers, self.others], covariance=(covariance + covariance.T) / 2, error=error,
            noise=float(np.std(error)),
            correlation_s=inflation(error) * float(np.median(self.seconds)) / 2, count=count, cost=self.cost,
        )  # fmt: skip


def _of_tails(error: FloatArray, least: float) -> tuple[float, FloatArray]:
    """Variance of errors (n,) of Student's distribution, and the roots of the weights that it gives them."""
    variance = float(np.mean(error**2)) + least**2
    for _ in range(20):
        weight = (TAILS + 1) / (TAILS + error**2 / variance)
        variance = float(np.mean(weight * error**2)) + least**2
    return variance, np.sqrt((TAILS + 1) / (TAILS + error**2 / variance))


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
    n, rho = len(J), correlations(error)
    kernel = np.zeros(2 * n)
    kernel[: len(rho)] = rho
    kernel[2 * n - len(rho) + 1 :] = rho[:0:-1]
    smooth = np.fft.irfft(np.fft.rfft(kernel)[:, None] * np.fft.rfft(J, 2 * n, axis=0), axis=0)[:n]
    size = np.sqrt((J**2).sum(axis=0)) + 1e-300
    found = J.T @ smooth / np.outer(size, size)
    values, directions = np.linalg.eigh((found + found.T) / 2)
    return (directions * np.maximum(values, 0.0)) @ directions.T * np.outer(size, size)
