"""The posterior of a sensor, from what is expected of it and measured pairs: Gauss-Newton, everything normal.

A pillar reads R = g c Σ s (d + B F)² + o. What all pillars share (parameters of the design, resistivity, the correction
that all units share, forces that are not quite known) is solved for together; what is a pillar's own (gain, offset,
correction of its influence) is marginalised pillar by pillar. Widths that nobody states follow from the pairs, too.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from dataset.measurement import reading_deviation
from decoupler.model.ensemble import Ensemble
from decoupler.twin.expectation import Expectation, Widths
from decoupler.twin.marginal import Marginal
from geometry.layout import FloatArray

MAX_STEPS = 10  #: of Gauss-Newton; widths are estimated anew at each
CONVERGED = 0.03  #: standard deviations that an unknown still moves, and relative change of a width, at the end
FARTHEST = 2.0  #: standard deviations that a shared unknown moves in a step
HALVINGS = 10  #: of a pillar's own step until its misfit falls
#: number of unknowns that a stated width counts as, beside those that the pairs determine
BELIEF = {"gain": 20.0, "offset": 20.0, "shared": 20.0, "own": 20.0, "misfit": 1.0}
BELIEF_IN_PAIRS = 20.0  #: number of readings that count as being as expected, beside those of a pair
#: largest width that pairs may lead to, unless a larger one is stated
WIDEST = {"gain": 0.3, "offset": 0.1, "shared": 1.0, "own": 1.0, "misfit": 0.3}
AT_ONCE = 10_000  #: readings of pillars whose derivatives are worked on together
MIN_NOISE = 1e-6  #: relative error that readings have at least


@dataclass(frozen=True, kw_only=True, eq=False)
class Readings:
    """n readings of P pillars, as columns, and the Q forces under them."""

    resistance_ohm: FloatArray  #: (n, P); anything where not read
    read: NDArray[np.bool_]  #: (n, P)
    force_n: FloatArray  #: (n, Q): expected; effective forces, if the model has a correction for finite strain
    acting_n: FloatArray  #: (n, Q): forces that these stand for
    unknown_n: FloatArray  #: (n_unknown, Q): directions in which forces may differ, a standard deviation each
    pair: NDArray[np.int64]  #: (n_unknown,): of which pair
    noise: float
    bits: int | None
    scale: FloatArray  #: (n,): of all deviations of a pair; above 1 if its load or its reading was not as stated

    def of_pairs(self, which: NDArray[np.int64]) -> "Readings":
        """The readings of some pairs, by their numbers."""
        kept = np.flatnonzero(np.isin(self.pair, which))
        place = {int(pair): k for k, pair in enumerate(which)}
        return replace(
            self,
            resistance_ohm=self.resistance_ohm[which],
            read=self.read[which],
            force_n=self.force_n[which],
            acting_n=self.acting_n[which],
            unknown_n=self.unknown_n[kept],
            pair=np.array([place[int(pair)] for pair in self.pair[kept]], dtype=np.int64),
            scale=self.scale[which],
        )

    def variance_ohm2(self) -> FloatArray:
        """Variance of the readings about their resistances, (n, P) [Ω²]."""
        deviation = reading_deviation(self.resistance_ohm, self.noise, self.bits)
        return deviation**2 + (MIN_NOISE * self.resistance_ohm) ** 2


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """One sensor that may be; unknowns are in standard deviations of their priors if no unit is stated."""

    parameters: FloatArray  #: (k,)
    resistivity: float  #: logarithm of its ratio to the design's, in standard deviations
    shared: FloatArray  #: (kinds, 3, n_shared)
    unknown: FloatArray  #: (n_unknown,): ξ of the forces
    gain: FloatArray  #: g, (P,)
    offset_ohm: FloatArray  #: o, (P,)
    own: FloatArray  #: (P, 3, Q) [mm/N]

    @classmethod
    def as_expected(cls, expected: Expectation, n_unknown: int) -> "State":
        """The prior's mean."""
        P, _, Q = expected.influence.shape
        kinds = P // expected.n_units
        n_shared = expected.near.shape[1] * (Q // expected.n_units)
        return cls(
            parameters=np.zeros(len(expected.names)),
            resistivity=0.0,
            shared=np.zeros((kinds, 3, n_shared)),
            unknown=np.zeros(n_unknown),
            gain=np.ones(P),
            offset_ohm=np.zeros(P),
            own=np.zeros((P, 3, Q)),
        )

    def influence(self, expected: Expectation) -> FloatArray:
        """B, (P, C, Q) [mm/N]."""
        B = expected.influence + np.tensordot(self.parameters, expected.by_influence, axes=1)
        B[:, :3] += self.own + expected.shared_influence(self.shared * expected.widths.shared)
        return B

    def rest_mm(self, expected: Expectation) -> FloatArray:
        """d, (P, C)."""
        return expected.rest_mm + np.tensordot(self.parameters, expected.by_rest_mm, axes=1)

    def ohm_per_mm2(self, expected: Expectation) -> FloatArray:
        """c, (P,), of the sensor's own size and resistivity."""
        logarithm = self.parameters @ expected.by_log_c + expected.widths.resistivity * self.resistivity
        return expected.ohm_per_mm2 * np.exp(logarithm)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pillars:
    """Readings of b pillars of a kind, linearised about a state and whitened."""

    pillars: NDArray[np.int64]  #: (b,): their numbers
    shared: FloatArray  #: A, (b, n, g): derivatives by what pillars share
    columns: NDArray[np.int64]  #: (g,): their places among all that is shared
    own: FloatArray  #: J, (b, n, m): by each pillar's own unknowns, as `_own` has them
    misfit: FloatArray  #: r, (b, n): readings less model

    def with_misfit(self, own: FloatArray) -> FloatArray:
        """A, and r as it would be without what pillars have of their own, (P, m): (b, n, g + 1)."""
        misfit = self.misfit[..., None] + self.own @ own[self.pillars][..., None]
        return np.concatenate([self.shared, misfit], axis=2)


@dataclass(frozen=True, kw_only=True, eq=False)
class Posterior:
    """A sensor as its pairs show it."""

    expected: Expectation  #: with the widths that the pairs led to
    state: State  #: the most probable sensor
    covariance: FloatArray  #: (k, k): of the parameters, in standard deviations of their priors
    gain_deviation: FloatArray  #: (P,)
    offset_deviation_ohm: FloatArray  #: (P,)
    ensemble: Ensemble
    scale: FloatArray  #: (n,): of all deviations of each pair, above 1 if it was not as stated or as modelled
    excess: float  #: χ² of the readings over their number, each predicted from all others: 1 if all is as modelled


def infer(expected: Expectation, readings: Readings, draws: int = 32, seed: int = 0) -> Posterior:
    """Infer a sensor from pairs.

    Parameters
    ----------
    expected : Expectation
    readings : Readings
    draws : int
        Size of the ensemble.
    seed : int
        Of its draws.

    Notes
    -----
    Each step solves (1 + Σ Aᵀ S⁻¹ A) δ = Σ Aᵀ S⁻¹ r − x for what pillars share, S = 1 + J Jᵀ of each pillar, then
    Jᵀ S⁻¹ (r − A δ) for its own. Widths follow MacKay's fixed point (Neural Computation 4, 1992): the sum of squares of
    unknowns over the number of those that the pairs determine, with the stated width as `BELIEF` more of them. Draws
    are exact for the linearised model (Matheron's rule).
    """
    stated, state = expected.widths, State.as_expected(expected, len(readings.unknown_n))
    for _ in range(MAX_STEPS):
        state, evidence = _improved(expected, readings, state)
        widths = evidence.widths(stated, expected.widths)
        readings = replace(readings, scale=np.maximum(readings.scale * evidence.scale, 1.0))
        change = max(abs(getattr(widths, name) / getattr(expected.widths, name) - 1.0) for name in evidence.known)
        state = _in_other_widths(state, expected.widths, widths)
        expected = replace(expected, widths=widths)
        if max(change, evidence.moved) < CONVERGED:
            break
    return _drawn(expected, readings, state, draws, seed)


def forces_under(readings: Readings, unknown: FloatArray) -> FloatArray:
    """Forces on the pads (n, Q) [N] for ξ (n_unknown,)."""
    force_n = readings.force_n.copy()
    np.add.at(force_n, readings.pair, unknown[:, None] * readings.unknown_n)
    return force_n


def _own(expected: Expectation, state: State) -> FloatArray:
    """Gain, offset and correction of each pillar, (P, 2 + 3Q), in standard deviations."""
    widths = expected.widths
    parts = [
        (state.gain[:, None] - 1.0) / widths.gain,
        (state.offset_ohm / (widths.offset * expected.rest_ohm))[:, None],
        (state.own / (widths.own * expected.sizes[:, None])).reshape(len(state.gain), -1),
    ]
    return np.concatenate(parts, axis=1)


def _with_own(expected: Expectation, state: State, own: FloatArray) -> State:
    """The state with these unknowns of the pillars, as `_own` has them."""
    widths = expected.widths
    return replace(
        state,
        gain=1.0 + widths.gain * own[:, 0],
        offset_ohm=widths.offset * expected.rest_ohm * own[:, 1],
        own=own[:, 2:].reshape(state.own.shape) * (widths.own * expected.sizes[:, None]),
    )


def _shown(expected: Expectation, state: State, force_n: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Vectors v = d + B F (n, P, C) [mm], and resistances without gain and offset, c Σ s v², (n, P) [Ω]."""
    P, C, Q = expected.influence.shape
    v = (force_n @ state.influence(expected).reshape(-1, Q).T).reshape(-1, P, C) + state.rest_mm(expected)
    return v, state.ohm_per_mm2(expected) * np.einsum("pi,npi,npi->np", expected.sign, v, v)


def _weights(expected: Expectation, readings: Readings, state: State) -> tuple[FloatArray, FloatArray]:
    """One over the deviation of each reading, (n, P) [1/Ω], 0 where not read; fraction of the variance that is misfit.

    A misfit is relative to the distance from the sensor's own rest.
    """
    rest_ohm = state.ohm_per_mm2(expected) * (expected.sign * state.rest_mm(expected) ** 2).sum(axis=1)
    distance = readings.resistance_ohm - state.gain * rest_ohm - state.offset_ohm
    misfit_ohm2 = (expected.widths.misfit * distance) ** 2
    variance = (readings.variance_ohm2() + misfit_ohm2) * readings.scale[:, None] ** 2
    misfit_ohm2 *= readings.scale[:, None] ** 2
    return readings.read / np.sqrt(variance), readings.read * misfit_ohm2 / variance


def _linearised(expected: Expectation, readings: Readings, state: State, weight: FloatArray) -> Iterator[_Pillars]:
    """Readings about a state, whitened by `weight` (n, P), some pillars of a kind at a time."""
    n, P = weight.shape
    k, Q, (kinds, _, n_shared) = len(expected.names), expected.influence.shape[2], state.shared.shape
    widths, pair = expected.widths, readings.pair
    force_n = forces_under(readings, state.unknown)
    near = expected.near_forces(force_n) * widths.shared
    v, modelled = _shown(expected, state, force_n)
    misfit = weight * (readings.resistance_ohm - state.gain * modelled - state.offset_ohm)
    slope = (2.0 * state.gain * state.ohm_per_mm2(expected) * weight)[..., None] * expected.sign * v  # by v, (n, P, C)
    scaled = weight * state.gain * modelled
    B, sizes = state.influence(expected), expected.sizes * widths.own
    first, latent = k + 1, k + 1 + 3 * n_shared
    at_once = max(1, AT_ONCE // n)
    for kind in range(kinds):
        ours = kind + kinds * np.arange(P // kinds)
        shared = first + 3 * n_shared * kind + np.arange(3 * n_shared)
        columns = np.concatenate([np.arange(first), shared, first + state.shared.size + np.arange(len(pair))])
        for p in np.split(ours, range(at_once, len(ours), at_once)):
            s = np.ascontiguousarray(slope[:, p].swapaxes(0, 1))
            A = np.zeros((len(p), n, latent + len(pair)))
            for j in range(k):
                moved = expected.by_rest_mm[j, p, None] + force_n @ expected.by_influence[j, p].swapaxes(1, 2)
                A[..., j] = (s * moved).sum(axis=2) + (scaled[:, p] * expected.by_log_c[j, p]).T
            A[..., k] = widths.resistivity * scaled[:, p].T
            beside = near[:, p // kinds].swapaxes(0, 1)
            A[..., first:latent] = (s[..., :3, None] * beside[:, :, None]).reshape(len(p), n, -1)
            moved = readings.unknown_n @ B[p].swapaxes(1, 2)
            A[:, pair, latent + np.arange(len(pair))] = (s[:, pair] * moved).sum(axis=2)
            J = np.empty((len(p), n, 2 + 3 * Q))
            J[..., 0] = widths.gain * (weight[:, p] * modelled[:, p]).T
            J[..., 1] = widths.offset * expected.rest_ohm[p, None] * weight[:, p].T
            J[..., 2:] = (s[..., :3, None] * (force_n * sizes[p, None])[:, :, None]).reshape(len(p), n, -1)
            yield _Pillars(pillars=p, shared=A, columns=columns, own=J, misfit=misfit[:, p].T)


@dataclass(kw_only=True)
class _Evidence:
    """Sums over pillars that tell the widths: squares of unknowns, and how many of them the pairs determine."""

    squares: dict[str, float]
    known: dict[str, float]
    scale: FloatArray  #: (n,): size of each pair's errors, over the expected one
    moved: float  #: largest step of an unknown, in standard deviations

    def widths(self, stated: Widths, now: Widths) -> Widths:
        """Widths that the pairs make more probable."""
        changed = {}
        for name, known in self.known.items():
            start, width = getattr(stated, name), getattr(now, name)
            belief = BELIEF[name]
            ratio = (self.squares[name] + belief * (start / width) ** 2) / (known + belief)
            changed[name] = min(width * float(np.sqrt(ratio)), max(start, WIDEST[name]))
        return replace(now, **changed)


def _improved(expected: Expectation, readings: Readings, state: State) -> tuple[State, _Evidence]:
    """The state after a Gauss-Newton step, and what the step says of the widths."""
    x = _flat(state)
    n_shared_first = len(state.parameters) + 1
    weight, unsure = _weights(expected, readings, state)
    own = _own(expected, state)
    N, rhs = np.eye(len(x)), -x
    squares = dict.fromkeys(("gain", "offset", "own", "misfit"), 0.0)
    known = dict.fromkeys(squares, 0.0)
    solved = []
    errors, expected_errors = np.full((2, len(weight)), BELIEF_IN_PAIRS)
    for part in _linearised(expected, readings, state, weight):
        marginal = Marginal(part.own)
        Y = part.with_misfit(own)
        X, to_own = marginal.solved(Y)
        sums = part.shared.reshape(-1, part.shared.shape[2]).T @ X.reshape(-1, X.shape[2])
        N[np.ix_(part.columns, part.columns)] += sums[:, :-1]
        rhs[part.columns] += sums[:, -1]
        left, determined = marginal.leverage()
        for name, which in (("gain", slice(0, 1)), ("offset", slice(1, 2)), ("own", slice(2, None))):
            known[name] += float(determined[:, which].sum())
        known["misfit"] += float((unsure[:, part.pillars].T * left).sum())
        expected_errors += (readings.read[:, part.pillars].T * left).sum(axis=0)
        solved.append((part.pillars, part.columns, X, to_own))
    factor = cho_factor(N, lower=True)
    step = cho_solve(factor, rhs)
    step *= min(1.0, FARTHEST / max(np.abs(step[:n_shared_first]).max(), 1e-12))
    found = np.empty_like(own)
    for p, columns, X, to_own in solved:
        left_over = np.append(-step[columns], 1.0)[:, None]
        found[p] = to_own(left_over)[..., 0]
        noise = (X @ left_over)[..., 0]  # the readings' own errors, whitened
        squares["misfit"] += float((unsure[:, p].T * noise**2).sum())
        errors += (noise**2).sum(axis=0)
    squares["gain"], squares["offset"] = (found[:, :2] ** 2).sum(axis=0).tolist()
    squares["own"] = float((found[:, 2:] ** 2).sum())
    moved = _unflat(state, x + step)
    if state.shared.size:
        half = solve_triangular(factor[0], np.eye(len(N)), lower=True, check_finite=False)  # N⁻¹ = halfᵀ half
        of_shared = slice(n_shared_first, n_shared_first + state.shared.size)
        known["shared"] = float(state.shared.size - (half[:, of_shared] ** 2).sum())
        squares["shared"] = float((moved.shared**2).sum())
    improved = _descended(expected, readings, moved, own, found, weight)
    farthest = max(float(np.abs(step).max()), float(np.abs(_own(expected, improved) - own).max()))
    return improved, _Evidence(squares=squares, known=known, scale=np.sqrt(errors / expected_errors), moved=farthest)


def _descended(
    expected: Expectation, readings: Readings, state: State, own: FloatArray, found: FloatArray, weight: FloatArray
) -> State:
    """The state with each pillar's own unknowns on the way from `own` to `found`, as far as its misfit falls."""

    def cost(unknowns: FloatArray) -> FloatArray:
        tried = _with_own(expected, state, unknowns)
        _, modelled = _shown(expected, tried, force_n)
        misfit = weight * (readings.resistance_ohm - tried.gain * modelled - tried.offset_ohm)
        return (misfit**2).sum(axis=0) + (unknowns**2).sum(axis=1)

    force_n = forces_under(readings, state.unknown)
    size, before = np.ones((len(own), 1)), cost(own)
    for _ in range(HALVINGS):
        worse = cost(own + size * (found - own)) > before
        if not worse.any():
            break
        size[worse] *= 0.5
    return _with_own(expected, state, own + size * (found - own))


def _flat(state: State) -> FloatArray:
    """All that pillars share, as one vector."""
    return np.concatenate([state.parameters, [state.resistivity], state.shared.ravel(), state.unknown])


def _unflat(state: State, x: FloatArray) -> State:
    """The state with all that pillars share from a vector."""
    k, size = len(state.parameters), state.shared.size
    shared = x[k + 1 : k + 1 + size].reshape(state.shared.shape)
    return replace(state, parameters=x[:k], resistivity=float(x[k]), shared=shared, unknown=x[k + 1 + size :])


def _in_other_widths(state: State, old: Widths, new: Widths) -> State:
    """The same sensor, its shared correction in standard deviations of another width."""
    return replace(state, shared=state.shared * (old.shared / new.shared) if state.shared.size else state.shared)


def _drawn(expected: Expectation, readings: Readings, state: State, draws: int, seed: int) -> Posterior:
    """The posterior about the most probable state, with draws from it."""
    generator = np.random.default_rng(seed)
    weight, _ = _weights(expected, readings, state)
    x, P, n, own = _flat(state), expected.n_pillars, len(weight), _own(expected, state)
    m = own.shape[1]
    N = np.eye(len(x))
    own_draws, by_shared = np.empty((P, m, draws)), []
    deviations, excess = np.empty((P, 2)), []
    for part in _linearised(expected, readings, state, weight):
        marginal, p = Marginal(part.own), part.pillars
        X, to_own = marginal.solved(part.with_misfit(own))
        sums = part.shared.reshape(-1, part.shared.shape[2]).T @ X[..., :-1].reshape(-1, X.shape[2] - 1)
        N[np.ix_(part.columns, part.columns)] += sums
        prior = generator.standard_normal((len(p), m, draws))
        own_draws[p] = marginal.drawn(prior, generator.standard_normal((len(p), n, draws)))
        by_shared.append((p, part.columns, to_own))
        left, determined = marginal.leverage()
        deviations[p] = np.sqrt(1.0 - determined[:, :2])
        excess.append((X[..., -1] ** 2 / left)[readings.read[:, p].T])
    factor = np.linalg.cholesky(N)
    shared_draws = solve_triangular(factor, generator.standard_normal((len(N), draws)), lower=True, trans="T")
    for p, columns, to_own in by_shared:
        own_draws[p] -= to_own(np.concatenate([shared_draws[columns], np.zeros((1, draws))]))
    k = len(state.parameters)
    inverse = cho_solve((factor, True), np.eye(len(N))[:, :k])[:k]
    widths = expected.widths
    return Posterior(
        expected=expected,
        state=state,
        covariance=inverse,
        gain_deviation=widths.gain * deviations[:, 0],
        offset_deviation_ohm=widths.offset * expected.rest_ohm * deviations[:, 1],
        ensemble=_ensemble(expected, state, own_draws, shared_draws),
        scale=readings.scale,
        excess=float(np.concatenate(excess).mean()),
    )


def _ensemble(expected: Expectation, state: State, own: FloatArray, shared: FloatArray) -> Ensemble:
    """Draws (P, m, draws) and (g, draws) of what pillars have alone and together, as changes of their resistances."""
    k, size, widths = len(state.parameters), state.shared.size, expected.widths
    parameters, resistivity = shared[:k].T, shared[k]
    influence = own[:, 2:].reshape(*state.own.shape, -1) * (widths.own * expected.sizes[:, None, :, None])
    influence = np.moveaxis(influence, -1, 0) + np.tensordot(parameters, expected.by_influence[:, :, :3], axes=1)
    for draw, values in enumerate(shared[k + 1 : k + 1 + size].T if size else ()):
        influence[draw] += expected.shared_influence(values.reshape(state.shared.shape) * widths.shared)
    resistance = widths.gain * own[:, 0].T / state.gain + parameters @ expected.by_log_c
    return Ensemble(
        resistance=resistance + widths.resistivity * resistivity[:, None],
        offset_ohm=widths.offset * expected.rest_ohm * own[:, 1].T,
        rest_mm=np.tensordot(parameters, expected.by_rest_mm[..., :3], axes=1),
        influence=influence.astype(np.float32),
    )
