"""Refinement to a tolerance: answers on ever finer levels, the rate at which they converge, and what is left of error.

With errors that fall as level^(−p), three answers a₁, a₂, a₃ show p by the ratio of their changes, and the error of the
last is |a₃ − a₂| / ((l₃/l₂)^p − 1). The rate is taken between bounds, since coarse levels show any; with two answers it
is the lower one. The estimate is that error times `SAFETY`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import brentq

from fem.scene.solution import relative_errors
from geometry.layout import FloatArray

Answer = Mapping[str, FloatArray]  #: displacements of probes, or whatever else is compared by name
Change = Callable[[Answer, Answer, Answer], float]  #: of one answer to another, relative to a third

SAFETY = 1.5  #: factor on the error that the observed rate says


def largest_change(one: Answer, other: Answer, reference: Answer) -> float:
    """Largest change of a probe from one answer to another, relative to a reference as `relative_errors` says."""
    difference = {name: other[name] - one[name] for name in reference}
    return max(relative_errors(difference, reference).values(), default=0.0)


def richardson_factor(coarse: float, fine: float, rate: float) -> float:
    """Error of the finer of two levels over the change between them, for errors ~ level^(−rate).

    Examples
    --------
    >>> round(richardson_factor(2, 4, rate=2) * (1 / 2**2 - 1 / 4**2) * 4**2, 6)
    1.0
    """
    return float(1 / ((fine / coarse) ** rate - 1))


def observed_rate(
    levels: tuple[float, float, float], changes: tuple[float, float], bounds: tuple[float, float]
) -> float:
    """The rate p at which errors ~ level^(−p) change so between three levels, between bounds.

    >>> round(observed_rate((1, 2, 4), (1.0, 0.25), (1.0, 4.0)), 6)
    2.0
    """
    first, second, third = levels
    low, high = bounds

    def misfit(p: float) -> float:
        return changes[1] * (first**-p - second**-p) - changes[0] * (second**-p - third**-p)

    if misfit(low) >= 0 or not changes[0] > 0:
        return low
    return high if misfit(high) <= 0 else float(brentq(misfit, low, high))


@dataclass(eq=False)
class Convergence:
    """Answers on levels so far, the best one, and its estimated error."""

    rates: tuple[float, float]  #: least and greatest rate of convergence that is believed
    is_extrapolated: bool = False  #: whether the best answer is the limit that the last two levels tend to
    change: Change = largest_change
    levels: list[float] = field(default_factory=list)
    answers: list[Answer] = field(default_factory=list)

    def add(self, level: float, answer: Answer) -> None:
        """Take the answer on the next level."""
        self.levels.append(level)
        self.answers.append(answer)

    @property
    def rate(self) -> float:
        """Rate of convergence: observed, or the least that is believed."""
        if len(self.levels) < 3:
            return self.rates[0]
        one, two, three = self.answers[-3:]
        changes = self.change(one, two, three), self.change(two, three, three)
        a, b, c = self.levels[-3:]
        return observed_rate((a, b, c), changes, self.rates)

    @property
    def factor(self) -> float:
        """Error of the last answer over its change, infinite with one answer."""
        if len(self.levels) < 2:
            return np.inf
        coarse, fine = self.levels[-2:]
        return richardson_factor(coarse, fine, self.rate)

    @property
    def answer(self) -> Answer:
        """The last answer, or the limit."""
        last = self.answers[-1]
        if not self.is_extrapolated or len(self.answers) < 2:
            return last
        return {name: u + self.factor * (u - self.answers[-2][name]) for name, u in last.items()}

    @property
    def estimate(self) -> float:
        """Relative error of the last answer, as estimated; infinite with one answer.

        An extrapolated answer is given the error of the one that it comes from.
        """
        if len(self.answers) < 2:
            return np.inf
        return SAFETY * self.factor * self.change(self.answers[-2], self.answers[-1], self.answers[-1])
