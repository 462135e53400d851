"""Finite strain: an array's state is the forces G that would move its electrodes so if the array were linear.

The state says how the rubber is deformed. The forces that act are F = G + χ(G), and the resistances, as squares of
lengths, are those of the linear array at G with ρ(G) added: two polynomials of the state of the pad itself and of its
eight neighbours, the same for every pad, learned from few samples at finite strain whose displacements are known. No
readings are turned around for it: where conduction is far from linear these may have several states, or none.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dataset.samples import SampleError
from decoupler.data.columns import eye, namespace, rowwise
from decoupler.solve import descended
from geometry.layout import FloatArray

MAX_STEPS = 40  #: damped Newton steps from forces to states; five are usual
CONVERGED = 1e-10  #: relative to the largest force
DAMPING = 1e-3, 1e3  #: the first one, where derivatives are of the order of 1, and that at which a sample has ended
BEYOND = 10.0  #: misfit of the samples at finite strain over which forces are beyond them
N_AXES = 3  #: forces of a pad
CHUNK_SAMPLES = 64  #: samples whose derivatives are in memory together
N_OWN = 9  #: of a pad: its three states, and the linear displacements of its first and its last electrode
_PAIRS = np.triu_indices(N_OWN)  #: numbers of each two of them
N_PAIRS = len(_PAIRS[0])
#: pairs of the pressing force and of the displacements that it causes: these bend what neighbours do
_PRESSING = np.flatnonzero(np.isin(_PAIRS[0], [2, 3, 4, 5, 8]) & np.isin(_PAIRS[1], [2, 3, 4, 5, 8]))
_SIDES = np.array([1, 3, 4, 6])  #: neighbours that share a side
_FOURS = np.triu_indices(N_PAIRS)  #: numbers of each two pairs
_PAIR_OF = np.empty((N_OWN, N_OWN), dtype=int)  #: and of those by two
_FOUR_OF = np.empty((N_PAIRS, N_PAIRS), dtype=int)
for _numbers, _two in ((_PAIR_OF, _PAIRS), (_FOUR_OF, _FOURS)):
    _numbers[_two] = _numbers.T[_two] = np.arange(len(_two[0]))
#: numbers of what o is multiplied by, of what pressing pairs are, and of neighbours' pairs
WITH_OWN, _WITH_PRESSING, _ALONE = 9 * N_OWN + 5 * N_PAIRS, 8 * N_OWN, 8 * N_PAIRS
_ENDS = np.cumsum([N_OWN * WITH_OWN, len(_PRESSING) * _WITH_PRESSING, _ALONE, len(_FOURS[0])])
N_CURVED = int(_ENDS[-1])  #: features of the second to the fourth order
N_FEATURES = N_CURVED + 1 + 9 * N_OWN  #: with 1, o and neighbours' o, which one specimen has beside its design
#: prior sizes of the features' shares in χ and ρ, by orders and neighbours (maximum likelihood, in the mean of both)
SCALES = np.concatenate(
    [
        np.tile(np.repeat([2.4, 0.18, 0.7, 0.09], [N_OWN, 8 * N_OWN, N_PAIRS, 4 * N_PAIRS]), N_OWN),
        np.repeat([0.11, 0.29, 0.1], np.diff(_ENDS)),
    ]
)

#: products of three, each once: numbers of the first and of the pair of the others
_TRIPLES = np.array([(i, n) for i in range(N_OWN) for n in range(N_PAIRS) if _PAIRS[0][n] >= i]).T
#: features that tell specimens apart: of the first order, and products of a pad's own o alone
FEW = np.concatenate(
    [
        np.arange(N_CURVED, N_FEATURES),
        _PAIRS[0] * WITH_OWN + _PAIRS[1],
        _TRIPLES[0] * WITH_OWN + 9 * N_OWN + _TRIPLES[1],
    ]
)


@dataclass(frozen=True, kw_only=True, eq=False)
class StrainMaps:
    """χ and ρ of an array of k units, each a sum of products of o, the `N_OWN` numbers of a pad and of its neighbours.

    For a design all products are of the second to the fourth order, so that at rest and under light loads the array is
    linear. A pad has m values: three forces [N], and a squared length [mm²] for each pillar of its unit.
    """

    influence: FloatArray  #: B of the linear array, (3 k, 3 k n_upper) as in `SensorModel`, on its electrodes [mm/N]
    near: NDArray[np.int64]  #: neighbours of each pad, (k, 8); k where there is none
    sizes: FloatArray  #: of o, by which it is divided, (9,) [N, mm]
    weights: FloatArray  #: of the features, (N_FEATURES, m) [N, mm²]
    misfit: FloatArray  #: root mean square of what each misses on samples that it has not seen, (m,) [N, mm²]
    growth: FloatArray  #: a, b of the misfit's variance over its mean at a mean square s of o: a + b s², (2,)

    def misfit_variance(self, state_n: FloatArray) -> FloatArray:
        """Variance of what the values miss in states (n, 3 k) [N], (n, k, m) [N², mm⁴]."""
        s = (self.own(state_n) ** 2).mean(axis=2)
        return (self.growth[0] + self.growth[1] * s**2)[..., None] * self.misfit**2

    def values(self, state_n: FloatArray) -> FloatArray:
        """χ and ρ of each pad, (n, 3 k) [N] -> (n, k, m); the same bits alone and in any batch."""
        n, k = len(state_n), len(self.near)
        o, around, pairs, pairs_around = self._parts(state_n)
        with_own, with_pressing, alone, with_pairs, first = self._maps
        z = _with_own(o, around, pairs, pairs_around)
        found = rowwise(pairs_around.reshape(n * k, -1), alone).reshape(n, k, -1)
        found += first[0] + rowwise(z[..., : 9 * N_OWN].reshape(n * k, -1), first[1:]).reshape(found.shape)
        pressing = pairs[..., _PRESSING]
        products = (o, z, with_own), (pressing, around, with_pressing), (0.5 * pairs, pairs, with_pairs)
        for factor, values, matrix in products:
            mapped = rowwise(values.reshape(n * k, -1), matrix).reshape(n, k, factor.shape[2], -1)
            found += (factor[..., None] * mapped).sum(axis=2)
        return found

    def features(self, state_n: FloatArray) -> FloatArray:
        """Features of each pad, (n, 3 k) [N] -> (n, k, N_FEATURES)."""
        o, around, pairs, pairs_around = self._parts(state_n)
        shape = (*o.shape[:2], -1)
        z = _with_own(o, around, pairs, pairs_around)
        return np.concatenate(
            [
                (o[..., :, None] * z[..., None, :]).reshape(shape),
                (pairs[..., _PRESSING, None] * around[..., None, :]).reshape(shape),
                pairs_around,
                pairs[..., _FOURS[0]] * pairs[..., _FOURS[1]],
                np.ones((*o.shape[:2], 1)),
                o,
                around,
            ],
            axis=2,
        )

    def own(self, state_n: FloatArray) -> FloatArray:
        """o, state and linear displacements of each pad over their sizes, (n, 3 k) [N] -> (n, k, 9)."""
        n, k = len(state_n), len(self.near)
        moved = rowwise(state_n, self.influence).reshape(n, N_AXES, k, -1)
        parts = [state_n.reshape(n, k, N_AXES), moved[..., 0].swapaxes(1, 2), moved[..., -1].swapaxes(1, 2)]
        return namespace(state_n).concat(parts, axis=2) / self.sizes

    def _parts(self, state_n: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """o of each pad, o of its neighbours, pairs of its own and of each neighbour: (n, k, 9, 72, 45 and 360)."""
        xp, o = namespace(state_n), self.own(state_n)
        (n, k, _), pairs = o.shape, o[..., _PAIRS[0]] * o[..., _PAIRS[1]]
        both = xp.concat([o, pairs], axis=2)
        near = xp.concat([both, xp.zeros_like(both[:, :1])], axis=1)[:, self.near]
        return o, near[..., :N_OWN].reshape(n, k, -1), pairs, near[..., N_OWN:].reshape(n, k, -1)

    def slopes(self, state_n: FloatArray) -> tuple[FloatArray, FloatArray]:
        """χ and ρ (n, k, m) and their derivatives by the state, (n, k, m, 3 k)."""
        n, k = len(state_n), len(self.near)
        o, around, pairs, pairs_around = self._parts(state_n)
        with_own, with_pressing, alone, with_pairs, first = self._maps
        m = self.weights.shape[1]
        z = _with_own(o, around, pairs, pairs_around)
        pressing = pairs[..., _PRESSING]
        by_factor = (z @ with_own).reshape(n, k, N_OWN, m)
        by_pressing = (around @ with_pressing).reshape(n, k, -1, m)
        values = (o[..., None] * by_factor).sum(axis=2) + (pressing[..., None] * by_pressing).sum(axis=2)
        values += pairs_around @ alone + first[0] + z[..., : 9 * N_OWN] @ first[1:]
        by_pairs = (pairs @ with_pairs).reshape(n, k, N_PAIRS, m).swapaxes(2, 3)
        values += 0.5 * (by_pairs @ pairs[..., None])[..., 0]
        by_z = (o @ self._of_own).reshape(n, k, m, -1)
        by_pairs = by_pairs + by_z[..., 9 * N_OWN : 9 * N_OWN + N_PAIRS]
        by_pairs[..., _PRESSING] += by_pressing.swapaxes(2, 3)
        by_own = by_factor.swapaxes(2, 3) + by_z[..., :N_OWN] + _by_o(by_pairs, o)
        near = around.reshape(n, k, 8, N_OWN)
        by_alone = self._by_alone @ near[..., None]
        by_around = by_z[..., N_OWN : 9 * N_OWN] + (pressing @ self._of_pressing).reshape(n, k, m, -1)
        by_around = by_around.reshape(n, k, m, 8, N_OWN) + by_alone.reshape(n, k, 8, m, N_OWN).swapaxes(2, 3)
        beside = by_z[..., 9 * N_OWN + N_PAIRS :].reshape(n, k, m, 4, N_PAIRS).swapaxes(2, 3)
        by_around[..., _SIDES, :] += _by_o(beside, near[:, :, _SIDES]).swapaxes(2, 3)
        by_o = namespace(o).concat([by_own, by_around.reshape(n, k, m, -1)], axis=3) + first[1:].T  # (n, k, m, 81)
        return values, by_o @ self._by_force

    def states(self, force_n: FloatArray) -> FloatArray:
        """States G in which forces F act, both (n, 3 k) [N], by damped Newton steps.

        Where a column nearly gives way, χ can miss the forces that it bears by as much as its misfit: there the G whose
        forces are nearest counts. Forces beyond those of the samples at finite strain are a `SampleError`.
        """
        found, there_are = self.nearest_states(force_n)
        if not there_are.all():
            raise SampleError(
                f"no deformation that the model knows bears forces of up to {np.abs(force_n).max():.4g} N on a pad: "
                "they are beyond its samples at finite strain. Train on samples of such forces."
            )
        return found

    def nearest_states(self, force_n: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """The same without a refusal: states (n, 3 k) [N], and where there are some, (n,)."""
        parts = [
            self._solved(force_n[start : start + CHUNK_SAMPLES])
            for start in range(0, max(len(force_n), 1), CHUNK_SAMPLES)
        ]
        states, there_are = (np.concatenate(part) for part in zip(*parts, strict=True))
        return states, there_are

    def _solved(self, force_n: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        found, enough = np.array(force_n, dtype=np.float64), CONVERGED * max(np.abs(force_n).max(initial=0.0), 1.0)

        def at(state_n: FloatArray, on: NDArray[np.intp]) -> tuple[FloatArray, ...]:
            misfit, J = self._misfit(force_n[on], state_n)
            return np.linalg.norm(misfit, axis=1), misfit, J

        def step(here: tuple[FloatArray, ...], damping: FloatArray, on: NDArray[np.intp]) -> FloatArray:
            _, misfit, J = here
            M = J.swapaxes(1, 2) @ J + damping[:, None, None] * np.eye(J.shape[1])
            return np.asarray(np.linalg.solve(M, J.swapaxes(1, 2) @ misfit[..., None])[..., 0])

        found, (_, misfit, _) = descended(found, at, step, MAX_STEPS, DAMPING, enough=enough)
        left = np.sqrt((misfit.reshape(len(misfit), -1, N_AXES) ** 2).mean(axis=1))
        return found, (left <= BEYOND * self.misfit[:N_AXES] + enough).all(axis=1)

    def _misfit(self, force_n: FloatArray, state_n: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Forces less those that act (n, 3 k) [N], and derivatives of the latter (n, 3 k, 3 k)."""
        values, slopes = self.slopes(state_n)
        J = np.eye(state_n.shape[1]) + slopes[:, :, :N_AXES].reshape(len(state_n), *[state_n.shape[1]] * 2)
        return force_n - state_n - values[..., :N_AXES].reshape(state_n.shape), J

    @cached_property
    def _maps(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Weights as matrices, of z (306, 9 m), neighbours' o (72, 15 m), their pairs (360, m), own pairs (45, 45 m).

        The last is of the first order, (82, m). That of own pairs gives derivatives, and so twice the values.
        """
        own, pressing, alone, fours, first = self._by_kind
        m = first.shape[1]
        with_own, with_pressing = (
            part.reshape(-1, size, m).swapaxes(0, 1).reshape(size, -1)
            for part, size in ((own, WITH_OWN), (pressing, _WITH_PRESSING))
        )
        with_pairs = _doubled(fours.T, _FOUR_OF).swapaxes(0, 1).swapaxes(1, 2).reshape(N_PAIRS, -1)
        return with_own, with_pressing, alone, with_pairs, first

    @property
    def _by_kind(self) -> list[FloatArray]:
        """Weights of what o is multiplied by, of pressing pairs, neighbours' pairs, own pairs and the first order."""
        return [self.weights[start:end] for start, end in pairwise([0, *_ENDS, N_FEATURES])]

    @cached_property
    def _by_alone(self) -> FloatArray:
        """From a neighbour's o to the derivatives of what its pairs add, by it, (8, 9 m, 9)."""
        by_pairs = self._by_kind[2].reshape(8, N_PAIRS, -1).swapaxes(1, 2)
        return _doubled(by_pairs, _PAIR_OF).reshape(8, -1, N_OWN)

    @cached_property
    def _of_own(self) -> FloatArray:
        """From o to the derivatives by z, (9, m · 306)."""
        return self._by_kind[0].reshape(N_OWN, WITH_OWN, -1).swapaxes(1, 2).reshape(N_OWN, -1)

    @cached_property
    def _of_pressing(self) -> FloatArray:
        """From pressing pairs to the derivatives by neighbours' o, (15, m · 72)."""
        pressing = self._by_kind[1].reshape(len(_PRESSING), _WITH_PRESSING, -1)
        return pressing.swapaxes(1, 2).reshape(len(_PRESSING), -1)

    @cached_property
    def _by_force(self) -> FloatArray:
        """Derivatives of o of a pad and of its neighbours by the state, (k, 81, 3 k)."""
        xp, k = namespace(self.influence), len(self.near)
        own = self.own(eye(N_AXES * k, self.influence))
        by_state = xp.concat([own, xp.zeros_like(own[:, :1])], axis=1)[:, np.column_stack([np.arange(k), self.near])]
        return by_state.reshape(N_AXES * k, k, -1).swapaxes(0, 1).swapaxes(1, 2).reshape(-1).reshape(k, 9 * N_OWN, -1)


def _doubled(values: FloatArray, numbers: NDArray[np.int64]) -> FloatArray:
    """Second derivatives of sums of products of pairs by their factors q, from weights (..., pairs), (..., q, q)."""
    spread = values[..., numbers]
    return spread + spread * eye(len(numbers), values)


def _by_o(by_pairs: FloatArray, o: FloatArray) -> FloatArray:
    """Derivatives (..., m, 9) by o (..., 9) of m sums of its pairs with weights (..., m, 45)."""
    of_pairs = o @ _doubled(eye(N_PAIRS, o), _PAIR_OF).reshape(-1, N_OWN).T
    return by_pairs @ of_pairs.reshape(*o.shape[:-1], N_PAIRS, N_OWN)


def _with_own(o: FloatArray, around: FloatArray, pairs: FloatArray, pairs_around: FloatArray) -> FloatArray:
    """z, what o is multiplied by: o, neighbours' o, pairs of its own and of neighbours at its sides, (n, k, 306)."""
    n, k, _ = o.shape
    beside = pairs_around.reshape(n, k, 8, N_PAIRS)[:, :, _SIDES].reshape(n, k, -1)
    return namespace(o).concat([o, around, pairs, beside], axis=2)


def neighbours(rows: int, cols: int) -> NDArray[np.int64]:
    """Numbers of the eight neighbours of each unit, (rows·cols, 8); rows·cols where there is none.

    >>> neighbours(1, 2).tolist()
    [[2, 2, 2, 2, 1, 2, 2, 2], [2, 2, 2, 0, 2, 2, 2, 2]]
    """
    return np.delete(units_around(rows, cols, 1, rows * cols), 4, axis=1)


def units_around(rows: int, cols: int, reach: int, beyond: int) -> NDArray[np.int64]:
    """Numbers of the units at most so many pitches away along x and y, each unit's own in the middle, row by row.

    Shape (rows·cols, (2 reach + 1)²); `beyond` stands where there is none.
    """
    padded = np.pad(np.arange(rows * cols).reshape(rows, cols), reach, constant_values=beyond)
    shifts = np.ndindex(2 * reach + 1, 2 * reach + 1)
    return np.stack([padded[i : i + rows, j : j + cols].reshape(-1) for i, j in shifts], axis=1)
