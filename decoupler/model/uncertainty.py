"""Uncertainty of each force: noise through the network's derivatives, and what training could not settle."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decoupler.data.columns import Component
from geometry.layout import FloatArray

WITHIN = (0.6827, 0.9545)  #: shares of errors that one and two standard deviations of a normal distribution hold
MANY_TIMES = 3.0  #: smallest error of an output over the usual one to distrust it
MIN_SHARE = 0.05  #: smallest error over half its range to distrust an output that is judged by the others
BEST = 0.1  #: share of the outputs of an axis that are taken to be as good as without dead pillars


@dataclass(frozen=True, eq=False, kw_only=True)
class Uncertainty:
    """Parts of a force's standard deviation.

    variance = what reading errors do through dF/dR + misfit + unexplained · aᵀ (AᵀA + λI)⁻¹ a, with a the activations
    of the sample and A those of the training set: the Gauss-Newton matrix of the output layer; no more than half the
    force's range squared, as unknown as before training. Scaled so that the shares `WITHIN` of leave-one-out errors lie
    within. Misfit and scale go from those at rest to those under load with the square of the forces.
    """

    inverse_matrix: FloatArray  #: (n_features, n_features): (AᵀA + λI)⁻¹
    #: (2, n_out): what noise does not explain of the training errors [N²], at rest and light touches, and under load
    misfit_n2: FloatArray
    unexplained_n2: FloatArray  #: (n_out,): variance of the training errors [N²]
    widths: FloatArray  #: (2, 2, n_axes): the same, of one and two deviations, relative to the normal distribution's
    light_n2: FloatArray  #: (1,): mean square of the forces of a light training sample [N²]
    #: (m, m): how far forces err along what m shared drifts do, a Cholesky factor in deviations of each; above 1, as
    #: load that is taken for drift counts, too. None without shared drifts
    drift_factor: FloatArray | None = None

    @classmethod
    def untold(cls, half_range_n: FloatArray, output: FloatArray, component: Component) -> "Uncertainty":
        """That of a network (output weights (n_out, n_features)) before anything has judged it: half of each range."""
        return cls(
            inverse_matrix=np.zeros([output.shape[1]] * 2),
            misfit_n2=np.stack([half_range_n**2] * 2),
            unexplained_n2=half_range_n**2,
            widths=np.ones((2, 2, len(component.axes))),
            light_n2=np.zeros(1),
        )

    def own_variance(
        self, A: FloatArray, force_n: FloatArray, half_range_n: FloatArray
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
        """Variance (n, n_out) [N²] that training left, and half-widths of 68 % and 95 % over the standard deviation.

        Takes activations (n, n_features) and forces (n, n_out) [N] of samples, and half the range of each force in
        training (n_out,) [N].
        """
        load = np.minimum((force_n**2).mean(axis=1, keepdims=True) / np.maximum(self.light_n2, 1e-300), 1.0)
        weights_n2 = self.unexplained_n2 * leverage(A, self.inverse_matrix)[:, None]
        variance, one, two = (
            at_rest + load * (loaded - at_rest)
            for at_rest, loaded in (
                self.misfit_n2,
                *np.tile(self.widths, force_n.shape[1] // self.widths.shape[2]).swapaxes(0, 1),
            )
        )
        return variance + np.minimum(weights_n2, half_range_n**2), (one, 2.0 * two)

    def untrusted(self, half_range_n: FloatArray, limit_n: FloatArray | None = None) -> NDArray[np.bool_]:
        """Which outputs (n_out,) dead pillars leave unsure.

        With the limit of the sensor whose pillars can all be read, `limit_n` (n_out,) [N]: those that miss by many
        times as much, counted from where the best outputs of their axis are. Without it: those that miss by far more
        than the others of their axis, and by much of their range `half_range_n` (n_out,) [N].
        """
        missed, n_axes = np.sqrt(self.unexplained_n2), self.widths.shape[2]
        if limit_n is not None and limit_n.all():
            times = (missed / limit_n).reshape(-1, n_axes)
            best = np.quantile(times, BEST, axis=0)
            return (times > MANY_TIMES * np.maximum(best, 1.0)).reshape(-1)
        share = (missed / np.maximum(half_range_n, 1e-300)).reshape(-1, n_axes)
        return ((share > MANY_TIMES * np.median(share, axis=0)) & (share > MIN_SHARE)).reshape(-1)


def leverage(A: FloatArray, inverse_matrix: FloatArray) -> FloatArray:
    """aᵀ (AᵀA + λI)⁻¹ a of each row a, shape (n,)."""
    return np.einsum("ni,ij,nj->n", A, inverse_matrix, A, optimize=True)
