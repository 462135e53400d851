"""Readings of a converter that cannot be told from those of a sensor at rest."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from dataset.measurement import SENSE_OHM
from geometry.layout import FloatArray

HALF_STEP = 0.6  #: counts from rest within which a reading may be one of rest; a tenth is for the calibration's error
MOST = 0.5  #: share of a scan's readings that must be so before any is taken for rest


@dataclass(frozen=True, eq=False, kw_only=True)
class Resting:
    """What pillars show at rest, and the converter that reads them.

    A converter reads one count whatever a resistance does within its step. A sensor at rest is always in the same place
    of every step, so what the steps hide does not average out: like pillars err alike, and the array seems pressed all
    over. Where more than half of a scan may be at rest, rest is likelier than any other place in the step.
    """

    rest_ohm: FloatArray  #: (n_in,)
    full_counts: FloatArray  #: (1,): of the converter, 2^bits − 1

    @classmethod
    def read_with(cls, rest_ohm: FloatArray, bits: int | None) -> Self | None:
        """Of pillars (n_in,) [Ω] behind a converter; None without one."""
        return None if bits is None else cls(rest_ohm=rest_ohm, full_counts=np.array([2.0**bits - 1.0]))

    def settled(self, columns_ohm: FloatArray) -> FloatArray:
        """Readings (n, n_in) [Ω] with those that may be at rest there, where most of a sample's may."""
        steps = self.full_counts * (SENSE_OHM / (columns_ohm + SENSE_OHM) - SENSE_OHM / (self.rest_ohm + SENSE_OHM))
        alike = np.abs(steps) <= HALF_STEP
        return np.where(alike & (alike.mean(axis=1, keepdims=True) > MOST), self.rest_ohm, columns_ohm)
