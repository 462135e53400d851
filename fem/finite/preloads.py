"""An array with stiff pads on one grid: its equilibria under uniform pressures, and samples by their tangents.

Samples come to equilibrium by the one tangent of a base state, in a modified Newton iteration that is accelerated: an
iteration costs one evaluation of the forces and one solve with a factor that is there. Alone such iterations diverge at
large loads; Anderson's acceleration takes of the last ones the combination whose change is least (Walker & Ni, SIAM J.
Numer. Anal. 49 (2011) 1715). Pressures are iterates of their own, as in `newton.py`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fem.boxes.boxes import Boxes
from fem.equations import State
from fem.finite.series import BaseState, load_series, quaternion_rotations
from fem.kernel.factor import Factor
from fem.kernel.loads import StiffLoad
from fem.rubber.body import RubberBody
from fem.system import System
from geometry.design import SensorDesign
from geometry.layout import FloatArray, unit_centres, upper_electrodes

MAX_ITERATIONS = 16  #: with one tangent
RENEWALS = 2  #: of the tangent, of samples that have not settled then
NEARLY = 0.1  #: change below which displacements tell whether a sample is wanted at all

DEPTH = 6  #: earlier iterates that are combined
MAX_GROWTH = 2.0  #: of the change that is asked for, before a step is halved
PRESSURE_MM_PER_MPA = 0.02  #: weight of pressures beside displacements where changes are measured

IntArray = NDArray[np.int64]
#: displacements (m, k, n_upper, 3) of electrodes to booleans (m,): of samples that need no answer
Unwanted = Callable[[FloatArray], NDArray[np.bool_]]


@dataclass(frozen=True, eq=False)
class Relaxed:
    """Samples after their last iteration."""

    state: State
    change: FloatArray  #: last change of the plates' motion, relative, (m,); infinite where the last step was halved
    iterations: IntArray  #: (m,)


def array_boxes(design: SensorDesign, pad: tuple[float, ...], height: tuple[float, ...]) -> Boxes:
    """The whole slab, with lines along the pads' edges, between units, and at shares of each pad and of the height."""
    pitch, size = design.array.pitch_mm, design.pad.size_mm
    lines = [design.unit.height_mm * np.array([0.0, *height])]
    for count, offset in ((design.array.rows, design.pad.offset_y_mm), (design.array.cols, design.pad.offset_x_mm)):
        low = pitch / 2 + offset - size / 2
        unit = np.unique(np.round([low, *(low + size * share for share in pad), pitch], 9))
        lines.append(np.concatenate([[0.0], *(unit + k * pitch for k in range(count))]) - count * pitch / 2)
    return Boxes.between(lines[::-1])


class PreloadedArray:
    """An array of k units of one rubber on one grid, its lines as of `array_boxes`."""

    def __init__(self, design: SensorDesign, pad: tuple[float, ...], height: tuple[float, ...]) -> None:
        self.design = design
        rubber = replace(design.matrix_material, model="neo-hookean")
        self.body = RubberBody.of(array_boxes(design, pad, height), [rubber])
        offset = [design.pad.offset_x_mm, design.pad.offset_y_mm, 0.0]
        #: of the electrodes on their plates, (n_upper, 3)
        self.arm = upper_electrodes(design.unit) * (1.0, 1.0, 0.0) - offset
        self._bases: dict[float, BaseState] = {}

    def base(self, preload_mpa: float) -> BaseState:
        """The equilibrium under a uniform pressure on all pads, found once; `UnreachableLoadError` if there is none."""
        if preload_mpa not in self._bases:
            down = -preload_mpa * self.design.pad.size_mm**2
            self._bases[preload_mpa] = BaseState.of(self.system(np.tile([0.0, 0.0, down], (self.design.n_units, 1))))
        return self._bases[preload_mpa]

    def system(self, force_n: FloatArray) -> System:
        """The array under forces (k, 3) on its pads [N]."""
        pad = self.design.pad
        middles = unit_centres(self.design) + np.array([pad.offset_x_mm, pad.offset_y_mm])
        loads = [
            StiffLoad(center_mm=(x, y), size_mm=(pad.size_mm, pad.size_mm), force_n=(fx, fy, fz))
            for (x, y), (fx, fy, fz) in zip(middles.tolist(), force_n.tolist(), strict=True)
        ]
        return System(self.body, loads)

    def electrodes(self, shift: FloatArray, rotation: FloatArray) -> FloatArray:
        """Displacements (m, k, n_upper, 3) [mm] of the electrodes under plates of these motions."""
        return np.asarray(shift[:, :, None] + np.einsum("mkij,ej->mkei", rotation, self.arm) - self.arm)

    @cached_property
    def influence(self) -> FloatArray:
        """Linear displacement of the electrodes per newton on each pad, (3 n_upper k, 3 k) [mm/N]."""
        k = self.design.n_units
        rest = self._bases.get(0.0) or BaseState.of(self.system(np.zeros((k, 3))))
        moves, spins = rest.compliance()[:, : 3 * k].T.reshape(3 * k, 2, k, 3).swapaxes(0, 1)
        spins = spins / rest.system.plates.half_mm[:, None]
        return np.asarray((moves[:, :, None] + np.cross(spins[:, :, None], self.arm)).reshape(3 * k, -1).T)

    def forces_of(self, moved: FloatArray) -> FloatArray:
        """Forces (m, 3 k) [N] that move the linear array most nearly by displacements (m, k, n_upper, 3) [mm]."""
        return np.asarray(moved.reshape(len(moved), -1) @ self._inverse.T)

    @cached_property
    def _inverse(self) -> FloatArray:
        return np.asarray(np.linalg.pinv(self.influence))

    def linear_field(self, force_n: FloatArray) -> FloatArray:
        """Linear displacements (n_nodes, 3) [mm] of the array at rest under forces (3 k,) on its pads [N]."""
        rest = self.base(0.0)
        loads = np.zeros((1, rest.system.n_blocks, 3))
        loads[0, -2 * self.design.n_units : -self.design.n_units] = force_n.reshape(-1, 3)
        return np.asarray(rest.system.nodal_change(rest.state.rotation, rest.solve(loads)[0]))

    def solve(self, preload_mpa: float, force_n: FloatArray, tolerance: float, unwanted: Unwanted) -> Relaxed:
        """Equilibria of samples under forces (m, k, 3) [N], by the tangent of a preload and, if need be, their own.

        Samples that are not wanted keep the change they had.
        """
        base = self.base(preload_mpa)
        found = _Relaxation(self, base, force_n).relax(tolerance, unwanted)
        state = found.state
        for number in np.flatnonzero((found.change > tolerance) & np.isfinite(found.change)):
            own = slice(number, number + 1)
            for _ in range(RENEWALS):
                moved = self.electrodes(state.shift[own], state.rotation[own])
                if found.change[number] <= tolerance or unwanted(moved):
                    break
                about = BaseState.about(base.system, state.part(int(number)), self._factor)
                last = _Relaxation(self, about, force_n[own]).relax(tolerance, unwanted)
                for name, values in vars(last.state).items():
                    getattr(state, name)[own] = values
                found.change[own] = last.change
                found.iterations[own] += last.iterations
        return found

    def series(self, preload_mpa: float, force_n: FloatArray, orders: int) -> tuple[FloatArray, FloatArray]:
        """Series of the electrodes and of the nodes under forces (m, k, 3) [N], see `series.py`.

        Terms of the electrodes' displacements (orders + 1, m, k, n_upper, 3) [mm], and the sum of those of the nodes
        (m, n_nodes, 3) [mm].

        The first one is the preload's own. With R = (I + 2 q₀ [v] + 2 [v]²) R₀ and v = Σ sⁱ vᵢ the order n of an
        electrode at a from its plate's middle moves by cₙ + 2 vₙ × a + 2 Σ vᵢ × (vₙ₋ᵢ × a) up to n = 3, but for the
        changes of q₀, which are of the order of |v|³.
        """
        base = self.base(preload_mpa)
        loads = np.zeros((len(force_n), 2, *force_n.shape[1:]))
        loads[:, 0] = force_n - base.system.force_n
        found = load_series(base, loads, orders)
        v, at_rest = found.half_spin[:, :, :, None], self.electrodes(base.state.shift[None], base.state.rotation[None])
        arm = np.einsum("kij,ej->kei", base.state.rotation, self.arm)
        terms = [np.broadcast_to(at_rest, (len(force_n), *at_rest.shape[1:]))]
        for n in range(orders):
            term = found.shift[n][:, :, None] + 2 * np.cross(v[n], arm)
            for i in range(n):
                term += 2 * np.cross(v[i], np.cross(v[n - 1 - i], arm))
            terms.append(term)
        return np.array(terms), base.state.u + found.u.sum(axis=0)

    @cached_property
    def _factor(self) -> Factor:
        return next(iter(self._bases.values())).system.new_factor()


class _Relaxation:
    """Iterates of m samples as vectors: free displacements, shifts and half spins times size of plates, pressures."""

    def __init__(self, array: PreloadedArray, base: BaseState, force_n: FloatArray) -> None:
        self.array, self.base, self.system, self.body = array, base, base.system, base.system.body
        self.force_n, self.k, self.n = force_n, self.system.plates.count, len(self.system.free)
        self.n_motions = 3 * self.system.n_blocks

    @property
    def rest(self) -> FloatArray:
        """The vector (n,) of the base state."""
        base = self.base.state
        spin = np.zeros_like(base.shift)
        return np.concatenate([part.ravel() for part in (base.u[self.system.free], base.shift, spin, base.p)])

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
        unbalanced[:, self.n : self.n + self.k] += self.force_n[samples]
        z = self.base.solve(unbalanced)
        nodal = self.system.nodal_change(self.base.state.rotation[None], z)
        pressures = missing + parts.pressure_changes(nodal)
        return np.hstack([z.reshape(len(x), -1), pressures.reshape(len(x), -1)])

    def plates(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Shifts (m, k, 3) and rotations (m, k, 3, 3) of the plates of vectors (m, n)."""
        blocks = x[:, 3 * self.n : self.n_motions].reshape(len(x), 2, self.k, 3)
        half_spin = blocks[:, 1] / (2 * self.system.plates.half_mm[:, None])
        return blocks[:, 0], quaternion_rotations(half_spin) @ self.base.state.rotation

    def relax(self, tolerance: float, unwanted: Unwanted) -> Relaxed:
        """Iterate from the base's tangent at once until the plates' motion changes by less than a tolerance, relative.

        A sample that has settled, or is not wanted, stays as it is, whatever the others need. A step that lets the
        forces grow, or turns an element inside out, is halved. A sample that does not settle ends with a change above
        the tolerance.
        """
        m = len(self.force_n)
        x = np.tile(self.rest, (m, 1))
        x += self.change(x, np.arange(m))
        weight = np.ones(x.shape[1])
        weight[self.n_motions :] = PRESSURE_MM_PER_MPA
        plates = slice(3 * self.n, self.n_motions)
        change, count = np.full(m, np.inf), np.zeros(m, dtype=np.int64)
        places: list[list[FloatArray]] = [[] for _ in range(m)]
        changes: list[list[FloatArray]] = [[] for _ in range(m)]
        last_size = np.full(m, np.inf)
        going = np.arange(m)
        for _ in range(MAX_ITERATIONS):
            asked = self.change(x[going], going)
            for sample, g in zip(going, asked, strict=True):
                count[sample] += 1
                with np.errstate(over="ignore"):  # an iterate that runs away is halved below
                    size = float(np.linalg.norm(g * weight))
                if not np.isfinite(size) or size > MAX_GROWTH * last_size[sample]:
                    x[sample] = (x[sample] + (places[sample][-1] if places[sample] else self.rest)) / 2
                    change[sample] = np.inf
                    continue
                last_size[sample] = size
                places[sample] = [*places[sample][-DEPTH:], x[sample].copy()]
                changes[sample] = [*changes[sample][-DEPTH:], g]
                step = g - _accelerated(places[sample], changes[sample], weight)
                x[sample] += step
                length = float(np.linalg.norm(x[sample, plates]))
                # both the step and what the tangent asks for: where one stagnates, the other does not
                change[sample] = max(float(np.linalg.norm(part[plates])) for part in (step, g)) / (length or 1.0)
            going = going[change[going] > tolerance]
            if len(going):
                beyond = unwanted(self.array.electrodes(*self.plates(x[going])))
                going = going[~(beyond & (change[going] < NEARLY))]
            if not len(going):
                break
        for sample in going:
            if places[sample]:  # where it came closest
                sizes = [float(np.linalg.norm(g * weight)) for g in changes[sample]]
                x[sample] = places[sample][int(np.argmin(sizes))]
        return Relaxed(state=self.state(x), change=change, iterations=count)


def _accelerated(places: list[FloatArray], changes: list[FloatArray], weight: FloatArray) -> FloatArray:
    """Step back from the last iterate plus its change to the combination whose change is least."""
    if len(places) < 2:
        return np.zeros_like(places[-1])
    differences = np.stack([changes[-1] - earlier for earlier in changes[:-1]])
    share = np.linalg.lstsq((differences * weight).T, weight * changes[-1], rcond=1e-6)[0]
    steps = np.stack([places[-1] - earlier for earlier in places[:-1]])
    return np.asarray(share @ (differences + steps))
