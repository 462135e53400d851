"""The kernel of readings: R = c y + o of a pillar, y = Σ s v² the square of its length, and back.

By eq. 1 of Song et al. v is the vector from a pillar's lower electrode to its upper one, and all signs s are 1. By
conduction it has more components, each pillar its own; the *length* √y then is the one that eq. 1 would need for R.
What moves v, forces or electrodes, is others' to say: `inverse.sensor_model`, `touch.sensing`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dataset.measurement import ReadingError
from decoupler.data.columns import namespace
from geometry.design import SensorDesign
from geometry.layout import FloatArray, pillar_vectors, pillar_volumes

MIN_WHOLE_OHM = 1.0  #: least resistance without its offset; a pillar with less is broken


@dataclass(frozen=True, kw_only=True, eq=False)
class Pillars:
    """P pillars, unit by unit, of C components; also with tensors of torch."""

    ohm_per_mm2: FloatArray  #: c, (P,): ρ/V of eq. 1, times the gain of one sensor's own pillar
    offset_ohm: FloatArray  #: o, (P,): of one sensor's own pillars; contacts of the design's
    rest_mm: FloatArray  #: d, (C, P): v at rest
    sign: FloatArray | None = None  #: s, (C, P); None: all are 1
    deviation_ohm: FloatArray | None = None  #: (P,): of R at rest, as far as pairs leave it open; None: as designed

    @classmethod
    def designed(cls, design: SensorDesign, numbers: Sequence[int] | None = None) -> "Pillars":
        """As designed, by eq. 1; those of these numbers in every unit, default: all."""
        own = slice(None) if numbers is None else list(numbers)
        c = np.tile((design.resistivity_ohm_mm / pillar_volumes(design.unit))[own], design.n_units)
        rest_mm = np.tile(pillar_vectors(design.unit)[own].T, design.n_units)
        return Pillars(ohm_per_mm2=c, offset_ohm=np.full(len(c), design.electrics.contacts_ohm), rest_mm=rest_mm)

    @property
    def n_pillars(self) -> int:
        return len(self.ohm_per_mm2)

    def signed(self, vectors: FloatArray) -> FloatArray:
        """s v of vectors (n, C, P): half of the slopes of y by v."""
        return vectors if self.sign is None else self.sign * vectors

    def squares(self, vectors: FloatArray) -> FloatArray:
        """y of vectors, (n, C, P) [mm] -> (n, P) [mm²]; by conduction it may be negative where nothing conducts so."""
        signed = self.signed(vectors)
        if isinstance(vectors, np.ndarray):
            return np.einsum("nip,nip->np", signed, vectors)
        return (signed * vectors).sum(1)  # einsum takes seven times as long in torch

    def lengths_between(self, vectors: FloatArray) -> FloatArray:
        """√y of vectors, (n, C, P) [mm] -> (n, P) [mm]; 0 where y is negative."""
        squares = self.squares(vectors)
        return (squares if self.sign is None else squares.clip(0.0)) ** 0.5

    def ohms(self, squares_mm2: FloatArray) -> FloatArray:
        """R of y, (..., P) [mm²] -> [Ω]; eq. 1."""
        return self.ohm_per_mm2 * squares_mm2 + self.offset_ohm

    def squares_of(self, resistance_ohm: FloatArray) -> FloatArray:
        """y that resistances stand for, (..., P) [Ω] -> [mm²]."""
        return (resistance_ohm - self.offset_ohm) / self.ohm_per_mm2

    def lengths_of(self, resistance_ohm: FloatArray) -> FloatArray:
        """Lengths that resistances stand for, (n, P) [Ω] -> [mm], of broken pillars by `MIN_WHOLE_OHM`; eq. 2."""
        xp, whole_ohm = namespace(resistance_ohm), resistance_ohm - self.offset_ohm
        return xp.sqrt(xp.where(whole_ohm > MIN_WHOLE_OHM, whole_ohm, MIN_WHOLE_OHM) / self.ohm_per_mm2)

    def errors_mm2(
        self, resistance_ohm: FloatArray, errors: ReadingError, shape: tuple[int, int]
    ) -> tuple[FloatArray, FloatArray]:
        """What y errs by if resistances (n, P) [Ω] of an array of rows and columns are read so [mm²].

        Deviations of each alone (n, P), and changes by one deviation of each error that they share (n, P, m).
        """
        own = errors.deviation(resistance_ohm)
        if self.deviation_ohm is not None:
            own = np.hypot(own, self.deviation_ohm)
        return own / self.ohm_per_mm2, errors.shared(resistance_ohm, *shape) / self.ohm_per_mm2[:, None]
