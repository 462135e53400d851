"""Readings of a sensor about a state of it that may be: linearised, whitened, each pillar's own unknowns marginalised.

A pillar reads R = c (Σ s (d + B G)² + ρ(G)) + o under forces F = G + χ(G). What all pillars share (parameters of the
design, resistivity, the correction that all units share, forces that are not quite known) is one vector; what is a
pillar's own is its gain, its offset and the correction of its influence.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dtrtri

from decoupler.inverse.sensor_model import PredictedReadings
from decoupler.inverse.strain_maps import N_AXES
from decoupler.twin.expectation import Expectation, State
from geometry.layout import FloatArray

MIN_NOISE = 1e-6  #: relative error that readings have at least
FOLDED = 3.0  #: change of a reading over its rest by one deviation of a parameter, beyond which a state is near a fold


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


class Marginal:
    """S⁻¹ of S = I + J Jᵀ: whitened readings of a pillar, its own unknowns marginalised.

    J is (n, m). With fewer readings than unknowns S itself is factored, else I + Jᵀ J. `half` is the factor's inverse,
    if it is known from before.
    """

    def __init__(self, J: FloatArray, half: FloatArray | None = None) -> None:
        self.J, self.dual = J, len(J) <= J.shape[1]
        if half is None:
            M = J @ J.T if self.dual else J.T @ J
            M.flat[:: len(M) + 1] += 1.0
            lower, failed = dpotrf(M.T, lower=1, overwrite_a=1)
            if failed:
                raise np.linalg.LinAlgError("the readings' covariance is not positive definite")
            half = np.tril(dtrtri(lower, lower=1, overwrite_c=1)[0])
        self.half = half  # halfᵀ half is the inverse

    def _inverse(self, X: FloatArray) -> FloatArray:
        return np.asarray(self.half.T @ (self.half @ X))

    def solved(self, Y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """X = S⁻¹ Y, (n, ...), and Jᵀ X, (m, ...)."""
        if self.dual:
            X = self._inverse(Y)
            return X, self.J.T @ X
        K = self._inverse(self.J.T @ Y)
        return Y - self.J @ K, K

    def drawn(self, prior: FloatArray, noise: FloatArray) -> FloatArray:
        """Draws of the pillar's own unknowns about their means, (m, draws), from draws of prior and noise."""
        if self.dual:
            return prior - self.J.T @ self._inverse(self.J @ prior + noise)
        return self._inverse(prior - self.J.T @ noise)

    def between(self, columns: np.ndarray) -> FloatArray:
        """These rows and columns of Jᵀ S⁻¹ J."""
        if self.dual:
            H = self.half @ self.J[:, columns]
            return np.asarray(H.T @ H)
        H = self.half[:, columns]
        return np.asarray(np.eye(len(columns)) - H.T @ H)

    def left(self, which: np.ndarray | None = None) -> FloatArray:
        """Diagonal of S⁻¹ of some or all readings: what is left of each; of all, if more than unknowns, their mean."""
        n, m = self.J.shape
        if self.dual:
            left = np.asarray((self.half**2).sum(axis=0))
            return left if which is None else left[which]
        if which is None:
            return np.full(n, 1.0 - (m - (self.half**2).sum()) / n)
        return np.asarray(1.0 - ((self.half @ self.J[which].T) ** 2).sum(axis=0))

    def known(self, alone: int) -> FloatArray:
        """Diagonal of Jᵀ S⁻¹ J: its first `alone` entries, then the sum of the others."""
        n, m = self.J.shape
        first = self.between(np.arange(alone)).diagonal()
        total = n - (self.half**2).sum() if self.dual else m - (self.half**2).sum()
        return np.append(first, total - first.sum())


class Linear:
    """All readings about a state, linearised and whitened; each pillar's own unknowns are marginalised.

    ``N`` and ``rhs`` are (1 + Σ Aᵀ S⁻¹ A) and Σ Aᵀ S⁻¹ r − x of what pillars share.
    """

    def __init__(self, expected: Expectation, readings: Readings, state: State) -> None:
        self.expected, self.readings, self.state = expected, readings, state
        sensor = expected.sensor(state)
        self.at = at = sensor.under(readings.forces(expected.parts(state.shared)[3]))
        c, ohms, by_parameters = sensor.ohm_per_mm2, readings.resistance_ohm, expected.by_parameters(at)
        misfit_ohm2 = (expected.widths.misfit * (ohms - sensor.linear.at_rest_ohm())) ** 2
        variance = readings.deviation_ohm**2 + (MIN_NOISE * ohms) ** 2 + misfit_ohm2
        self.read = readings.read & at.there[:, None]
        if sensor.maps is not None:
            by_rest = np.abs(by_parameters).max(axis=2) / expected.rest_ohm * expected.forward.ohm_per_mm2
            self.read &= (by_rest.max(axis=1) < FOLDED)[:, None]
            variance += c**2 * _missed_by_maps(at)
        #: one over the deviation of each reading, (n, P) [1/Ω], 0 where not read; misfit's fraction of the variance
        self.weight = self.read / (np.sqrt(variance) * readings.scale[:, None])
        self.unsure = self.read * misfit_ohm2 / variance
        self._misfit = self.weight * (ohms - at.resistance_ohm)
        self._by_squares = c * self.weight
        self._by_gain = expected.widths.gain * self._by_squares * at.squares / expected.gain(state)
        self._by_parameters = self._by_squares[..., None] * by_parameters
        along = at.along(readings.unknown_n[:, None], readings.pair)[..., 0]
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
        expected, at, widths = self.expected, self.at, self.expected.widths
        n, Q, k, pair = len(self.weight), expected.n_forces, len(expected.names), self.readings.pair
        n_axes, kinds, n_near = Q // expected.n_units, expected.n_pillars // expected.n_units, expected.near.shape[1]
        unit, kind = divmod(p, kinds)
        D = np.zeros((n, k + 1 + len(pair)))
        D[:, : k + 1] = self._by_parameters[:, p]
        D[pair, k + 1 + np.arange(len(pair))] = self._by_unknown[:, p]
        J = np.empty((n, 2 + 3 * Q))
        J[:, 0] = self._by_gain[:, p]
        J[:, 1] = widths.offset * expected.rest_ohm[p] * self.weight[:, p]
        slope = self._by_squares[:, p, None] * at.by_vector[:, p, :3]
        moved = at.state_n * (expected.sizes[p] * widths.own * expected.reached[p])
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


def _missed_by_maps(at: PredictedReadings) -> FloatArray:
    """Variance of the squares by what maps miss, of the squares and of the forces that lead there, (n, P) [mm⁴]."""
    maps, n = at.sensor.maps, len(at.state_n)
    assert maps is not None
    forces_n2, squares_mm4 = np.split(maps.misfit_variance(at.state_n), [N_AXES], axis=2)
    by_force = at.along(np.broadcast_to(np.eye(at.state_n.shape[1]), at.slopes[1].shape))
    return np.asarray(squares_mm4.reshape(n, -1) + (by_force**2 @ forces_n2.reshape(n, -1, 1))[..., 0])
