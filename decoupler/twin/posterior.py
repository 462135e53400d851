"""The posterior of a sensor, from what is expected of it and measured pairs: Gauss-Newton, everything normal.

What all pillars share is solved for together; what is a pillar's own is marginalised, see `linearised`.
Widths that nobody states follow from the pairs, too.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from dataset.samples import SampleError
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.ensemble import Ensemble
from decoupler.twin.expectation import Expectation, State, Widths
from decoupler.twin.linearised import Linear, Readings
from geometry.layout import FloatArray

MAX_STEPS = 10  #: of Gauss-Newton; widths are estimated anew at each
CONVERGED = 0.03  #: standard deviations that an unknown still moves, and relative change of a width, at the end
FARTHEST = 2.0  #: standard deviations that a shared unknown moves in a step
HALVINGS = 10  #: of a pillar's own step until its misfit falls
#: number of unknowns that a stated width counts as, beside those that the pairs determine
BELIEF = {"gain": 20.0, "offset": 20.0, "shared": 5.0, "own": 5.0, "misfit": 1.0}
BELIEF_IN_PAIRS = 20.0  #: number of readings that count as being as expected, beside those of a pair
#: largest width that pairs may lead to, unless a larger one is stated
WIDEST = {"gain": 0.3, "offset": 0.1, "shared": 1.0, "own": 1.0, "misfit": 0.3}


@dataclass(frozen=True, kw_only=True, eq=False)
class Specimen:
    """A sensor as its pairs show it."""

    expected: Expectation  #: with the widths that the pairs led to
    state: State  #: the most probable sensor
    covariance: FloatArray  #: (k, k): of the parameters, in standard deviations of their priors
    gain_deviation: FloatArray  #: (P,)
    offset_deviation_ohm: FloatArray  #: (P,)
    ensemble: Ensemble
    scale: FloatArray  #: (n,): of all deviations of each pair, above 1 if it was not as stated or as modelled
    excess: float  #: χ² of the readings over their number, each predicted from all others: 1 if all is as modelled

    @cached_property
    def sensor(self) -> SensorModel:
        """The most probable sensor."""
        return self.expected.sensor(self.state)

    @property
    def parameters(self) -> dict[str, tuple[float, float]]:
        """Most probable value and standard deviation of each parameter, by the design's keys."""
        expected = self.expected
        values = expected.values + expected.deviations * expected.parts(self.state.shared)[0]
        deviations = expected.deviations * np.sqrt(self.covariance.diagonal())
        return dict(zip(expected.names, zip(values.tolist(), deviations.tolist(), strict=True), strict=True))

    @property
    def resistivity(self) -> float:
        """Of all pillars together, over the design's."""
        return math.exp(self.expected.widths.resistivity * self.expected.parts(self.state.shared)[1][0])

    @property
    def gain(self) -> FloatArray:
        """Of each pillar, (P,)."""
        return self.expected.gain(self.state)

    @property
    def offset_ohm(self) -> FloatArray:
        """Of each pillar, (P,)."""
        return self.expected.offset_ohm(self.state)


def infer(
    expected: Expectation,
    readings: Readings,
    draws: int = 32,
    progress: Callable[[float], None] = lambda share: None,
) -> Specimen:
    """Infer a sensor from pairs, with an ensemble of so many draws; `progress` is told each step's part of the whole.

    Raises
    ------
    SampleError
        If no pair has forces that finite strain knows.

    Notes
    -----
    Each step solves (1 + Σ Aᵀ S⁻¹ A) δ = Σ Aᵀ S⁻¹ r − x for what pillars share, S = 1 + J Jᵀ of each pillar, then
    Jᵀ S⁻¹ (r − A δ) for its own. Widths follow MacKay's fixed point (Neural Computation 4, 1992): the sum of squares of
    unknowns over the number of those that the pairs determine, with the stated width as `BELIEF` more of them. Draws
    are exact for the linearised model (Matheron's rule).
    """
    stated, state = expected.widths, expected.mean(len(readings.pair))
    for _ in range(MAX_STEPS):
        progress(1.0 / (MAX_STEPS + 1))
        old, before = expected.widths, state
        state, widths, scale = _improved(Linear(expected, readings, state), stated)
        moved = max(float(np.abs(getattr(state, name) - getattr(before, name)).max()) for name in ("shared", "own"))
        change = max(abs(width / getattr(old, name) - 1.0) for name, width in vars(widths).items() if width)
        readings = replace(readings, scale=np.maximum(readings.scale * scale, 1.0))
        expected = replace(expected, widths=widths)
        state = state.rescaled(expected, old)
        if max(change, moved) < CONVERGED:
            break
    return _drawn(expected, readings, state, draws)


def _improved(linear: Linear, stated: Widths) -> tuple[State, Widths, FloatArray]:
    """The state after a Gauss-Newton step, widths that the pairs make more probable, and the size of their errors.

    The latter is over the expected one, (n,).
    """
    expected, state = linear.expected, linear.state
    if not linear.read.any():
        raise SampleError("no pair has forces that this design bears at finite strain: are they in newtons?")
    own, n_first = state.own, len(expected.names) + 1
    known = dict(zip(("gain", "offset", "own"), linear.known.sum(axis=0).tolist(), strict=True))
    known["misfit"] = float((linear.unsure * linear.left).sum())
    expected_errors = BELIEF_IN_PAIRS + (linear.read * linear.left).sum(axis=1)
    factor = cho_factor(linear.N, lower=True)
    step = cho_solve(factor, linear.rhs)
    step *= min(1.0, FARTHEST / max(np.abs(step[:n_first]).max(), 1e-12))
    found, noise = np.empty_like(own), np.empty_like(linear.weight)
    for p, pillar, marginal in linear.pillars():  # the readings' own errors, whitened, and the pillars' own unknowns
        noise[:, p], found[p] = marginal.solved(pillar.misfit + pillar.J @ own[p] - pillar.by_shared(step))
    squares = {"misfit": float((linear.unsure * noise**2).sum()), "own": float((found[:, 2:] ** 2).sum())}
    squares["gain"], squares["offset"] = (found[:, :2] ** 2).sum(axis=0).tolist()
    moved = replace(state, shared=state.shared + step)
    if expected.n_corrections:
        half = solve_triangular(factor[0], np.eye(len(linear.N)), lower=True, check_finite=False)  # N⁻¹ = halfᵀ half
        of_shared = slice(n_first, n_first + expected.n_corrections)
        known["shared"] = float(expected.n_corrections - (half[:, of_shared] ** 2).sum())
        squares["shared"] = float((moved.shared[of_shared] ** 2).sum())
    widths = {}
    for name, number in known.items():
        start, width = getattr(stated, name), getattr(expected.widths, name)
        ratio = (squares[name] + BELIEF[name] * (start / width) ** 2) / (number + BELIEF[name])
        widths[name] = min(width * float(np.sqrt(ratio)), max(start, WIDEST[name]))
    scale = np.sqrt((BELIEF_IN_PAIRS + (noise**2).sum(axis=1)) / expected_errors)
    return _descended(linear, moved, found), replace(expected.widths, **widths), scale


def _descended(linear: Linear, state: State, found: FloatArray) -> State:
    """The state with each pillar's own unknowns on the way to those `found`, as far as its misfit falls."""
    expected, readings, own = linear.expected, linear.readings, state.own
    force_n = readings.forces(expected.parts(state.shared)[3])
    state_n = expected.sensor(state).under(force_n).state_n  # the same for all unknowns of a pillar's own

    def cost(unknowns: FloatArray) -> FloatArray:
        at = expected.sensor(replace(state, own=unknowns)).at(state_n)
        misfit = linear.weight * (readings.resistance_ohm - at.resistance_ohm)
        return np.asarray((misfit**2).sum(axis=0) + (unknowns**2).sum(axis=1))

    size, before = np.ones((len(own), 1)), cost(own)
    for _ in range(HALVINGS):
        worse = cost(own + size * (found - own)) > before
        if not worse.any():
            break
        size[worse] *= 0.5
    return replace(state, own=own + size * (found - own))


def _drawn(expected: Expectation, readings: Readings, state: State, draws: int) -> Specimen:
    """The posterior about the most probable state, with draws from it."""
    generator = np.random.default_rng(0)
    linear = Linear(expected, readings, state)
    n, own = len(linear.weight), state.own
    factor = np.linalg.cholesky(linear.N)
    shared_draws = solve_triangular(factor, generator.standard_normal((len(factor), draws)), lower=True, trans="T")
    own_draws, noise = np.empty((*own.shape, draws)), np.empty_like(linear.weight)
    for p, pillar, marginal in linear.pillars():
        prior = generator.standard_normal((own.shape[1], draws))
        own_draws[p] = marginal.drawn(prior, generator.standard_normal((n, draws)))
        own_draws[p] -= marginal.solved(pillar.by_shared(shared_draws))[1]
        noise[:, p] = marginal.solved(pillar.misfit + pillar.J @ own[p])[0]
    k = len(expected.names)
    widths, deviations = expected.widths, np.sqrt(1.0 - linear.known[:, :2])
    return Specimen(
        expected=expected,
        state=state,
        covariance=cho_solve((factor, True), np.eye(len(factor))[:, :k])[:k],
        gain_deviation=widths.gain * deviations[:, 0],
        offset_deviation_ohm=widths.offset * expected.rest_ohm * deviations[:, 1],
        ensemble=_ensemble(expected, state, own_draws, shared_draws),
        scale=readings.scale,
        excess=float((noise**2 / linear.left)[linear.read].mean()),
    )


def without_each(found: Specimen, readings: Readings, which: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Errors of some pairs' readings as foretold by all other pairs, and how sure these are.

    Returns
    -------
    array, shape (len(which), P)
        Readings less what the other pairs foretell [Ω]; 0 where not read.
    array, shape (len(which), P, P)
        Covariance of what they foretell, without the reading's own error [Ω²].

    Notes
    -----
    The PRESS residual of linear regression, a pair at a time, about the most probable sensor: [C⁻¹]ₙₙ⁻¹ [C⁻¹ r]ₙ with
    C = 1 + J Jᵀ + A Aᵀ of all whitened readings r. Widths stay as all pairs led to them.
    """
    linear = Linear(found.expected, replace(readings, scale=found.scale), found.state)
    half = np.linalg.inv(np.linalg.cholesky(linear.N))
    step = half.T @ (half @ linear.rhs)
    shape = len(which), found.expected.n_pillars
    noise, left, by_shared = np.empty(shape), np.empty(shape), np.empty((*shape, len(half)))
    for p, pillar, marginal in linear.pillars():
        A = np.concatenate([pillar.D, pillar.J[:, pillar.rows] * pillar.factors], axis=1)
        r = pillar.misfit + pillar.J @ found.state.own[p] - A @ step[pillar.places]
        X = marginal.solved(np.column_stack([A, r]))[0][which]
        by_shared[:, p], noise[:, p] = X[:, :-1] @ half[:, pillar.places].T, X[:, -1]
        left[:, p] = marginal.left(which)
    C = -by_shared @ by_shared.swapaxes(1, 2)
    diagonal = np.arange(shape[1])
    C[:, diagonal, diagonal] += left
    covariance: FloatArray = np.linalg.inv(C).astype(np.float64, copy=False)
    error = (covariance @ noise[..., None])[..., 0]
    covariance[:, diagonal, diagonal] -= 1.0
    weight = linear.weight[which]
    deviation = np.divide(1.0, weight, out=np.zeros_like(weight), where=weight > 0)
    return error * deviation, covariance * deviation[:, None] * deviation[..., None]


def _ensemble(expected: Expectation, state: State, own: FloatArray, shared: FloatArray) -> Ensemble:
    """Draws (P, m, draws) and (g, draws) of what pillars have alone and together, as changes of their resistances."""
    widths = expected.widths
    parameters, resistivity, corrections, _ = expected.parts(shared)
    influence = np.tensordot(parameters.T, expected.by.influence[:, :, :3], axes=1)
    for draw, (alone, together) in enumerate(zip(np.moveaxis(own, 2, 0), corrections.T, strict=True)):
        influence[draw] += expected.correction(alone[:, 2:], together)
    resistance = widths.gain * own[:, 0] / expected.gain(state)[:, None] + (parameters.T @ expected.by.resistance).T
    return Ensemble(
        resistance=(resistance + widths.resistivity * resistivity).T,
        offset_ohm=widths.offset * expected.rest_ohm * own[:, 1].T,
        rest_mm=np.tensordot(parameters.T, expected.by.rest_mm[..., :3], axes=1),
        influence=influence.astype(np.float32),
        parameters=None if expected.by.by_weights is None else parameters.T,
        by_weights=expected.by.by_weights,
    )
