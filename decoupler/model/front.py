"""What a network is given of a scan: a feature of its readings, scaled to [-1, 1]."""

from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from decoupler.data.columns import Columns, Resting, Scaling, namespace
from decoupler.inverse.sensor_model import ModelInverse, SensorModel
from geometry.layout import FloatArray


class Feature(Protocol):
    """A function of readings, columns of resistances (n, n_in) [Ω]; also of tensors of torch."""

    def values(self, columns_ohm: FloatArray) -> FloatArray:
        """Its values, (n, k)."""

    def derivatives(self, columns_ohm: FloatArray) -> FloatArray:
        """Derivatives of the values by the resistances, (n, k, n_in)."""

    def resistances(self, values: FloatArray) -> FloatArray:
        """Readings (n, n_in) [Ω] that have such values."""


@dataclass(frozen=True)
class Resistance:
    """R."""

    def values(self, columns_ohm: FloatArray) -> FloatArray:
        return columns_ohm

    def derivatives(self, columns_ohm: FloatArray) -> FloatArray:
        return np.ones_like(columns_ohm)[:, None, :] * np.eye(columns_ohm.shape[1])

    def resistances(self, values: FloatArray) -> FloatArray:
        return values


@dataclass(frozen=True)
class Root:
    """√R, in proportion to a pillar's length."""

    def values(self, columns_ohm: FloatArray) -> FloatArray:
        found: FloatArray = namespace(columns_ohm).sqrt(columns_ohm)
        return found

    def derivatives(self, columns_ohm: FloatArray) -> FloatArray:
        return np.asarray((0.5 / np.sqrt(columns_ohm))[:, None, :] * np.eye(columns_ohm.shape[1]))

    def resistances(self, values: FloatArray) -> FloatArray:
        return values**2


FEATURES: dict[str, Any] = {"resistance": Resistance, "root": Root, "inverse": ModelInverse}


@dataclass(frozen=True, eq=False, kw_only=True)
class Front:
    """A feature of readings that may be at rest, scaled."""

    feature: Feature
    scaling: Scaling
    resting: Resting  #: readings at rest, where the response tells them

    @classmethod
    def of(cls, data: Columns, feature: Feature, output_scaling: Scaling) -> Self:
        """That of training samples; forces that the response tells are scaled as those of the samples."""
        if isinstance(feature, ModelInverse):
            resting = Resting.read_with(feature.forward.at_rest_ohm(), data.errors.bits)
            return cls(feature=feature, scaling=output_scaling, resting=resting)
        scaling = Scaling.fitted(feature.values(data.resistance_ohm))
        return cls(feature=feature, scaling=scaling, resting=Resting.read_with(data.resistance_ohm[0], None))

    @property
    def forward(self) -> SensorModel | None:
        """The response that the feature knows; None if none."""
        return self.feature.forward if isinstance(self.feature, ModelInverse) else None

    def inputs(self, columns_ohm: FloatArray) -> FloatArray:
        """The scaled feature of resistances (n, n_in) [Ω], (n, k)."""
        return self.scaling.scale(self.feature.values(self.resting.settled(columns_ohm)))

    def derivatives(self, columns_ohm: FloatArray) -> FloatArray:
        """Derivatives of the inputs by the resistances, (n, k, n_in) [1/Ω]."""
        by_ohm = self.feature.derivatives(columns_ohm).swapaxes(1, 2)
        return self.scaling.scale_differences(by_ohm).swapaxes(1, 2)
