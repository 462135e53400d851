"""The law of a rubber that remembers, turned round: strain from ln R, reading by reading.

A pillar that is let go breaks contacts so fast that ln R may rise, as it does while the pillar is loaded. Where both
ways explain a reading, a pillar that moves goes on as before; one that rested goes home. If that was wrong, no small
step explains what follows: then the least large one is taken that does.
"""

from typing import Any

import numpy as np

from dataset.memory import decays, log_rise
from geometry.design import Memory
from geometry.layout import FloatArray

RULES = ("lengthen", "load")  #: b_lengthen is of strains ε that grow, as in tension; or of |ε| that grows
BAND = 0.01  #: of ln R that is no motion: noise would break contacts
JUMP = 0.02  #: of ln R beyond the band that no small step explains, from which a large one is looked for
STEPS = 0.004 * 1.45 ** np.arange(13)  #: large changes of strain
STILL_S = 1.0  #: after which a pillar rests
CLOSE = 0.01  #: strain below which a pillar can be loaded either way; one that rests beyond is on its way home
BRANCH_S = 2.0  #: in which a choice between both ways fades from `LawInverse.evidence`
MIN_SLOPE = 0.7  #: of ln R by strain that is divided by
STEEPEST, LARGEST = 0.1, 0.05  #: strains of Newton's first step, and of the others
BOUNDS = (-0.6, 0.7)  #: strains that are looked for


def settled_strain(log_ratio: FloatArray, memory: Memory) -> FloatArray:
    """Strain at which ln R/R₀ is this with no contact broken; the nearest one where there is none."""
    strain = log_ratio / (2.0 + memory.g1)
    for _ in range(4):
        slope = np.maximum(2.0 / (1.0 + strain) + memory.g1 + 2.0 * memory.g2 * strain, 0.5)
        missing = log_ratio - 2.0 * np.log1p(strain) - memory.g1 * strain - memory.g2 * strain**2
        strain = np.clip(strain + missing / slope, *BOUNDS)
    return strain


class LawInverse:
    """Strains of n pillars that `memory` reads from their ln R, by both rules of direction: (2, n), `RULES` first.

    `strains` are the least and the largest that can be. Where the least is 0, as of a strip that hangs in a bench, a
    reading below the law's at rest says that the zero was taken on a strip already stretched: `lifted` is by how much.
    """

    def __init__(self, memory: Memory, pillars: int, strains: tuple[float, float] = BOUNDS) -> None:
        shape = (len(RULES), pillars)
        self.memory, self.strains = memory, strains
        self.strain, self.broken = np.zeros(shape), np.zeros((2, *shape))
        self.way, self.still_s, self.choice = np.zeros(shape), np.full(shape, 1e3), np.zeros(shape)
        self.missing, self.lifted = np.zeros(shape), np.zeros(shape)
        self._by_size = np.array([[False], [True]])

    def step(self, log_ratio: FloatArray, seconds: float) -> FloatArray:
        """Strains (2, n) by readings ln R/R₀ (n,) so many seconds after the last ones."""
        memory, before = self.memory, self.strain
        y = log_ratio + self.lifted
        rested = self._broken(before, before, self.broken, seconds)
        unexplained = _beyond(y - self._law(before, rested))
        up, down = self._slopes(before, rested)
        can_up, can_down = unexplained * up > 0, (unexplained * down < 0) & (before > self.strains[0] + CLOSE / 2)
        is_open = can_up & can_down
        home = np.where(np.abs(before) > CLOSE, -1.0, 1.0) * np.where(before < 0, -1.0, 1.0)
        usual = np.where((self.still_s < STILL_S) & (self.way != 0), self.way, home)
        way = np.where(is_open, usual, can_up - 1.0 * (can_down & ~can_up))
        strain = self._newton(y, unexplained, way, before, seconds) if way.any() else before
        if (stuck := (way == 0) & (np.abs(unexplained) > JUMP)).any():
            strain = self._jumped(y, unexplained, stuck, strain, seconds)
        moved = np.abs(strain - before) > 1e-4
        self.still_s = np.where(moved, 0.0, self.still_s + seconds)
        self.way = np.where(moved, np.sign(strain - before), self.way)
        self.choice = np.where(is_open, 1.0, self.choice * np.exp(-seconds / BRANCH_S))
        self.broken, self.strain = self._broken(before, strain, self.broken, seconds), strain
        a = np.reshape(memory.a, (2, 1, 1))
        found = settled_strain(y - (a * self.broken).sum(axis=0), memory)
        if self.strains[0] >= 0.0:
            self.lifted = self.lifted + np.maximum(-found, 0.0) * (2.0 + memory.g1) * min(1.0, seconds)
        self.missing = y - self._law(strain, self.broken)
        return found

    def evidence(self, found: FloatArray) -> list[FloatArray]:
        """What tells whether strains (2, n) of `step` can be believed, each (2, n)."""
        missing = np.clip(self.missing, -0.3, 0.3)
        return [found, self.strain - found, *self.broken, missing, self.choice, self.way * np.exp(-self.still_s)]

    def _law(self, strain: FloatArray, broken: FloatArray) -> Any:
        return 2.0 * np.log1p(strain) + log_rise(strain, broken, self.memory)

    def _broken(self, before: FloatArray, strain: FloatArray, broken: Any, seconds: float) -> FloatArray:
        """Shares of broken contacts (2, 2, n) after strains have changed."""
        change = np.where(self._by_size, np.abs(strain) - np.abs(before), strain - before)
        return np.stack(
            [keep * q + gain for q, (keep, gain) in zip(broken, decays(change, seconds, self.memory), strict=True)]
        )

    def _slopes(self, strain: FloatArray, broken: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Slopes of ln R by strain while it grows and while it falls."""
        memory = self.memory
        shape = 2.0 / (1.0 + strain) + memory.g1 + 2.0 * memory.g2 * strain
        left = memory.a[0] * (1.0 - broken[0]) + memory.a[1] * (1.0 - broken[1])
        up = np.where(self._by_size & (self.strain < -CLOSE), memory.b_shorten, memory.b_lengthen)
        down = np.where(self._by_size & (self.strain < CLOSE), memory.b_lengthen, memory.b_shorten)
        return shape + left * up, shape - left * down

    def _newton(self, y: FloatArray, unexplained: FloatArray, way: Any, before: FloatArray, seconds: float) -> Any:
        """Strains that explain readings on their way."""
        strain, broken, most = before, self.broken, STEEPEST
        for _ in range(2):
            up, down = self._slopes(strain, broken)
            slope = np.where(way > 0, up, down)
            slope = np.where(np.abs(slope) < MIN_SLOPE, np.copysign(MIN_SLOPE, slope), slope)
            change = np.clip(unexplained / slope, -most, most) * (way != 0)
            strain, most = np.clip(strain + change, BOUNDS[0], BOUNDS[1]), LARGEST
            broken = self._broken(before, strain, self.broken, seconds)
            unexplained = _beyond(y - self._law(strain, broken))
        return np.maximum(strain, self.strains[0])

    def _jumped(self, y: FloatArray, unexplained: FloatArray, stuck: Any, strain: FloatArray, seconds: float) -> Any:
        """Strains of which those that are stuck take the least large step that explains their readings."""
        rule, pillar = np.nonzero(stuck)
        before, broken = self.strain[rule, pillar], self.broken[:, rule, pillar]
        steps = np.concatenate([STEPS, -STEPS])[:, None]
        tried = np.clip(before + steps, self.strains[0], BOUNDS[1])
        change = np.where(rule == 1, np.abs(tried) - np.abs(before), tried - before)
        moved = [keep * q + gain for q, (keep, gain) in zip(broken, decays(change, seconds, self.memory), strict=True)]
        left = y[rule, pillar] - self._law(tried, np.stack(moved))
        explains = left * unexplained[rule, pillar] <= 0
        chosen = np.where(explains, np.abs(steps), np.inf).argmin(axis=0)
        strain = strain.copy()
        strain[rule, pillar] = np.where(explains.any(axis=0), tried[chosen, np.arange(len(chosen))], before)
        return strain


def _beyond(values: FloatArray) -> FloatArray:
    """What of values lies beyond the band."""
    return values - np.clip(values, -BAND, BAND)
