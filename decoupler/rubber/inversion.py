"""The law of a rubber that remembers, turned round: strain from ln R, reading by reading.

A pillar that is let go breaks contacts so fast that ln R may rise, as it does while the pillar is loaded. Where both
ways explain a reading, a pillar that moves goes on as before; one that rested goes home. If that was wrong, no small
step explains what follows: then the least large one is taken that does.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from geometry.design import Memory
from geometry.layout import FloatArray

STILL_BAND, BAND = 0.01, 0.003  #: of ln R that is no motion, of pillars that rest and that move: noise breaks contacts
MOVING_S = 0.6  #: for which a pillar that has moved is one that moves
JUMP = 0.03  #: of ln R that no small step explains, from which a large one is looked for
STEPS = np.outer([1.0, -1.0], 0.004 * 1.45 ** np.arange(13)).reshape(-1, 1, 1, 1)  #: large changes of strain
STILL_S = 1.0  #: after which a pillar rests
CLOSE = 0.01  #: strain below which a pillar can be loaded either way; one that rests beyond is on its way home
MIN_SLOPE = 0.7  #: of ln R by strain that is divided by
STEEPEST, LARGEST = 0.1, 0.05  #: strains of Newton's first step, and of the others
ROUNDS, NEAR = 3, 5e-4  #: of Newton's steps, and what of ln R may be left
LEAST_STRAIN = 1e-4  #: change of strain that is a motion
BOUNDS = (-0.6, 0.7)  #: strains that are looked for


class LawInverse:
    """Strains of n pillars as each of k memories reads them from their ln R, (k, n).

    Where a memory's direction is loading, b_lengthen is of |ε| that grows; else of ε.
    """

    def __init__(self, memories: Sequence[Memory], pillars: int) -> None:
        shape = (len(memories), pillars)
        self.still_s, self._way = np.full(shape, 1e3), np.zeros(shape)
        names = ("b_lengthen", "b_shorten", "g1", "g2")
        lengthen, shorten, self._g1, self._g2 = (
            np.array([[getattr(each, name)] for each in memories], dtype=float) for name in names
        )
        self._rates = (lengthen + shorten) / 2.0, (lengthen - shorten) / 2.0  # of both ways, and by way
        self.a, self.tau_s = (
            np.array([[[getattr(each, name)[i]] for each in memories] for i in (0, 1)]) for name in ("a", "tau_s")
        )
        self._all = self.a[0] + self.a[1]
        self._by_size = np.array([[each.direction == "loading"] for each in memories])
        self.settle(np.zeros(shape), np.zeros((2, *shape)))

    def settle(self, strain: FloatArray, broken: FloatArray) -> None:
        """Take strains (k, n) and shares of broken contacts (2, k, n) for what they are."""
        self.strain, self.broken, self._static = strain, broken, self._unbroken(strain)
        self.slopes = np.maximum(self._slope(strain), 0.5)  #: of ln R by strain while no contact breaks

    def step(self, log_ratio: FloatArray, seconds: float) -> FloatArray:
        """Strains (k, n) by readings ln R/R₀ (n,) so many seconds after the last ones."""
        rested = self.broken * np.exp(-seconds / self.tau_s)
        left = log_ratio - self._static - self._risen(rested)
        moves = np.abs(left) > BAND + (STILL_BAND - BAND) * (self.still_s >= MOVING_S)
        if moves.any():
            left = self._moved(log_ratio, left, moves, rested, seconds)
        else:
            self.broken, self.still_s = rested, self.still_s + seconds
        return np.asarray(_within(self.strain + left / self.slopes, BOUNDS))

    def _unbroken(self, strain: FloatArray) -> Any:
        """ln R/R₀ of strains (k, n) with no contact broken."""
        return 2.0 * np.log1p(strain) + strain * (self._g1 + self._g2 * strain)

    def _slope(self, strain: FloatArray) -> Any:
        return 2.0 / (1.0 + strain) + (self._g1 + 2.0 * self._g2 * strain)

    def _risen(self, broken: FloatArray) -> Any:
        return self.a[0] * broken[0] + self.a[1] * broken[1]

    def _rate(self, strain: FloatArray, way: Any) -> Any:
        """Rates at which contacts break where strains (k, n) go this way, 1 or -1."""
        both, apart = self._rates
        return both + apart * (way * (1.0 - 2.0 * (self._by_size & (strain < 0.0))))

    def _after(self, strain: FloatArray, seconds: float, pillars: Any = slice(None)) -> FloatArray:
        """Shares of broken contacts (2, k, n) after strains of some pillars have changed to these."""
        both, apart = self._rates
        before = self.strain[:, pillars]
        grown = np.where(self._by_size, np.abs(strain) - np.abs(before), strain - before)
        rate = both * np.abs(grown) + apart * grown
        total = rate + seconds / self.tau_s
        keep = np.exp(-total)
        return np.asarray(keep * self.broken[..., pillars] + rate / total * (1.0 - keep))

    def _moved(self, y: FloatArray, left: FloatArray, moves: Any, rested: FloatArray, seconds: float) -> FloatArray:
        """What readings (n,) still miss (k, n) once pillars have moved that do."""
        before, (low, high) = self.strain, BOUNDS
        whole = self._all - self._risen(rested)  # what contacts that are not broken can add
        folds = self._slope(before) < whole * self._rate(before, -1.0)  # ln R rises by strain that falls, too
        rises = left > 0.0
        way = 1.0 * (moves & rises) - (moves & ~rises & ~folds)
        if (either := moves & rises & folds & (before > low + CLOSE / 2)).any():
            home = np.where((np.abs(before) > CLOSE) ^ (before < 0), -1.0, 1.0)
            way = np.where(either, np.where((self.still_s < STILL_S) & (self._way != 0), self._way, home), way)
        goes, strain, most = np.abs(way), before, STEEPEST
        for _ in range(ROUNDS):
            slope = way * self._slope(strain) + whole * self._rate(strain, way)
            slope = np.copysign(np.maximum(np.abs(slope), MIN_SLOPE), slope)
            change = way * (strain - before) + goes * _within(left / slope, (-most, most))
            strain = _within(before + way * np.maximum(change, 0.0), (low, high))
            broken, most = self._after(strain, seconds), LARGEST
            risen = self._risen(broken)
            whole, left = self._all - risen, y - self._unbroken(strain) - risen
            if (np.abs(left) * goes).max() < NEAR:
                break
        if (stuck := moves & (way == 0.0) & (np.abs(left) > JUMP)).any():
            some = np.flatnonzero(stuck.any(axis=0))
            tried = _within(before[:, some] + STEPS, BOUNDS)  # (26, 1, k, s)
            broken, tried = np.moveaxis(self._after(tried, seconds, some), 1, 0), tried[:, 0]
            missing = y[some] - self._unbroken(tried) - self._risen(broken)
            explains = (missing * left[:, some] <= 0) & stuck[:, some]
            least = np.where(explains, np.abs(STEPS[:, 0]), np.inf).argmin(axis=0)[None]
            jumped = np.take_along_axis(tried, least, axis=0)[0]
            strain[:, some] = np.where(explains.any(axis=0), jumped, strain[:, some])
            broken = self._after(strain, seconds)
            left = y - self._unbroken(strain) - self._risen(broken)
        change = strain - before
        moved = np.abs(change) > LEAST_STRAIN
        self.still_s = (self.still_s + seconds) * ~moved
        self._way = np.where(moved, np.sign(change), self._way)
        self.settle(strain, broken)
        return left


def _within(values: Any, limits: tuple[float, float]) -> Any:
    """As `np.clip`, in half its time."""
    return np.minimum(np.maximum(values, limits[0]), limits[1])
