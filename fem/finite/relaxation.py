"""Equilibrium of many samples by the one tangent of a base state: a modified Newton iteration, accelerated.

The tangent stays, so that an iteration costs one evaluation of the forces and one solve with a factor that is there.
Alone such iterations diverge at large loads; Anderson's acceleration takes of the last ones the combination whose
change is least (Walker & Ni, SIAM J. Numer. Anal. 49 (2011) 1715). Pressures are iterates of their own, as in
`newton.py`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fem.finite.series import BaseState, quaternion_rotations
from fem.system import State
from geometry.layout import FloatArray

IntArray = NDArray[np.int64]
#: which samples need no answer, (m,), by shifts (m, k, 3) and rotations (m, k, 3, 3) of their plates and last changes
Hopeless = Callable[[FloatArray, FloatArray, FloatArray], NDArray[np.bool_]]

DEPTH = 6  #: earlier iterates that are combined
MAX_GROWTH = 2.0  #: of the change that is asked for, before a step is halved
PRESSURE_MM_PER_MPA = 0.02  #: weight of pressures beside displacements where changes are measured


@dataclass(frozen=True, eq=False)
class Relaxed:
    """Samples after their last iteration."""

    state: State
    change: FloatArray  #: last change of the plates' motion, relative, (m,); infinite where the last step was halved
    iterations: IntArray  #: (m,)


def never(shift: FloatArray, rotation: FloatArray, change: FloatArray) -> NDArray[np.bool_]:
    """No sample is hopeless."""
    return np.zeros(len(change), dtype=bool)


class Relaxation:
    """Iterates of m samples as vectors: free displacements, shifts and half spins times size of plates, pressures."""

    def __init__(self, base: BaseState, loads: FloatArray) -> None:
        self.base, self.system, self.body = base, base.system, base.system.body
        self.m, self.k, self.n = len(loads), self.system.plates.count, len(self.system.free)
        self.loads = loads.reshape(self.m, -1, 3).copy()
        self.loads[:, : self.k] += self.system.force_n
        self.n_motions = 3 * self.system.n_blocks

    @property
    def rest(self) -> FloatArray:
        """The vector (n,) of the base state."""
        base = self.base.state
        spin = np.zeros_like(base.shift)
        return np.concatenate([part.ravel() for part in (base.u[self.system.free], base.shift, spin, base.p)])

    def start(self) -> FloatArray:
        """Vectors (m, n) of the base's tangent at once."""
        return np.asarray(self.rest + self.change(np.tile(self.rest, (self.m, 1)), np.arange(self.m)))

    def state(self, x: FloatArray) -> State:
        """The deformed bodies of vectors (m, n)."""
        blocks = x[:, : self.n_motions].reshape(len(x), -1, 3)
        shift, rotation = self.plates(x)
        turn = rotation - np.eye(3)
        u = np.zeros((len(x), self.body.n_nodes, 3))
        u[:, self.system.free] = blocks[:, : self.n]
        u[:, self.system.plates.node] = self.system.plates.displacements(shift, turn)
        p = x[:, self.n_motions :].reshape(len(x), -1, self.body.n_pressures)
        return State(u=u, p=p, shift=shift, turn=turn)

    def change(self, x: FloatArray, samples: IntArray) -> FloatArray:
        """The change that the base's tangent asks for, (s, n), of vectors (s, n) of these samples."""
        state, parts = self.state(x), self.base.parts
        strain = self.body.strain(state.u)
        missing = self.body.pressures(strain.theta) - state.p
        with np.errstate(divide="ignore", invalid="ignore"):
            forces = self.body.divergence(self.body.stress(strain, state.p)) + parts.pressed(missing)
        unbalanced = -self.system.gathered(forces, state.rotation)
        unbalanced[:, self.n :] += self.loads[samples]
        z = self.base.solve(unbalanced)
        nodal = self.system.nodal_change(self.base.state.rotation[None], z)
        pressures = missing + parts.pressure_changes(nodal)
        return np.hstack([z.reshape(len(x), -1), pressures.reshape(len(x), -1)])

    def plates(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Shifts (m, k, 3) and rotations (m, k, 3, 3) of the plates of vectors (m, n)."""
        blocks = x[:, 3 * self.n : self.n_motions].reshape(len(x), 2, self.k, 3)
        half_spin = blocks[:, 1] / (2 * self.system.plates.half_mm[:, None])
        return blocks[:, 0], quaternion_rotations(half_spin) @ self.base.state.rotation

    def relax(self, x: FloatArray, iterations: int, tolerance: float, hopeless: Hopeless = never) -> Relaxed:
        """Iterate until the plates' motion changes by less than a tolerance, relative, or so many times.

        A sample that has settled, or is hopeless, stays as it is, whatever the others need. A step that lets the forces
        grow, or turns an element inside out, is halved. A sample that does not settle ends with a change above the
        tolerance.
        """
        weight = np.ones(x.shape[1])
        weight[self.n_motions :] = PRESSURE_MM_PER_MPA
        plates = slice(3 * self.n, self.n_motions)
        x, change, count = x.copy(), np.full(self.m, np.inf), np.zeros(self.m, dtype=np.int64)
        places: list[list[FloatArray]] = [[] for _ in range(self.m)]
        changes: list[list[FloatArray]] = [[] for _ in range(self.m)]
        last_size = np.full(self.m, np.inf)
        going = np.arange(self.m)
        for _ in range(iterations):
            asked = self.change(x[going], going)
            for sample, g in zip(going, asked, strict=True):
                count[sample] += 1
                size = float(np.linalg.norm(g * weight))
                if not np.isfinite(size) or size > MAX_GROWTH * last_size[sample]:
                    x[sample] = (x[sample] + (places[sample][-1] if places[sample] else self.rest)) / 2
                    change[sample] = np.inf
                    continue
                last_size[sample] = size
                places[sample] = [*places[sample][-DEPTH:], x[sample].copy()]
                changes[sample] = [*changes[sample][-DEPTH:], g]
                step = g - _combined(places[sample], changes[sample], weight)
                x[sample] += step
                length = float(np.linalg.norm(x[sample, plates]))
                # both the step and what the tangent asks for: where one stagnates, the other does not
                moves = max(float(np.linalg.norm(part[plates])) for part in (step, g))
                change[sample] = moves / (length or 1.0)
            going = going[change[going] > tolerance]
            if len(going):
                going = going[~hopeless(*self.plates(x[going]), change[going])]
            if not len(going):
                break
        for sample in going:
            if places[sample]:  # where it came closest
                sizes = [float(np.linalg.norm(g * weight)) for g in changes[sample]]
                x[sample] = places[sample][int(np.argmin(sizes))]
        return Relaxed(state=self.state(x), change=change, iterations=count)


def _combined(places: list[FloatArray], changes: list[FloatArray], weight: FloatArray) -> FloatArray:
    """Step back from the last iterate plus its change to the combination whose change is least."""
    if len(places) < 2:
        return np.zeros_like(places[-1])
    differences = np.stack([changes[-1] - earlier for earlier in changes[:-1]])
    share = np.linalg.lstsq((differences * weight).T, weight * changes[-1], rcond=1e-6)[0]
    steps = np.stack([places[-1] - earlier for earlier in places[:-1]])
    return np.asarray(share @ (differences + steps))
