"""How far to trust each force: noise through the network's derivatives, and what training could not settle."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from dataset.measurement import reading_deviation
from decoupler.data.selection import over_loads
from geometry.errors import DesignError
from geometry.layout import FloatArray

if TYPE_CHECKING:
    from decoupler.model.decoupler import Decoupler

WITHIN = (0.6827, 0.9545)  #: shares of errors that one and two standard deviations of a normal distribution hold
ENOUGH_SAMPLES = 500  #: for the effect of noise and for the widths; of each every unit counts
CHUNK = 64  #: samples whose derivatives are in memory together
MANY_TIMES = 3.0  #: errors of an output over the usual, to distrust it
MIN_SHARE = 0.05  #: of half its range, to distrust an output where the usual is only known from the others
BEST = 0.1  #: share of the outputs of an axis that are held to be as good as without dead pillars
MIN_FREEDOM = 0.05  #: 1 − leverage below which a training sample's own error says nothing
LIGHT = 0.05  #: share of the training samples that bear less than what counts as load
MIN_DEVIATION = 1e-12  #: of a force's range, so that nothing is divided by 0


@dataclass(frozen=True, eq=False, kw_only=True)
class Uncertainty:
    """What a force's standard deviation is made of.

    variance = what reading errors do through dF/dR + misfit + unexplained · aᵀ (AᵀA + λI)⁻¹ a, with a the activations
    of the sample and A those of the training set: the Gauss-Newton matrix of the output layer; no more than half the
    force's range squared, as unknown as before training. Scaled so that the shares `WITHIN` of leave-one-out errors lie
    within. Misfit and scale go from those at rest to those under load with the square of the forces.
    """

    noise: float  #: of the training readings, relative
    bits: int | None  #: of their converter
    inverse_matrix: FloatArray  #: (n_features, n_features): (AᵀA + λI)⁻¹
    misfit_n2: FloatArray  #: (n_out,): what noise does not explain of the training errors [N²]
    unexplained_n2: FloatArray  #: (n_out,): variance of the training errors [N²]
    widths: FloatArray  #: (2, n_axes): of one and two deviations, relative to the normal distribution's
    misfit_at_rest_n2: FloatArray  #: (n_out,): as `misfit_n2`, at rest and under light touches
    widths_at_rest: FloatArray  #: (2, n_axes)
    light_n2: FloatArray  #: (1,): mean square of the forces of a light training sample [N²]

    def __post_init__(self) -> None:
        if not isinstance(self.noise, float | int) or not 0 <= self.noise < np.inf:
            raise DesignError(f"noise={self.noise!r} must be a finite number not below 0; 0.001 is 0.1 %.")
        if self.bits is not None and (type(self.bits) is not int or not 4 <= self.bits <= 24):
            raise DesignError(f"bits={self.bits!r} must be a whole number from 4 to 24, or None if readings are exact.")

    @classmethod
    def fitted(
        cls,
        decoupler: "Decoupler",
        columns_ohm: FloatArray,
        force_n: FloatArray,
        noise: float,
        bits: int | None,
        ridge: float,
        load: NDArray[np.int64],
        n_light: int = 0,
    ) -> Self:
        """From the training set: readings (n, n_in) [Ω], forces (n, n_out) [N] and the number of its load (n,).

        The last `n_light` samples are light.

        Notes
        -----
        A training sample's own error is divided by 1 − leverage: its error if it had been left out (the PRESS
        residual of linear regression); the hidden weights, shared by all outputs, add their share to every leverage.
        Readings of one load are left out together: their leverages add up, which is exact where they are alike. A
        sample that the network meets whatever its force is (fewer samples than weights) has none; it is taken to be as
        unknown as before training.
        """
        A = decoupler.activations(columns_ohm)
        M = A.T @ A
        M.flat[:: len(M) + 1] += ridge
        G = np.linalg.inv(M).astype(np.float64)
        leverage = _leverage(A, G).clip(0.0, 1.0)
        shared = np.count_nonzero(decoupler.hidden_weights) / force_n.size
        freedom = 1.0 - over_loads(leverage + shared, load)
        errors = (decoupler.outputs(columns_ohm) - force_n) / np.maximum(freedom, MIN_FREEDOM)[:, None]
        errors = np.where((freedom > MIN_FREEDOM)[:, None], errors, force_n - force_n.mean(axis=0))
        n = len(A) - n_light
        unexplained = (errors[:n] ** 2).mean(axis=0)
        n_axes = len(decoupler.component.axes)
        smallest = (MIN_DEVIATION * np.ptp(force_n, axis=0)) ** 2 + 1e-300
        parts = [np.arange(n), np.arange(n, len(A)) if n_light else np.arange(n)]
        misfits, ratios = [], []
        for part in parts:
            some = part[np.linspace(0, len(part) - 1, min(ENOUGH_SAMPLES, len(part))).astype(int)]
            through = _through(decoupler, columns_ohm[some], noise, bits)
            left = np.maximum((errors[part] ** 2).mean(axis=0) - through.mean(axis=0), 0.0)
            if part[0]:  # few outputs are touched often: all of an axis together tell more
                left = np.tile(left.reshape(-1, n_axes).mean(axis=0), len(left) // n_axes)
            misfits.append(left + smallest)
            weights_n2 = np.minimum(unexplained * leverage[some, None], decoupler.output_scaling.half_range**2)
            deviation = np.sqrt(through + misfits[-1] + weights_n2)
            ratios.append(np.abs(errors[some] / deviation).reshape(-1, n_axes))
        widths = [
            np.stack([np.quantile(ratio, share, axis=0) / (k + 1) for k, share in enumerate(WITHIN)])
            for ratio in ratios
        ]
        return cls(
            noise=noise,
            bits=bits,
            inverse_matrix=G,
            misfit_n2=misfits[0],
            unexplained_n2=unexplained,
            widths=widths[0],
            misfit_at_rest_n2=misfits[1],
            widths_at_rest=widths[1],
            light_n2=np.quantile((force_n[:n] ** 2).mean(axis=1), [LIGHT]),
        )

    def deviations(self, decoupler: "Decoupler", columns_ohm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Half-widths that hold 68 % and 95 % of errors, each (n, n_out) [N], for readings (n, n_in) [Ω]."""
        A = decoupler.activations(columns_ohm)
        force_n = decoupler.output_scaling.unscale(A @ decoupler.output_weights.T)
        load = np.minimum((force_n**2).mean(axis=1, keepdims=True) / np.maximum(self.light_n2, 1e-300), 1.0)
        weights_n2 = self.unexplained_n2 * _leverage(A, self.inverse_matrix)[:, None]
        variance = _through(decoupler, columns_ohm, self.noise, self.bits)
        variance += self.misfit_at_rest_n2 + load * (self.misfit_n2 - self.misfit_at_rest_n2)
        variance += np.minimum(weights_n2, decoupler.output_scaling.half_range**2)
        deviation = np.sqrt(variance).reshape(len(A), -1, self.widths.shape[1])
        one, two = (
            k * (deviation * (at_rest + load * (width - at_rest))[:, None]).reshape(variance.shape)
            for k, at_rest, width in zip((1, 2), self.widths_at_rest, self.widths, strict=True)
        )
        return one, two

    def widened(
        self, decoupler: "Decoupler", columns_ohm: FloatArray, force_n: FloatArray, noise: float, bits: int | None
    ) -> Self:
        """The same for another sensor and its noise, wider if its pairs (n, n_in) [Ω], (n, n_out) [N] say so."""
        one = np.ones_like(self.widths)
        changed = replace(self, noise=noise, bits=bits, widths=one, widths_at_rest=one)
        errors = np.abs(decoupler.outputs(columns_ohm) - force_n)
        n_axes = self.widths.shape[1]
        scales = [
            np.quantile((errors / width).reshape(-1, n_axes), share, axis=0)
            for share, width in zip(WITHIN, changed.deviations(decoupler, columns_ohm), strict=True)
        ]
        wider = np.maximum(np.stack(scales), 1.0)
        return replace(changed, widths=wider, widths_at_rest=wider)

    def untrusted(self, half_range_n: FloatArray, least_n: FloatArray | None = None) -> NDArray[np.bool_]:
        """Which outputs (n_out,) dead pillars leave unsure.

        With the limit of the sensor whose pillars can all be read, `least_n` (n_out,) [N]: those that miss by many
        times as much, counted from where the best outputs of their axis are. Without it: those that miss by far more
        than the others of their axis, and by much of their range `half_range_n` (n_out,) [N].
        """
        missed, n_axes = np.sqrt(self.unexplained_n2), self.widths.shape[1]
        if least_n is not None and least_n.all():
            times = (missed / least_n).reshape(-1, n_axes)
            best = np.quantile(times, BEST, axis=0)
            return (times > MANY_TIMES * np.maximum(best, 1.0)).reshape(-1)
        share = (missed / np.maximum(half_range_n, 1e-300)).reshape(-1, n_axes)
        return ((share > MANY_TIMES * np.median(share, axis=0)) & (share > MIN_SHARE)).reshape(-1)


def _leverage(A: FloatArray, inverse_matrix: FloatArray) -> FloatArray:
    """aᵀ (AᵀA + λI)⁻¹ a of each row a, shape (n,)."""
    return np.einsum("ni,ij,nj->n", A, inverse_matrix, A, optimize=True)


def _through(decoupler: "Decoupler", columns_ohm: FloatArray, noise: float, bits: int | None) -> FloatArray:
    """Variance of the forces (n, n_out) [N²] that errors of the readings (n, n_in) [Ω] cause."""
    found = np.zeros((len(columns_ohm), len(decoupler.output_weights)))
    if not noise and bits is None:
        return found
    for start in range(0, len(columns_ohm), CHUNK):
        chunk = slice(start, start + CHUNK)
        derivatives = decoupler.derivatives(columns_ohm[chunk])
        variance = reading_deviation(columns_ohm[chunk], noise, bits) ** 2
        found[chunk] = np.einsum("nom,nm->no", derivatives**2, variance)
    return found
