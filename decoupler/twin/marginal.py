"""Readings of pillars whose own unknowns are marginalised."""

from collections.abc import Callable

import numpy as np

from geometry.layout import FloatArray


class Marginal:
    """S⁻¹ of S = I + J Jᵀ for b pillars: readings whitened, each pillar's own unknowns marginalised.

    J is (b, n, m). With fewer readings than unknowns S itself is factored, else I + Jᵀ J.
    """

    def __init__(self, J: FloatArray) -> None:
        n, m = J.shape[1:]
        self.J, self.Jt, self.dual = J, J.swapaxes(1, 2), n <= m
        M = J @ self.Jt if self.dual else self.Jt @ J
        M += np.eye(M.shape[1])
        self.half = np.linalg.inv(np.linalg.cholesky(M))  # M⁻¹ = halfᵀ half

    def _inverse(self, X: FloatArray) -> FloatArray:
        return self.half.swapaxes(1, 2) @ (self.half @ X)

    def solved(self, Y: FloatArray) -> tuple[FloatArray, Callable[[FloatArray], FloatArray]]:
        """X = S⁻¹ Y, (b, n, g), and Jᵀ X V as a function of V (g, ·), (b, m, ·)."""
        if self.dual:
            X = self._inverse(Y)
            return X, lambda V: self.Jt @ (X @ V)
        K = self._inverse(self.Jt @ Y)
        return Y - self.J @ K, lambda V: K @ V

    def drawn(self, prior: FloatArray, noise: FloatArray) -> FloatArray:
        """Draws of the pillars' own unknowns about their means, (b, m, draws), from draws of prior and noise."""
        if self.dual:
            return prior - self.Jt @ self._inverse(self.J @ prior + noise)
        return self._inverse(prior - self.Jt @ noise)

    def leverage(self) -> tuple[FloatArray, FloatArray]:
        """Diagonals of S⁻¹, (b, n), and of Jᵀ S⁻¹ J, (b, m): what is left of a reading, what is known of an unknown.

        With more readings than unknowns the first is the mean of all readings.
        """
        n = self.J.shape[1]
        squares = (self.half**2).sum(axis=1)
        if self.dual:
            return squares, ((self.half @ self.J) ** 2).sum(axis=1)
        known = 1.0 - squares
        return np.repeat(1.0 - known.sum(axis=1, keepdims=True) / n, n, axis=1), known
