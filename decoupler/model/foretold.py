"""Some of many normal numbers by the others: readings that are left out, or that are doubted."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from decoupler.data.columns import rowwise
from geometry.layout import FloatArray


@dataclass(frozen=True, eq=False)
class Foretold:
    """k of P normal numbers as all others foretell them; or each of some groups of k, where shapes begin with "...".

    With K = S⁻¹ of their covariance S, what is foretold of a group g is off by K_gg⁻¹ (K (y − mean))_g, of which the
    covariance is K_gg⁻¹.
    """

    which: NDArray[np.intp]  #: (..., k): numbers of the k among the P
    mean: FloatArray  #: (P,)
    weights: FloatArray  #: (..., P, k): of the others' distances from their mean in those of the k; 0 of the k
    covariance: FloatArray  #: (..., k, k): of what the others leave open

    @classmethod
    def by(cls, precision: FloatArray, which: NDArray[np.intp], mean: FloatArray | None = None) -> Self:
        """By K (P, P); without a mean, of distances from it."""
        mine, own = precision[which], which[..., None, :]
        covariance = np.asarray(np.linalg.inv(np.take_along_axis(mine, own, axis=-1)), dtype=np.float64)
        weights = -covariance @ mine
        np.put_along_axis(weights, own, 0.0, axis=-1)
        return cls(which, np.zeros(len(precision)) if mean is None else mean, weights.swapaxes(-1, -2), covariance)

    def told(self, values: FloatArray) -> FloatArray:
        """The k (n, k) by values (n, P), of which those of the k may be any numbers; also tensors of torch."""
        return rowwise(values - self.mean, self.weights) + self.mean[self.which]
