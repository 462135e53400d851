"""Equilibria of many loads by one tangent: the chord method, accelerated.

An iteration costs one evaluation of the forces and one solve with a factor that is there. Alone such iterations diverge
at large loads; Anderson's acceleration takes of the last ones the combination whose change is least (Walker & Ni, SIAM
J. Numer. Anal. 49 (2011) 1715). Pressures are iterates of their own, as in `newton.py`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fem.kernel.newton import Linearised
from fem.kernel.system import State
from geometry.layout import FloatArray

DEPTH = 6  #: earlier iterates that are combined
MAX_GROWTH = 2.0  #: of the change that is asked for, before a step is halved
PRESSURE_MM_PER_MPA = 0.02  #: weight of pressures beside displacements where changes are measured
AT_ONCE = 40_000  #: points of integration whose stress is worked on at a time: more would leave the cache
NEARLY = 0.1  #: change below which displacements tell whether a sample is wanted at all

IntArray = NDArray[np.int64]
Unwanted = Callable[[State], NDArray[np.bool_]]  #: states of m samples to booleans (m,): of those that need no answer


@dataclass(frozen=True, eq=False)
class Relaxed:
    """Samples after their last iteration."""

    state: State
    steps: FloatArray  #: from the tangent's state, (m, n): see `Chord`
    change: FloatArray  #: last change of the plates' motion, relative, (m,); infinite before the first
    iterations: IntArray  #: (m,)


class Chord:
    """m samples of a system under forces (m, k, 3) on its plates [N], by the tangent at one state.

    A sample's step from that state is a vector: changes of the unknowns, then of the pressures.
    """

    def __init__(self, tangent: Linearised, force_n: FloatArray) -> None:
        self.tangent, self.system, self.force_n = tangent, tangent.system, force_n
        self.n_motions = 3 * self.system.n_blocks
        self._plates = slice(3 * len(self.system.free), self.n_motions)
        shift = tangent.state.shift
        self._moved = np.concatenate([shift.ravel(), np.zeros(shift.size)])  # plates at the tangent's state

    def state(self, x: FloatArray) -> State:
        """The deformed bodies of vectors (m, n)."""
        base, m = self.tangent.state, len(x)
        copies = State(*(np.broadcast_to(part, (m, *part.shape)) for part in (base.u, base.p, base.shift, base.turn)))
        pressures = x[:, self.n_motions :].reshape(copies.p.shape)
        return self.system.moved(copies, x[:, : self.n_motions].reshape(m, -1, 3), pressures)

    def change(self, x: FloatArray, samples: IntArray) -> FloatArray:
        """The change that the tangent asks for, (s, n), of vectors (s, n) of these samples."""
        state, system, body = self.state(x), self.system, self.system.body
        missing, forces = np.empty_like(state.p), np.empty_like(state.u)
        step = max(1, AT_ONCE // body.dx.size)
        for first in range(0, len(x), step):
            some = slice(first, first + step)
            strain = body.strain(state.u[some])
            missing[some] = body.pressures(strain.theta) - state.p[some]
            with np.errstate(divide="ignore", invalid="ignore"):
                forces[some] = body.divergence(body.stress(strain, state.p[some]))
        forces += self.tangent.parts.pressed(missing)
        unbalanced = system.gathered(system.dead - forces, state.rotation)
        n, k = len(system.free), system.plates.count
        unbalanced[:, n : n + k] += self.force_n[samples]
        motions, pressures = self.tangent.changes(unbalanced, missing)
        return np.hstack([motions.reshape(len(x), -1), pressures.reshape(len(x), -1)])

    def relax(
        self, tolerance: float, most: int, start: FloatArray | None = None, unwanted: Unwanted | None = None
    ) -> Relaxed:
        """Iterate from steps (m, n), or the tangent's own, until the plates' motion changes by less than a tolerance.

        A sample that has settled, or is not wanted, stays as it is, whatever the others need. A step that lets the
        forces grow, or turns an element inside out, is halved. A sample that does not settle ends with a change above
        the tolerance, after `most` iterations where it came closest.
        """
        m = len(self.force_n)
        if start is None:
            start = np.zeros((m, self.n_motions + self.tangent.state.p.size))
            start = start + self.change(start, np.arange(m))
        x, change, count = start.copy(), np.full(m, np.inf), np.zeros(m, dtype=np.int64)
        weight = np.ones(x.shape[1])
        weight[self.n_motions :] = PRESSURE_MM_PER_MPA
        seen = [_Iterates([], [], []) for _ in range(m)]
        going = np.arange(m)
        for _ in range(most):
            for sample, g in zip(going, self.change(x[going], going), strict=True):
                own = seen[sample]
                count[sample] += 1
                with np.errstate(over="ignore"):  # an iterate that runs away is halved
                    size = float(np.linalg.norm(g * weight))
                if not np.isfinite(size) or (own.sizes and size > MAX_GROWTH * own.sizes[-1]):
                    x[sample] = (x[sample] + (own.places[-1] if own.places else 0.0)) / 2
                    own.is_halved = True
                    continue
                own.add(x[sample], g, size)
                step = g - own.accelerated(weight)
                x[sample] += step
                length = float(np.linalg.norm(self._moved + x[sample, self._plates])) or 1.0
                # both the step and what the tangent asks for: where one stagnates, the other does not
                change[sample] = max(float(np.linalg.norm(part[self._plates])) for part in (step, g)) / length
            going = going[change[going] > tolerance]
            if unwanted is not None and len(going):
                going = going[~(unwanted(self.state(x[going])) & (change[going] < NEARLY))]
            if not len(going):
                break
        for sample in going:
            own = seen[sample]
            if own.sizes and (own.is_halved or own.sizes[-1] > min(own.sizes)):
                x[sample] = own.places[int(np.argmin(own.sizes))]
        return Relaxed(self.state(x), x, change, count)


@dataclass(eq=False)
class _Iterates:
    """The last iterates of a sample."""

    places: list[FloatArray]
    changes: list[FloatArray]  #: that the tangent asked for there
    sizes: list[float]  #: of these
    is_halved: bool = False  #: whether the last step was

    def add(self, place: FloatArray, change: FloatArray, size: float) -> None:
        self.places = [*self.places[-DEPTH:], place.copy()]
        self.changes = [*self.changes[-DEPTH:], change]
        self.sizes = [*self.sizes[-DEPTH:], size]
        self.is_halved = False

    def accelerated(self, weight: FloatArray) -> FloatArray | float:
        """Step back from the last iterate plus its change to the combination whose change is least."""
        if len(self.places) < 2:
            return 0.0
        differences = self.changes[-1] - np.stack(self.changes[:-1])
        share = np.linalg.lstsq((differences * weight).T, weight * self.changes[-1], rcond=1e-6)[0]
        return np.asarray(share @ (differences + self.places[-1] - np.stack(self.places[:-1])))
