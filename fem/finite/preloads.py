"""An array with stiff pads on a grid, its equilibria under uniform pressures, and what it takes to a finer grid."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.discretization.grid import Grid
from fem.discretization.lagrange import gauss_points, line_values
from fem.finite.relaxation import Relaxation, Relaxed
from fem.finite.rubber_body import N_PRESSURES, PROJECTION, RubberBody
from fem.finite.series import BaseState
from fem.finite.system import FiniteSystem, State, at_state
from fem.linear.refactored import RepeatedFactor
from fem.scene.loads import Load, StiffLoad
from geometry.design import SensorDesign
from geometry.layout import FloatArray, unit_centres, upper_electrodes

MAX_ITERATIONS = 16  #: with one tangent
RENEWALS = 2  #: of the tangent, of samples that have not settled then
NEARLY = 0.1  #: change below which displacements tell whether a sample is wanted at all

#: displacements (m, k, 2, 3) of electrodes to booleans (m,): of samples that need no answer
Unwanted = Callable[[FloatArray], NDArray[np.bool_]]


@dataclass(frozen=True, kw_only=True)
class Lines:
    """Lines of a grid within a unit, as shares of the gap beside the pad, of the pad, and of the height."""

    gap: tuple[float, ...] = (1.0,)
    pad: tuple[float, ...]
    height: tuple[float, ...]

    def grid(self, design: SensorDesign) -> Grid:
        """The whole slab, with lines along the pads' edges and between units."""
        pitch, size, height = design.array.pitch_mm, design.pad.size_mm, design.unit.height_mm
        lines = []
        for count, offset in ((design.array.cols, design.pad.offset_x_mm), (design.array.rows, design.pad.offset_y_mm)):
            low, high = pitch / 2 + offset - size / 2, pitch / 2 + offset + size / 2
            own = [low * share for share in self.gap] + [low + size * share for share in self.pad]
            own += [high + (pitch - high) * share for share in self.gap]
            unit = np.unique(np.round(own, 9))
            lines.append(np.concatenate([[0.0], *(unit + k * pitch for k in range(count))]) - count * pitch / 2)
        return Grid(x=lines[0], y=lines[1], z=height * np.array([0.0, *self.height]))


class PreloadedArray:
    """An array of k units on one grid.

    Parameters
    ----------
    design : SensorDesign
        Of one rubber.
    lines : Lines
    """

    def __init__(self, design: SensorDesign, lines: Lines) -> None:
        self.design = design
        self.body = RubberBody(lines.grid(design), [design.matrix_material])
        offset = [design.pad.offset_x_mm, design.pad.offset_y_mm, 0.0]
        self.arm = (
            upper_electrodes(design.unit) * (1.0, 1.0, 0.0) - offset
        )  #: of the electrodes on their plates, (2, 3)
        self._bases: dict[float, BaseState] = {}

    def base(self, preload_mpa: float) -> BaseState:
        """The equilibrium under a uniform pressure on all pads, found once.

        Raises
        ------
        UnreachableLoadError
            If there is none.
        """
        if preload_mpa not in self._bases:
            self._bases[preload_mpa] = BaseState.of(self._system(preload_mpa))
        return self._bases[preload_mpa]

    def _system(self, preload_mpa: float) -> FiniteSystem:
        pad = self.design.pad
        loads: list[Load] = [
            StiffLoad(
                center_mm=(float(x + pad.offset_x_mm), float(y + pad.offset_y_mm)),
                size_mm=(pad.size_mm, pad.size_mm),
                force_n=(0.0, 0.0, -preload_mpa * pad.size_mm**2),
            )
            for x, y in unit_centres(self.design)
        ]
        return FiniteSystem(self.body, loads)

    def electrodes(self, shift: FloatArray, rotation: FloatArray) -> FloatArray:
        """Displacements (m, k, 2, 3) [mm] of the electrodes under plates of these motions."""
        return np.asarray(shift[:, :, None] + np.einsum("mkij,ej->mkei", rotation, self.arm) - self.arm)

    @cached_property
    def influence(self) -> FloatArray:
        """Linear displacement of the electrodes per newton on each pad, (6 k, 3 k) [mm/N]."""
        k, rest = self.design.n_units, self._bases.get(0.0) or BaseState.of(self._system(0.0))
        moves, spins = rest.compliance()[:, : 3 * k].T.reshape(3 * k, 2, k, 3).swapaxes(0, 1)
        spins = spins / rest.system.plates.half_mm[:, None]
        return np.asarray((moves[:, :, None] + np.cross(spins[:, :, None], self.arm)).reshape(3 * k, -1).T)

    @cached_property
    def forces_of(self) -> FloatArray:
        """Forces (3 k) that move the linear array most nearly by displacements (6 k), as a matrix [N/mm]."""
        return np.asarray(np.linalg.pinv(self.influence))

    def solve(
        self, preload_mpa: float, force_n: FloatArray, tolerance: float, unwanted: Unwanted, start: State | None = None
    ) -> Relaxed:
        """Equilibria of samples under forces (m, k, 3) [N], by the tangent of a preload and, if need be, their own.

        Begins from that tangent at once, or from given states. Samples that are not wanted keep the change they had.
        """
        found = self._relaxed(self.base(preload_mpa), force_n, tolerance, unwanted, start)
        for number in np.flatnonzero((found.change > tolerance) & np.isfinite(found.change)):
            own, sample = at_state(found.state, int(number)), slice(number, number + 1)
            for _ in range(RENEWALS):
                if unwanted(self.electrodes(found.state.shift[sample], found.state.rotation[sample]))[0]:
                    break
                about = BaseState.about(self.base(preload_mpa).system, own, self._factor)
                last = self._relaxed(about, force_n[sample], tolerance, unwanted)
                for name in ("u", "p", "shift", "rotation"):
                    getattr(found.state, name)[number] = getattr(last.state, name)[0]
                found.change[number] = last.change[0]
                found.iterations[number] += last.iterations[0]
                if last.change[0] <= tolerance:
                    break
                own = at_state(last.state, 0)
        return found

    def _relaxed(
        self, base: BaseState, force_n: FloatArray, tolerance: float, unwanted: Unwanted, start: State | None = None
    ) -> Relaxed:
        def hopeless(shift: FloatArray, rotation: FloatArray, change: FloatArray) -> NDArray[np.bool_]:
            return (change < NEARLY) & unwanted(self.electrodes(shift, rotation))

        loads = np.zeros((len(force_n), 2, *force_n.shape[1:]))
        loads[:, 0] = force_n - base.system.force_n
        relaxation = Relaxation(base, loads)
        x = relaxation.start() if start is None else relaxation.vectors(start)
        return relaxation.relax(x, MAX_ITERATIONS, tolerance, hopeless)

    @cached_property
    def _factor(self) -> RepeatedFactor:
        return RepeatedFactor(next(iter(self._bases.values())).system.pattern)


Transfer = Callable[[State, State, State], State]


def transfer(coarse: PreloadedArray, fine: PreloadedArray) -> Transfer:
    """A function that takes states of a coarse grid to a fine one, given the base states of both grids.

    Displacements from the base state are interpolated, and pressures by the nearest linear functions.
    """
    along = [line_values(c, 2, _nodes(f)) for c, f in zip(coarse.body.grid.lines, fine.body.grid.lines, strict=True)]
    shape = [matrix.shape[1] for matrix in along]
    of_pressures = _pressure_matrix(coarse.body.grid, fine.body.grid)

    def transferred(state: State, base: State, to: State) -> State:
        m = len(state.u)
        moved = (state.u - base.u).reshape(m, *shape, 3)
        for axis, matrix in enumerate(along, start=1):
            moved = np.moveaxis(np.tensordot(matrix, moved, axes=(1, axis)), 0, axis)
        p = (of_pressures @ (state.p - base.p).reshape(m, -1).T).T
        return State(
            u=to.u + moved.reshape(m, -1, 3),
            p=to.p + p.reshape(m, -1, N_PRESSURES),
            shift=to.shift + state.shift - base.shift,
            rotation=state.rotation @ base.rotation.swapaxes(1, 2) @ to.rotation,
        )

    return transferred


def _nodes(lines: FloatArray) -> FloatArray:
    return np.sort(np.concatenate([lines, (lines[1:] + lines[:-1]) / 2]))


def _pressure_matrix(coarse: Grid, fine: Grid) -> sp.csr_matrix:
    """Pressures (e, 4) of the fine grid's elements from those of the coarse one's, flat."""
    points, _ = gauss_points(3)
    element, within = [], []
    for old, new in zip(coarse.lines, fine.lines, strict=True):
        place = (new[:-1, None] + new[1:, None] + np.diff(new)[:, None] * points) / 2  # (elements, 3)
        e = np.clip(np.searchsorted(old, place, side="right") - 1, 0, len(old) - 2)
        element.append(e)
        within.append((2 * place - old[e] - old[e + 1]) / (old[e + 1] - old[e]))
    shape, (nx, ny, nz) = fine.shape, coarse.shape
    rows, cols, values = [], [], []
    number = np.arange(int(np.prod(shape)))
    i, j, k = np.unravel_index(number, shape)
    for q, (a, b, c) in enumerate(product(range(3), repeat=3)):
        source = (element[0][i, a] * ny + element[1][j, b]) * nz + element[2][k, c]
        local = np.stack([np.ones(len(number)), within[0][i, a], within[1][j, b], within[2][k, c]])
        for row, col in product(range(N_PRESSURES), repeat=2):
            rows.append(N_PRESSURES * number + row)
            cols.append(N_PRESSURES * source + col)
            values.append(PROJECTION[q, row] * local[col])
    size = (N_PRESSURES * len(number), N_PRESSURES * nx * ny * nz)
    return sp.csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))), shape=size)
