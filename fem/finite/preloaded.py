"""An array on a coarse grid, whose tangents under uniform pressures serve every other load.

Pillars of another rubber are shares of the boxes that they cut, point of integration by point of integration.
"""

from dataclasses import replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from fem.kernel.factor import Factor
from fem.kernel.field import slopes_at
from fem.kernel.loads import StiffLoad
from fem.kernel.mixed import mixed_rubber, quadrature_lines
from fem.kernel.newton import Linearised, Relaxed, Unwanted, find_equilibrium
from fem.kernel.plates import skew
from fem.kernel.rubber import Rubber
from fem.kernel.system import State, System
from fem.meshes.grid import Grid
from geometry.design import SensorDesign
from geometry.law import LAWS
from geometry.layout import FloatArray, unit_centres, upper_electrodes
from geometry.prism import unit_prisms
from geometry.shares import pillar_shares

PRELOADS = (0.0, 2.0 / 6.1)  #: uniform pressures from whose tangents samples are solved, over Young's modulus
TOLERANCE = 5e-5  #: relative change of the pads' motion by an iteration at which a sample ends
MAX_ITERATIONS = 16  #: with one tangent
RENEWALS = 2  #: of the tangent, of samples that have not settled then
#: of the pad, between a line and another one or an upright face of a pillar, if both are to be lines
MIN_GAP, MIN_BOX = 0.01, 0.1
FACES = 2  #: shares of a pad from which on faces are lines


def array_grid(design: SensorDesign, pad: tuple[float, ...], height: tuple[float, ...]) -> Grid:
    """The whole slab, with lines along the pads' edges, between units, and at shares of each pad and of the height.

    With `FACES` shares of a pad or more, upright faces of pillars of another rubber are lines, in place of shares near.
    """
    pitch, size = design.array.pitch_mm, design.pad.size_mm
    lines = [design.unit.height_mm * np.array([0.0, *height])]
    for axis, count in ((1, design.array.rows), (0, design.array.cols)):
        offset = (design.pad.offset_x_mm, design.pad.offset_y_mm)[axis]
        low = pitch / 2 + offset - size / 2
        ends, faces = [0.0, low, low + size, pitch], list[float]()
        for prism in () if design.is_homogeneous or len(pad) < FACES else unit_prisms(design.unit.body):
            for face in prism.base_mm[axis] + prism.extents_mm[axis] / 2 * np.array([-1, 1]) + pitch / 2:
                if prism.lean[axis] == 0 and min(abs(face - place) for place in (*ends, *faces)) > MIN_GAP * size:
                    faces.append(float(face))
        inner = [low + size * share for share in pad]
        inner = [place for place in inner if all(abs(place - face) > MIN_BOX * size for face in faces)]
        unit = np.unique(np.round([low, *inner, low + size, *faces, pitch], 9))
        lines.append(np.concatenate([[0.0], *(unit + k * pitch for k in range(count))]) - count * pitch / 2)
    return Grid(lines[::-1])


def array_body(design: SensorDesign, grid: Grid, model: str | None = None) -> Rubber:
    """A slab's rubbers on a grid of equal units, pillars of another one as shares of its points of integration.

    The law is the design's, neo-Hookean where that is linear, unless a model is given.
    """
    own = design.matrix_material.model
    law = LAWS[model or ("neo-hookean" if own == "linear" else own)]
    shares = None
    if not design.is_homogeneous:
        counts = (design.array.cols, design.array.rows, 1)
        units = [line[: len(line) // n + 1] for line, n in zip(grid.lines, counts, strict=True)]
        middle = design.array.pitch_mm / 2
        x, y, z = (quadrature_lines(line - line[0] - at) for line, at in zip(units, (middle, middle, 0.0), strict=True))
        of_pillars = np.tile(pillar_shares(design.unit, x, y, z), counts)
        shares = np.stack([1 - of_pillars, of_pillars])
    return mixed_rubber(grid, law, [design.matrix_material, design.pillar_material], shares)


class PreloadedArray:
    """An array of k units on one grid, its lines as of `array_grid`."""

    def __init__(self, design: SensorDesign, pad: tuple[float, ...], height: tuple[float, ...]) -> None:
        self.design, self.grid, self._lines = design, array_grid(design, pad, height), (pad, height)
        self.body = array_body(design, self.grid)
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
        moved = self.linear(np.eye(3 * self.design.n_units))
        return np.asarray(self.electrodes(moved).reshape(len(moved.u), -1).T)

    def linear(self, force_n: FloatArray) -> State:
        """Linear motions of the array at rest under forces (m, 3 k) on its pads [N]."""
        rest, k = self.base(0.0), self.design.n_units
        loads = np.zeros((len(force_n), rest.system.n_blocks, 3))
        loads[:, -2 * k : -k] = force_n.reshape(len(force_n), k, 3)
        (change, _), n = rest.changes(loads, np.zeros(1)), len(rest.system.free)
        u = rest.system.nodal_change(rest.state.rotation, change)
        spin = change[:, n + k :] / rest.system.plates.half_mm[:, None]
        return State(u=u, p=np.zeros(0), shift=change[:, n : n + k], turn=skew(spin))

    def forces_of(self, moved: FloatArray) -> FloatArray:
        """Forces (m, 3 k) [N] that move the linear array most nearly by displacements (m, k, n_upper, 3) [mm]."""
        return np.asarray(moved.reshape(len(moved), -1) @ self._inverse.T)

    @cached_property
    def _inverse(self) -> FloatArray:
        return np.asarray(np.linalg.pinv(self.influence))

    def slopes(self, points_mm: FloatArray) -> sp.csr_matrix:
        """Rows (3 n, n_nodes) of `slopes_at` at points (n, 3) [mm]."""
        return slopes_at(self.body, *self.grid.located(points_mm))

    @cached_property
    def young_mpa(self) -> float:
        """Young's modulus of the one rubber, of the matrix's ν, that plates on all units press in as far [MPa]."""
        own = self.design.matrix_material.young_mpa
        if self.design.is_homogeneous:
            return own
        alone = PreloadedArray(replace(self.design, pillar_material=self.design.matrix_material), *self._lines)
        down = np.tile([0.0, 0.0, 1.0], (1, self.design.n_units))
        soft, stiff = (array.linear(down).shift[..., 2].sum() for array in (alone, self))
        return float(own * soft / stiff)

    def solve(self, preload_mpa: float, force_n: FloatArray, unwanted: Unwanted) -> Relaxed:
        """Equilibria of samples under forces (m, k, 3) [N], by the tangent of a preload and, if need be, their own.

        Samples that are not wanted keep the change they had.
        """
        base = self.base(preload_mpa)
        found = base.relaxed(force_n, TOLERANCE, MAX_ITERATIONS, unwanted=unwanted)
        for number in np.flatnonzero(found.change > TOLERANCE):
            own = slice(number, number + 1)
            for _ in range(RENEWALS):
                if found.change[number] <= TOLERANCE or unwanted(found.state.part(np.array([number])))[0]:
                    break
                about = Linearised.at(base.system, found.state.part(int(number)), self._factor)
                last = about.relaxed(force_n[own], TOLERANCE, MAX_ITERATIONS, unwanted=unwanted)
                for name, values in vars(last.state).items():
                    getattr(found.state, name)[own] = values
                found.change[own] = last.change
                found.iterations[own] += last.iterations
        return found

    @cached_property
    def _factor(self) -> Factor:
        return next(iter(self._bases.values())).system.new_factor()
