"""Faults of pillars and wires, named from a window of scans by what usual loads let readings do.

Readings y are logarithms of resistances about their mean over the window, so that gains fall out. Under usual loads
their covariance S is that of training, and the readings of any group g of pillars are foretold by all others: with
K = S⁻¹ the residual r = K_gg⁻¹ (K y)_g has the covariance V = K_gg⁻¹, of which the readings' noise makes N. Loads of
another size a have a²(V − N) + N; a is that of the other pillars of the same units, of the units around or of the whole
array, whichever makes no fault likeliest. Faults then are:

- stuck: readings stay within their noise in scans in which the prediction moves;
- swapped: readings are likelier after two wires are swapped back;
- open or shorted: a resistance is beyond what any load makes of it.

Loads that follow one another slowly count as often as they are new, by the ratio of von Neumann: the squares of
differences from scan to scan over twice those from the mean. What no window tells: an error that a force on the same
pad makes as well, such as a wrong gain of one pillar.
"""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dataset.measurement import ReadingError
from decoupler.model.decoder import BEYOND as LONGER
from decoupler.model.decoder import Decoder
from geometry.layout import FloatArray, Layout
from geometry.wiring import crossings, pillar_of_crossing

WINDOW = 40  #: scans that are looked at together
FEWEST = 8  #: scans, below which nothing is named
FALSE_ALARMS = 1e-5  #: of a hypothesis: a likelihood ratio passes 1/α with a probability of α at most (Markov)
ONE_SCAN = 5.0  #: largest log-likelihood ratio of one scan that counts: loads have longer tails than normal ones
MAX_NAMED = 3  #: faults of one window
BEYOND = LONGER**2  #: ratio to the mean resistance in training, either way, at which no load arrives
SIZES = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)  #: of loads over the usual ones, that are tried for a whole scan
USUAL = 4.0  #: largest mean square of readings of usual loads, over the mean, after wires are swapped back
CLEAR = 5.0  #: deviations by noise, by which a prediction must move before a pillar that does not is stuck
MAX_WINDOWS = 50  #: of a recording, spread over it, that are looked at
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Fault:
    """Kind and place of what is wrong."""

    kind: str  #: open, shorted, stuck or swapped
    place: str  #: a pillar, a wire or two, in words
    pillars: tuple[tuple[int, int, str], ...]  #: row, col and name of each pillar that reads wrong

    def __str__(self) -> str:
        return f"{self.place} {self.kind}"


class _Hypothesis(NamedTuple):
    """A fault and how much likelier than none it makes the readings."""

    kind: str
    place: str
    which: Indices  #: (k,): its pillars among P
    ratio: float  #: log-likelihood ratio to none, no scan above `ONE_SCAN`
    order: Indices | None = None  #: (P,): of the pillars that swaps wires back


@dataclass(frozen=True, eq=False, kw_only=True)
class FaultTest:
    """Readings of the P readable pillars of a decoupler under usual loads; made once, asked of every window."""

    rows: int
    cols: int
    layout: Layout
    pillars: Indices  #: (P,): places in a flattened (rows, cols, n_pillars) array
    mean: FloatArray  #: (P,): of ln R under usual loads
    covariance: FloatArray  #: S, (P, P): of ln R under usual loads, noise included
    noise: FloatArray  #: (P,): relative standard deviation of a reading
    window: ClassVar[int] = WINDOW  #: scans that are looked at together

    @classmethod
    def of(cls, decoder: Decoder) -> "FaultTest | None":
        """The test of a decoder; None if it does not know how readings move under loads, or takes them for exact."""
        usual, stated, rest_ohm = decoder.usual_readings, decoder.errors, decoder.rest_resistances()
        if usual is None or stated is None or rest_ohm is None:
            return None
        errors = ReadingError(noise=stated.noise, bits=stated.bits)
        if errors.is_exact:
            return None
        pillars = np.flatnonzero(decoder.read)
        noise = (errors.deviation(rest_ohm) / rest_ohm).reshape(-1)[pillars]
        return cls(
            rows=decoder.rows,
            cols=decoder.cols,
            layout=decoder.layout,
            pillars=pillars,
            mean=usual[0][pillars],
            covariance=usual[1][np.ix_(pillars, pillars)] + np.diag(noise**2),
            noise=noise,
        )

    def named(self, resistance_ohm: FloatArray) -> tuple[Fault, ...]:
        """Faults of n scans (n, rows, cols, n_pillars) [Ω] that follow one another, `window` usually, the surest first.

        Below `FEWEST` only open and shorted pillars are named. Readings may be anything, infinite or no number.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            y = np.log(resistance_ohm.reshape(len(resistance_ohm), -1)[:, self.pillars]) - self.mean
        y = np.clip(np.nan_to_num(y, nan=np.inf), -math.log(BEYOND), math.log(BEYOND))
        found: list[Fault] = []
        broken = np.zeros(len(self.pillars), dtype=bool)
        for kind, beyond in (("open", y >= math.log(BEYOND)), ("shorted", y <= -math.log(BEYOND))):
            is_so = beyond.mean(axis=0) > 0.5
            found += self._broken(kind, is_so)
            broken |= is_so
        test = self._without(np.flatnonzero(broken))
        y = y[:, ~broken]
        while len(y) >= FEWEST and len(found) < MAX_NAMED and (one := test._likeliest(y)) is not None:
            found.append(test._fault(one.kind, one.place, one.which))
            if one.order is None:
                test, y = test._without(one.which), np.delete(y, one.which, axis=1)
            else:
                y = y[:, one.order]
        return tuple(found)

    def named_in(self, resistance_ohm: FloatArray) -> dict[str, int]:
        """Faults of a recording's scans (n, rows, cols, n_pillars) [Ω], in words, and how many windows name each."""
        n_windows = max(len(resistance_ohm) // self.window, 1)
        some = np.unique(np.linspace(0, n_windows - 1, min(n_windows, MAX_WINDOWS)).astype(int))
        windows = [resistance_ohm[k * self.window : (k + 1) * self.window] for k in some.tolist()]
        return dict(Counter(str(fault) for window in windows for fault in self.named(window)))

    def _without(self, gone: Indices) -> "FaultTest":
        """The test of the other pillars."""
        if not len(gone):
            return self
        kept = np.delete(np.arange(len(self.pillars)), gone)
        own = {name: getattr(self, name)[kept] for name in ("pillars", "mean", "noise")}
        return replace(self, covariance=self.covariance[np.ix_(kept, kept)], **own)

    def _broken(self, kind: str, is_so: NDArray[np.bool_]) -> list[Fault]:
        """Faults of pillars that are open or shorted, (P,): wires if all of theirs are, and what is left."""
        wires = [(place, which) for place, which in self.wires if is_so[which].all()]
        left = np.setdiff1d(np.flatnonzero(is_so), np.concatenate([[], *(which for _, which in wires)]))
        pillars = [(self._name(p), np.array([p])) for p in left.tolist()]
        return [self._fault(kind, place, which) for place, which in wires + pillars]

    def _fault(self, kind: str, place: str, which: Indices) -> Fault:
        names = self.layout.pillar_names
        rows, cols, numbers = np.unravel_index(self.pillars[which], (self.rows, self.cols, len(names)))
        return Fault(kind, place, tuple(zip(rows.tolist(), cols.tolist(), (names[k] for k in numbers), strict=True)))

    def _name(self, pillar: int) -> str:
        ((row, col, name),) = self._fault("", "", np.array([pillar])).pillars
        return f"pillar {name} of row {row}, col {col}"

    @cached_property
    def _boards(self) -> tuple[tuple[str, int, Indices], ...]:
        """Of rows and of columns: name, number and the pillars of each wire, (wires, wires across), -1 for none."""
        at = np.full(self.rows * self.cols * len(self.layout.pillars), -1)
        at[self.pillars] = np.arange(len(self.pillars))
        wires = crossings(self.rows, self.cols, self.layout)
        board = np.full(wires.max(axis=0) + 1, -1)
        board[tuple(wires.T)] = at[pillar_of_crossing(self.rows, self.cols, self.layout)]
        return ("row", self.rows, board), ("column", self.cols, board.T)

    @cached_property
    def wires(self) -> list[tuple[str, Indices]]:
        """Name and pillars, as numbers among P, of each wire that has two pillars at least."""
        every = [(f"{name} wire {k}", own[own >= 0]) for name, _, board in self._boards for k, own in enumerate(board)]
        return [(place, which) for place, which in every if len(which) > 1]

    @cached_property
    def swaps(self) -> list[tuple[str, Indices]]:
        """Name of every swap of two wires, or of all wires of two rows or columns, and the order of pillars then."""
        found = []
        for name, n, board in self._boards:
            of_each = np.arange(len(board)).reshape(n, -1)
            for i, j in combinations(range(n), 2):
                pairs = zip(of_each[i], of_each[j], strict=True)
                single = [(f"{name} wires {a} and {b}", [a], [b]) for a, b in pairs]
                for place, one, other in [(f"{name}s {i} and {j}", of_each[i], of_each[j]), *single]:
                    turned = board.copy()
                    turned[one], turned[other] = board[other], board[one]
                    order = np.arange(len(self.pillars))
                    order[board[board >= 0]] = turned[board >= 0]
                    if order.min() >= 0 and (order != np.arange(len(order))).any():
                        found.append((place, order))
        return found

    @cached_property
    def precision(self) -> FloatArray:
        """K = S⁻¹, (P, P)."""
        return np.asarray(np.linalg.inv(self.covariance), dtype=np.float64)

    @cached_property
    def _groups(self) -> "list[_Groups]":
        """Each pillar and each wire beside which others are left, those of as many pillars together."""
        each = [(self._name(p), np.array([p])) for p in range(len(self.pillars))]
        by_size: dict[int, list[tuple[str, Indices]]] = {}
        for place, which in (*each, *self.wires):
            if len(which) < len(self.pillars):
                by_size.setdefault(len(which), []).append((place, which))
        return [_Groups(self, groups) for groups in by_size.values()]

    def _likeliest(self, y: FloatArray) -> _Hypothesis | None:
        """The fault that explains readings (n, P) best, of those that are decidedly likelier than none."""
        y = y - y.mean(axis=0)
        passing = sorted(self._hypotheses(y), key=lambda one: one.ratio)
        passing = [one for one in passing if one.ratio > -math.log(FALSE_ALARMS)]
        # of swaps, whose caps leave ties, all are compared
        best = {len(one.which) > 1 if one.order is None else one.place: one for one in passing}
        return max(best.values(), key=lambda one: self._gain(one, y), default=None)

    def _gain(self, fault: _Hypothesis, y: FloatArray) -> float:
        """Log-likelihood ratio of a fault to none by all readings (n, P) about their means, none of them capped."""
        if fault.order is not None:
            return self._log_density(y[:, fault.order]) - self._log_density(y)
        still = self.covariance.copy()
        still[fault.which] = still[:, fault.which] = 0.0
        still[fault.which, fault.which] = self.noise[fault.which] ** 2
        return replace(self, covariance=still)._log_density(y) - self._log_density(y)

    def _log_density(self, y: FloatArray) -> float:
        """Log-density of readings (n, P) but for a constant, each scan by the likeliest size of its loads."""
        spread, U = self._independent
        squares = (y / self.noise @ U) ** 2
        each = [1.0 + size**2 * np.maximum(spread, 0.0) for size in SIZES]
        by_size = [-0.5 * (squares @ (1.0 / one) + np.log(one).sum()) for one in each]
        return float(np.max(by_size, axis=0).sum()) - len(y) * float(np.log(self.noise).sum())

    @cached_property
    def _independent(self) -> tuple[FloatArray, FloatArray]:
        """Variances (P,) and directions (P, P) of independent loads, over those of noise."""
        return np.linalg.eigh(self.covariance / np.outer(self.noise, self.noise) - np.eye(len(self.noise)))

    def _hypotheses(self, y: FloatArray) -> Iterator[_Hypothesis]:
        """All faults, by readings (n, P) about their means."""
        u = y @ self.precision
        squares, steps = (y**2).sum(axis=0), (np.diff(y, axis=0) ** 2).sum(axis=0)
        for groups in self._groups:
            ratios = groups.stuck(y, u, _news(squares, steps, groups.near[..., 0]))
            for place, which, ratio in zip(groups.places, groups.which, ratios, strict=True):
                yield _Hypothesis("stuck", place, which, float(ratio))
        energy, P = (u * y).sum(axis=1), y.shape[1]
        news = float(_news(squares, steps, self.noise**-2.0))
        for place, order in self.swaps:
            back = y[:, order]
            other = ((back @ self.precision) * back).sum(axis=1)
            ratio, tells = 0.5 * (energy - other), (energy > P) & (other < USUAL * P)
            capped = news * float(_total(_where_told(tells, ratio)[:, None]))
            yield _Hypothesis("swapped", place, np.flatnonzero(order != np.arange(P)), capped, order)


def _news(squares: FloatArray, steps: FloatArray, weights: FloatArray) -> FloatArray:
    """Ratio of von Neumann, 1 if each scan has a load of its own, near 0 if all have one; weights (..., P) of pillars.

    `squares` and `steps` (P,) are sums of squares of readings about their means and of differences from scan to scan.
    """
    total = 2.0 * weights @ squares
    return np.minimum(np.divide(weights @ steps, total, out=np.zeros_like(total), where=total > 0), 1.0)


class _Groups:
    """g groups of k pillars that may fail together, and what the others say of them."""

    def __init__(self, test: FaultTest, groups: list[tuple[str, Indices]]) -> None:
        K = test.precision
        self.places = [place for place, _ in groups]
        self.which = here = np.stack([which for _, which in groups])  # (g, k)
        self.noise = test.noise[here]
        self.across = K[here]  # K_gq, (g, k, P)
        self.solved = V = np.asarray(np.linalg.inv(K[here[:, :, None], here[:, None]]))  # K_gg⁻¹, (g, k, k)
        mine = V @ K[here]
        self.by_noise = np.einsum("gkk->gk", (mine * test.noise**2) @ mine.swapaxes(1, 2))
        self.by_loads = np.einsum("gkk->gk", V) - self.by_noise
        # (K y)_q without the group: its variance, and what part of that is noise, (g, P)
        without = K - K[here].swapaxes(1, 2) @ mine
        self.scale = np.maximum(np.einsum("gpp->gp", without), 1e-12 * K.diagonal())
        self.noise_share = np.minimum(((without * test.noise) ** 2).sum(axis=2) / self.scale, 0.99)
        # (g, P, 3): 1 for others of the same units, of those around, for all; the next, where there is none
        rows, cols = np.divmod(test.pillars // len(test.layout.pillars), test.cols)
        far = np.maximum(np.abs(rows - rows[here][..., None]), np.abs(cols - cols[here][..., None])).min(axis=1)
        other = ~(here[..., None] == np.arange(len(K))).any(axis=1)
        near = np.stack([other & (far <= most) for most in (0, 1, len(K))], axis=-1)
        for k in (1, 0):
            near[..., k] |= near[..., k + 1] & ~near[..., k].any(axis=1, keepdims=True)
        self.near = near.astype(np.float64)

    def stuck(self, y: FloatArray, u: FloatArray, news: FloatArray) -> FloatArray:
        """Log-likelihood ratios of readings (n, P) that do not move to such that do as usual, (g,)."""
        r = u[:, self.which].swapaxes(0, 1) @ self.solved  # (g, n, k)
        squares = (u - r @ self.across) ** 2 / self.scale[:, None] - self.noise_share[:, None]
        free = (1.0 - self.noise_share)[:, None] @ self.near
        sizes = np.maximum(squares @ self.near / free, 0.0)[:, :, None]  # a² by each of `near`, (g, n, 1, 3)
        own, by_noise = y[:, self.which].swapaxes(0, 1), self.by_noise[:, None]
        usual = sizes * self.by_loads[:, None, :, None] + by_noise[..., None]
        ratio = _log_normal(own, self.noise[:, None] ** 2) - _log_normal(r[..., None], usual).max(axis=-1)
        moved = (own - r) ** 2 > CLEAR**2 * by_noise
        return news * _total(_where_told(moved, ratio))


def _log_normal(values: FloatArray, variance: FloatArray) -> FloatArray:
    """Log-density of normal values but for a constant, each by itself."""
    return -0.5 * (values**2 / variance + np.log(variance))


def _where_told(tells: NDArray[np.bool_], ratio: FloatArray) -> FloatArray:
    """Log-likelihood ratios, of which only those of some scans may speak for a fault; all may speak against it."""
    return np.where(tells, ratio, np.minimum(ratio, 0.0))


def _total(ratio: FloatArray) -> FloatArray:
    """Log-likelihood ratios (..., n, k) of n scans: what half of the k pillars or parts say, as if it were one."""
    each = np.sort(np.minimum(ratio, ONE_SCAN).sum(axis=-2), axis=-1)
    return np.asarray(each[..., (each.shape[-1] - 1) // 2])
