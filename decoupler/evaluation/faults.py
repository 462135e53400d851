"""Faults of pillars and wires, named from a window of scans by what usual loads let readings do.

Readings y are logarithms of resistances about their mean over the window, so that gains fall out. Under usual loads
their covariance S is that of training, and a group of pillars is off by r from what all others foretell (`Foretold`)
with the covariance V, of which the readings' noise makes N. Loads of another size a have a²(V − N) + N; a² is what χ²
of the others has beyond noise, over what usual loads give it. Faults then are:

- stuck: readings stay within their noise in scans in which the prediction moves;
- swapped: readings are likelier after two wires are swapped back;
- open or shorted: a resistance is beyond what any load makes of it.

Once one of them is decidedly likelier than none, the likeliest of all is named. Loads that follow one another slowly
count as often as they are new, by the ratio of von Neumann: the squares of differences from scan to scan over twice
those from the mean. What no window tells: an error that a force on the same pad makes as well, such as a wrong gain of
one pillar.
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

from decoupler.model.decoder import BEYOND as LONGER
from decoupler.model.decoder import Decoder
from decoupler.model.foretold import Foretold
from geometry.layout import FloatArray
from geometry.wiring import pillar_at

WINDOW = 40  #: scans that are looked at together
FEWEST = 8  #: scans, below which nothing is named
FALSE_ALARMS = 1e-5  #: of a hypothesis: a likelihood ratio passes 1/α with a probability of α at most (Markov)
ONE_SCAN = 5.0  #: largest log-likelihood ratio of one scan that counts: loads have longer tails than normal ones
MAX_NAMED = 3  #: faults of one window
BEYOND = LONGER**2  #: ratio to the mean resistance in training, either way, at which no load arrives
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
    ratio: float  #: log-likelihood ratio to none of half of the pillars, no scan above `ONE_SCAN`
    whole: float  #: the same of all, none capped
    order: Indices | None = None  #: (P,): of the pillars that swaps wires back


@dataclass(frozen=True, eq=False, kw_only=True)
class FaultTest:
    """Readings of the P readable pillars of a decoder under usual loads; made once, asked of every window."""

    decoder: Decoder
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
        errors = stated.without_drifts()
        if errors.is_exact:
            return None
        pillars = np.flatnonzero(decoder.read)
        noise = (errors.deviation(rest_ohm) / rest_ohm).reshape(-1)[pillars]
        covariance = usual[1][np.ix_(pillars, pillars)] + np.diag(noise**2)
        return cls(decoder=decoder, pillars=pillars, mean=usual[0][pillars], covariance=covariance, noise=noise)

    def named(self, resistance_ohm: FloatArray) -> tuple[Fault, ...]:
        """Faults of n scans (n, rows, cols, n_pillars) [Ω] that follow one another, `window` usually, the surest first.

        Below `FEWEST` only open and shorted pillars are named. Readings may be anything, infinite or no number.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            y = np.log(resistance_ohm.reshape(len(resistance_ohm), -1)[:, self.pillars]) - self.mean
        y = np.clip(np.nan_to_num(y, nan=np.inf), -math.log(BEYOND), math.log(BEYOND))
        found: list[Fault] = []
        broken = np.zeros(len(self.pillars), dtype=bool)
        for kind, sign in (("open", 1.0), ("shorted", -1.0)):
            is_so = (sign * y >= math.log(BEYOND)).mean(axis=0) > 0.5
            found += self._broken(kind, is_so)
            broken |= is_so
        test, y = self._without(np.flatnonzero(broken)), y[:, ~broken]
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
        in_wires = {k for _, which in wires for k in which.tolist()}
        alone = [each for k, each in enumerate(self._alone) if is_so[k] and k not in in_wires]
        return [self._fault(kind, place, which) for place, which in wires + alone]

    def _fault(self, kind: str, place: str, which: Indices) -> Fault:
        return Fault(kind, place, tuple(self._places[k] for k in which.tolist()))

    @cached_property
    def _places(self) -> list[tuple[int, int, str]]:
        """Row, col and name of each of the P."""
        names = self.decoder.layout.pillar_names
        at = (np.unravel_index(p, self.decoder.read.shape) for p in self.pillars)
        return [(int(row), int(col), names[k]) for row, col, k in at]

    @cached_property
    def _alone(self) -> list[tuple[str, Indices]]:
        """Each pillar, in words and as a number among P."""
        every = enumerate(self._places)
        return [(f"pillar {name} of row {row}, col {col}", np.array([k])) for k, (row, col, name) in every]

    @cached_property
    def _boards(self) -> tuple[tuple[str, int, Indices], ...]:
        """Of rows and of columns: name, number and the pillars of each wire, (wires, wires across), -1 for none."""
        rows, cols, layout = self.decoder.rows, self.decoder.cols, self.decoder.layout
        at = np.full(rows * cols * len(layout.pillars) + 1, -1)
        at[self.pillars] = np.arange(len(self.pillars))
        board = at[pillar_at(rows, cols, layout)]
        return ("row", rows, board), ("column", cols, board.T)

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
    def _groups(self) -> list[tuple[list[str], Foretold]]:
        """Each pillar and each wire beside which others are left, those of as many pillars together."""
        by_size: dict[int, list[tuple[str, Indices]]] = {}
        for place, which in self._alone + self.wires:
            if len(which) < len(self.pillars):
                by_size.setdefault(len(which), []).append((place, which))
        found = [tuple(zip(*groups, strict=True)) for groups in by_size.values()]
        return [(list(places), Foretold.by(self.precision, np.stack(which))) for places, which in found]

    def _likeliest(self, y: FloatArray) -> _Hypothesis | None:
        """The fault that explains readings (n, P) best, if one at least is decidedly likelier than none."""
        likelier = [one for one in self._hypotheses(y - y.mean(axis=0)) if one.ratio > 0.0]
        is_decided = any(one.ratio > -math.log(FALSE_ALARMS) for one in likelier)
        return max(likelier, key=lambda one: one.whole) if is_decided else None

    def _hypotheses(self, y: FloatArray) -> Iterator[_Hypothesis]:
        """All faults, by readings (n, P) about their means."""
        K, P, noise2 = self.precision, y.shape[1], self.noise**2
        steps, squares = (float((each**2 / noise2).sum()) for each in (np.diff(y, axis=0), y))
        news = min(0.5 * steps / squares, 1.0) if squares else 0.0
        chi2 = ((y @ K) * y).sum(axis=1)
        for places, known in self._groups:
            W, V, k = known.weights.swapaxes(1, 2), known.covariance, known.which.shape[1]
            N = (W * noise2) @ W.swapaxes(1, 2) + noise2[known.which][:, None] * np.eye(k)
            own = y[:, known.which].swapaxes(0, 1)  # (groups, n, k)
            r = own - y @ known.weights
            V_inverse = np.linalg.inv(V)
            others = chi2 - ((r @ V_inverse) * r).sum(axis=2)
            by_noise = (K.diagonal() @ noise2 - (V_inverse * N).sum(axis=(1, 2)))[:, None]
            size2 = np.maximum((others - by_noise) / (P - k - by_noise), 0.0)[..., None]
            V, N = (np.einsum("gkk->gk", each)[:, None] for each in (V, N))
            ratio = _log_normal(own, noise2[known.which][:, None]) - _log_normal(r, size2 * (V - N) + N)
            weighed = _weighed((own - r) ** 2 > CLEAR**2 * N, ratio)
            for place, which, half, whole in zip(places, known.which, *weighed, strict=True):
                yield _Hypothesis("stuck", place, which, news * float(half), news * float(whole))
        for place, order in self.swaps:
            back = y[:, order]
            other = ((back @ K) * back).sum(axis=1)
            tells, which = (chi2 > P) & (other < USUAL * P), np.flatnonzero(order != np.arange(P))
            half, whole = _weighed(tells[:, None], 0.5 * (chi2 - other)[:, None])
            yield _Hypothesis("swapped", place, which, news * float(half), news * float(whole), order)


def _log_normal(values: FloatArray, variance: FloatArray) -> FloatArray:
    """Log-density of normal values but for a constant, each by itself."""
    return -0.5 * (values**2 / variance + np.log(variance))


def _weighed(tells: NDArray[np.bool_], ratio: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Log-likelihood ratios (..., n, k) of n scans, of k pillars: what half of the k say, as if it were one, and all.

    For a fault only some scans may speak in the first, each up to `ONE_SCAN`; all may speak against it.
    """
    each = np.sort(np.minimum(ratio, np.where(tells, ONE_SCAN, 0.0)).sum(axis=-2), axis=-1)
    return each[..., (each.shape[-1] - 1) // 2], ratio.sum(axis=(-2, -1))
