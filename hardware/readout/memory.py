"""Readings of a rubber that remembers, as they would be without its memory."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geometry.layout import FloatArray

if TYPE_CHECKING:
    from decoupler.rubber.belief import SensorFilter

RATIOS = (0.02, 50.0)  #: of a resistance to that at rest, beyond which it tells no strain


@dataclass(frozen=True, kw_only=True, eq=False)
class Settled:
    """Readings of n scans without memory."""

    resistance_ohm: FloatArray  #: (n, rows, cols, 3): R₀ (1 + ε)²
    rise: FloatArray  #: of ln R that is taken for memory, of that shape
    deviation: FloatArray  #: relative, of the resistances


class MemoryReader:
    """Follows the pillars of a sensor, scan by scan: its state is all that it has seen.

    `contacts_ohm` are in every reading, and remember nothing.
    """

    def __init__(self, causal: "SensorFilter", rest_ohm: FloatArray, contacts_ohm: float = 0.0) -> None:
        self._rest_ohm, self._contacts_ohm = rest_ohm.ravel() - contacts_ohm, contacts_ohm
        self._follower = causal.start(self._rest_ohm.size)

    def settled(self, resistance_ohm: FloatArray, seconds: FloatArray) -> Settled:
        """Readings (n, rows, cols, 3) [Ω] that come so many seconds (n,), each, after the one before.

        What is no resistance stays as it is.
        """
        given_ohm = resistance_ohm.reshape(len(resistance_ohm), -1) - self._contacts_ohm
        with np.errstate(invalid="ignore"):
            ratio = np.clip(np.nan_to_num(given_ohm / self._rest_ohm, nan=1.0, neginf=1.0), *RATIOS)
        found = [self._follower.step(y, dt) for y, dt in zip(np.log(ratio), seconds.tolist(), strict=True)]
        strain = np.stack([each for each, _ in found])
        without_ohm = self._rest_ohm * (1.0 + strain) ** 2
        settled_ohm = np.where(np.isfinite(given_ohm), without_ohm, given_ohm) + self._contacts_ohm
        deviation = 2.0 * np.stack([each for _, each in found]) / (1.0 + strain) * without_ohm / np.abs(settled_ohm)
        rise = np.log(ratio) - 2.0 * np.log1p(strain)
        shaped = [each.reshape(resistance_ohm.shape) for each in (settled_ohm, rise, deviation)]
        return Settled(resistance_ohm=shaped[0], rise=shaped[1], deviation=shaped[2])
