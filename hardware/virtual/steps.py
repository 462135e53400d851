"""Steps of a reading that torch differentiates: a sensor at finite strain, a converter's counts, shares of pads."""

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
        self._maps, self._like = forward.maps, like
        self._forward: Any = in_torch(forward, like)

    def _at(self, force_n: Tensor) -> Any:
        """Readings in the states that NumPy finds, and one of Newton's steps more, which has their derivatives."""
        state_n = self._like.new_tensor(self._maps.states(force_n.detach().cpu().double().numpy()))
        _, _, borne_n, by_state = self._forward.at_states(state_n)
        return self._forward.at(state_n + torch.linalg.solve(by_state, force_n - borne_n))

    def lengths(self, force_n: Tensor) -> Tensor:
        return self._at(force_n).squares.clamp(min=0.0).sqrt()

    def resistances(self, force_n: Tensor) -> Tensor:
        return self._at(force_n).resistance_ohm

    def of_sensors(self, ensemble: Any, force_n: Tensor, numbers: Tensor) -> Tensor:
        """Resistances of those of an `Ensemble` in tensors that have these numbers (e,), to first order."""
        at = self._at(force_n)
        return at.resistance_ohm + ensemble.differences(at)[torch.arange(len(numbers)), :, numbers]


def rounded(readings: Tensor, bits: int) -> Tensor:
    """Shares of full scale as a converter's counts hold them, the nearest inside its range; the derivative stays."""
    full = 2.0**bits - 1.0
    counts = (full * readings).clamp(1.0, full - 1.0)
    return (counts + (counts.round() - counts).detach()) / full


def shares(place_mm: Tensor, centres_mm: Tensor) -> Tensor:
    """Shares of the pads at these centres (n,) in forces at places (e, k), (e, k, n); they sum to 1."""
    if len(centres_mm) == 1:
        return torch.ones_like(place_mm)[..., None]
    within = torch.minimum(torch.maximum(place_mm, centres_mm[0]), centres_mm[-1])
    return (1.0 - (within[..., None] - centres_mm).abs() / (centres_mm[1] - centres_mm[0])).clamp(min=0.0)
