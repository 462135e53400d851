"""Refinement to a tolerance: answers on ever finer levels, the rate at which they converge, and what is left of error.

With errors that fall as level^(−p), three answers a₁, a₂, a₃ show p by the ratio of their changes, and the error of the
last is |a₃ − a₂| / ((l₃/l₂)^p − 1). The rate is taken between bounds, since coarse levels show any; with two answers it
is the lower one. The estimate is that error times `SAFETY`.

Where elements are split one by one, the error of a probe is a(u − u_h, z − z_h), z the answer to a unit load on the
probe (Becker & Rannacher, Acta Numerica 10, 2001). Indicators bound it element by element up to a ratio. On boxes the
answers of two orders on the same mesh show it (`estimated_errors`); on tetrahedra it hardly changes from mesh to mesh,
and answers on several show both it and what they tend to (`limits`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fem.scene.solution import SMALLEST_SHARE, relative_errors
from geometry.layout import FloatArray

Answer = Mapping[str, FloatArray]  #: displacements of probes, or whatever else is compared by name

SAFETY = 1.5  #: factor on the error that the observed rate says
BISECTIONS = 50  #: of the interval of rates
#: error over η that is stated of an answer with no other to compare it with (2.2 on a plate of 0.36 mm)
ALONE = 2.5
#: and over the geometric mean of η and the change with the order, the less on boxes that were split where probes err.
#: It was at most 1.93 on first meshes (beside a rubber 1000 times as soft) and on hexahedra whose lines lean apart
#: (in one 1000 times as stiff), on others 1.37, 0.45 in the median
COMPARED = 2.2, 1.5
MIN_CHANGE = 0.2  #: of η: a smaller change with the order may be chance
#: of the ratio of error and η on tetrahedra: how far it is off by chance, and changes from mesh to mesh, relative; and
#: as how many meshes that counts
CHANCE, DRIFT, COUNTED = 0.1, 0.2, 2.0
STILL = 1e-12  #: relative change of a value that rounding may make


def richardson_factor(coarse: float, fine: float, rate: float) -> float:
    """Error of the finer of two levels over the change between them, for errors ~ level^(−rate).

    >>> round(richardson_factor(2, 4, rate=2) * (1 / 2**2 - 1 / 4**2) * 4**2, 6)
    1.0
    """
    return float(1 / ((fine / coarse) ** rate - 1))


@dataclass(eq=False)
class Convergence:
    """Answers on levels so far, the best one, and its estimated error."""

    rates: tuple[float, float]  #: least and greatest rate of convergence that is believed
    is_extrapolated: bool = False  #: whether the best answer is the limit that the last two levels tend to
    levels: list[float] = field(default_factory=list)
    answers: list[Answer] = field(default_factory=list)

    def add(self, level: float, answer: Answer) -> None:
        """Take the answer on the next level."""
        self.levels.append(level)
        self.answers.append(answer)

    def change(self, one: Answer, other: Answer) -> float:
        """Largest change of a probe from one answer to another, relative to the last answer."""
        difference = {name: other[name] - u for name, u in one.items()}
        return max(relative_errors(difference, self.answers[-1]).values(), default=0.0)

    @property
    def rate(self) -> float:
        """Rate of convergence p at which errors ~ level^(−p) change so: observed, or the least that is believed."""
        low, high = self.rates
        if len(self.levels) < 3:
            return low
        (a, b, c), (one, two, three) = self.levels[-3:], self.answers[-3:]
        first, second = self.change(one, two), self.change(two, three)

        def misfit(p: float) -> float:
            return second * (a**-p - b**-p) - first * (b**-p - c**-p)

        if misfit(low) >= 0 or not first > 0:
            return low
        if misfit(high) <= 0:
            return high
        for _ in range(BISECTIONS):
            low, high = ((low + high) / 2, high) if misfit((low + high) / 2) < 0 else (low, (low + high) / 2)
        return (low + high) / 2

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
        return SAFETY * self.factor * self.change(self.answers[-2], self.answers[-1])


def sizes(probes: FloatArray) -> FloatArray:
    """Displacement that the error of each probe (n, 3) is relative to, (n,) [mm]."""
    size = np.linalg.norm(probes, axis=1)
    scale = np.maximum(size, SMALLEST_SHARE * size.max())
    return np.where(scale > 0, scale, 1.0)


def unit_loads(probes: FloatArray, most: int, sums: int) -> FloatArray:
    """Weights (k, n_probes, 3) of the probes' components in unit loads: one over the size that errors are relative to.

    Of up to `most` probes each component has its own load, in order; of more, `sums` of all with random signs, which
    together mark the same elements.
    """
    n, scale = len(probes), sizes(probes)[:, None]
    if n <= most:
        return np.eye(3 * n).reshape(3 * n, n, 3) / scale
    return np.random.default_rng(0).choice([-1.0, 1.0], (sums, n, 3)) / scale


def estimated_errors(
    probes: FloatArray, eta: FloatArray, coarser: FloatArray | None, is_suited: bool = False
) -> FloatArray:
    """Relative error of each of `probes` (n_probes, 3) [mm], (n_probes,), from its η, (n_probes,).

    η is a sum of absolute values, and too large; what `coarser`, answers by the order before on the same mesh, differ
    by may be small by chance. Their geometric mean is nearer to the error than either. `is_suited` says that the mesh
    is of boxes and was split where the probes err; on others a higher order may do little for singular stress.
    """
    if coarser is None:
        return ALONE * eta
    change = np.linalg.norm(probes - coarser, axis=1) / sizes(probes)
    return COMPARED[is_suited] * np.sqrt(eta * np.maximum(change, MIN_CHANGE * eta))


def limits(values: FloatArray, eta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What values (k, n, 3) on k ≥ 3 meshes tend to where their η (k, n, 3) vanish, (n, 3), and its deviation (n,).

    Errors are −b η, where b varies by `CHANCE` of itself, and by as much again as `DRIFT` from mesh to mesh. So values
    over η are a line over 1/η, whose slope is the limit, found by generalised least squares. Few meshes show little of
    the chance, so that what is said here counts as `COUNTED` further ones. Values that do not change are the limits.
    """
    k, last = len(values), values[-1]
    each = np.arange(k)
    P = np.linalg.inv(CHANCE**2 * np.eye(k) + DRIFT**2 * np.minimum.outer(each, each))
    still = (np.ptp(values, axis=0) <= STILL * np.linalg.norm(last, axis=1, keepdims=True)) | (eta[0] == 0)
    x = 1 / np.where(still, 2.0 ** -each[:, None, None], eta)
    y = values * x
    middle, mean = (np.tensordot(P.sum(axis=0), each, 1) / P.sum() for each in (x, y))
    x, y = x - middle, y - mean
    spread, common = (np.einsum("kni,kl,lni->ni", x, P, each) for each in (x, y))
    limit = common / spread
    squares = np.einsum("kni,kl,lni->ni", y - limit * x, P, y - limit * x) + COUNTED * (limit * middle - mean) ** 2
    variance = np.where(still, 0.0, squares / (k - 2 + COUNTED) / spread)
    return np.where(still, last, limit), np.sqrt(variance.sum(axis=1))


def largest_contributors(indicators: FloatArray, share: float) -> NDArray[np.int64]:
    """The fewest elements that hold a share of the sum of all indicators (n,) (Dörfler's rule)."""
    order = np.argsort(-indicators)
    running = np.cumsum(indicators[order])
    return order[: int(np.searchsorted(running, share * running[-1])) + 1]
