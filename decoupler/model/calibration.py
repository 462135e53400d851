"""Gain and offset of every pillar of one sensor, from measured pairs of resistance and force."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from geometry.layout import FloatArray

GAIN_SPREAD = 0.2  #: standard deviation of gains before anything is measured
OFFSET_SPREAD = 0.05  #: the same of offsets, as a share of a pillar's resistance
MIN_OHM = 1.0  #: that a calibrated resistance is taken for; a pillar of so little is broken
MIN_NOISE = 1e-4  #: of a resistance; a model is never trusted more than this


@dataclass(frozen=True, eq=False)
class Calibration:
    """R measured = gain · R modelled + offset, one pair of numbers a pillar."""

    gain: FloatArray  #: (n_pillars,)
    offset_ohm: FloatArray  #: (n_pillars,) [Ω]

    @classmethod
    def none(cls, n_pillars: int) -> Self:
        """Of a sensor that is exactly as designed."""
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
        """What this sensor shows where one as designed has these resistances, (..., n_pillars) [Ω]."""
        return self.gain * modelled_ohm + self.offset_ohm

    def modelled(self, measured_ohm: FloatArray) -> FloatArray:
        """What a sensor as designed would show, (n, n_pillars) [Ω]; kept above 0."""
        modelled = measured_ohm - self.offset_ohm
        modelled /= self.gain
        return np.maximum(modelled, MIN_OHM, out=modelled)
