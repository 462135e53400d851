"""Draws from the posterior of one sensor: how far its resistances may be from those of its model."""

from dataclasses import dataclass

import numpy as np

from geometry.layout import FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class Ensemble:
    """m equally likely sensors of P pillars under Q forces, each as its difference from the model, to first order."""

    resistance: FloatArray  #: (m, P): of a pillar's resistance at a given length, relative
    offset_ohm: FloatArray  #: (m, P): of its offset [Ω]
    rest_mm: FloatArray  #: (m, P, 3): of its vector's first three components at rest [mm]
    influence: FloatArray  #: (m, P, 3, Q): of these by each force [mm/N]; of single precision

    def __len__(self) -> int:
        return len(self.resistance)

    def differences(self, force_n: FloatArray, slopes: FloatArray, resistance_ohm: FloatArray) -> FloatArray:
        """Difference of each sensor's resistances from the model's, (n, m, P) [Ω].

        Parameters
        ----------
        force_n : array, shape (n, Q)
        slopes : array, shape (n, n_components, P)
            `ForwardModel.relative_slopes` under these forces.
        resistance_ohm : array, shape (n, P)
            The model's, without offsets.
        """
        m, P, components, Q = self.influence.shape
        moved = (force_n.astype(self.influence.dtype) @ self.influence.reshape(-1, Q).T).reshape(-1, m, P, components)
        by_vector = slopes[:, :components].swapaxes(1, 2)
        relative = self.resistance + np.einsum("nmpi,npi->nmp", moved + self.rest_mm, by_vector)
        return relative * resistance_ohm[:, None] + self.offset_ohm

    def drawn(self, force_n: FloatArray, slopes: FloatArray, resistance_ohm: FloatArray, first: int = 0) -> FloatArray:
        """Differences (n, P) [Ω] of the sensors in turn, one a sample, the sample of number `first` first.

        Other arguments as of `differences`.
        """
        found = np.empty_like(resistance_ohm)
        for sensor in range(len(self)):
            mine = slice((sensor - first) % len(self), None, len(self))
            one = Ensemble(**{name: values[sensor : sensor + 1] for name, values in vars(self).items()})
            found[mine] = one.differences(force_n[mine], slopes[mine], resistance_ohm[mine])[:, 0]
        return found
