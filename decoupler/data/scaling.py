"""Affine scaling of columns to [-1, 1], so that a network takes ohms and gives newtons."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from geometry.layout import FloatArray

SMALLEST_RANGE = 1e-12  #: of a column's size; below it a column is constant up to rounding
SMALLEST = 1e-100  #: a range in newtons or ohms whose square still is a number


@dataclass(frozen=True)
class Scaling:
    """Maps each column's range in the training set onto [-1, 1], and back."""

    centre: FloatArray  #: (n_columns,)
    half_range: FloatArray  #: (n_columns,); 0 for a constant column

    @classmethod
    def fitted(cls, values: FloatArray) -> Self:
        """Scaling by the smallest and largest value of every column, shape (n_samples, n_columns).

        A constant column tells nothing: it is scaled to 0 whatever it holds, and comes back as the constant.

        >>> Scaling.fitted(np.array([[1.0, 7.0], [3.0, 7.0]])).scale(np.array([[1.0, 7.0], [2.5, 8.0]]))
        array([[-1. ,  0. ],
               [ 0.5,  0. ]])
        """
        low, high = values.min(axis=0), values.max(axis=0)
        half_range = (high - low) / 2.0
        constant = half_range <= np.maximum(SMALLEST_RANGE * np.maximum(np.abs(low), np.abs(high)), SMALLEST)
        return cls((low + high) / 2.0, np.where(constant, 0.0, half_range))

    def scale(self, values: FloatArray) -> FloatArray:
        return self.scale_differences(values - self.centre)

    def scale_differences(self, differences: FloatArray) -> FloatArray:
        """Differences of values as differences of scaled values; columns last."""
        return differences * self.factor

    @cached_property
    def factor(self) -> FloatArray:
        """What a difference is multiplied by to be scaled, (n_columns,); 0 for a constant column."""
        return np.divide(1.0, self.half_range, out=np.zeros_like(self.half_range), where=self.half_range > 0)

    def unscale(self, scaled: FloatArray) -> FloatArray:
        return scaled * self.half_range + self.centre
