"""Preparation of columns for a network: readings at rest are settled, gains and offsets undone, ranges scaled.

`Resting`, `Calibration` and `Scaling` are applied to resistances in this order.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from dataset.measurement import SENSE_OHM
from geometry.layout import FloatArray

MAX_COUNTS_FROM_REST = 0.6  #: largest distance of a reading that may be one of rest; 0.1 is for the calibration's error
MIN_RESTING = 0.5  #: share of a scan's readings that must be near rest before any of them is taken for rest
GAIN_SPREAD = 0.2  #: standard deviation of gains before anything is measured
OFFSET_SPREAD = 0.05  #: the same of offsets, as a share of a pillar's resistance
MIN_CALIBRATED_OHM = 1.0  #: lower bound of a calibrated resistance; a pillar with less is broken
MIN_NOISE = 1e-4  #: smallest relative error that a modelled resistance is trusted to
MIN_RELATIVE_RANGE = 1e-12  #: range of a column over its size, below which it is constant up to rounding
MIN_RANGE = 1e-100  #: a range in newtons or ohms whose square still is a number


@dataclass(frozen=True, eq=False, kw_only=True)
class Resting:
    """Readings of pillars at rest, and the converter that reads them.

    A converter reads one count whatever a resistance does within its step. A sensor at rest is always in the same place
    of every step, so what the steps hide does not average out: like pillars err alike, and the array seems pressed all
    over. Where more than half of a scan may be at rest, rest is likelier than any other place in the step.
    """

    rest_ohm: FloatArray  #: (n_in,)
    full_counts: FloatArray  #: (1,): of the converter, 2^bits − 1

    @classmethod
    def read_with(cls, rest_ohm: FloatArray, bits: int | None) -> Self | None:
        """Rest of pillars (n_in,) [Ω] behind a converter; None without a converter."""
        return None if bits is None else cls(rest_ohm=rest_ohm, full_counts=np.array([2.0**bits - 1.0]))

    def settled(self, columns_ohm: FloatArray) -> FloatArray:
        """Readings (n, n_in) [Ω] with those that may be at rest there, where most of a sample's may."""
        steps = self.full_counts * (SENSE_OHM / (columns_ohm + SENSE_OHM) - SENSE_OHM / (self.rest_ohm + SENSE_OHM))
        alike = np.abs(steps) <= MAX_COUNTS_FROM_REST
        return np.where(alike & (alike.mean(axis=1, keepdims=True) > MIN_RESTING), self.rest_ohm, columns_ohm)


@dataclass(frozen=True, eq=False)
class Calibration:
    """R measured = gain · R modelled + offset, one pair of numbers a pillar."""

    gain: FloatArray  #: (n_pillars,)
    offset_ohm: FloatArray  #: (n_pillars,) [Ω]

    @classmethod
    def none(cls, n_pillars: int) -> Self:
        """The calibration of a sensor that is exactly as designed."""
        return cls(np.ones(n_pillars), np.zeros(n_pillars))

    @classmethod
    def fitted(cls, measured_ohm: FloatArray, modelled_ohm: FloatArray, noise: float) -> Self:
        """The most probable calibration, from resistances of both kinds, each (n_pairs, n_pillars) [Ω].

        Notes
        -----
        Bayes' rule with normal errors of relative size `noise` and normal priors about gain 1 and offset 0, so a single
        pair sets the gain, and an offset is believed only as far as a pillar's resistance has varied.
        """
        size = modelled_ohm.mean(axis=0)
        weight = (max(noise, MIN_NOISE) * size) ** -2.0
        misfit = measured_ohm - modelled_ohm
        # normal equations of (gain − 1, offset), 2 × 2 a pillar
        a = weight * (modelled_ohm**2).sum(axis=0) + GAIN_SPREAD**-2
        b = weight * modelled_ohm.sum(axis=0)
        d = weight * len(misfit) + (OFFSET_SPREAD * size) ** -2.0
        p, q = weight * (modelled_ohm * misfit).sum(axis=0), weight * misfit.sum(axis=0)
        determinant = a * d - b * b
        return cls(1.0 + (d * p - b * q) / determinant, (a * q - b * p) / determinant)

    def shown(self, modelled_ohm: FloatArray) -> FloatArray:
        """Resistances that this sensor shows where one as designed has `modelled_ohm`, (..., n_pillars) [Ω]."""
        return self.gain * modelled_ohm + self.offset_ohm

    def modelled(self, measured_ohm: FloatArray) -> FloatArray:
        """Resistances that a sensor as designed would show, (n, n_pillars) [Ω]; kept above 0."""
        modelled = measured_ohm - self.offset_ohm
        modelled /= self.gain
        return np.maximum(modelled, MIN_CALIBRATED_OHM, out=modelled)


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
        constant = half_range <= np.maximum(MIN_RELATIVE_RANGE * np.maximum(np.abs(low), np.abs(high)), MIN_RANGE)
        return cls((low + high) / 2.0, np.where(constant, 0.0, half_range))

    def scale(self, values: FloatArray) -> FloatArray:
        return self.scale_differences(values - self.centre)

    def scale_differences(self, differences: FloatArray) -> FloatArray:
        """Differences of values as differences of scaled values; columns last."""
        return differences * self.factor

    @cached_property
    def factor(self) -> FloatArray:
        """Factors that scale differences, (n_columns,); 0 for a constant column."""
        return np.divide(1.0, self.half_range, out=np.zeros_like(self.half_range), where=self.half_range > 0)

    def unscale(self, scaled: FloatArray) -> FloatArray:
        return scaled * self.half_range + self.centre
