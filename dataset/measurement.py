"""Measurement of a resistance: drift since the tare, relative noise, and the steps of an analogue-to-digital converter.

The converter sees a voltage divider: the pillar between the supply and the input, a sense resistor between
the input and ground, so its reading is the fraction R_sense/(R + R_sense) of full scale.
"""

import math
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from common.errors import DesignError
from common.quantity import quantity
from geometry.design import Drifts, SensorDesign
from geometry.layout import FloatArray

MIN_LEFT = 0.01  #: part of its resistance that the widest drift leaves a pillar
SENSE_OHM = 10_000.0  #: default sense resistor: the z pillar's rest value puts the divider in mid-range


class Readout(Protocol):
    """Electronics with errors of their own in place of `measured`'s.

    A frozen dataclass of plain values, so that what it made can carry the hash of it.
    """

    @property
    def bits(self) -> int | None:
        """Resolution of its converter; None reads exactly."""

    def seen(self, design: SensorDesign) -> SensorDesign:
        """The design as it shows: without contacts to electronics that see none."""

    def measured(self, resistance_ohm: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Resistances that it reads of pillars, both (n_samples, rows, cols, n_pillars) [Ω]; finite and above 0."""


@dataclass(frozen=True, kw_only=True)
class ReadingError(Drifts):
    """Errors of a reading: what each pillar has by itself, and the drifts that pillars share; drawn anew for each."""

    noise: float = quantity(0.0, "standard deviation of a reading, relative to the resistance", within=(0, math.inf))
    bits: int | None = quantity(None, "bits of the converter; default: exact readings", within=(4, 24))

    @property
    def is_exact(self) -> bool:
        """Readings are the resistances themselves."""
        return self.bits is None and not (self.noise or self.has_drift)

    @property
    def has_drift(self) -> bool:
        return any(getattr(self, spec.name) for spec in fields(Drifts))

    def without_drifts(self) -> "ReadingError":
        """What each pillar has by itself, anew in each reading."""
        none: dict[str, Any] = {spec.name: 0.0 for spec in fields(Drifts)}
        return replace(self, **none)

    def drifts_beyond(self, own: "ReadingError") -> "ReadingError":
        """The drifts alone that, beside those of readings drawn with `own`, make them these."""
        drifts: dict[str, Any] = {
            spec.name: math.sqrt(max(getattr(self, spec.name) ** 2 - getattr(own, spec.name) ** 2, 0.0))
            for spec in fields(Drifts)
        }
        return ReadingError(**drifts)

    def deviation(self, resistance_ohm: FloatArray) -> FloatArray:
        """Standard deviation of what each reading has by itself [Ω], of the shape of the resistances.

        A step of the converter, (R + R_sense)²/(R_sense (2^bits − 1)) wide, holds its readings evenly: deviation
        width/√12.

        >>> ReadingError(noise=0.001).deviation(np.array([10_000.0]))
        array([10.])
        """
        variance = (self.own_relative * resistance_ohm) ** 2
        if self.bits is not None:
            step = (resistance_ohm + SENSE_OHM) ** 2 / (SENSE_OHM * (2**self.bits - 1))
            variance = variance + step**2 / 12.0
        return variance**0.5

    @property
    def own_relative(self) -> float:
        """Relative standard deviation of what each reading has by itself, the converter's steps apart."""
        return float(np.hypot(self.noise, self.drift_pillar))

    def shared(self, resistance_ohm: FloatArray, rows: int, cols: int) -> FloatArray:
        """Changes of readings by one standard deviation of each drift that pillars share, (n, P) -> (n, P, m) [Ω].

        The P pillars are in the order of units, as many of each of the rows × cols; m is 0 without such drifts.
        """
        unit = self._patterns(rows, cols)
        pillar = np.repeat(unit, resistance_ohm.shape[1] // len(unit), axis=0)
        relative = np.pad(pillar[:, pillar.any(axis=0)], [(0, 0), (0, int(self.drift_offset_ohm > 0))])
        offset_ohm = np.where(relative.any(axis=0), 0.0, self.drift_offset_ohm)
        like = getattr(resistance_ohm, "new_tensor", np.asarray)  # of torch
        return resistance_ohm[:, :, None] * like(relative) + like(offset_ohm)

    def total(self, resistance_ohm: FloatArray, rows: int, cols: int) -> FloatArray:
        """Standard deviation of readings, of what they share as well, (n, P) [Ω] -> (n, P) [Ω]."""
        shared = self.shared(resistance_ohm, rows, cols)
        return np.sqrt(self.deviation(resistance_ohm) ** 2 + (shared**2).sum(axis=2))

    def scattered(self, resistance_ohm: FloatArray, rows: int, cols: int, generator: np.random.Generator) -> FloatArray:
        """Readings (n, P) [Ω] of P pillars as these errors leave them to first order, converter's steps as noise."""
        own, shared = self.deviation(resistance_ohm), self.shared(resistance_ohm, rows, cols)
        found = resistance_ohm + own * generator.standard_normal(resistance_ohm.shape)
        return found + np.einsum("npm,nm->np", shared, generator.standard_normal((len(found), shared.shape[2])))

    def _patterns(self, rows: int, cols: int) -> FloatArray:
        """Relative change at each unit by a deviation of the drift, of its tilt along x and along y, (k, 3)."""
        along_y, along_x = (np.linspace(-1.0, 1.0, size) if size > 1 else np.zeros(1) for size in (rows, cols))
        y, x = np.meshgrid(along_y, along_x, indexing="ij")
        tilted = self.drift_tilt * np.stack([x.reshape(-1), y.reshape(-1)], axis=1)
        return np.concatenate([np.full((rows * cols, 1), self.drift), tilted], axis=1)

    def drifted(self, resistance_ohm: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Resistances (n, rows, cols, n_pillars) [Ω] with a new drift in every sample; the same if none is stated.

        Series (n, time, rows, cols, n_pillars) have one each.
        Draws come from a child of the generator: what it gives next does not depend on the drift.
        """
        if not self.has_drift:
            return resistance_ohm
        generator = generator.spawn(1)[0]
        n, *moments, rows, cols, pillars = resistance_ohm.shape
        once = [n, *[1] * len(moments)]  # of all moments
        common = (generator.standard_normal((n, 3)) @ self._patterns(rows, cols).T).reshape(*once, rows, cols, 1)
        own = self.drift_pillar * generator.standard_normal((*once, rows, cols, pillars))
        offset = self.drift_offset_ohm * generator.standard_normal((*once, 1, 1, 1))
        return np.maximum(resistance_ohm * (1.0 + common + own) + offset, MIN_LEFT * resistance_ohm)

    def read(self, resistance_ohm: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Resistances (n, rows, cols, n_pillars) [Ω] as measured: drift, noise, and the converter's steps last."""
        return measured(self.drifted(resistance_ohm, generator), self.noise, self.bits, generator)


def counts_from_resistance(resistance_ohm: FloatArray, bits: int, sense_ohm: float = SENSE_OHM) -> NDArray[np.int64]:
    """Counts that a `bits`-bit converter reads for each resistance.

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

    ``noise=0`` and ``bits=None`` leave them as they are. Noise is drawn even so, one number a resistance, so that what
    `generator` gives next does not depend on the setting. A resistance so far from the sense resistor that the
    converter reads 0 or full scale, which stand for none at all, is a `DesignError`.
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
