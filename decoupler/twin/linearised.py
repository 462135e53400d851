"""Readings of a sensor about a state of it that may be: linearised, whitened, each pillar's own unknowns marginalised.

A pillar reads R = g c Σ s (d + B F)² + o. What all pillars share (parameters of the design, resistivity, the correction
that all units share, forces that are not quite known) is one vector; what is a pillar's own is its gain, its offset and
the correction of its influence.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dataset.measurement import reading_deviation
from decoupler.twin.expectation import Expectation
from decoupler.twin.marginal import Marginal
from geometry.layout import FloatArray

MIN_NOISE = 1e-6  #: relative error that readings have at least


@dataclass(frozen=True, kw_only=True, eq=False)
class Readings:
    """n readings of P pillars, as columns, and the Q forces under them."""

    resistance_ohm: FloatArray  #: (n, P); anything where not read
    read: NDArray[np.bool_]  #: (n, P)
    force_n: FloatArray  #: (n, Q): expected
    unknown_n: FloatArray  #: (n_unknown, Q): directions in which forces may differ, a standard deviation each
    pair: NDArray[np.int64]  #: (n_unknown,): of which pair
    noise: float
    bits: int | None
    scale: FloatArray  #: (n,): of all deviations of a pair; above 1 if its load or its reading was not as stated

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


def forces_under(readings: Readings, unknown: FloatArray) -> FloatArray:
    """Forces on the pads (n, Q) [N] for ξ (n_unknown,)."""
    force_n = readings.force_n.copy()
    np.add.at(force_n, readings.pair, unknown[:, None] * readings.unknown_n)
    return force_n


def own_unknowns(expected: Expectation, state: State) -> FloatArray:
    """Gain, offset and correction of each pillar, (P, 2 + 3Q), in standard deviations."""
    widths = expected.widths
    parts = [
        (state.gain[:, None] - 1.0) / widths.gain,
        (state.offset_ohm / (widths.offset * expected.rest_ohm))[:, None],
        (state.own / (widths.own * expected.sizes[:, None])).reshape(len(state.gain), -1),
    ]
    return np.concatenate(parts, axis=1)


def with_own(expected: Expectation, state: State, own: FloatArray) -> State:
    """The state with these unknowns of the pillars, as `own_unknowns` has them."""
    widths = expected.widths
    return replace(
        state,
        gain=1.0 + widths.gain * own[:, 0],
        offset_ohm=widths.offset * expected.rest_ohm * own[:, 1],
        own=own[:, 2:].reshape(state.own.shape) * (widths.own * expected.sizes[:, None]),
    )


def shown(expected: Expectation, state: State, force_n: FloatArray) -> tuple[FloatArray, FloatArray]:
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


def flat(state: State) -> FloatArray:
    """All that pillars share, as one vector."""
    return np.concatenate([state.parameters, [state.resistivity], state.shared.ravel(), state.unknown])


@dataclass(frozen=True, kw_only=True, eq=False)
class Pillar:
    """Readings of one pillar, linearised about a state and whitened: misfit ≈ D x + J (z + T y).

    x are parameters, resistivity and unknown parts of forces, z the pillar's own unknowns as `own_unknowns` has them. A
    shared correction y moves a pillar as one of its own would: T has one entry a column.
    """

    D: FloatArray  #: (n, k + 1 + n_unknown)
    J: FloatArray  #: (n, m)
    misfit: FloatArray  #: r, (n,): readings less model
    places: NDArray[np.int64]  #: of x, then of y, among all that is shared
    rows: NDArray[np.int64]  #: (n_y,): of T's entries, among z
    factors: FloatArray  #: (n_y,): these entries

    def by_shared(self, shared: FloatArray) -> FloatArray:
        """Whitened readings (n, ...) by what is shared, (g, ...)."""
        x, y = np.split(shared[self.places], [self.D.shape[1]])
        z = np.zeros((self.J.shape[1], *y.shape[1:]))
        z[self.rows] = (self.factors * y.T).T
        return self.D @ x + self.J @ z


class Linear:
    """All readings about a state, linearised and whitened; each pillar's own unknowns are marginalised.

    ``N`` and ``rhs`` are (1 + Σ Aᵀ S⁻¹ A) and Σ Aᵀ S⁻¹ r − x of what pillars share.
    """

    def __init__(self, expected: Expectation, readings: Readings, state: State) -> None:
        self.expected, self.readings, self.state = expected, readings, state
        self.weight, self.unsure = _weights(expected, readings, state)
        self.own = own_unknowns(expected, state)
        self._force_n = forces_under(readings, state.unknown)
        v, modelled = shown(expected, state, self._force_n)
        self._misfit = self.weight * (readings.resistance_ohm - state.gain * modelled - state.offset_ohm)
        self._gain = self.weight * modelled
        self._slope = (2.0 * state.gain * state.ohm_per_mm2(expected) * self.weight)[..., None] * expected.sign * v
        self._B = state.influence(expected)
        x, P = flat(state), expected.n_pillars
        self.N, self.rhs = np.eye(len(x)), -x
        self.known, self.left = np.empty((P, 3)), np.empty(self.weight.shape)
        self._half = []
        for p in range(P):
            pillar = self.pillar(p)
            marginal = Marginal(pillar.J)
            self._half.append(marginal.half)
            self.known[p], self.left[:, p] = marginal.known(2), marginal.left()
            y = pillar.misfit + pillar.J @ self.own[p]
            X, Z = marginal.solved(np.column_stack([pillar.D, y]))
            by_y = Z[pillar.rows] * pillar.factors[:, None]
            among_y = marginal.between(pillar.rows) * np.outer(pillar.factors, pillar.factors)
            sums = pillar.D.T @ X
            self.N[np.ix_(pillar.places, pillar.places)] += np.block(
                [[sums[:, :-1], by_y[:, :-1].T], [by_y[:, :-1], among_y]]
            )
            self.rhs[pillar.places] += np.concatenate([sums[:, -1], by_y[:, -1]])

    def pillar(self, p: int) -> Pillar:
        """Pillar number p."""
        expected, state, pair = self.expected, self.state, self.readings.pair
        k, Q, (kinds, _, n_shared) = len(expected.names), expected.influence.shape[2], state.shared.shape
        n, n_axes = len(self.weight), Q // expected.n_units
        unit, kind = divmod(p, kinds)
        s, scaled, widths = self._slope[:, p], state.gain[p] * self._gain[:, p], expected.widths
        moved = (self._force_n @ expected.by_influence[:, p].reshape(-1, Q).T).reshape(n, k, s.shape[1])
        D = np.zeros((n, k + 1 + len(pair)))
        D[:, :k] = np.einsum("nc,nkc->nk", s, moved + expected.by_rest_mm[:, p])
        D[:, :k] += scaled[:, None] * expected.by_log_c[:, p]
        D[:, k] = widths.resistivity * scaled
        D[pair, k + 1 + np.arange(len(pair))] = (s[pair] * (self.readings.unknown_n @ self._B[p].T)).sum(axis=1)
        sizes_n = self._force_n * (expected.sizes[p] * widths.own)
        J = np.empty((n, 2 + 3 * Q))
        J[:, 0] = widths.gain * self._gain[:, p]
        J[:, 1] = widths.offset * expected.rest_ohm[p] * self.weight[:, p]
        np.multiply(s[:, :3, None], sizes_n[:, None], out=J[:, 2:].reshape(n, 3, Q))
        near = np.flatnonzero(expected.near[unit] >= 0)
        forces = (expected.near[unit, near, None] * n_axes + np.arange(n_axes)).ravel()
        columns = (near[:, None] * n_axes + np.arange(n_axes)).ravel()
        of_axis = np.arange(3)[:, None]
        ratio = np.repeat(expected.near_mm_per_n[near] * widths.shared, n_axes)
        ratio = ratio / (expected.sizes[p, forces] * widths.own)
        first = k + 1 + 3 * n_shared * kind
        places = [np.arange(k + 1), k + 1 + state.shared.size + np.arange(len(pair))]
        return Pillar(
            D=D,
            J=J,
            misfit=self._misfit[:, p],
            places=np.concatenate([*places, (first + of_axis * n_shared + columns).ravel()]),
            rows=(2 + of_axis * Q + forces).ravel(),
            factors=np.tile(ratio, 3),
        )

    def pillars(self) -> Iterator[tuple[int, Pillar, Marginal]]:
        """Each pillar with its number and its marginal."""
        for p, half in enumerate(self._half):
            pillar = self.pillar(p)
            yield p, pillar, Marginal(pillar.J, half)
