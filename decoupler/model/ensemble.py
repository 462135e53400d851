"""Changes of a sensor's readings to first order, and draws of one: how far its resistances may be from its model's."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decoupler.data.columns import namespace
from decoupler.inverse.sensor_model import PredictedReadings, SensorModel
from decoupler.inverse.strain_maps import N_AXES
from decoupler.readings import MIN_WHOLE_OHM
from geometry.layout import FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class Changes:
    """m changes of a sensor of P pillars under Q forces: by parameters of its design, or of equally likely sensors."""

    resistance: FloatArray  #: (m, P): of a pillar's resistance at a given length, relative
    rest_mm: FloatArray  #: (m, P, c): of its vector's first c components at rest [mm]
    influence: NDArray[Any]  #: (m, P, c, Q): of these by each force, or state [mm/N]
    by_weights: FloatArray | None = None  #: of the weights of maps of finite strain, (N_FEATURES, k, values)
    parameters: FloatArray | None = None  #: (m, k): how much of these k; None: each in turn

    def __len__(self) -> int:
        return len(self.resistance)

    def squares(self, at: PredictedReadings) -> FloatArray:
        """Change of the squares of lengths under the same forces, of c as well, (n, P, m) [mm²]."""
        xp, (m, P, c, Q) = namespace(at.state_n), self.influence.shape
        state_n = at.state_n.astype(self.influence.dtype) if xp is np else at.state_n
        moved = (state_n @ self.influence.reshape(-1, Q).T).reshape(len(state_n), m, P, c)
        found = xp.einsum("nmpi,npi->nmp", moved + self.rest_mm, at.by_vector[..., :c]).swapaxes(1, 2)
        found += self.resistance.T * at.squares[..., None]
        if self.by_weights is not None:
            assert at.sensor.maps is not None
            k = self.by_weights.shape[1]
            changed = replace(at.sensor.maps, weights=self.by_weights.reshape(len(self.by_weights), -1))
            values = changed.values(at.state_n).reshape(len(state_n), Q // N_AXES, k, -1).swapaxes(1, 2)
            by_weights = values[..., N_AXES:].reshape(len(state_n), k, P).swapaxes(1, 2)
            by_weights = by_weights - at.along(values[..., :N_AXES].reshape(len(state_n), k, Q))
            found += by_weights if self.parameters is None else by_weights @ self.parameters.T
        return found


@dataclass(frozen=True, eq=False, kw_only=True)
class Ensemble(Changes):
    """m equally likely sensors, each as its difference from the model; influences are of single precision."""

    offset_ohm: FloatArray  #: (m, P): of a pillar's offset [Ω]

    @classmethod
    def of_none(cls, n_pillars: int, n_forces: int) -> "Ensemble":
        """Of a sensor that is as its model has it."""
        each = np.zeros((0, n_pillars))
        influence = np.zeros((0, n_pillars, 3, n_forces), np.float32)
        return cls(resistance=each, offset_ohm=each, rest_mm=np.zeros((0, n_pillars, 3)), influence=influence)

    def differences(self, at: PredictedReadings) -> FloatArray:
        """Difference of each sensor's resistances from the model's under the same forces, (n, P, m) [Ω]."""
        found = self.squares(at)
        found *= at.sensor.ohm_per_mm2[:, None]  # in place: products with them round by their order in memory
        found += self.offset_ohm.T
        return found

    def factors(self, forward: SensorModel, state_n: FloatArray) -> FloatArray:
        """U of the covariance U Uᵀ of the sensors' resistances in states (n, Q) [N] of their model, (n, P, m) [Ω]."""
        return self.differences(forward.at(state_n)) / len(self) ** 0.5

    def readings(self, forward: SensorModel, force_n: FloatArray, sensor: NDArray[np.int64]) -> FloatArray:
        """Resistances (n, P) [Ω] of the sensors of these numbers (n,), one for each load (n, Q) [N]; also in torch.

        The model is linear.
        """
        at, (_, P, c, Q) = forward.at(force_n), self.influence.shape
        moved = 0.0 * at.by_vector[..., :c]
        for k in set(sensor.tolist()):
            own = sensor == k
            moved[own] = (force_n[own] @ self.influence[k].reshape(-1, Q).T).reshape(-1, P, c) + self.rest_mm[k]
        squares = at.squares * (1.0 + self.resistance[sensor]) + (at.by_vector[..., :c] * moved).sum(2)
        return (forward.ohms(squares) + self.offset_ohm[sensor]).clip(MIN_WHOLE_OHM)
