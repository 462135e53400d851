"""Thousands of finite-strain samples of an array with stiff pads, from two equilibria under uniform preloads.

A sample begins at the preload nearest to the middle of its pressures, so that no pad is far from it, and is relaxed by
that preload's tangent: one factor serves every sample. What the coarse grid gets wrong at small strain is put right by
the linear response of a fine one.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fem.discretization.grid import Grid
from fem.finite.relaxation import Relaxation, Relaxed
from fem.finite.rubber_body import RubberBody
from fem.finite.series import BaseState, quaternion_rotations
from fem.finite.system import FiniteSystem, State, at_state
from fem.linear.refactored import RepeatedFactor
from fem.scene.loads import Load, StiffLoad
from geometry.design import SensorDesign
from geometry.errors import DesignError
from geometry.layout import FloatArray, unit_centres, upper_electrodes

PRELOADS_MPA = (0.0, 2.0)  #: uniform pressures from which samples are solved
TOLERANCE = 2e-4  #: relative change of the pads' motion by an iteration at which a sample ends
MAX_ITERATIONS = 14  #: with one tangent
RENEWALS = 3  #: of the tangent, of samples that have not settled then
AT_ONCE = 4  #: samples solved together, which bounds the memory
#: lines of the grid within a unit, as shares of the gap beside the pad, of the pad, and of the height; a thin layer at
#: the clamped base matters as much as one at the pads
GAP, PAD, HEIGHT = (1.0,), (0.2, 0.5, 0.8, 1.0), (0.2, 0.8, 1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class FiniteSamples:
    """Answers to m samples of loads on an array of k units."""

    displacement_mm: FloatArray  #: of the electrodes, (m, k, 2, 3)
    shift_mm: FloatArray  #: of the pads' middles, (m, k, 3)
    rotation: FloatArray  #: of the pads, (m, k, 3, 3)
    change: FloatArray  #: of the pads' motion by the last iteration, relative, (m,); infinite where none converged
    iterations: NDArray[np.int64]  #: (m,)
    preload: FloatArray  #: pressure from which each was solved, (m,) [MPa]


@dataclass(eq=False)
class SampleSolver:
    """Finite-strain response of an array of one rubber whose pads are rigid plates.

    Parameters
    ----------
    design : SensorDesign
    fine_compliance : array, shape (6 k, 3 k), optional
        Linear motions of the pads by a fine grid per newton on them, shifts (k, 3) then spins times half the pad's size
        [mm/N]; None leaves the coarse grid's.
    tolerance : float
        See `TOLERANCE`.
    """

    design: SensorDesign
    fine_compliance: FloatArray | None = None
    tolerance: float = TOLERANCE
    _bases: dict[float, BaseState] = field(default_factory=dict)
    _factor: RepeatedFactor | None = None

    def __post_init__(self) -> None:
        if not self.design.is_homogeneous:
            raise DesignError("finite strain takes arrays of one rubber so far: give the pillars the matrix's.")
        self.body = RubberBody(array_grid(self.design), [self.design.matrix_material])
        self.area_mm2 = self.design.pad.size_mm**2

    def base(self, preload_mpa: float) -> BaseState:
        """The equilibrium under a uniform pressure on all pads, found once."""
        if preload_mpa not in self._bases:
            self._bases[preload_mpa] = BaseState.of(self._system(preload_mpa))
        return self._bases[preload_mpa]

    def _system(self, preload_mpa: float) -> FiniteSystem:
        size, offset = self.design.pad.size_mm, (self.design.pad.offset_x_mm, self.design.pad.offset_y_mm)
        loads: list[Load] = [
            StiffLoad(
                center_mm=(float(x + offset[0]), float(y + offset[1])),
                size_mm=(size, size),
                force_n=(0.0, 0.0, -preload_mpa * self.area_mm2),
            )
            for x, y in unit_centres(self.design)
        ]
        return FiniteSystem(self.body, loads)

    def displacements(self, force_n: FloatArray) -> FiniteSamples:
        """Displacements of the electrodes under forces on the pads.

        Parameters
        ----------
        force_n : array, shape (m, k, 3)
            Along x, y, z; z negative pushes down [N].

        Returns
        -------
        FiniteSamples

        Raises
        ------
        UnreachableLoadError
            If a uniform preload near a sample has no equilibrium.
        """
        pressure = -force_n[..., 2] / self.area_mm2
        middle = (pressure.min(axis=1) + pressure.max(axis=1)) / 2
        levels = np.array(PRELOADS_MPA)
        far = np.abs(pressure[:, :, None] - levels).max(axis=1)  # (m, levels)
        preload = levels[np.abs(middle[:, None] - levels).argmin(axis=1)]
        m, k = force_n.shape[:2]
        shift, rotation = np.empty((m, k, 3)), np.empty((m, k, 3, 3))
        change, iterations = np.empty(m), np.empty(m, dtype=np.int64)
        for level, distance in zip(levels, far.T, strict=True):
            mine = np.flatnonzero(preload == level)
            mine = mine[np.argsort(distance[mine])]  # those that need as many iterations go together
            for first in range(0, len(mine), AT_ONCE):
                own = mine[first : first + AT_ONCE]
                found = self._relaxed(self.base(float(level)), force_n[own])
                shift[own], rotation[own], change[own] = found.state.shift, found.state.rotation, found.change
                iterations[own] = found.iterations
                for number in np.flatnonzero(found.change > self.tolerance):
                    sample = own[number]
                    last = self._renewed(at_state(found.state, int(number)), force_n[sample])
                    shift[sample], rotation[sample] = last.state.shift[0], last.state.rotation[0]
                    change[sample] = last.change[0]
                    iterations[sample] += last.iterations[0]
        if self.fine_compliance is not None:
            extra = force_n.reshape(m, -1) @ (self.fine_compliance - self._coarse_compliance()).T
            moves, spins = extra.reshape(m, 2, k, 3).swapaxes(0, 1)
            shift = shift + moves
            rotation = quaternion_rotations(spins / self.design.pad.size_mm) @ rotation
        arm = upper_electrodes(self.design.unit)
        arm[:, 2] = 0.0
        arm[:, :2] -= [self.design.pad.offset_x_mm, self.design.pad.offset_y_mm]
        moved = shift[:, :, None] + np.einsum("mkij,ej->mkei", rotation, arm) - arm
        return FiniteSamples(
            displacement_mm=moved,
            shift_mm=shift,
            rotation=rotation,
            change=change,
            iterations=iterations,
            preload=preload,
        )

    def _coarse_compliance(self) -> FloatArray:
        k = self.design.n_units
        return self.base(0.0).compliance()[:, : 3 * k]

    def _relaxed(self, base: BaseState, force_n: FloatArray) -> Relaxed:
        loads = np.zeros((len(force_n), 2, *force_n.shape[1:]))
        loads[:, 0] = force_n - base.system.force_n
        relaxation = Relaxation(base, loads)
        return relaxation.relax(relaxation.start(), MAX_ITERATIONS, self.tolerance)

    def _renewed(self, state: State, force_n: FloatArray) -> Relaxed:
        """One sample (k, 3) taken on from a state, whose own tangent is factored: up to `RENEWALS` times."""
        loads = np.zeros((1, 2, *force_n.shape))
        system = self.base(PRELOADS_MPA[-1]).system
        loads[0, 0] = force_n - system.force_n
        self._factor = self._factor or RepeatedFactor(system.pattern)
        for _ in range(RENEWALS):
            relaxation = Relaxation(BaseState.about(system, state, self._factor), loads)
            found = relaxation.relax(relaxation.start(), MAX_ITERATIONS, self.tolerance)
            if found.change[0] <= self.tolerance:
                break
            state = at_state(found.state, 0)
        return found


def array_grid(design: SensorDesign) -> Grid:
    """The whole slab: a few boxes a unit, with lines along the pads' edges."""
    pitch, size, height = design.array.pitch_mm, design.pad.size_mm, design.unit.height_mm
    lines = []
    for count, offset in ((design.array.cols, design.pad.offset_x_mm), (design.array.rows, design.pad.offset_y_mm)):
        low, high = pitch / 2 + offset - size / 2, pitch / 2 + offset + size / 2
        own = [low * share for share in GAP] + [low + size * share for share in PAD]
        own += [high + (pitch - high) * share for share in GAP]
        unit = np.unique(np.round(own, 9))
        lines.append(np.concatenate([[0.0], *(unit + k * pitch for k in range(count))]) - count * pitch / 2)
    return Grid(x=lines[0], y=lines[1], z=height * np.array([0.0, *HEIGHT]))
