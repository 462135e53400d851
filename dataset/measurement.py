"""Measurement of a resistance: relative noise, and the steps of an analogue-to-digital converter.

The converter sees a voltage divider: the pillar between the supply and the input, a sense resistor between
the input and ground, so its reading is the fraction R_sense/(R + R_sense) of full scale.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from geometry.errors import DesignError
from geometry.layout import FloatArray

SENSE_OHM = 10_000.0  #: default sense resistor: the z pillar's rest value puts the divider in mid-range


class Readout(Protocol):
    """Electronics with errors of their own in place of `measured`'s.

    A frozen dataclass of plain values, so that what it made can carry the hash of it.
    """

    @property
    def bits(self) -> int | None:
        """Resolution of its converter; None reads exactly."""

    def measured(self, resistance_ohm: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Resistances that it reads of pillars z, x, y, both (n_samples, rows, cols, 3) [Ω]; finite and above 0."""


def counts_from_resistance(resistance_ohm: FloatArray, bits: int, sense_ohm: float = SENSE_OHM) -> NDArray[np.int64]:
    """Counts that a `bits`-bit converter reads for each resistance; any shape.

    >>> counts_from_resistance(np.array([0.0, 10_000.0]), bits=10)
    array([1023,  512])
    """
    return np.rint((2**bits - 1) * sense_ohm / (resistance_ohm + sense_ohm)).astype(np.int64)


def resistance_from_counts(counts: NDArray[np.int64], bits: int, sense_ohm: float = SENSE_OHM) -> FloatArray:
    """Resistance in the middle of each count's step, the inverse of `counts_from_resistance`; any shape.

    Count 0 stands for an open circuit and gives infinity; full scale gives 0 Ω.
    """
    with np.errstate(divide="ignore"):
        return sense_ohm * ((2**bits - 1) / np.asarray(counts, dtype=np.float64) - 1.0)


def measured(resistance_ohm: FloatArray, noise: float, bits: int | None, generator: np.random.Generator) -> FloatArray:
    """Resistances as measured: relative Gaussian noise of standard deviation `noise`, then converter steps.

    ``noise=0`` and ``bits=None`` leave the resistances as they are. Noise is drawn even so, one number a
    resistance, so that what `generator` gives next does not depend on the setting.

    Raises
    ------
    DesignError
        If a resistance is so far from the sense resistor that the converter reads 0 or full scale, which
        stand for no resistance at all.
    """
    disturbance = generator.standard_normal(resistance_ohm.shape)
    if noise:
        resistance_ohm = resistance_ohm * (1.0 + noise * disturbance)
    if bits is not None:
        counts = counts_from_resistance(resistance_ohm, bits)
        lost = (counts <= 0) | (counts >= 2**bits - 1)
        if lost.any():
            raise DesignError(
                f"a converter of bits={bits} with a sense resistor of {SENSE_OHM:g} Ω cannot tell "
                f"{resistance_ohm[lost][0]:.4g} Ω: raise bits, or choose resistivity_ohm_mm so that pillars "
                f"rest near {SENSE_OHM:g} Ω."
            )
        resistance_ohm = resistance_from_counts(counts, bits)
    return resistance_ohm


def reading_deviation(
    resistance_ohm: FloatArray, noise: float, bits: int | None, sense_ohm: float = SENSE_OHM
) -> FloatArray:
    """Standard deviation of a reading about its resistance [Ω], of noise and converter steps together; any shape.

    A step of the converter, (R + R_sense)²/(R_sense (2^bits − 1)) wide, holds its readings evenly: deviation width/√12.

    >>> reading_deviation(np.array([10_000.0]), noise=0.001, bits=None)
    array([10.])
    """
    variance = (noise * resistance_ohm) ** 2
    if bits is not None:
        step = (resistance_ohm + sense_ohm) ** 2 / (sense_ohm * (2**bits - 1))
        variance = variance + step**2 / 12.0
    return np.sqrt(variance)
