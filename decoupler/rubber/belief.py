"""Strain of a sensor's pillars from the resistance of a rubber that remembers, from past and present readings alone.

Each belief says how the rubber remembers: by its law, in each direction that it may have, or not at all. All pillars
together tell which one holds: while a sensor is held ln R falls as contacts heal, by what the right law foretold when
the motion ended. A law that is contradicted gives way to no memory at all, with wide deviations.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from decoupler.rubber.inversion import LawInverse, along
from decoupler.rubber.law import LINEAR, Rubber
from geometry.design import Memory
from geometry.layout import FloatArray

DOUBT = 0.2  #: belief in no memory before anything is seen
FLOOR = 7.0  #: logarithm by which one belief exceeds another at most
LOOK_S = 0.19  #: between looks at what all pillars did
RISING = 0.15  #: part of all changes of ln R, squared, that rise: contacts that heal let all fall
SUDDEN, SLOWER = 1.5, 0.3  #: growth of these squares with which a motion begins, and fall with which it ends
CREEP = 1.02  #: growth from look to look of what is taken for noise
FAST, SLOW, SLOW_S, COMMON = 0.001, 0.01, 20.0, 0.003  #: errors of ln R: of single readings, slow ones, those all share
SPREAD = 0.15  #: of pillars' numbers about their rubber's, relative
UNSEEN = 0.5  #: share of contacts that a past which nobody saw may have broken
READ_S = 0.039  #: between times at which laws are followed: between them, strain goes by ln R's slope
JUDGE_S = 0.1  #: between times at which rest and deviations are judged
LEAST = 0.003  #: deviation of a strain, at least
PRESSED = 0.06  #: deviation of strains of a sensor that is not at rest
AT_REST = 0.3  #: how often a sensor is at rest
WEIGHT = 0.1  #: of each pillar's word whether all rest: they are not independent
RESTING_S = 0.5  #: without motion, before a pillar can be at rest; and in which its numbers then follow
MOST_BY_REST = 6.0  #: logarithm of belief that pillars all at rest by one law add to it, at most
SURE = 0.9  #: belief in rest from which they do
PATH_S = 100.0  #: over which ways that strains went count for what a rubber unknown may remember
GAP_S = 1.0  #: between readings, from which anything may have happened in between
MAX_STEP_S, MIN_STEP_S = 3600.0, 1e-5  #: as long as for ever


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorFilter:
    """What follows the strains of a sensor's pillars, of a rubber that is known so well; never changed, only used."""

    memory: Memory
    unsure: tuple[float, float] = (0.0, 0.0)  #: relative variance of what either kind of contact adds to ln R

    @classmethod
    def of_rubber(cls, rubber: Rubber) -> "SensorFilter":
        """A filter of a rubber as a bench series showed it."""
        variance = rubber.covariance.diagonal()
        a = np.maximum(np.abs(rubber.memory.a), 1e-3)
        first, second = np.minimum(variance[2:4] / a**2 + variance[LINEAR : LINEAR + 2].mean(), 1.0)
        return cls(memory=rubber.memory, unsure=(float(first), float(second)))

    def start(self, pillars: int) -> "SensorFollower":
        """A state that has seen nothing yet."""
        return SensorFollower(self, pillars)

    def followed(self, time_s: FloatArray, log_ratio: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Strains and their standard deviations, both (time, n), of readings ln R/R₀ (time, n) in their order."""
        return along(self.start(log_ratio.shape[1]).step, time_s, log_ratio)


class SensorFollower:
    """The state of a filter for n pillars: bounded, whatever comes."""

    def __init__(self, known: SensorFilter, pillars: int) -> None:
        memory, n, self._known = known.memory, pillars, known
        ways = ("lengthening", "loading") if memory.direction == "unknown" else (memory.direction,)
        memories = [*(replace(memory, direction=way) for way in ways), replace(memory, a=(0.0, 0.0))]
        self._law = LawInverse(memories, n)
        self._log_belief = np.log([*((1 - DOUBT) / len(ways) for _ in ways), DOUBT])
        self._resting = np.zeros(len(memories))  #: of beliefs by which all pillars are at rest
        self._told = np.zeros(len(memories))  #: of beliefs by the hold that lasts
        self._unseen = np.ones((2, 1, 1))  #: how much of a past unseen is left
        self._path = np.zeros(n)
        self._look: tuple[FloatArray, FloatArray] | None = None
        self._held: tuple[FloatArray, FloatArray] | None = None
        self._since_s = self._held_s = 0.0
        self._squares, self._noise = 0.0, np.inf
        a, unsure = self._law.a, np.reshape(self._known.unsure, (2, 1, 1))
        self._of_unseen, self._of_broken = (UNSEEN * a) ** 2, a**2 * (1.5 * SPREAD**2 + unsure)
        self._unread_s, self._unjudged_s = 0.0, JUDGE_S
        self._rest, self._deviation = np.zeros((len(memories), n)), np.ones(n)
        self._believe()

    def step(self, log_ratio: FloatArray, seconds: float) -> tuple[FloatArray, FloatArray]:
        """Strains (n,) and their standard deviations by readings ln R/R₀ (n,) so many seconds after the last ones."""
        self._unread_s += min(max(seconds, MIN_STEP_S), MAX_STEP_S)
        if self._unread_s >= READ_S or self._look is None:
            self._read(log_ratio, self._unread_s)
            self._unread_s = 0.0
        change = (log_ratio - self._last) / self._law.slopes
        return self.belief.dot(self._strain + change * self._moving), self._deviation

    def _read(self, y: FloatArray, seconds: float) -> None:
        """Follow all laws to readings (n,)."""
        law = self._law
        if seconds > GAP_S:
            self._unseen, self._look, self._held = np.ones((2, 1, 1)), None, None
            self._unjudged_s = JUDGE_S - seconds
        before = law.strain
        strain = law.step(y, seconds)
        if law.strain is not before:
            self._path = self._path + np.abs(law.strain[-1] - before[-1])
        self._since_s += seconds
        self._unjudged_s += seconds
        if self._look is None or self._since_s >= LOOK_S:
            self._looked(y)
        if self._unjudged_s >= JUDGE_S:
            self._judge(strain, self._unjudged_s)
            self._unjudged_s = 0.0
        self._moving = 1.0 - self._rest * (law.still_s > RESTING_S)
        self._last, self._strain = y, strain * self._moving

    def _judge(self, strain: FloatArray, seconds: float) -> None:
        """Beliefs in rest (k, n), and deviations (n,) of strains by all beliefs."""
        self._path = self._path * np.exp(-seconds / PATH_S)
        self._unseen = self._unseen * np.exp(-seconds / self._law.tau_s[:, :1])
        rest, variance = self._rested(strain, seconds)
        self._rest, strain = rest, strain - strain * rest
        variance[-1] = self._path**2 + ((strain[:-1] - strain[-1]) ** 2).max(axis=0) + LEAST**2
        self._deviation = np.sqrt(self.belief @ (variance + (strain - self.belief @ strain) ** 2))

    def _rested(self, strain: FloatArray, seconds: float) -> tuple[FloatArray, FloatArray]:
        """Beliefs (k, n) that pillars rest, as all may together, and variances of their strains by each law."""
        law, broken = self._law, self._law.broken**2
        variance = self._of_broken * broken + self._of_unseen * self._unseen**2
        own = (variance[0] + variance[1] + SLOW**2) / law.slopes**2 + LEAST**2
        quiet, square = law.still_s > RESTING_S, 0.5 * strain**2
        least = own.max(axis=0)  # one deviation for all laws, or the one that promises most would win
        self._resting = np.clip(_all_rest(_word(least, square), quiet)[:, 0], 0.0, MOST_BY_REST)
        word, quiet[-1] = _word(own, square), False
        together = _all_rest(word, quiet)
        rest = quiet / (1.0 + np.exp(-np.clip(np.clip(together, -6.0, 4.0) + word, -30.0, 30.0)))
        if (settles := rest > SURE).any():
            part = settles * min(1.0, seconds / RESTING_S)
            risen = law.a * broken
            size = (law.a * risen).sum(axis=0) + 1e-12
            missing = law.slopes * strain * part / size
            law.settle(law.strain * (1.0 - part), np.clip(law.broken + missing * risen, 0.0, 1.0))
            if settles[:-1].mean() > 0.5:
                self._unseen = self._unseen * (1.0 - min(1.0, seconds / RESTING_S))
        return rest, own * (1.0 - rest) + rest * (1.0 - rest) * strain**2

    def _looked(self, y: FloatArray) -> None:
        """Judge the laws by readings (n,), some time after the last look."""
        look = (y, self._law.broken)
        if self._look is None:
            self._look, self._since_s = look, 0.0
            return
        change = y - self._look[0]
        squares = float(change @ change)
        rising = float((np.maximum(change, 0.0) ** 2).sum())
        self._noise = max(min(squares, CREEP * self._noise), len(y) * 1e-8)
        floor = 2.0 * self._noise
        moves = rising - floor > RISING * squares or squares > SUDDEN * self._squares + floor
        if moves and self._held is not None:
            log = self._log_belief + self._told
            self._log_belief, self._told = np.maximum(log - log.max(), -FLOOR), np.zeros(len(log))
            self._held = None
        elif not moves and squares + floor < SLOWER * self._squares:  # the look may have seen the end of a motion
            self._held, self._held_s, self._told = look, 0.0, np.zeros(len(self._told))
        elif self._held is not None:
            first = self._held_s == 0.0
            self._held_s += self._since_s
            told = self._evidence(y - self._held[0], self._held[1])
            worst = told if first else np.minimum(told, self._told)
            self._told = np.where(worst < -0.5, worst, told)
        self._believe()
        self._squares = squares
        self._look, self._since_s = look, 0.0

    def _believe(self) -> None:
        log = self._log_belief + self._told + self._resting
        belief = np.exp(log - log.max())
        #: beliefs (k,) in the law in each direction that it may have, and, last, in no memory
        self.belief: FloatArray = belief / belief.sum()

    def _evidence(self, change: FloatArray, broken: Any) -> FloatArray:
        """Logarithms (k,) of how well each law foretold by how much ln R (n,) would fall in a hold; of none: 0.

        The fall is compared by one factor of all pillars, 1 if the law is right.
        """
        law, seconds = self._law, self._held_s
        healed = (law.a * broken * (1.0 - np.exp(-seconds / law.tau_s))).sum(axis=0)
        size = (healed**2).sum(axis=1) + 1e-12
        factor = -(healed @ change) / size
        slow = 2.0 * (1.0 - np.exp(-seconds / SLOW_S))
        noise, alike = 2.0 * FAST**2 + slow * SLOW**2, slow * (COMMON * healed.sum(axis=1) / size) ** 2
        unsure = SPREAD**2 + self._known.unsure[0] / 2 + float(self._unseen[0].max()) + noise / size + alike
        wide, miss = unsure + 1.0, 0.5 * (factor - 1.0) ** 2
        told = 0.5 * np.log(wide / unsure) - miss * (1.0 / unsure - 1.0 / wide)
        told[-1] = 0.0
        return np.clip(told, -FLOOR, FLOOR)


def _word(variance: FloatArray, square: FloatArray) -> FloatArray:
    """Logarithms (k, n) by which rest is likelier than load, of strains so large: `square` is half of theirs."""
    wide = variance + PRESSED**2
    return np.asarray(0.5 * np.log(wide / variance) - square * (1.0 / variance - 1.0 / wide))


def _all_rest(word: FloatArray, quiet: Any) -> FloatArray:
    """The same (k, 1) of all pillars together."""
    said = np.where(quiet, word, -1.0).sum(axis=1, keepdims=True)
    return np.asarray(np.log(AT_REST / (1 - AT_REST)) + WEIGHT * said)
