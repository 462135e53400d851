"""Readings of a rubber that remembers, as they would be without its memory."""

from typing import TYPE_CHECKING

import numpy as np

from geometry.layout import FloatArray

if TYPE_CHECKING:
    from decoupler.rubber.belief import SensorFilter

RATIOS = (0.02, 50.0)  #: of a resistance to that at rest, beyond which it tells no strain


class MemoryReader:
    """Follows the pillars of a sensor, scan by scan: its state is all that it has seen.

    `contacts_ohm` are in every reading, and remember nothing.
    """

    def __init__(self, causal: "SensorFilter", rest_ohm: FloatArray, contacts_ohm: float = 0.0) -> None:
        self._rest_ohm, self._contacts_ohm = rest_ohm.ravel() - contacts_ohm, contacts_ohm
        self._follower = causal.start(self._rest_ohm.size)

    def settled(self, resistance_ohm: FloatArray, seconds: FloatArray) -> dict[str, FloatArray]:
        """What `Forces` has of readings (n, rows, cols, 3) [Ω], each so many seconds (n,) after the one before.

        These are the readings without memory, R₀ (1 + ε)², what of ln R was taken for it, and the relative deviation
        that this leaves, all of their shape; and from which scan on (n,) the law is tested: before, readings stay as
        they are. What is no resistance does, too.
        """
        given_ohm = resistance_ohm.reshape(len(resistance_ohm), -1) - self._contacts_ohm
        with np.errstate(invalid="ignore"):
            ratio = np.clip(np.nan_to_num(given_ohm / self._rest_ohm, nan=1.0, neginf=1.0), *RATIOS)
        steps = zip(np.log(ratio), seconds.tolist(), strict=True)
        followed = [(*self._follower.step(y, dt), self._follower.is_tested) for y, dt in steps]
        strain, deviation, is_tested = (np.stack(each) for each in zip(*followed, strict=True))
        without_ohm = self._rest_ohm * (1.0 + strain) ** 2
        settled_ohm = np.where(np.isfinite(given_ohm), without_ohm, given_ohm) + self._contacts_ohm
        deviation = 2.0 * deviation / (1.0 + strain) * without_ohm / np.abs(settled_ohm)
        rise = np.log(ratio) - 2.0 * np.log1p(strain)
        found = {"resistance_ohm": settled_ohm, "memory_rise": rise, "memory_deviation": deviation}
        shaped = {name: each.reshape(resistance_ohm.shape) for name, each in found.items()}
        return shaped | {"memory_tested": is_tested}
