"""A sensor at finite strain, as a model learned it: forces on the pads to resistances, differentiable. Loads torch."""

from typing import Any

import torch
from torch import Tensor

from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.tensors import in_torch


class StrainedSensor:
    """Lengths and resistances (e, P) under forces (e, Q) [N], as `SensorModel` has them; of a twin's sensors, too.

    Forces beyond those that the model has seen are a `SampleError`.
    """

    def __init__(self, forward: SensorModel, like: Tensor) -> None:
        assert forward.maps is not None
        self._maps, self._like, self._forward = forward.maps, like, in_torch(forward, like)

    def _states(self, force_n: Tensor) -> Tensor:
        """By those that NumPy finds, and one of Newton's steps more, which has their derivatives."""
        state_n = self._like.new_tensor(self._maps.states(force_n.detach().cpu().double().numpy()))
        _, _, borne_n, by_state = self._forward.at_states(state_n)
        return state_n + torch.linalg.solve(by_state, force_n - borne_n)

    def lengths(self, force_n: Tensor) -> Tensor:
        return self._forward.at_states(self._states(force_n))[0].clamp(min=0.0).sqrt()

    def resistances(self, force_n: Tensor) -> Tensor:
        return self._in_ohms(self._states(force_n))

    def of_sensors(self, ensemble: Any, force_n: Tensor, numbers: Tensor) -> Tensor:
        """Resistances of those of an `Ensemble` in tensors that have these numbers (e,), to first order."""
        state_n = self._states(force_n)
        off_ohm = ensemble.differences(self._forward, state_n)
        return self._in_ohms(state_n) + off_ohm[torch.arange(len(numbers)), numbers]

    def _in_ohms(self, state_n: Tensor) -> Tensor:
        c: Any = self._forward.ohm_per_mm2
        return c * self._forward.at_states(state_n)[0].clamp(min=0.0) + self._forward.offset_ohm
