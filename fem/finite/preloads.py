"""An array with stiff pads on one grid: its equilibria under uniform pressures, and samples by their tangents."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.kernel.chord import Chord, Relaxed
from fem.kernel.elements import hexahedra
from fem.kernel.factor import Factor
from fem.kernel.field import rows_at, slopes_at
from fem.kernel.loads import StiffLoad
from fem.kernel.newton import Linearised, find_equilibrium
from fem.kernel.plates import skew, spins
from fem.kernel.reference import tabulated
from fem.kernel.rubber import Rubber
from fem.kernel.system import State, System
from fem.meshes.grid import Grid
from geometry.design import SensorDesign
from geometry.layout import FloatArray, unit_centres, upper_electrodes

MAX_ITERATIONS = 16  #: with one tangent
RENEWALS = 2  #: of the tangent, of samples that have not settled then

#: displacements (m, k, n_upper, 3) of electrodes to booleans (m,): of samples that need no answer
Unwanted = Callable[[FloatArray], NDArray[np.bool_]]


def array_grid(design: SensorDesign, pad: tuple[float, ...], height: tuple[float, ...]) -> Grid:
    """The whole slab, with lines along the pads' edges, between units, and at shares of each pad and of the height."""
    pitch, size = design.array.pitch_mm, design.pad.size_mm
    lines = [design.unit.height_mm * np.array([0.0, *height])]
    for count, offset in ((design.array.rows, design.pad.offset_y_mm), (design.array.cols, design.pad.offset_x_mm)):
        low = pitch / 2 + offset - size / 2
        unit = np.unique(np.round([low, *(low + size * share for share in pad), pitch], 9))
        lines.append(np.concatenate([[0.0], *(unit + k * pitch for k in range(count))]) - count * pitch / 2)
    return Grid(lines[::-1])


class PreloadedArray:
    """An array of k units of one rubber on one grid, its lines as of `array_grid`."""

    def __init__(self, design: SensorDesign, pad: tuple[float, ...], height: tuple[float, ...]) -> None:
        self.design, self.grid = design, array_grid(design, pad, height)
        rubber = replace(design.matrix_material, model="neo-hookean")
        self.body = Rubber.of(self.grid.mesh, hexahedra(2), [rubber])
        offset = [design.pad.offset_x_mm, design.pad.offset_y_mm, 0.0]
        #: of the electrodes on their plates, (n_upper, 3)
        self.arm = upper_electrodes(design.unit) * (1.0, 1.0, 0.0) - offset
        self._bases: dict[float, Linearised] = {}

    def base(self, preload_mpa: float) -> Linearised:
        """The equilibrium under a uniform pressure on all pads, found once; `UnreachableLoadError` if there is none."""
        if preload_mpa not in self._bases:
            down = -preload_mpa * self.design.pad.size_mm**2
            system = self.system(np.tile([0.0, 0.0, down], (self.design.n_units, 1)))
            factor = system.new_factor()
            self._bases[preload_mpa] = Linearised.at(system, find_equilibrium(system, factor).state, factor)
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

    def electrodes(self, state: State) -> FloatArray:
        """Displacements (m, k, n_upper, 3) [mm] of the electrodes in m states."""
        moved = np.einsum("mkij,ej->mkei", state.turn, self.arm)
        return np.asarray(state.shift[:, :, None] + moved)

    @cached_property
    def influence(self) -> FloatArray:
        """Linear displacement of the electrodes per newton on each pad, (3 n_upper k, 3 k) [mm/N]."""
        moved = self._at_rest(np.eye(3 * self.design.n_units))
        return np.asarray(self.electrodes(moved).reshape(len(moved.u), -1).T)

    def _at_rest(self, force_n: FloatArray) -> State:
        """Linear motions of the array at rest under forces (m, 3 k) on its pads [N]."""
        rest, k = self.base(0.0), self.design.n_units
        loads = np.zeros((len(force_n), rest.system.n_blocks, 3))
        loads[:, -2 * k : -k] = force_n.reshape(len(force_n), k, 3)
        change, n = rest.solve(loads), len(rest.system.free)
        u = rest.system.nodal_change(rest.state.rotation, change)
        spin = change[:, n + k :] / rest.system.plates.half_mm[:, None]
        return State(u=u, p=np.zeros(0), shift=change[:, n : n + k], turn=skew(spin))

    def forces_of(self, moved: FloatArray) -> FloatArray:
        """Forces (m, 3 k) [N] that move the linear array most nearly by displacements (m, k, n_upper, 3) [mm]."""
        return np.asarray(moved.reshape(len(moved), -1) @ self._inverse.T)

    @cached_property
    def _inverse(self) -> FloatArray:
        return np.asarray(np.linalg.pinv(self.influence))

    def linear_fields(self, force_n: FloatArray) -> FloatArray:
        """Linear displacements (m, n_nodes, 3) [mm] of the array at rest under forces (m, 3 k) on its pads [N]."""
        return self._at_rest(force_n).u

    def slopes(self, points_mm: FloatArray) -> sp.csr_matrix:
        """Rows (3 n, n_nodes) of `slopes_at` at points (n, 3) [mm]."""
        return slopes_at(self.body, *self.grid.located(points_mm))

    def solve(self, preload_mpa: float, force_n: FloatArray, tolerance: float, unwanted: Unwanted) -> Relaxed:
        """Equilibria of samples under forces (m, k, 3) [N], by the tangent of a preload and, if need be, their own.

        Samples that are not wanted keep the change they had.
        """

        def is_unwanted(state: State) -> NDArray[np.bool_]:
            return unwanted(self.electrodes(state))

        base = self.base(preload_mpa)
        found = Chord(base, force_n).relax(tolerance, MAX_ITERATIONS, unwanted=is_unwanted)
        for number in np.flatnonzero(found.change > tolerance):
            own = slice(number, number + 1)
            for _ in range(RENEWALS):
                if found.change[number] <= tolerance or is_unwanted(found.state.part(np.array([number])))[0]:
                    break
                about = Linearised.at(base.system, found.state.part(int(number)), self._factor)
                last = Chord(about, force_n[own]).relax(tolerance, MAX_ITERATIONS, unwanted=is_unwanted)
                for name, values in vars(last.state).items():
                    getattr(found.state, name)[own] = values
                found.change[own] = last.change
                found.iterations[own] += last.iterations
        return found

    @cached_property
    def _factor(self) -> Factor:
        return next(iter(self._bases.values())).system.new_factor()


class Refinement:
    """Steps of samples on a finer grid from their states on a coarse one."""

    def __init__(self, coarse: PreloadedArray, fine: PreloadedArray) -> None:
        self.coarse, self.fine = coarse, fine
        self._nodes = rows_at(coarse.body, *coarse.grid.located(fine.body.points_mm))
        self._element, local = coarse.grid.located(fine.body.centres_mm)
        self._pressures = tabulated(coarse.body.pressure, local)[0].T

    def steps(self, preload_mpa: float, state: State) -> FloatArray:
        """Vectors (m, n) of `Chord` from the preload on the finer grid; pressures are uniform in each element there."""
        base, system = self.coarse.base(preload_mpa).state, self.fine.base(preload_mpa).system
        m, half_mm = len(state.u), system.plates.half_mm[:, None]
        moved = (state.u - base.u).transpose(1, 0, 2).reshape(-1, 3 * m)
        u = (self._nodes @ moved).reshape(-1, m, 3).swapaxes(0, 1)[:, system.free]
        turned = spins(state.rotation @ base.rotation.swapaxes(-1, -2)) * half_mm
        pressures = np.zeros((m, *system.body.pressures_shape))
        pressures[..., 0] = np.einsum("mek,ek->me", (state.p - base.p)[:, self._element], self._pressures)
        return np.hstack([part.reshape(m, -1) for part in (u, state.shift - base.shift, turned, pressures)])
