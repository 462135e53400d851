"""Draws from the posterior of one sensor: how far its resistances may be from those of its model."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from decoupler.data.columns import MIN_CALIBRATED_OHM, Calibration
from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.strain_maps import N_AXES, N_FEATURES
from geometry.layout import FloatArray

CHUNK = 64  #: states whose derivatives are in memory together


@dataclass(frozen=True, eq=False, kw_only=True)
class Ensemble:
    """m equally likely sensors of P pillars under Q forces, each as its difference from the model, to first order."""

    resistance: FloatArray  #: (m, P): of a pillar's resistance at a given length, relative
    offset_ohm: FloatArray  #: (m, P): of its offset [Ω]
    rest_mm: FloatArray  #: (m, P, 3): of its vector's first three components at rest [mm]
    influence: FloatArray  #: (m, P, 3, Q): of these by each force, or state [mm/N]; of single precision
    parameters: FloatArray | None = None  #: (m, k): of the design's, which change the maps of finite strain
    by_weights: FloatArray | None = None  #: (N_FEATURES, k, values): of the maps' weights by these

    def __len__(self) -> int:
        return len(self.resistance)

    def differences(self, forward: ForwardModel, state_n: FloatArray, resistance_ohm: FloatArray) -> FloatArray:
        """Difference of each sensor's resistances from the model's under the same forces, (n, m, P) [Ω].

        Parameters
        ----------
        forward : ForwardModel
            The model.
        state_n : array, shape (n, Q)
            States; without maps of finite strain the forces [N].
        resistance_ohm : array, shape (n, P)
            The model's, without offsets.
        """
        m, P, components, Q = self.influence.shape
        moved = (state_n.astype(self.influence.dtype) @ self.influence.reshape(-1, Q).T).reshape(-1, m, P, components)
        moved = moved + self.rest_mm
        if self.by_weights is None:
            by_vector = forward.relative_slopes(state_n)[:, :components].swapaxes(1, 2)
            relative = np.einsum("nmpi,npi->nmp", moved, by_vector)
        else:
            parts = [slice(start, start + CHUNK) for start in range(0, len(state_n), CHUNK)]
            relative = np.concatenate([self._at_strain(forward, state_n[part], moved[part]) for part in parts])
        return (self.resistance + relative) * resistance_ohm[:, None] + self.offset_ohm

    def factors(self, forward: ForwardModel, state_n: FloatArray, resistance_ohm: FloatArray) -> FloatArray:
        """U of the covariance U Uᵀ of the sensors' resistances, (n, P, m) [Ω]; arguments as of `differences`."""
        return self.differences(forward, state_n, resistance_ohm).swapaxes(1, 2) / np.sqrt(len(self))

    def _at_strain(self, forward: ForwardModel, state_n: FloatArray, moved: FloatArray) -> FloatArray:
        """Relative difference by changed vectors (n, m, P, 3) [mm] and maps, (n, m, P)."""
        assert forward.maps is not None
        assert self.parameters is not None
        assert self.by_weights is not None
        n, k, Q = len(state_n), self.parameters.shape[1], state_n.shape[1]
        y, by_state, _, by_force = forward.at_states(state_n)
        vectors = forward.linear.vectors(state_n)
        by_vector = 2.0 * (vectors if forward.sign is None else forward.sign * vectors)[:, : moved.shape[3]]
        maps = replace(forward.maps, weights=self.by_weights.reshape(N_FEATURES, -1))
        values = maps.values(state_n).reshape(n, Q // N_AXES, k, -1).swapaxes(1, 2)
        by_parameters = values[..., N_AXES:].reshape(n, k, -1).swapaxes(1, 2)
        by_parameters -= by_state @ np.linalg.solve(by_force, values[..., :N_AXES].reshape(n, k, Q).swapaxes(1, 2))
        squares = np.einsum("nmpi,nip->nmp", moved, by_vector) + (by_parameters @ self.parameters.T).swapaxes(1, 2)
        return np.asarray(squares / y[:, None])

    def readings(
        self, forward: ForwardModel, calibration: Calibration, state_n: FloatArray, first: int = 0
    ) -> FloatArray:
        """Resistances (n, P) [Ω] of the sensors in turn, one a state, the state of number `first` first."""
        squares = forward.linear.lengths(state_n) ** 2
        if forward.maps is not None:
            squares += forward.maps.values(state_n)[..., N_AXES:].reshape(squares.shape)
        of_gain = calibration.gain * forward.ohm_per_mm2 * squares
        found = of_gain + calibration.offset_ohm
        for sensor, one in enumerate(self._sensors()):
            mine = slice((sensor - first) % len(self), None, len(self))
            found[mine] += one.differences(forward, state_n[mine], of_gain[mine])[:, 0]
        return np.maximum(found, MIN_CALIBRATED_OHM)

    def _sensors(self) -> Iterator["Ensemble"]:
        """Each sensor alone."""
        drawn = {name: values for name, values in vars(self).items() if values is not None and name != "by_weights"}
        for sensor in range(len(self)):
            yield replace(self, **{name: values[sensor : sensor + 1] for name, values in drawn.items()})
