"""A sensor at finite strain, as a model learned it: forces on the pads to resistances, differentiable. Loads torch."""

from typing import Any

import torch
from torch import Tensor

from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.tensors import in_torch


class StrainedSensor:
    """Lengths and resistances (e, P) under forces (e, Q) [N], as `SensorModel` has them.

    Forces beyond those that the model has seen are a `SampleError`.
    """

    def __init__(self, forward: SensorModel, like: Tensor) -> None:
        assert forward.maps is not None
        self._maps, self._like = forward.maps, like
        self._forward: Any = in_torch(forward, like)

    def lengths(self, force_n: Tensor) -> Tensor:
        """By the states that NumPy finds, and one of Newton's steps more, which has their derivatives."""
        state_n = self._like.new_tensor(self._maps.states(force_n.detach().cpu().double().numpy()))
        _, _, borne_n, by_state = self._forward.at_states(state_n)
        state_n = state_n + torch.linalg.solve(by_state, force_n - borne_n)
        return self._forward.at(state_n).squares.clamp(min=0.0).sqrt()

    def resistances(self, force_n: Tensor) -> Tensor:
        return self._forward.ohms(self.lengths(force_n) ** 2)
