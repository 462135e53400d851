"""Forces at finite strain from effective ones: those that would explain the readings if the array were linear.

Any readings of an array have forces G that cause them by the linear response and eq. 1, found as fast as ever. The
forces that act are F = G + χ(G), with χ a polynomial of the state of the pad itself and of its eight neighbours, the
same for every pad and learned from few samples at finite strain. G says how the rubber is deformed, and forces are
nearly polynomials of that; deformations are none of the forces, since columns give way under pressure.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dataset.samples import SampleError
from decoupler.data.columns import rowwise
from geometry.layout import FloatArray

MAX_STEPS = 40  #: damped Newton steps from forces to effective ones; five are usual
CONVERGED = 1e-10  #: relative to the largest force
FIRST_DAMPING = 1e-3  #: of the steps, where derivatives are of the order of 1
LAST_DAMPING = 1e3  #: at which a sample comes no nearer
BEYOND = 10.0  #: misfit of the samples at finite strain over which forces are beyond them
CHUNK = 64  #: samples whose derivatives are in memory together
OWN = 9  #: of a pad: its three effective forces, and the linear displacements of its two electrodes
_PAIRS = np.triu_indices(OWN)  #: numbers of each two of them
N_PAIRS = len(_PAIRS[0])
#: pairs of the pressing force and of the displacements that it causes: these bend what neighbours do
_PRESSING = np.flatnonzero(np.isin(_PAIRS[0], [2, 3, 4, 5, 8]) & np.isin(_PAIRS[1], [2, 3, 4, 5, 8]))
_SLOPES = np.zeros((N_PAIRS, OWN, OWN))  #: derivatives of the pairs by o, as matrices that are multiplied by o
_SLOPES[np.arange(N_PAIRS), _PAIRS[0], _PAIRS[1]] += 1.0
_SLOPES[np.arange(N_PAIRS), _PAIRS[1], _PAIRS[0]] += 1.0
#: numbers of what o is multiplied by, of what pressing pairs are, and of neighbours' pairs
_WITH_OWN, _WITH_PRESSING, _ALONE = 9 * OWN + N_PAIRS, 8 * OWN, 8 * N_PAIRS
N_FEATURES = OWN * _WITH_OWN + len(_PRESSING) * _WITH_PRESSING + _ALONE


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectiveForces:
    """F = G + χ(G) of an array of k units, χ a sum of products of o, the `OWN` numbers of a pad and of its neighbours.

    All products are of the second or the third order, so that at rest and under light loads the array is linear.
    """

    influence: FloatArray  #: B of the linear array, (3 k, 6 k) as in `ForwardModel` [mm/N]
    near: NDArray[np.int64]  #: neighbours of each pad, (k, 8); k where there is none
    sizes: FloatArray  #: of o, by which it is divided, (9,) [N, mm]
    weights: FloatArray  #: of the features, (N_FEATURES, 3) [N]
    misfit_n: FloatArray  #: root mean square of what χ misses on samples that it has not seen, (3,) [N]

    def actual(self, effective_n: FloatArray) -> FloatArray:
        """Forces F that act where G is effective, both (n, 3 k) [N]; the same bits alone and in any batch."""
        n, k = len(effective_n), len(self.near)
        o, around, pairs, pairs_around = self._parts(effective_n)
        with_own, with_pressing, alone = self._maps
        z = np.concatenate([o, around, pairs], axis=2)
        found = rowwise(pairs_around.reshape(n * k, -1), alone).reshape(n, k, 3)
        for factor, values, matrix in ((o, z, with_own), (pairs[..., _PRESSING], around, with_pressing)):
            mapped = rowwise(values.reshape(n * k, -1), matrix).reshape(n, k, -1, 3)
            found += (factor[..., None] * mapped).sum(axis=2)
        return effective_n + found.reshape(n, -1)

    def features(self, effective_n: FloatArray) -> FloatArray:
        """Features of each pad, (n, 3 k) [N] -> (n, k, N_FEATURES)."""
        o, around, pairs, pairs_around = self._parts(effective_n)
        shape = (*o.shape[:2], -1)
        z = np.concatenate([o, around, pairs], axis=2)
        return np.concatenate(
            [
                (o[..., :, None] * z[..., None, :]).reshape(shape),
                (pairs[..., _PRESSING, None] * around[..., None, :]).reshape(shape),
                pairs_around,
            ],
            axis=2,
        )

    def own(self, effective_n: FloatArray) -> FloatArray:
        """o, effective forces and linear displacements of each pad over their sizes, (n, 3 k) [N] -> (n, k, 9)."""
        n, k = len(effective_n), len(self.near)
        moved = rowwise(effective_n, self.influence).reshape(n, 3, k, 2)
        o = np.empty((n, k, OWN))
        o[..., :3] = effective_n.reshape(n, k, 3)
        o[..., 3:] = moved.transpose(0, 2, 3, 1).reshape(n, k, 6)
        o /= self.sizes
        return o

    def _parts(self, effective_n: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """o of each pad, o of its neighbours, pairs of its own and of each neighbour: (n, k, 9, 72, 45 and 360)."""
        n, k = len(effective_n), len(self.near)
        both = np.zeros((n, k + 1, OWN + N_PAIRS))
        o = both[:, :k, :OWN] = self.own(effective_n)
        pairs = both[:, :k, OWN:] = o[..., _PAIRS[0]] * o[..., _PAIRS[1]]
        near = both[:, self.near]
        return o, near[..., :OWN].reshape(n, k, -1), pairs, near[..., OWN:].reshape(n, k, -1)

    def jacobian(self, effective_n: FloatArray) -> tuple[FloatArray, FloatArray]:
        """F (n, 3 k) [N] and its derivatives by G, (n, 3 k, 3 k)."""
        n, k = len(effective_n), len(self.near)
        o, around, pairs, _ = self._parts(effective_n)
        with_own, with_pressing, alone = self._maps
        z = np.concatenate([o, around, pairs], axis=2)
        by_factor = (z @ with_own).reshape(n, k, OWN, 3).swapaxes(2, 3)  # (n, k, 3, 9)
        by_z = np.tensordot(o, with_own.reshape(-1, OWN, 3), (2, 1)).swapaxes(2, 3)  # (n, k, 3, 126)
        by_pressing = (around @ with_pressing).reshape(n, k, -1, 3).swapaxes(2, 3)
        by_around = by_z[..., OWN : 9 * OWN] + np.tensordot(
            pairs[..., _PRESSING], with_pressing.reshape(_WITH_PRESSING, -1, 3), (2, 1)
        ).swapaxes(2, 3)
        slopes = np.tensordot(o, _SLOPES, (2, 2))  # (n, k, 45, 9): of the pairs by o
        by_own = by_factor + by_z[..., :OWN] + by_z[..., 9 * OWN :] @ slopes
        by_own += by_pressing @ slopes[:, :, _PRESSING]
        around_slopes = np.concatenate([slopes, np.zeros((n, 1, N_PAIRS, OWN))], axis=1)[:, self.near]
        alone_of = alone.reshape(8, N_PAIRS, 3).swapaxes(1, 2)
        by_around = by_around + (alone_of @ around_slopes).transpose(0, 1, 3, 2, 4).reshape(by_around.shape)
        of_none = np.zeros((1, *self._own_by_force.shape[1:]))
        around_by_force = np.concatenate([self._own_by_force, of_none])[self.near].reshape(k, 8 * OWN, -1)
        J = (by_own.swapaxes(0, 1) @ self._own_by_force[:, None].reshape(k, 1, OWN, -1)).swapaxes(0, 1)
        J = J + (by_around.swapaxes(0, 1) @ around_by_force[:, None]).swapaxes(0, 1)
        return self.actual(effective_n), np.eye(3 * k) + J.reshape(n, 3 * k, 3 * k)

    def effective(self, force_n: FloatArray) -> FloatArray:
        """Effective forces G of those that act, both (n, 3 k) [N].

        Raises
        ------
        SampleError
            If there are none: forces beyond those of the samples at finite strain.

        Notes
        -----
        Damped Newton steps. Where a column nearly gives way, χ can miss the forces that it bears by as much as its
        misfit: there the G whose forces are nearest counts.
        """
        found = np.array(force_n, dtype=np.float64)
        for start in range(0, len(found), CHUNK):
            part = slice(start, start + CHUNK)
            found[part] = self._solved(found[part])
        return found

    def _solved(self, force_n: FloatArray) -> FloatArray:
        found, enough = force_n.copy(), CONVERGED * max(np.abs(force_n).max(), 1.0)
        misfit, J = self._misfit(force_n, found)
        damping = np.full(len(found), FIRST_DAMPING)
        for _ in range(MAX_STEPS):
            on = np.flatnonzero((np.abs(misfit).max(axis=1) > enough) & (damping < LAST_DAMPING))
            if not len(on):
                break
            Jt = J[on].swapaxes(1, 2)
            M = Jt @ J[on] + damping[on, None, None] * np.eye(J.shape[1])
            trial = found[on] + np.linalg.solve(M, Jt @ misfit[on, :, None])[..., 0]
            after, J_after = self._misfit(force_n[on], trial)
            better = np.linalg.norm(after, axis=1) < np.linalg.norm(misfit[on], axis=1)
            found[on[better]], misfit[on[better]], J[on[better]] = trial[better], after[better], J_after[better]
            damping[on] *= np.where(better, 0.1, 10.0)
        left = np.sqrt((misfit.reshape(len(misfit), -1, 3) ** 2).mean(axis=1))
        if (left > BEYOND * self.misfit_n + enough).any():
            raise SampleError(
                f"no deformation that the model knows bears forces of up to {np.abs(force_n).max():.4g} N on a pad: "
                "they are beyond its samples at finite strain. Train on samples of such forces."
            )
        return found

    def _misfit(self, force_n: FloatArray, effective_n: FloatArray) -> tuple[FloatArray, FloatArray]:
        found, J = self.jacobian(effective_n)
        return force_n - found, J

    @cached_property
    def _maps(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Weights as matrices: from z (126, 27), from neighbours' o (72, 45), from neighbours' pairs (360, 3)."""
        ends = np.cumsum([OWN * _WITH_OWN, len(_PRESSING) * _WITH_PRESSING])
        own, pressing, alone = np.split(self.weights, ends)
        with_own, with_pressing = (
            np.ascontiguousarray(part.reshape(-1, size, 3).swapaxes(0, 1).reshape(size, -1))
            for part, size in ((own, _WITH_OWN), (pressing, _WITH_PRESSING))
        )
        return with_own, with_pressing, alone

    @cached_property
    def _own_by_force(self) -> FloatArray:
        """Derivatives of o by G, (k, 9, 3 k)."""
        return np.ascontiguousarray(self.own(np.eye(3 * len(self.near))).transpose(1, 2, 0))


def neighbours(rows: int, cols: int) -> NDArray[np.int64]:
    """Numbers of the eight neighbours of each unit, (rows·cols, 8); rows·cols where there is none.

    >>> neighbours(1, 2).tolist()
    [[2, 2, 2, 2, 1, 2, 2, 2], [2, 2, 2, 0, 2, 2, 2, 2]]
    """
    padded = np.full((rows + 2, cols + 2), rows * cols)
    padded[1:-1, 1:-1] = np.arange(rows * cols).reshape(rows, cols)
    shifts = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    return np.stack([padded[i : i + rows, j : j + cols].reshape(-1) for i, j in shifts], axis=1)
