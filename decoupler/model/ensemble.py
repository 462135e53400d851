"""Draws from the posterior of one sensor: how far its resistances may be from those of its model."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decoupler.data.columns import namespace
from decoupler.inverse.sensor_model import MIN_WHOLE_OHM, SensorModel
from decoupler.inverse.strain_maps import N_AXES
from geometry.layout import FloatArray

CHUNK = 64  #: states whose derivatives are in memory together


@dataclass(frozen=True, eq=False, kw_only=True)
class Ensemble:
    """m equally likely sensors of P pillars under Q forces, each as its difference from the model, to first order."""

    resistance: FloatArray  #: (m, P): of a pillar's resistance at a given length, relative
    offset_ohm: FloatArray  #: (m, P): of its offset [Ω]
    rest_mm: FloatArray  #: (m, P, 3): of its vector's first three components at rest [mm]
    influence: NDArray[Any]  #: (m, P, 3, Q): of these by each force, or state [mm/N]; of single precision
    parameters: FloatArray | None = None  #: (m, k): of the design's, which change the maps of finite strain
    by_weights: FloatArray | None = None  #: (N_FEATURES, k, values): of the maps' weights by these

    @classmethod
    def of_none(cls, n_pillars: int, n_forces: int) -> "Ensemble":
        """Of a sensor that is as its model has it."""
        each = np.zeros((0, n_pillars))
        influence = np.zeros((0, n_pillars, 3, n_forces), np.float32)
        return cls(resistance=each, offset_ohm=each, rest_mm=np.zeros((0, n_pillars, 3)), influence=influence)

    def __len__(self) -> int:
        return len(self.resistance)

    def differences(self, forward: SensorModel, state_n: FloatArray) -> FloatArray:
        """Difference of each sensor's resistances from the model's under the same forces, (n, m, P) [Ω].

        `state_n` (n, Q) [N] are the model's states, without maps of finite strain the forces.
        """
        (m, P, components, Q), xp = self.influence.shape, namespace(state_n)
        vectors = forward.linear.vectors(state_n)
        signed = vectors if forward.sign is None else forward.sign * vectors
        y = xp.einsum("ncp,ncp->np", signed, vectors)
        single = state_n.astype(self.influence.dtype) if isinstance(state_n, np.ndarray) else state_n
        moved = (single @ self.influence.reshape(-1, Q).T).reshape(-1, m, P, components)
        squares = 2.0 * xp.einsum("nmpi,nip->nmp", moved + self.rest_mm, signed[:, :components])
        if forward.maps is not None and self.parameters is not None:
            y += forward.maps.values(state_n)[..., N_AXES:].reshape(y.shape)
            parts = [state_n[start : start + CHUNK] for start in range(0, len(state_n), CHUNK)]
            by_parameters = xp.concat([self._by_parameters(forward, part) for part in parts])
            squares += (by_parameters @ self.parameters.T).swapaxes(1, 2)
        ohms: FloatArray = forward.ohm_per_mm2 * (squares + self.resistance * y[:, None]) + self.offset_ohm
        return ohms

    def _by_parameters(self, forward: SensorModel, state_n: FloatArray) -> FloatArray:
        """Change of the squares of lengths under the same forces by parameters' change of the maps, (n, P, k) [mm²]."""
        assert forward.maps is not None
        assert self.by_weights is not None
        (n, Q), k = state_n.shape, self.by_weights.shape[1]
        _, by_state, _, by_force = forward.at_states(state_n)
        changed = replace(forward.maps, weights=self.by_weights.reshape(len(self.by_weights), -1))
        values = changed.values(state_n).reshape(n, Q // N_AXES, k, -1).swapaxes(2, 3)
        by_forces = namespace(state_n).linalg.solve(by_force, values[:, :, :N_AXES].reshape(n, Q, k))
        squares: FloatArray = values[:, :, N_AXES:].reshape(n, -1, k) - by_state @ by_forces
        return squares

    def factors(self, forward: SensorModel, state_n: FloatArray) -> FloatArray:
        """U of the covariance U Uᵀ of the sensors' resistances, (n, P, m) [Ω]; arguments as of `differences`."""
        return self.differences(forward, state_n).swapaxes(1, 2) / len(self) ** 0.5

    def readings(self, forward: SensorModel, force_n: FloatArray, sensor: NDArray[np.int64]) -> FloatArray:
        """Resistances (n, P) [Ω] of the sensors of these numbers (n,), one for each load (n, Q) [N]; also in torch.

        The model is linear.
        """
        vectors = forward.vectors(force_n)
        signed = vectors if forward.sign is None else vectors * forward.sign
        y, moved = (signed * vectors).sum(1), 0.0 * vectors[:, : self.rest_mm.shape[2]]
        for k in set(sensor.tolist()):
            own = sensor == k
            by_force = self.influence[k].reshape(-1, force_n.shape[1]).T
            off = (force_n[own] @ by_force).reshape(-1, *self.rest_mm[k].shape) + self.rest_mm[k]
            moved[own] = off.swapaxes(1, 2)
        squares = y * (1.0 + self.resistance[sensor]) + 2.0 * (signed[:, : moved.shape[1]] * moved).sum(1)
        return (forward.ohm_per_mm2 * squares + forward.offset_ohm + self.offset_ohm[sensor]).clip(MIN_WHOLE_OHM)
