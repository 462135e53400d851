"""Readings of a pillar whose own unknowns are marginalised."""

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri

from geometry.layout import FloatArray


class Marginal:
    """S⁻¹ of S = I + J Jᵀ: whitened readings of a pillar, its own unknowns marginalised.

    J is (n, m). With fewer readings than unknowns S itself is factored, else I + Jᵀ J. `half` is the factor's inverse,
    if it is known from before.
    """

    def __init__(self, J: FloatArray, half: FloatArray | None = None) -> None:
        self.J, self.dual = J, len(J) <= J.shape[1]
        if half is None:
            M = J @ J.T if self.dual else J.T @ J
            M.flat[:: len(M) + 1] += 1.0
            lower, failed = dpotrf(M.T, lower=1, overwrite_a=1)
            if failed:
                raise np.linalg.LinAlgError("the readings' covariance is not positive definite")
            half = np.tril(dtrtri(lower, lower=1, overwrite_c=1)[0])
        self.half = half  # halfᵀ half is the inverse

    def _inverse(self, X: FloatArray) -> FloatArray:
        return np.asarray(self.half.T @ (self.half @ X))

    def solved(self, Y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """X = S⁻¹ Y, (n, ...), and Jᵀ X, (m, ...)."""
        if self.dual:
            X = self._inverse(Y)
            return X, self.J.T @ X
        K = self._inverse(self.J.T @ Y)
        return Y - self.J @ K, K

    def drawn(self, prior: FloatArray, noise: FloatArray) -> FloatArray:
        """Draws of the pillar's own unknowns about their means, (m, draws), from draws of prior and noise."""
        if self.dual:
            return prior - self.J.T @ self._inverse(self.J @ prior + noise)
        return self._inverse(prior - self.J.T @ noise)

    def between(self, columns: np.ndarray) -> FloatArray:
        """These rows and columns of Jᵀ S⁻¹ J."""
        if self.dual:
            H = self.half @ self.J[:, columns]
            return np.asarray(H.T @ H)
        H = self.half[:, columns]
        return np.asarray(np.eye(len(columns)) - H.T @ H)

    def left(self, which: np.ndarray | None = None) -> FloatArray:
        """Diagonal of S⁻¹ of some or all readings: what is left of each; of all, if more than unknowns, their mean."""
        n, m = self.J.shape
        if self.dual:
            left = np.asarray((self.half**2).sum(axis=0))
            return left if which is None else left[which]
        if which is None:
            return np.full(n, 1.0 - (m - (self.half**2).sum()) / n)
        return np.asarray(1.0 - ((self.half @ self.J[which].T) ** 2).sum(axis=0))

    def known(self, alone: int) -> FloatArray:
        """Diagonal of Jᵀ S⁻¹ J: its first `alone` entries, then the sum of the others."""
        n, m = self.J.shape
        first = self.between(np.arange(alone)).diagonal()
        total = n - (self.half**2).sum() if self.dual else m - (self.half**2).sum()
        return np.append(first, total - first.sum())
