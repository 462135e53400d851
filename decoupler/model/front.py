"""What a network is given of a scan: a feature of its readings, scaled to [-1, 1]."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from decoupler.data.columns import Columns, Resting, Scaling
from decoupler.inverse.sensor_model import ModelInverse
from geometry.layout import FloatArray


@dataclass(frozen=True)
class Power:
    """A power of each reading, a feature as `ModelInverse` is one; also of tensors of torch."""

    exponent: float

    def values(self, columns_ohm: FloatArray) -> FloatArray:
        """Of resistances (n, n_in) [Ω], (n, n_in)."""
        return columns_ohm**self.exponent

    def derivatives(self, columns_ohm: FloatArray) -> FloatArray:
        """Derivatives of the values by the resistances, (n, n_in, n_in)."""
        return (self.exponent * self.values(columns_ohm) / columns_ohm)[:, None] * np.eye(columns_ohm.shape[1])

    def resistances(self, values: FloatArray) -> FloatArray:
        """Resistances (n, n_in) [Ω] that have such values."""
        return values ** (1.0 / self.exponent)


POWERS = {"resistance": Power(1.0), "root": Power(0.5)}  #: √R is in proportion to a pillar's length


@dataclass(frozen=True, eq=False, kw_only=True)
class Front:
    """A feature of readings that may be at rest, scaled."""

    feature: ModelInverse | Power
    scaling: Scaling
    resting: Resting  #: readings at rest, where the response tells them

    @classmethod
    def of(cls, data: Columns, feature: ModelInverse | Power, output_scaling: Scaling) -> Self:
        """That of training samples; forces that the response tells are scaled as those of the samples."""
        if isinstance(feature, ModelInverse):
            resting = Resting.read_with(feature.forward.at_rest_ohm(), data.errors.bits)
            return cls(feature=feature, scaling=output_scaling, resting=resting)
        scaling = Scaling.fitted(feature.values(data.resistance_ohm))
        return cls(feature=feature, scaling=scaling, resting=Resting.read_with(data.resistance_ohm[0], None))

    def inputs(self, columns_ohm: FloatArray) -> FloatArray:
        """The scaled feature of resistances (n, n_in) [Ω], (n, k)."""
        return self.scaling.scale(self.feature.values(self.resting.settled(columns_ohm)))

    def derivatives(self, columns_ohm: FloatArray) -> FloatArray:
        """Derivatives of the inputs by the resistances, (n, k, n_in) [1/Ω]."""
        by_ohm = self.feature.derivatives(columns_ohm).swapaxes(1, 2)
        return (by_ohm * self.scaling.factor).swapaxes(1, 2)
