"""What the rubber of sensors remembers from one reading to the next. Loads torch."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from common.errors import ArgumentError
from dataset.imperfections import log_normal
from dataset.memory import AnyMemory, PillarMemory, decays, lengthening, log_rise
from geometry.design import Memory, SensorDesign
from geometry.layout import rest_lengths


class RubberState:
    """Strains of e sensors' pillars at their last readings, and the contacts that are broken in them.

    `like` (e, rows, cols, P) has the kind of all tensors, `spread` is that of the pillars' memories.
    """

    def __init__(self, design: SensorDesign, like: Tensor, spread: float) -> None:
        memory = design.pillar_material.memory
        self.remembers = memory != Memory()  #: without, all of it costs nothing
        self._rest_mm, self._spread = like.new_tensor(rest_lengths(design.unit)), spread
        self._strain, self._broken = 0.0 * like, like.new_zeros((2, *like.shape))
        self._factors = like.new_ones((6, *like.shape))
        self._rubber = memory
        self._memory: AnyMemory = memory

    def forget(self, chosen: Tensor, normal: Callable[[tuple[int, ...]], Tensor]) -> None:
        """Put some sensors (k,) back to rest; each pillar draws what it remembers anew, by standard `normal` draws."""
        self._strain = self._strain.index_fill(0, chosen, 0.0)
        self._broken = self._broken.index_fill(1, chosen, 0.0)
        if self.remembers and self._spread:
            drawn = normal((6, len(chosen), *self._strain.shape[1:]))
            self._factors[:, chosen] = log_normal(drawn, self._spread)
            self._memory = PillarMemory.spread(self._rubber, self._factors)

    def require(self, seconds: float | None) -> None:
        """Refuse seconds that are missing or not above 0, of rubber that remembers."""
        if self.remembers and (seconds is None or not 0.0 < seconds < math.inf):
            raise ArgumentError(
                f"seconds={seconds}: this rubber remembers: say how many passed since the last reading, above 0."
            )

    def step(self, length_mm: Tensor, seconds: float) -> Tensor:
        """Factors of resistances as pillars of these lengths show them, so many seconds after the last step.

        Both (e, rows, cols, P); derivatives lead back to these lengths, not to earlier ones. Errors as of `require`.
        """
        self.require(seconds)
        strain = length_mm / self._rest_mm - 1.0
        now, before = (lengthening(each, self._rubber) for each in (strain, self._strain))
        steps = decays(now - before, seconds, self._memory)
        broken = [keep * own + gain for own, (keep, gain) in zip(self._broken, steps, strict=True)]
        self._strain, self._broken = strain.detach(), torch.stack(broken).detach()
        return log_rise(strain, broken, self._memory).exp()
