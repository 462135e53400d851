"""Readings of a sensor about a state of it that may be: linearised, whitened, each pillar's own unknowns marginalised.

A pillar reads R = c (Σ s (d + B G)² + ρ(G)) + o under forces F = G + χ(G). What all pillars share (parameters of the
design, resistivity, the correction that all units share, forces that are not quite known) is one vector; what is a
pillar's own is its gain, its offset and the correction of its influence.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from decoupler.inverse.strain_maps import N_AXES, N_FEATURES
from decoupler.twin.expectation import Expectation, State
from decoupler.twin.marginal import Marginal
from geometry.layout import FloatArray

MIN_NOISE = 1e-6  #: relative error that readings have at least
FOLDED = 3.0  #: change of a reading over its rest by one deviation of a parameter, beyond which a state is near a fold
CHUNK = 64  #: states whose derivatives are in memory together


@dataclass(frozen=True, kw_only=True, eq=False)
class Readings:
    """n readings of P pillars, as columns, and the Q forces under them."""

    resistance_ohm: FloatArray  #: (n, P); anything where not read
    read: NDArray[np.bool_]  #: (n, P)
    force_n: FloatArray  #: (n, Q): expected
    unknown_n: FloatArray  #: (n_unknown, Q): directions in which forces may differ, a standard deviation each
    pair: NDArray[np.int64]  #: (n_unknown,): of which pair
    deviation_ohm: FloatArray  #: (n, P): of the readings' own errors
    scale: FloatArray  #: (n,): of all deviations of a pair; above 1 if its load or its reading was not as stated

    def forces(self, unknown: FloatArray) -> FloatArray:
        """Forces on the pads (n, Q) [N] for ξ (n_unknown,)."""
        force_n = self.force_n.copy()
        np.add.at(force_n, self.pair, unknown[:, None] * self.unknown_n)
        return force_n


class Shown:
    """Squares of lengths of a sensor under forces (n, Q) [N], or in states that are known, and their derivatives.

    Squares y are resistances without offset over c [mm²]. ``there`` (n,) says which forces have a state.
    """

    def __init__(
        self, expected: Expectation, state: State, force_n: FloatArray, state_n: FloatArray | None = None
    ) -> None:
        self.expected, self.sensor = expected, expected.sensor(state)
        maps, self.force_n, self.there = self.sensor.maps, force_n, np.ones(len(force_n), dtype=bool)
        if state_n is None and maps is not None:
            state_n, self.there = maps.nearest_states(force_n)
            state_n[~self.there] = 0.0
        self.state_n = force_n if state_n is None else state_n
        vectors = self.sensor.linear.vectors(self.state_n)
        signed = vectors if self.sensor.sign is None else vectors * self.sensor.sign
        self.squares = np.einsum("ncp,ncp->np", signed, vectors)
        if maps is not None:
            self.squares += maps.values(self.state_n)[..., N_AXES:].reshape(self.squares.shape)
        self.by_vector = 2.0 * signed.transpose(0, 2, 1)  #: (n, P, C) [mm]

    @property
    def resistance_ohm(self) -> FloatArray:
        """Resistances, (n, P) [Ω]."""
        return self.sensor.ohm_per_mm2 * self.squares + self.sensor.offset_ohm

    @cached_property
    def _by_force(self) -> FloatArray:
        """Derivatives of the squares by forces at finite strain, (n, P, Q) [mm²/N]."""
        parts = []
        for start in range(0, len(self.state_n), CHUNK):
            _, by_state, _, by_force = self.sensor.at_states(self.state_n[start : start + CHUNK])
            parts.append(np.linalg.solve(by_force.swapaxes(1, 2), by_state.swapaxes(1, 2)).swapaxes(1, 2))
        return np.concatenate(parts)

    def along(self, direction_n: FloatArray, rows: NDArray[np.int64] | slice = slice(None)) -> FloatArray:
        """Change of the squares by r directions of the forces for some of the n, (·, r, Q) [N] -> (·, P, r) [mm²]."""
        if self.sensor.maps is not None:
            return self._by_force[rows] @ direction_n.swapaxes(1, 2)
        moved = (direction_n @ self.sensor.influence).reshape(*direction_n.shape[:2], *self.sensor.rest_mm.shape)
        return np.einsum("npc,nrcp->npr", self.by_vector[rows], moved)

    @cached_property
    def missed_by_maps(self) -> FloatArray:
        """Variance of the squares by what maps miss, of the squares and of the forces that lead there, (n, P) [mm⁴]."""
        maps, n = self.sensor.maps, len(self.state_n)
        assert maps is not None
        forces_n2, squares_mm4 = np.split(maps.misfit_variance(self.state_n), [N_AXES], axis=2)
        by_forces = (self._by_force**2 @ forces_n2.reshape(n, -1, 1))[..., 0]
        return np.asarray(squares_mm4.reshape(n, -1) + by_forces)

    @cached_property
    def by_parameters(self) -> FloatArray:
        """Change of the squares by the parameters, then by the resistivity, (n, P, k + 1) [mm²]."""
        expected, (n, P, C) = self.expected, self.by_vector.shape
        k = len(expected.names)
        moved = (self.state_n @ expected.by_influence.reshape(-1, expected.n_forces).T).reshape(n, k, P, C)
        by = np.einsum("npc,nkpc->npk", self.by_vector, moved + expected.by_rest_mm)
        by += self.squares[..., None] * expected.by_log_c.T
        if expected.by_weights is not None:
            maps = self.sensor.maps
            assert maps is not None
            changed = replace(maps, weights=expected.by_weights.reshape(N_FEATURES, -1))
            values = changed.values(self.state_n).reshape(n, expected.n_units, k, -1).swapaxes(1, 2)
            by += values[..., N_AXES:].reshape(n, k, P).swapaxes(1, 2)
            by -= self.along(values[..., :N_AXES].reshape(n, k, -1))
        return np.concatenate([by, expected.widths.resistivity * self.squares[..., None]], axis=2)

    def far_from_folds(self) -> NDArray[np.bool_]:
        """Where a state is known that a deviation of a parameter moves little, (n,)."""
        if self.sensor.maps is None:
            return self.there
        by_rest = np.abs(self.by_parameters).max(axis=2) / self.expected.rest_ohm * self.expected.forward.ohm_per_mm2
        return self.there & (by_rest.max(axis=1) < FOLDED)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pillar:
    """Readings of one pillar, linearised about a state and whitened: misfit ≈ D x + J (z + T y).

    x are parameters, resistivity and unknown parts of forces, z the pillar's own unknowns as `State` has them. A shared
    correction y moves a pillar as one of its own would: T has one entry a column.
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
        self.shown = shown = Shown(expected, state, readings.forces(expected.parts(state.shared)[3]))
        c, ohms = shown.sensor.ohm_per_mm2, readings.resistance_ohm
        self.read = readings.read & shown.far_from_folds()[:, None]
        misfit_ohm2 = (expected.widths.misfit * (ohms - shown.sensor.linear.at_rest_ohm())) ** 2
        variance = readings.deviation_ohm**2 + (MIN_NOISE * ohms) ** 2 + misfit_ohm2
        if shown.sensor.maps is not None:
            variance += c**2 * shown.missed_by_maps
        #: one over the deviation of each reading, (n, P) [1/Ω], 0 where not read; misfit's fraction of the variance
        self.weight = self.read / (np.sqrt(variance) * readings.scale[:, None])
        self.unsure = self.read * misfit_ohm2 / variance
        self._misfit = self.weight * (ohms - shown.resistance_ohm)
        self._by_squares = c * self.weight
        self._by_gain = expected.widths.gain * self._by_squares * shown.squares / expected.gain(state)
        self._by_parameters = self._by_squares[..., None] * shown.by_parameters
        along = shown.along(readings.unknown_n[:, None], readings.pair)[..., 0]
        self._by_unknown = self._by_squares[readings.pair] * along  # (n_unknown, P)
        self.N, self.rhs = np.eye(len(state.shared)), -state.shared
        self.known, self.left = np.empty((expected.n_pillars, 3)), np.empty(self.weight.shape)
        self._half = []
        for p in range(expected.n_pillars):
            pillar = self.pillar(p)
            marginal = Marginal(pillar.J)
            self._half.append(marginal.half)
            self.known[p], self.left[:, p] = marginal.known(2), marginal.left()
            y = pillar.misfit + pillar.J @ state.own[p]
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
        expected, shown, widths = self.expected, self.shown, self.expected.widths
        n, Q, k, pair = len(self.weight), expected.n_forces, len(expected.names), self.readings.pair
        n_axes, kinds, n_near = Q // expected.n_units, expected.n_pillars // expected.n_units, expected.near.shape[1]
        unit, kind = divmod(p, kinds)
        D = np.zeros((n, k + 1 + len(pair)))
        D[:, : k + 1] = self._by_parameters[:, p]
        D[pair, k + 1 + np.arange(len(pair))] = self._by_unknown[:, p]
        J = np.empty((n, 2 + 3 * Q))
        J[:, 0] = self._by_gain[:, p]
        J[:, 1] = widths.offset * expected.rest_ohm[p] * self.weight[:, p]
        slope = self._by_squares[:, p, None] * shown.by_vector[:, p, :3]
        moved = shown.state_n * (expected.sizes[p] * widths.own * expected.reached[p])
        np.multiply(slope[..., None], moved[:, None], out=J[:, 2:].reshape(n, 3, Q))
        near = np.flatnonzero(expected.near[unit] >= 0)
        forces = (expected.near[unit, near, None] * n_axes + np.arange(n_axes)).ravel()
        columns = (near[:, None] * n_axes + np.arange(n_axes)).ravel()
        of_axis = np.arange(3)[:, None]
        ratio = np.repeat(expected.near_mm_per_n[near] * widths.shared, n_axes)
        ratio = ratio / (expected.sizes[p, forces] * widths.own)
        first = k + 1 + 3 * n_near * n_axes * kind
        unknown = k + 1 + expected.n_corrections + np.arange(len(pair))
        return Pillar(
            D=D,
            J=J,
            misfit=self._misfit[:, p],
            places=np.concatenate([np.arange(k + 1), unknown, (first + of_axis * n_near * n_axes + columns).ravel()]),
            rows=(2 + of_axis * Q + forces).ravel(),
            factors=np.tile(ratio, 3),
        )

    def pillars(self) -> Iterator[tuple[int, Pillar, Marginal]]:
        """Each pillar with its number and its marginal."""
        for p, half in enumerate(self._half):
            pillar = self.pillar(p)
            yield p, pillar, Marginal(pillar.J, half)
