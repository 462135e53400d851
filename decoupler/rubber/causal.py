"""Strain of a strip in a bench from the resistance of a rubber that remembers, from past and present readings alone.

A strip has filters of its ln R, and the rubber's law turned round (`inversion`). A small net, trained on histories that
the rubber may have (`causal_training`), judges how far each is to be believed, and what it would say itself. Pillars
of a sensor tell more together, and need no net: `belief`.
"""

from dataclasses import dataclass, replace

import numpy as np

from decoupler.rubber.inversion import LawInverse, along
from geometry.design import Memory
from geometry.layout import FloatArray

LAG_S = np.array([0.5, 1.5, 5.0, 15.0, 50.0, 150.0])  #: times of filters
PEAK_S = np.array([3.0, 15.0, 60.0, 240.0])  #: in which highest and lowest readings fade
AGE_S = np.array([10.0, 60.0, 240.0])  #: over which a start, or a gap, counts
GAP_S = 1.0  #: between readings, from which anything may have happened in between
FARTHEST = 6.0  #: deviations of an input of the net
LOG_SPREADS = (-6.0, 2.0)  #: of an answer over all strains
MAX_STEP_S = 3600.0  #: as long as for ever
MIN_STEP_S = 1e-5


@dataclass(frozen=True, kw_only=True, eq=False)
class CausalFilter:
    """What follows the strain of a rubber's strip, or of many; never changed, only used."""

    memory: Memory
    strains: tuple[float, float]  #: least and largest that it was trained for
    centre: FloatArray  #: (k,) of the net's inputs
    width: FloatArray  #: (k,): their deviations
    hidden: FloatArray  #: (nets, h, k + 1) weights, bias last; ReLU
    second: FloatArray  #: (nets, h, h + 1)
    output: FloatArray  #: (nets, 5, h + 1): beliefs in both answers, logarithms of their deviations, and a net's own
    skip: FloatArray  #: (nets, 1, k): a net's own answer by its inputs
    unit: float  #: deviation of the strains that it was trained on
    widening: float = 1.0  #: of its deviations, so that they hold what they say

    def start(self, pillars: int) -> "Follower":
        """A state that has seen nothing yet."""
        return Follower(self, pillars)

    def followed(self, time_s: FloatArray, log_ratio: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Strains and their standard deviations, both (time, n), of readings ln R/R₀ (time, n) in their order."""
        return along(self.start(log_ratio.shape[1]).step, time_s, log_ratio)

    def judged(self, inputs: FloatArray, by_law: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and deviation (n,) of strains by inputs (k, n) and what the law says, (1, n): all nets count alike."""
        x = (inputs - self.centre[:, None]) / self.width[:, None]
        x = np.clip(x, -FARTHEST, FARTHEST).astype(np.float32)
        h = np.maximum(self.hidden[..., :-1] @ x + self.hidden[..., -1:], 0)
        h = np.maximum(self.second[..., :-1] @ h + self.second[..., -1:], 0)
        out = (self.output[..., :-1] @ h + self.output[..., -1:]).astype(float)
        belief = np.exp(out[:, :2] - out[:, :2].max(axis=1, keepdims=True))
        belief /= len(belief) * belief.sum(axis=1, keepdims=True)
        deviation = self.unit * np.exp(np.clip(out[:, 2:4], *LOG_SPREADS))
        own = self.unit * (out[:, 4:] + self.skip @ x)
        answers = np.concatenate([np.broadcast_to(by_law, own.shape), own], axis=1)
        mean = (belief * answers).sum(axis=(0, 1))
        variance = (belief * (deviation**2 + (answers - mean) ** 2)).sum(axis=(0, 1))
        return mean, self.widening * np.sqrt(variance)


class Follower:
    """The state of a filter for n pillars: bounded; filters are exact for readings that change at a constant rate."""

    def __init__(self, causal: CausalFilter, pillars: int) -> None:
        self._filter, self._n, self._age_s = causal, pillars, -1.0
        self._law = LawInverse([replace(causal.memory, direction="lengthening")], pillars, causal.strains)
        self._lifted = np.zeros((1, pillars))

    def step(self, log_ratio: FloatArray, seconds: float) -> tuple[FloatArray, FloatArray]:
        """Strains (n,) and their standard deviations by readings ln R/R₀ (n,) so many seconds after the last ones."""
        return self._filter.judged(*self.seen(log_ratio, seconds))

    def seen(self, y: FloatArray, seconds: float) -> tuple[FloatArray, FloatArray]:
        """Inputs of the net (k, n), and strains by the law (1, n), after readings (n,)."""
        if self._age_s < 0:
            self._age_s, self._before = 0.0, y
            self._lagging = np.tile(y, (len(LAG_S), 1))
            self._moved = np.zeros((2 * len(LAG_S), self._n))
            self._high = self._low = np.tile(y, (len(PEAK_S), 1))
            seconds = MIN_STEP_S
        else:
            seconds = min(max(seconds, MIN_STEP_S), MAX_STEP_S)
            self._filtered(y, seconds)
        law = self._law
        by_law = law.step((y + self._lifted)[0], seconds)
        beyond = law.strain + law.missing / law.slopes
        if law.strains[0] >= 0.0:
            self._lifted = self._lifted - np.minimum(beyond, 0.0) * law.slopes * min(1.0, seconds)
        missing, way = np.clip(law.missing, -0.3, 0.3), law.way * np.exp(-law.still_s)
        evidence = [beyond, law.strain - beyond, *law.broken, missing, way]
        age = np.broadcast_to(np.exp(-self._age_s / AGE_S)[:, None], (len(AGE_S), self._n))
        kept = [y[None], y - self._lagging, self._moved, self._high - y, self._low - y, age]
        return np.concatenate([*kept, *evidence]), by_law

    def _filtered(self, y: FloatArray, seconds: float) -> None:
        self._age_s = 0.0 if seconds > GAP_S else self._age_s + seconds
        keep, ahead = np.exp(-seconds / LAG_S)[:, None], LAG_S[:, None] * ((y - self._before) / seconds)
        self._lagging = y - ahead + keep * (self._lagging - self._before + ahead)
        rate = (y - self._lagging[0]) / LAG_S[0]
        up = np.tile(np.maximum(rate, 0.0), (len(LAG_S), 1))
        both = np.concatenate([keep, keep])
        self._moved = both * self._moved + (1 - both) * np.concatenate([up, up - rate])
        fading = np.exp(-seconds / PEAK_S)[:, None]
        self._high = y + fading * np.maximum(self._high - y, 0.0)
        self._low = y + fading * np.minimum(self._low - y, 0.0)
        self._before = y
