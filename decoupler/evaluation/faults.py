"""Faults of pillars and wires, named from a window of scans by what usual loads let readings do.

Readings y are logarithms of resistances about their mean over the window, so that gains fall out. Under usual loads
their covariance S is that of training, and the readings of any group g of pillars are foretold by all others: with
K = S⁻¹ the residual r = K_gg⁻¹ (K y)_g has the covariance V = K_gg⁻¹, of which the readings' noise makes N. Loads of
another size a have a²(V − N) + N; a is that of the other pillars of the same units, of the units around or of the whole
array, whichever makes no fault likeliest. Faults then are:

- stuck: readings stay within their noise in scans in which the prediction moves;
- noisy: residuals of second differences, which loads that move evenly do not have, are larger than V and noise allow;
- swapped: readings are likelier after two wires are swapped back;
- open or shorted: a resistance is beyond what any load makes of it.

Loads that follow one another slowly count as often as they are new, by the ratio of von Neumann: the squares of
differences from scan to scan over twice those from the mean. What no window tells: an error that a force on the same
pad makes as well, such as a wrong gain of one pillar.
"""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dataset.measurement import ReadingError
from decoupler.data.columns import readable_columns
from decoupler.model.decoupler import Decoupler
from geometry.layout import PILLARS, SONG2018, FloatArray
from geometry.wiring import crossings, pillar_of_crossing

WINDOW = 40  #: scans that are looked at together
FEWEST = 8  #: scans, below which nothing is named
FALSE_ALARMS = 1e-5  #: of a hypothesis: a likelihood ratio passes 1/α with a probability of α at most (Markov)
ONE_SCAN = 5.0  #: largest log-likelihood ratio of one scan that counts: loads have longer tails than normal ones
MAX_NAMED = 3  #: faults of one window
BEYOND = 4.0  #: ratio to the mean resistance in training, either way, at which no load arrives
SIZES = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)  #: of loads over the usual ones, that are tried for a whole scan
USUAL = 4.0  #: largest mean square of readings of usual loads, over the mean, after wires are swapped back
CLEAR = 5.0  #: deviations by noise, by which a prediction must move before a pillar that does not is stuck
NOISES = (4.0, 10.0, 30.0)  #: times the stated noise, that a noisy pillar may have
OVERLAP = 35.0 / 18.0  #: variance of sums of squares of second differences of noise, over that of independent ones
MAX_WINDOWS = 50  #: of a recording, spread over it, that are looked at
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Fault:
    """Kind and place of what is wrong."""

    kind: str  #: open, shorted, stuck, noisy or swapped
    place: str  #: a pillar, a wire or two, in words
    pillars: tuple[tuple[int, int, str], ...]  #: row, col and name of each pillar that reads wrong
    log_likelihood_ratio: float = field(compare=False)  #: to no fault; infinite if open or shorted

    def __str__(self) -> str:
        return f"{self.place} {self.kind}"


@dataclass(frozen=True, eq=False, kw_only=True)
class FaultTest:
    """Readings of the P readable pillars of a decoupler under usual loads; made once, asked of every window."""

    rows: int
    cols: int
    pillars: Indices  #: (P,): places in a flattened (rows, cols, 3) array
    mean: FloatArray  #: (P,): of ln R under usual loads
    covariance: FloatArray  #: S, (P, P): of ln R under usual loads, noise included
    noise: FloatArray  #: (P,): relative standard deviation of a reading
    window: ClassVar[int] = WINDOW  #: scans that are looked at together

    @classmethod
    def of(cls, decoupler: Decoupler) -> "FaultTest | None":
        """The test of a model; None if it does not know how readings move under its loads, or takes them for exact."""
        usual = decoupler.usual
        if usual is None or usual.log_ohm is None or decoupler.uncertainty is None:
            return None
        rest_ohm = decoupler.rest_resistances()
        if rest_ohm is None:
            return None
        stated = decoupler.uncertainty.errors
        errors = ReadingError(noise=stated.noise, bits=stated.bits)
        if errors.is_exact:
            return None
        assert usual.log_ohm_covariance is not None
        names = [PILLARS.index(name) for name in decoupler.component.pillars]
        places = np.arange(rest_ohm.size).reshape(rest_ohm.shape)[..., names].reshape(-1)
        read = readable_columns(decoupler.component, decoupler.dead, len(places))
        noise = (errors.deviation(rest_ohm) / rest_ohm).reshape(-1)[places][read]
        return cls(
            rows=decoupler.rows,
            cols=decoupler.cols,
            pillars=places[read],
            mean=usual.log_ohm[read],
            covariance=usual.log_ohm_covariance[np.ix_(read, read)] + np.diag(noise**2),
            noise=noise,
        )

    def named(self, resistance_ohm: FloatArray) -> tuple[Fault, ...]:
        """Faults of a window of scans, the surest first.

        Parameters
        ----------
        resistance_ohm : array, shape (n, rows, cols, 3)
            Of n scans that follow one another, `window` usually; below `FEWEST` only open and shorted pillars are
            named. Readings may be anything, infinite or no number.
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
            found.append(test._fault(one.kind, one.place, one.which, one.ratio))
            if one.order is None:
                test, y = test._without(one.which), np.delete(y, one.which, axis=1)
            else:
                y = y[:, one.order]
        return tuple(found)

    def named_in(self, resistance_ohm: FloatArray) -> dict[str, int]:
        """Faults of a recording's scans (n, rows, cols, 3) [Ω], in words, and in how many windows each is named."""
        n_windows = max(len(resistance_ohm) // self.window, 1)
        some = np.unique(np.linspace(0, n_windows - 1, min(n_windows, MAX_WINDOWS)).astype(int))
        windows = [resistance_ohm[k * self.window : (k + 1) * self.window] for k in some.tolist()]
        return dict(Counter(str(fault) for window in windows for fault in self.named(window)))

    def _without(self, gone: Indices) -> "FaultTest":
        """The test of the other pillars."""
        if not len(gone):
            return self
        kept = np.delete(np.arange(len(self.pillars)), gone)
        return FaultTest(
            rows=self.rows,
            cols=self.cols,
            pillars=self.pillars[kept],
            mean=self.mean[kept],
            covariance=self.covariance[np.ix_(kept, kept)],
            noise=self.noise[kept],
        )

    def _broken(self, kind: str, is_so: NDArray[np.bool_]) -> list[Fault]:
        """Faults of pillars that are open or shorted, (P,): wires if all of theirs are, and what is left."""
        found, left = [], is_so.copy()
        for place, wire in self.wires:
            if is_so[wire].all():
                found.append(self._fault(kind, place, wire, math.inf))
                left[wire] = False
        return found + [
            self._fault(kind, self._name(p), np.array([p]), math.inf) for p in np.flatnonzero(left).tolist()
        ]

    def _fault(self, kind: str, place: str, which: Indices, ratio: float) -> Fault:
        units, numbers = np.divmod(self.pillars[which], len(PILLARS))
        rows, cols = np.divmod(units, self.cols)
        named = zip(rows.tolist(), cols.tolist(), (PILLARS[number] for number in numbers), strict=True)
        return Fault(kind, place, tuple(named), ratio)

    def _name(self, pillar: int) -> str:
        unit, number = divmod(int(self.pillars[pillar]), len(PILLARS))
        row, col = divmod(unit, self.cols)
        return f"pillar {PILLARS[number]} of row {row}, col {col}"

    @cached_property
    def wires(self) -> list[tuple[str, Indices]]:
        """Name and pillars, as numbers among P, of each wire that has two pillars at least."""
        sent = pillar_of_crossing(self.rows, self.cols)
        wires = crossings(self.rows, self.cols)
        at = np.full(self.rows * self.cols * len(PILLARS), -1)
        at[self.pillars] = np.arange(len(self.pillars))
        found = []
        for side, name in enumerate(("row", "column")):
            for wire in range(wires[:, side].max() + 1):
                own = at[sent[wires[:, side] == wire]]
                if (own >= 0).sum() > 1:
                    found.append((f"{name} wire {wire}", own[own >= 0]))
        return found

    @cached_property
    def swaps(self) -> list[tuple[str, Indices]]:
        """Name of every swap of two wires, or of all wires of two rows or columns, and the order of pillars then."""
        shape = (self.rows, self.cols, len(PILLARS))
        at = np.full(shape, -1)
        at.reshape(-1)[self.pillars] = np.arange(len(self.pillars))
        found = []
        ends = np.array(SONG2018.pillar_terminals)  # (pillar, side): its electrode
        for side, (name, n) in enumerate((("row", self.rows), ("column", self.cols))):
            carried = [np.flatnonzero(ends[:, side] == end) for end in np.unique(ends[:, side])]
            for i, j in combinations(range(n), 2):
                wires = [(len(carried) * i + m, len(carried) * j + m) for m in range(len(carried))]
                named = [
                    (f"{name} wires {one} and {other}", own) for (one, other), own in zip(wires, carried, strict=True)
                ]
                for said, own in [(f"{name}s {i} and {j}", np.arange(len(PILLARS))), *named]:
                    turned = at.copy()
                    by_wire = np.moveaxis(turned, side, 0)
                    first = by_wire[i][:, own].copy()
                    by_wire[i][:, own] = by_wire[j][:, own]
                    by_wire[j][:, own] = first
                    order = turned.reshape(-1)[self.pillars]
                    if order.min() >= 0 and (order != np.arange(len(order))).any():
                        found.append((said, order))
        return found

    @cached_property
    def _precision(self) -> FloatArray:
        return np.asarray(np.linalg.inv(self.covariance), dtype=np.float64)

    @cached_property
    def _groups(self) -> "list[_Groups]":
        """Each pillar and each wire beside which others are left, those of as many pillars together."""
        each = [(self._name(p), np.array([p])) for p in range(len(self.pillars))]
        by_size: dict[int, list[tuple[str, Indices]]] = {}
        for place, which in (*each, *self.wires):
            if len(which) < len(self.pillars):
                by_size.setdefault(len(which), []).append((place, which))
        return [_Groups.of(self, *zip(*groups, strict=True)) for groups in by_size.values()]

    def _likeliest(self, y: FloatArray) -> "_Found | None":
        """The fault that explains readings (n, P) best, of those that are decidedly likelier than none."""
        y = y - y.mean(axis=0)
        best: dict[tuple[str, bool], _Found] = {}
        for one in self._passing(y):
            kind = one.kind, len(one.which) > 1
            if kind not in best or one.ratio > best[kind].ratio:
                best[kind] = one
        return max(best.values(), key=lambda one: self._gain(one, y), default=None)

    def _passing(self, y: FloatArray) -> "Iterator[_Found]":
        """Faults decidedly likelier than none, readings (n, P) about their means."""
        enough = -math.log(FALSE_ALARMS)
        u, u_bent = y @ self._precision, _bent(y) @ self._precision
        for groups in self._groups:
            for kind, ratios in (("stuck", groups.stuck(y, u)), ("noisy", groups.noisy(u_bent) / OVERLAP)):
                for k in np.flatnonzero(ratios > enough):
                    yield _Found(kind, groups.places[k], groups.which[k], float(ratios[k]))
        energy, P = (u * y).sum(axis=1), y.shape[1]
        news = float(_news((y**2).sum(axis=0), (np.diff(y, axis=0) ** 2).sum(axis=0), self.noise**-2.0))
        products = y.T @ y
        for place, order in self.swaps:
            turned = products[np.ix_(order, order)]
            if news * 0.5 * float((self._precision * (products - turned)).sum()) <= enough:
                continue  # by all scans in full, which is never less
            other = ((y[:, order] @ self._precision) * y[:, order]).sum(axis=1)
            ratio = 0.5 * (energy - other)
            tells = (energy > P) & (other < USUAL * P)
            capped = news * float(np.minimum(np.where(tells, ratio, np.minimum(ratio, 0.0)), ONE_SCAN).sum())
            if capped > enough:
                yield _Found("swapped", place, np.flatnonzero(order != np.arange(P)), capped, order)

    def _gain(self, fault: "_Found", y: FloatArray) -> float:
        """Log-likelihood ratio, to none, of a fault that passes, by all readings (n, P) about their means."""
        if fault.order is not None:
            return self._log_density(y[:, fault.order]) - self._log_density(y)
        which = fault.which
        if fault.kind == "stuck":
            noise, own = self.noise[which], y[:, which]
            still = -0.5 * float(((own / noise) ** 2).sum()) - len(y) * float(np.log(noise).sum())
            others = self._without(which)._log_density(np.delete(y, which, axis=1))
            return still + others - self._log_density(y)
        bent, found = _bent(y), []
        for times in NOISES:
            noise = self.noise.copy()
            noise[which] *= times
            louder = replace(self, noise=noise, covariance=self.covariance + np.diag(noise**2 - self.noise**2))
            found.append(louder._log_density(bent))
        return (max(found) - self._log_density(bent)) / OVERLAP

    def _log_density(self, y: FloatArray) -> float:
        """Log-density of readings (n, P) but for a constant, each scan by the likeliest size of its loads."""
        basis, spread = self._independent
        squares = (y @ basis) ** 2
        each = [1.0 + size**2 * spread for size in SIZES]
        by_size = [-0.5 * (squares @ (1.0 / one) + np.log(one).sum()) for one in each]
        return float(np.max(by_size, axis=0).sum()) - len(y) * float(np.log(self.noise).sum())

    @cached_property
    def _independent(self) -> tuple[FloatArray, FloatArray]:
        """What makes noise independent and of variance 1, and loads independent, (P, P); variances by loads, (P,)."""
        relative = self.covariance / np.outer(self.noise, self.noise) - np.eye(len(self.noise))
        spread, U = np.linalg.eigh(relative)
        return U / self.noise[:, None], np.maximum(spread, 0.0)


def _bent(y: FloatArray) -> FloatArray:
    """Second differences of readings (n, P), with the noise of one reading, (n − 2, P)."""
    return np.diff(y, n=2, axis=0) / math.sqrt(6.0)


def _news(squares: FloatArray, steps: FloatArray, weights: FloatArray) -> FloatArray:
    """Ratio of von Neumann, 1 if each scan has a load of its own, near 0 if all have one; weights (..., P) of pillars.

    `squares` and `steps` (P,) are sums of squares of readings about their means and of differences from scan to scan.
    """
    total = 2.0 * weights @ squares
    return np.minimum(np.divide(weights @ steps, total, out=np.zeros_like(total), where=total > 0), 1.0)


@dataclass(frozen=True, eq=False)
class _Found:
    """A fault that is decidedly likelier than none."""

    kind: str
    place: str
    which: Indices  #: (k,): pillars
    ratio: float  #: log-likelihood ratio to none, no scan above `ONE_SCAN`
    order: Indices | None = None  #: (P,): of the pillars that swaps wires back


@dataclass(frozen=True, eq=False)
class _Groups:
    """g groups of k pillars that may fail together, and what the others say of them."""

    places: tuple[str, ...]
    which: Indices  #: (g, k)
    noise: FloatArray  #: (g, k)
    solved: FloatArray  #: V = K_gg⁻¹, (g, k, k)
    variance: FloatArray  #: its diagonal, (g, k)
    by_noise: FloatArray  #: that of N, (g, k)
    across: FloatArray  #: K_gq, (g, k, P)
    scale: FloatArray  #: (g, P): variance of (K y)_q without the group
    noise_share: FloatArray  #: (g, P): of it, by noise
    near: FloatArray  #: (g, P, 3): 1 for others of the same units, of those around, for all
    apart: FloatArray  #: what makes residuals independent, under loads and noise alike, (g, k, k)
    by_parts: FloatArray  #: variances of these parts by loads, (g, k); those by noise are 1
    own_parts: FloatArray  #: the same by the group's own noise, (g, k)

    @classmethod
    def of(cls, test: FaultTest, places: tuple[str, ...], which: tuple[Indices, ...]) -> "_Groups":
        K, here = test._precision, np.stack(which)
        V: FloatArray = np.asarray(np.linalg.inv(K[here[:, :, None], here[:, None]]), dtype=np.float64)
        mine = V @ K[here]
        without = K - K[here].swapaxes(1, 2) @ mine
        scale = np.maximum(np.einsum("gpp->gp", without), 1e-12 * K.diagonal())
        rows, cols = np.divmod(test.pillars // len(PILLARS), test.cols)
        far = np.maximum(np.abs(rows - rows[here][..., None]), np.abs(cols - cols[here][..., None])).min(axis=1)
        other = ~(here[..., None] == np.arange(len(K))).any(axis=1)
        near = np.stack([other & (far <= most) for most in (0, 1, len(K))], axis=-1)
        for k in (1, 0):
            near[..., k] |= near[..., k + 1] & ~near[..., k].any(axis=1, keepdims=True)  # the next, where there is none
        N = (mine * test.noise**2) @ mine.swapaxes(1, 2)
        L = np.linalg.inv(np.linalg.cholesky(N))
        by_parts, U = np.linalg.eigh(L @ V @ L.swapaxes(1, 2))
        apart = L.swapaxes(1, 2) @ U
        return cls(
            places=places,
            which=here,
            noise=test.noise[here],
            solved=V,
            variance=np.einsum("gkk->gk", V),
            by_noise=np.einsum("gkk->gk", N),
            across=K[here],
            scale=scale,
            noise_share=np.minimum(((without * test.noise) ** 2).sum(axis=2) / scale, 0.99),
            near=near.astype(np.float64),
            apart=apart,
            by_parts=np.maximum(by_parts - 1.0, 0.0),
            own_parts=((apart * test.noise[here][..., None]) ** 2).sum(axis=1),
        )

    def _residuals(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """r, (g, n, k), and a², how large loads are over the usual ones by each of `near`, (g, n, 1, 3)."""
        r = u[:, self.which].swapaxes(0, 1) @ self.solved
        squares = (u - r @ self.across) ** 2 / self.scale[:, None] - self.noise_share[:, None]
        free = (1.0 - self.noise_share)[:, None] @ self.near
        return r, np.maximum(squares @ self.near / free, 0.0)[:, :, None]

    def stuck(self, y: FloatArray, u: FloatArray) -> FloatArray:
        """Log-likelihood ratios of readings (n, P) that do not move to such that do as usual, (g,)."""
        r, sizes = self._residuals(u)
        own, by_noise = y[:, self.which].swapaxes(0, 1), self.by_noise[:, None]
        usual = sizes * (self.variance - self.by_noise)[:, None, :, None] + by_noise[..., None]
        ratio = _log_normal(own, self.noise[:, None] ** 2) - _log_normal(r[..., None], usual).max(axis=-1)
        moved = (own - r) ** 2 > CLEAR**2 * by_noise
        news = _news((y**2).sum(axis=0), (np.diff(y, axis=0) ** 2).sum(axis=0), self.near[..., 0])
        return news * _total(np.where(moved, ratio, np.minimum(ratio, 0.0)))

    def noisy(self, u: FloatArray) -> FloatArray:
        """The largest log-likelihood ratios of `NOISES` to the stated one, of scans with noise of their own, (g,).

        Residuals of a wire's pillars go together under loads, so their independent parts are looked at.
        """
        r, sizes = self._residuals(u)
        parts, usual = (r @ self.apart)[..., None], sizes * self.by_parts[:, None, :, None] + 1.0
        none = _log_normal(parts, usual).max(axis=-1)
        more = [(times**2 - 1.0) * self.own_parts[:, None, :, None] for times in NOISES]
        return np.max([_total(_log_normal(parts, usual + extra).max(axis=-1) - none) for extra in more], axis=0)


def _log_normal(values: FloatArray, variance: FloatArray) -> FloatArray:
    """Log-density of normal values but for a constant, each by itself."""
    return -0.5 * (values**2 / variance + np.log(variance))


def _total(ratio: FloatArray) -> FloatArray:
    """Log-likelihood ratios by those of pillars or parts, (g, n, k): what half of them say, as if it were one, (g,)."""
    each = np.sort(np.minimum(ratio, ONE_SCAN).sum(axis=1), axis=1)
    return np.asarray(each[:, (each.shape[1] - 1) // 2])
