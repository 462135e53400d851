"""Strain of a sensor's pillars from the resistance of a rubber that remembers, from past and present readings alone.

A law counts for nothing until readings have tested it. While a sensor is held, or rests after a load, ln R falls as
contacts heal, by what the law foretold when the motion ended; without memory it changes only as the load does. The
likelihoods of all pillars' changes by either are compared, from hold to hold. Until the law's is decisively the larger
one readings are taken by eq. 1, as without a rubber.

From then on each belief says how the rubber remembers: by its law, in each direction that it may have, or otherwise.
A law that later holds contradict gives way to no contact broken. Deviations are wide wherever memory is in doubt.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dataset.samples import FALSE_ALARMS
from decoupler.rubber.inversion import LawInverse
from decoupler.rubber.law import LINEAR, Rubber
from geometry.design import Memory
from geometry.layout import FloatArray

DOUBT = 0.2  #: belief in no memory before anything is seen
FLOOR = 7.0  #: logarithm by which one belief exceeds another at most
LOOK_S = 0.19  #: between looks at what all pillars did
RISING = 0.15  #: part of all changes of ln R, squared, that rise: contacts that heal let all fall
SUDDEN, SLOWER = 1.5, 0.3  #: growth of these squares with which a motion begins, and fall from their most that ends it
CREEP = 1.02  #: growth from look to look of what is taken for noise
FAST, SLOW, SLOW_S, COMMON = 0.001, 0.01, 20.0, 0.003  #: errors of ln R: of single readings, slow ones, those all share
SPREAD = 0.15  #: of pillars' numbers about their rubber's, relative
UNSEEN = 0.5  #: share of contacts that a past which nobody saw may have broken
READ_S = 0.039  #: between times at which laws are followed: between them, strain goes by ln R's slope
JUDGE_S = 0.1  #: between times at which rest and deviations are judged
LEAST_STRAIN = 0.003  #: deviation of a strain, at least
PRESSED = 0.06  #: deviation of strains of a sensor that is not at rest
AT_REST = 0.3  #: how often a sensor is at rest
WEIGHT = 0.1  #: of each pillar's word whether all rest: they are not independent
RESTING_S = 0.5  #: without motion, before a pillar can be at rest; and in which its numbers then follow
MOST_BY_REST = 6.0  #: logarithm of belief that pillars all at rest by one law add to it, at most
SURE = 0.9  #: belief in rest from which they do
PATH_S = 100.0  #: over which ways that strains went count for what a rubber unknown may remember
GAP_S = 1.0  #: between readings, from which anything may have happened in between
DECISIVE = float(np.log(1.0 / FALSE_ALARMS))  #: logarithm of a likelihood ratio
APART = 0.33  #: of each pillar's word whether its rubber remembers: those of a unit feel one load
LOAD_CREEP = 0.1  #: of a load that is held, relative: what changes ln R in proportion without memory
AMOUNTS = (0.03, 0.1, 0.3, 1.0, 3.0)  #: of what the law foretells, that another rubber's memory may have
LOAD_CHANGES = np.array([0.0, 0.01, 0.03, 0.1, 0.3, 1.0])  #: the same of each pillar alone; the likeliest counts
MAX_STEP_S, MIN_STEP_S = 3600.0, 1e-5  #: as long as for ever


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorFilter:
    """What follows the strains of a sensor's pillars, of a rubber that is known so well; never changed, only used."""

    memory: Memory
    unsure: tuple[float, float] = (0.0, 0.0)  #: relative variance of what either kind of contact adds to ln R
    is_tested: bool = False  #: whether the sensor is known to be of this rubber, as its design says

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
        self.is_tested = known.is_tested  #: whether the law is applied
        #: logarithms of how much likelier memory makes what was read than none: in past holds, and in this one
        self._past_ratio = self._ratio = 0.0
        self._unseen = np.ones((2, 1, 1))  #: how much of a past unseen is left
        self._path = np.zeros(n)
        self._look: tuple[FloatArray, FloatArray] | None = None
        self._held: tuple[FloatArray, FloatArray] | None = None
        self._since_s = self._held_s = 0.0
        self._squares, self._noise = 0.0, np.inf
        self._fastest = 0.0  #: largest squares of this motion
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
        if not self.is_tested:
            return np.expm1(0.5 * log_ratio), self._deviation
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
            self._judge(strain, y, self._unjudged_s)
            self._unjudged_s = 0.0
        self._moving = 1.0 - self._rest * (law.still_s > RESTING_S)
        self._last, self._strain = y, strain * self._moving

    def _judge(self, strain: FloatArray, y: FloatArray, seconds: float) -> None:
        """Beliefs in rest (k, n), and deviations (n,) of strains by all beliefs."""
        self._path = self._path * np.exp(-seconds / PATH_S)
        self._unseen = self._unseen * np.exp(-seconds / self._law.tau_s[:, :1])
        rest, variance = self._rested(strain, seconds)
        self._rest, strain = rest, strain - strain * rest
        variance[-1] = self._path**2 + ((strain[:-1] - strain[-1]) ** 2).max(axis=0) + LEAST_STRAIN**2
        mean = self.belief @ strain if self.is_tested else np.expm1(0.5 * y)
        self._deviation = np.sqrt(self.belief @ (variance + (strain - mean) ** 2))

    def _rested(self, strain: FloatArray, seconds: float) -> tuple[FloatArray, FloatArray]:
        """Beliefs (k, n) that pillars rest, as all may together, and variances of their strains by each law."""
        law, broken = self._law, self._law.broken**2
        variance = self._of_broken * broken + self._of_unseen * self._unseen**2
        own = (variance[0] + variance[1] + SLOW**2) / law.slopes**2 + LEAST_STRAIN**2
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
        look, before = (y, self._law.broken), self._look
        (self._look, self._since_s), since_s = (look, 0.0), self._since_s
        if before is None:
            return
        change = y - before[0]
        squares, rising = float(change @ change), float((np.maximum(change, 0.0) ** 2).sum())
        self._noise = max(min(squares, CREEP * self._noise), len(y) * 1e-8)
        floor = 2.0 * self._noise
        moves = rising - floor > RISING * squares or squares > SUDDEN * self._squares + floor
        settles = not moves and squares + floor < SLOWER * self._fastest  # the look may have seen the end of a motion
        if moves or settles:
            self._past_ratio, self._ratio = max(self._past_ratio + self._ratio, -DECISIVE), 0.0
        if moves and self._held is not None:
            log = self._log_belief + self._told
            self._log_belief, self._told, self._held = np.maximum(log - log.max(), -FLOOR), np.zeros(len(log)), None
        elif settles:
            self._held, self._held_s, self._told = look, 0.0, np.zeros(len(self._told))
        elif self._held is not None:
            first = self._held_s == 0.0
            self._held_s += since_s
            told = self._evidence(y)
            worst = told if first else np.minimum(told, self._told)
            self._told = np.where(worst < -0.5, worst, told)
        self._believe()
        self._squares, self._fastest = squares, max(squares, self._fastest * (self._held is None))

    def _believe(self) -> None:
        log = self._log_belief + self._told + self._resting
        belief = np.exp(log - log.max())
        #: beliefs (k,) in the law in each direction that it may have, and, last, in no memory
        self.belief: FloatArray = belief / belief.sum()

    def _evidence(self, y: FloatArray) -> FloatArray:
        """Logarithms (k,) of how well each law foretold by how much ln R (n,) would fall in a hold; of none: 0.

        The fall is compared by one factor of all pillars, 1 if the law is right. The law that did best is also compared
        with no memory: there each pillar's ln R changes as its load does.
        """
        assert self._held is not None
        law, seconds, (held, broken) = self._law, self._held_s, self._held
        change = y - held
        healed = (law.a * broken * (1.0 - np.exp(-seconds / law.tau_s))).sum(axis=0)
        size = (healed**2).sum(axis=1) + 1e-12
        factor = -(healed @ change) / size
        slow = 2.0 * (1.0 - np.exp(-seconds / SLOW_S))
        noise, alike = 2.0 * FAST**2 + slow * SLOW**2, slow * (COMMON * healed.sum(axis=1) / size) ** 2
        series = self._known.unsure[0] / 2 + float(self._unseen[0].max())
        unsure = SPREAD**2 + series + noise / size + alike
        told = _word(unsure, 0.5 * (factor - 1.0) ** 2, 1.0)
        told[-1] = 0.0
        if not self.is_tested:
            self._ratio = _memory_ratio(change, held, healed[:-1], noise, COMMON * np.sqrt(slow))
            self.is_tested = self._past_ratio + self._ratio > DECISIVE
        return np.clip(told, -FLOOR, FLOOR)


def _memory_ratio(change: FloatArray, held: FloatArray, healed: FloatArray, noise: float, common: float) -> float:
    """Logarithm of how much likelier changes of ln R (n,) in a hold are with memory than without.

    With memory ln R falls as laws foretold, `healed` (k, n), times one of `AMOUNTS`: that a law is this rubber's in all
    numbers is for its belief. Either way loads change, all together and each pillar's alone, and change `held` (n,),
    what ln R was off rest, in proportion; readings err by `noise`, a variance, and all alike by `common`.
    """
    fall = np.concatenate([0.0 * change[None], *(times * healed for times in AMOUNTS)])
    variance = noise + (LOAD_CHANGES[:, None, None] * held) ** 2 + 1.5 * SPREAD**2 * fall**2
    alike = np.broadcast_to([LOAD_CREEP * held, common + 0.0 * held], (len(fall), 2, len(held)))
    likely = _likelihood(change + fall, variance, np.concatenate([alike, fall[:, None]], axis=1))
    likely = (likely - 0.5 * (LOAD_CHANGES[:, None] / LOAD_CREEP) ** 2).max(axis=0)
    return float(likely[1:].max() - np.log(len(fall) - 1) - likely[0])


def _likelihood(left: FloatArray, variance: FloatArray, along: FloatArray) -> FloatArray:
    """Logarithms (..., k) of normal densities of what is left (k, n), each pillar counting for `APART`.

    `variance` (..., k, n) is each pillar's own; besides, all go together by standard normal multiples of m patterns,
    `along` (k, m, n).
    """
    scaled = along / variance[..., None, :]
    wide = np.eye(along.shape[1]) + APART * scaled @ along.swapaxes(-1, -2)
    both = APART * (scaled @ left[..., None])
    squares = APART * (left**2 / variance + np.log(variance)).sum(axis=-1)
    squares -= (both.swapaxes(-1, -2) @ np.linalg.solve(wide, both))[..., 0, 0]
    return np.asarray(-0.5 * (squares + np.linalg.slogdet(wide)[1]))


def _word(variance: FloatArray, square: FloatArray, width: float = PRESSED) -> FloatArray:
    """Logarithms (...) by which values are likelier 0 than spread by `width`; half their squares, errors' variance."""
    wide = variance + width**2
    return np.asarray(0.5 * np.log(wide / variance) - square * (1.0 / variance - 1.0 / wide))


def _all_rest(word: FloatArray, quiet: Any) -> FloatArray:
    """The same (k, 1) of all pillars together."""
    said = np.where(quiet, word, -1.0).sum(axis=1, keepdims=True)
    return np.asarray(np.log(AT_REST / (1 - AT_REST)) + WEIGHT * said)
