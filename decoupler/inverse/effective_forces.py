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


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectiveForces:
    """F = G + χ(G) of an array of k units. χ of a pad is Σᵢⱼ oᵢ zⱼ Wᵢⱼ.

    o are the `OWN` numbers of the pad, z these, those of its neighbours (0 where there is none), and the products of
    two of o: χ has terms of the second and of the third order, and none at rest.
    """

    influence: FloatArray  #: B of the linear array, (3 k, 6 k) as in `ForwardModel` [mm/N]
    near: NDArray[np.int64]  #: neighbours of each pad, (k, 8); k where there is none
    sizes: FloatArray  #: of o, by which it is divided, (9,) [N, mm]
    weights: FloatArray  #: W, (9, 126, 3) [N]
    misfit_n: FloatArray  #: root mean square of what χ misses on samples that it has not seen, (3,) [N]

    def actual(self, effective_n: FloatArray) -> FloatArray:
        """Forces F that act where G is effective, both (n, 3 k) [N]; the same bits alone and in any batch."""
        o = self.own(effective_n)
        mapped = rowwise(self.around(o).reshape(-1, self.weights.shape[1]), self._by_around)
        found = (o[..., None] * mapped.reshape(*o.shape, 3)).sum(axis=2)
        return np.asarray(effective_n + found.reshape(effective_n.shape))

    def own(self, effective_n: FloatArray) -> FloatArray:
        """o, effective forces and linear displacements of each pad over their sizes, (n, 3 k) [N] -> (n, k, 9)."""
        n, k = len(effective_n), len(self.near)
        moved = rowwise(effective_n, self.influence).reshape(n, 3, k, 2)
        o = np.empty((n, k, OWN))
        o[..., :3] = effective_n.reshape(n, k, 3)
        o[..., 3:] = moved.transpose(0, 2, 3, 1).reshape(n, k, 6)
        o /= self.sizes
        return o

    def around(self, own: FloatArray) -> FloatArray:
        """z of each pad, (n, k, 9) -> (n, k, 126)."""
        n, k, _ = own.shape
        padded = np.zeros((n, k + 1, OWN))
        padded[:, :k] = own
        first, second = _PAIRS
        return np.concatenate([own, padded[:, self.near].reshape(n, k, -1), own[..., first] * own[..., second]], axis=2)

    def jacobian(self, effective_n: FloatArray) -> tuple[FloatArray, FloatArray]:
        """F (n, 3 k) [N] and its derivatives by G, (n, 3 k, 3 k)."""
        n, k = len(effective_n), len(self.near)
        o = self.own(effective_n)
        mapped = (self.around(o) @ self._by_around).reshape(n, k, OWN, 3)
        by_around = np.einsum("nui,ijc->nucj", o, self.weights)  # (n, k, 3, 126)
        first, second = _PAIRS
        by_own = mapped.swapaxes(2, 3) + by_around[..., :OWN]
        of_pairs = by_around[..., 9 * OWN :]
        for own in range(OWN):
            by_own[..., own] += (of_pairs[..., first == own] * o[:, :, None, second[first == own]]).sum(axis=3)
            by_own[..., own] += (of_pairs[..., second == own] * o[:, :, None, first[second == own]]).sum(axis=3)
        J = np.einsum("nuco,uof->nucf", by_own, self._own_by_force)
        padded = np.concatenate([self._own_by_force, np.zeros((1, *self._own_by_force.shape[1:]))])
        J += np.einsum(
            "nucl,ulf->nucf",
            by_around[..., OWN : 9 * OWN],
            padded[self.near].reshape(k, 8 * OWN, -1),
            optimize=True,
        )
        force_n = effective_n + (o[..., None] * mapped).sum(axis=2).reshape(n, -1)
        return force_n, np.eye(3 * k) + J.reshape(n, 3 * k, 3 * k)

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
    def _by_around(self) -> FloatArray:
        """W as a matrix from z, (126, 27)."""
        return np.ascontiguousarray(self.weights.transpose(1, 0, 2).reshape(self.weights.shape[1], -1))

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
