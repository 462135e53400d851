"""The sensors that a twin's posterior takes for likely, to one of which each environment belongs. Loads torch."""

from typing import Any

from torch import Tensor

from common.errors import DesignError
from decoupler.inverse.sensor_model import MIN_WHOLE_OHM
from decoupler.model.decoupler import Decoupler
from decoupler.model.tensors import in_torch
from geometry.layout import AXES


class TwinSensors:
    """The posterior's sensors of a twin, each to first order about the most probable one, as `Ensemble.readings`."""

    def __init__(self, decoder: Decoupler, like: Tensor) -> None:
        if decoder.posterior is not None:
            raise DesignError("a twin at finite strain tells no other sensors: give its design, and its model.")
        if decoder.component.axes != AXES or decoder.inverse is None or decoder.ensemble is None:
            raise DesignError(
                f"this twin tells {', '.join(decoder.component.forces)} alone: identify one of all forces."
            )
        self.forward: Any = in_torch(decoder.inverse.forward, like)
        held = decoder.ensemble
        self.members = len(held)
        self._relative, self._offset = like.new_tensor(held.resistance), like.new_tensor(held.offset_ohm)
        self._rest = like.new_tensor(held.rest_mm).mT  # (m, 3, n)
        self._influence = like.new_tensor(held.influence).permute(0, 3, 2, 1).flatten(2)  # (m, Q, 3 n)

    def resistances(self, force_n: Tensor, member: Tensor) -> Tensor:
        """Resistances (e, n) [Ω] of sensors `member` (e,) under forces (e, Q) [N]."""
        vectors = self.forward.vectors(force_n)
        signed = vectors if self.forward.sign is None else vectors * self.forward.sign
        squares = (signed * vectors).sum(dim=1)
        moved = self._rest[member]
        for m in member.unique():
            own = member == m
            moved[own] = moved[own] + (force_n[own] @ self._influence[m]).reshape(-1, *moved.shape[1:])
        slopes = (2.0 * signed / squares[:, None])[:, : moved.shape[1]]
        relative = 1.0 + self._relative[member] + (moved * slopes).sum(dim=1)
        ohms = relative * self.forward.ohm_per_mm2 * squares + self.forward.offset_ohm + self._offset[member]
        return ohms.clamp(min=MIN_WHOLE_OHM)
