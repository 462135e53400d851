"""The sensors of a twin's posterior in torch, one an environment."""

from typing import Any

import torch
from torch import Tensor

from decoupler.inverse.sensor_model import MIN_WHOLE_OHM
from decoupler.model.decoupler import Decoupler
from decoupler.model.tensors import in_torch
from geometry.errors import DesignError
from geometry.layout import AXES


class TorchTwin:
    """The posterior's sensors of a twin, each to first order about the most probable one, as `Ensemble.drawn`."""

    def __init__(self, decoder: Decoupler, like: Tensor) -> None:
        if decoder.component.axes != AXES or decoder.inverse is None or decoder.ensemble is None:
            raise DesignError(
                f"this twin tells {', '.join(decoder.component.forces)} alone: identify one of all forces."
            )
        self.forward: Any = in_torch(decoder.inverse.forward, like)
        held = decoder.ensemble
        self.members = len(held)
        self._relative, self._offset = like.new_tensor(held.resistance), like.new_tensor(held.offset_ohm)
        self._rest = like.new_tensor(held.rest_mm).mT  # (m, 3, P)
        self._influence = like.new_tensor(held.influence).permute(0, 3, 2, 1).flatten(2)  # (m, Q, 3 P)

    def resistances(self, force_n: Tensor, member: Tensor) -> Tensor:
        """Resistances (e, P) [Ω] of sensors `member` (e,) under forces (e, Q) [N]."""
        vectors = self.forward.vectors(force_n)
        signed = vectors if self.forward.sign is None else vectors * self.forward.sign
        squares = (signed * vectors).sum(dim=1)
        of_gain = self.forward.ohm_per_mm2 * squares
        slopes = (2.0 * signed / squares[:, None])[:, : self._rest.shape[1]]
        order, moved_by = torch.argsort(member, stable=True), []
        for m, some in zip(*self._groups(member[order], order), strict=True):
            moved_by.append((force_n[some] @ self._influence[m]).reshape(len(some), *slopes.shape[1:]))
        moved = torch.cat(moved_by)[torch.argsort(order)]
        relative = self._relative[member] + ((moved + self._rest[member]) * slopes).sum(dim=1)
        return ((1.0 + relative) * of_gain + self.forward.offset_ohm + self._offset[member]).clamp(min=MIN_WHOLE_OHM)

    @staticmethod
    def _groups(sorted_members: Tensor, order: Tensor) -> tuple[list[int], tuple[Tensor, ...]]:
        """Each member once, and the environments that have it."""
        members, sizes = torch.unique_consecutive(sorted_members, return_counts=True)
        return members.tolist(), order.split(sizes.tolist())
