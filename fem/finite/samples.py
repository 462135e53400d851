"""Thousands of finite-strain samples of an array with stiff pads, on a coarse grid and, from there, on a finer one.

A sample is relaxed on a coarse grid by the tangent of the preload nearest to the middle of its pressures, and from its
answer on a finer grid in a few iterations more; one factor of each grid serves every sample. What a grid gets wrong at
small strain is put right by a linear response: with influence matrices A, of a much finer grid, and B, its own, an
answer d becomes d + (A − B) g, where g are the forces that would move the linear array most nearly by d; resistances by
conduction are put right in the same way. What is left falls from the coarse grid to the finer one by a factor that is
nearly constant, and is extrapolated.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from common.storage.cache import kept_value
from common.storage.files import digest
from fem.conduction.potentials import Piezoresistivity, unit_conductances
from fem.conduction.reduced import Deformations, ReducedConduction, mended, reduced_conduction
from fem.finite.preloaded import PRELOADS, TOLERANCE, PreloadedArray
from fem.kernel.field import rows_at
from fem.kernel.newton import Relaxed
from fem.kernel.plates import spins
from fem.kernel.reference import IntArray, tabulated
from fem.kernel.system import State
from geometry.design import SensorDesign
from geometry.layout import FloatArray, pillar_vectors, pillar_volumes, unit_centres

#: most iterations on the finer grid, of one rubber and of two: where rubber at pads' edges needs more, the answer is
#: left as it is, and what it may be off by of the last change is stated
FINER, STALLED = {True: 5, False: 10}, 4.0
MAX_ERROR = 0.1  #: estimated, of a sample: there elements at plates' edges collapse, and the finer grid has no answer
AT_ONCE = 8  #: samples solved together, which bounds the memory
#: lines of the coarse grid and of the finer one, as shares of the pad and of the height; of one rubber and of two
GRIDS = {
    True: (((0.5,), (0.5, 1.0)), ((0.2, 0.8), (0.2, 0.8, 1.0))),
    False: (((0.5,), (0.5, 1.0)), ((0.4, 0.8), (1 / 3, 2 / 3, 1.0))),
}
#: error of the finer grid over the difference of both, from pairs of units at strains of 0.1 to 0.3 on a grid of eight
#: times the elements; and how much of the difference may be left after it is subtracted, as in arrays of 3 × 3 units
EXTRAPOLATED, LEFT = 0.15, 0.4
LEFT_OF_TWO = 0.5  #: the same of two rubbers, of matrices 6 and 121 times as soft as the pillars, 1 × 1 and 2 × 2 units
#: the same of ratios of resistances, from arrays of 2 × 2 units at strains to 0.3 and whole conduction on such a grid
RATIO_EXTRAPOLATED, RATIO_LEFT = 0.2, 0.45
PROBE_N = 0.1  #: force on a pad by which resistances are differentiated: strains of 1e-4, errors of their square
#: samples of 2 × 2 units whose deformations the reduced conduction is made of; their highest pressure over Young's
#: modulus, and largest shear over pressure
TYPICAL, HIGHEST, FRICTION = 12, 0.8, 0.3
LOWERED = 0.7  #: what of its load a typical sample keeps that has no answer
TYPICAL_METHOD = 2  #: raise when the same design gives another reduced conduction
REDUCED_ERROR = 2e-3  #: largest relative error of a resistance by few potentials and points, of 48 in other samples

#: displacements (m, k, n_upper, 3) of electrodes to booleans (m,): of samples that need no answer
UnwantedMotion = Callable[[FloatArray], NDArray[np.bool_]]


@dataclass(frozen=True, kw_only=True, eq=False)
class FiniteSamples:
    """Answers to m samples of loads on an array of k units."""

    displacement_mm: FloatArray  #: of the electrodes, (m, k, n_upper, 3)
    change: FloatArray  #: of the pads' motion by the last iteration, relative, (m,); infinite where none converged
    iterations: IntArray  #: (m,)
    error_estimate: FloatArray  #: of the displacements, relative, (m,)
    #: resistances by conduction over those of eq. 1, (m, k, n_pillars); 1 where eq. 1 is asked for
    resistance_ratio: FloatArray
    ratio_error: FloatArray  #: largest estimated error of these, (m,)

    @property
    def settled(self) -> NDArray[np.bool_]:
        """Where it is an answer, (m,)."""
        return (self.change <= TOLERANCE) & (self.error_estimate <= MAX_ERROR)


class SampleSolver:
    """Finite-strain response of an array whose pads are rigid plates.

    Parameters
    ----------
    design : SensorDesign
        Of one rubber or two, of its own law; linear rubber is taken for neo-Hookean.
    influence_mm_per_n : array, shape (k, n_upper, 3, k, 3), optional
        Linear response of the electrodes by a much finer grid, per newton on each pad; None leaves each grid its own.
    resistance_per_n : array, shape (k, n_pillars, k, 3), optional
        Relative change of resistances by conduction per newton on each pad, by the same response.
    unwanted : function, optional
        Of samples that need no answer, such as those far beyond a cap of strain: given up before they have settled.
    typical : SensorDesign, optional
        Design of the same unit whose `typical_conduction` reads the pillars; default: this one's own.

    Notes
    -----
    Where the design's electrics are conduction, resistances are read by both grids' displacement gradients in the
    pillars, and extrapolated as displacements are.
    """

    def __init__(
        self,
        design: SensorDesign,
        influence_mm_per_n: FloatArray | None = None,
        resistance_per_n: FloatArray | None = None,
        unwanted: UnwantedMotion | None = None,
        typical: SensorDesign | None = None,
    ) -> None:
        self.design, self._influence, self._unwanted = design, influence_mm_per_n, unwanted
        self._resistance_per_n = resistance_per_n
        self._loaded, self._finer = [*design.unit.layout.loaded], FINER[design.is_homogeneous]
        coarse, fine = GRIDS[design.is_homogeneous]
        self.coarse, self.fine = PreloadedArray(design, *coarse), PreloadedArray(design, *fine)
        self._piezo = Piezoresistivity.of(design.electrics)
        self._reduced = typical_conduction(typical or design) if design.electrics.is_conduction else None

    def displacements(self, force_n: FloatArray) -> FiniteSamples:
        """Displacements of the electrodes under forces (m, k, 3) on the pads along x, y, z, down negative [N].

        To the last bit the same for the same samples in the same order, on one machine and one thread; other neighbours
        change it by rounding. An `UnreachableLoadError` says that a uniform preload near a sample has no equilibrium.
        """
        m, found = len(force_n), dict[str, Any]()
        nearest = self._nearest(force_n)
        for preload in self._preloads_mpa:
            own = np.flatnonzero(nearest == preload)
            for some in np.split(own, range(AT_ONCE, len(own), AT_ONCE)) if len(own) else []:
                for name, values in vars(self._together(preload, force_n[some])).items():
                    found.setdefault(name, np.zeros((m, *values.shape[1:]), values.dtype))[some] = values
        return FiniteSamples(**found)

    def _nearest(self, force_n: FloatArray) -> FloatArray:
        """The preload (m,) nearest to the middle of the pressures of samples (m, k, 3) [N]."""
        middle = -(force_n[..., 2].min(axis=1) + force_n[..., 2].max(axis=1)) / 2 / self.design.pad.size_mm**2
        low, high = self._preloads_mpa
        return np.where(middle < (low + high) / 2, low, high)

    @cached_property
    def _preloads_mpa(self) -> FloatArray:
        return self.coarse.young_mpa * np.array(PRELOADS)

    def _solved(self, preload: float, force_n: FloatArray) -> tuple[Relaxed, NDArray[np.bool_], Relaxed | None]:
        """Samples on the coarse grid, which of them have settled, and these on the finer one."""
        coarse = self.coarse.solve(preload, force_n, self._is_unwanted)
        on = coarse.change <= TOLERANCE
        if not on.any():
            return coarse, on, None
        start = self._on_finer(preload, coarse.state.part(np.flatnonzero(on)))
        return coarse, on, self.fine.base(preload).relaxed(force_n[on], TOLERANCE, self._finer, start)

    def _on_finer(self, preload: float, state: State) -> FloatArray:
        """Steps (m, n) of `Linearised` from the preload on the finer grid to states of the coarse one.

        Pressures are uniform in each element there.
        """
        (nodes, element, shown), base = self._of_finer, self.coarse.base(preload).state
        system, m = self.fine.base(preload).system, len(state.u)
        moved = (state.u - base.u).transpose(1, 0, 2).reshape(-1, 3 * m)
        u = (nodes @ moved).reshape(-1, m, 3).swapaxes(0, 1)[:, system.free]
        turned = spins(state.rotation @ base.rotation.swapaxes(-1, -2)) * system.plates.half_mm[:, None]
        pressures = np.zeros((m, *system.body.pressures_shape))
        pressures[..., 0] = np.einsum("mek,ek->me", (state.p - base.p)[:, element], shown)
        return np.hstack([part.reshape(m, -1) for part in (u, state.shift - base.shift, turned, pressures)])

    @cached_property
    def _of_finer(self) -> tuple[sp.csr_matrix, IntArray, FloatArray]:
        """Rows of the coarse grid at the finer one's nodes; its elements at that one's middles, and pressures there."""
        coarse, fine = self.coarse, self.fine
        element, local = coarse.grid.located(fine.body.centres_mm)
        rows = rows_at(coarse.body, *coarse.grid.located(fine.body.points_mm))
        return rows, element, tabulated(coarse.body.pressure, local)[0].T

    def _together(self, preload: float, force_n: FloatArray) -> FiniteSamples:
        """Answers to some samples by one preload; the finer grid costs nothing where a sample has not settled."""
        coarse, on, fine = self._solved(preload, force_n)
        rough = self._corrected(self.coarse, coarse.state)
        moved, change, left = rough.copy(), coarse.change, np.full(len(force_n), np.inf)
        ratio = np.ones((*force_n.shape[:2], len(self.design.unit.layout.pillars)))
        ratio_error = np.zeros(len(force_n))
        if fine is not None:
            coarse.iterations[on] += fine.iterations
            answers = self._corrected(self.fine, fine.state)
            difference = answers - rough[on]
            moved[on] = answers + EXTRAPOLATED * difference
            size = np.maximum(_norms(moved[on]), 1e-300)
            part = LEFT if self.design.is_homogeneous else LEFT_OF_TWO
            left[on] = np.hypot(part * _norms(difference) / size, STALLED * fine.change)
        if fine is not None and self._reduced is not None:
            less, sound = self._ratios(self.coarse, coarse.state.part(np.flatnonzero(on)))
            more, whole = self._ratios(self.fine, fine.state)
            loaded = ratio[on]
            loaded[..., self._loaded] = more + RATIO_EXTRAPOLATED * (more - less)
            ratio[on] = loaded
            by_grid = np.hypot(RATIO_LEFT * np.abs(more - less).max(axis=(1, 2)), STALLED * fine.change)
            ratio_error[on] = np.hypot(by_grid, REDUCED_ERROR)
            change[np.flatnonzero(on)[~(sound & whole)]] = np.inf
        return FiniteSamples(
            displacement_mm=moved,
            change=change,
            iterations=coarse.iterations,
            error_estimate=np.hypot(left, change),
            resistance_ratio=ratio,
            ratio_error=ratio_error,
        )

    def fields(self, force_n: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Displacements of both grids' nodes (1, n_nodes, 3) [mm] of samples under forces (m, k, 3) [N].

        Loads are lowered, sample by sample, until they have an answer.
        """
        found = []
        for force in force_n:
            fine = None
            while fine is None:
                coarse, _, fine = self._solved(float(self._nearest(force[None])[0]), force[None])
                force = LOWERED * force
            found.append((coarse.state.u, fine.state.u))
        return found

    @cached_property
    def _slopes(self) -> tuple[sp.csr_matrix, sp.csr_matrix]:
        """Of the coarse grid and of the finer one at the pillars' points."""
        assert self._reduced is not None
        places = (unit_middles(self.design)[:, None] + self._reduced.points_mm).reshape(-1, 3)
        return self.coarse.slopes(places), self.fine.slopes(places)

    def _ratios(self, array: PreloadedArray, state: State) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Ratios (m, k, n_loaded) of resistances by a grid, with the much finer linear response; which are answers."""
        moved = array.electrodes(state)
        found, good = self._read(array, state.u, moved)
        if self._resistance_per_n is not None:
            changes = array.forces_of(moved) @ self._missing_ratios[array is self.fine].T
            found = found + changes.reshape(found.shape)
        return found, good

    def _read(self, array: PreloadedArray, u: FloatArray, moved: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """`ReducedConduction.ratios` by nodes (m, n_nodes, 3) and electrodes (m, k, n_upper, 3) of a grid."""
        assert self._reduced is not None
        H = gradients(self._slopes[array is self.fine], u).reshape(*moved.shape[:2], -1, 3, 3)
        return self._reduced.ratios(self.design.unit.body, H, moved, self._piezo)

    def _corrected(self, array: PreloadedArray, state: State) -> FloatArray:
        """Electrodes (m, k, n_upper, 3) with the much finer linear response in place of the grid's own."""
        moved = array.electrodes(state)
        if self._influence is None:
            return moved
        added = self._influence.reshape(array.influence.shape) - array.influence
        return moved + (array.forces_of(moved) @ added.T).reshape(moved.shape)

    @cached_property
    def _missing_ratios(self) -> tuple[FloatArray, FloatArray]:
        """What the coarse and the finer grid miss of the ratios per newton, (n_pillars k, 3 k) [1/N]."""
        assert self._influence is not None
        assert self._resistance_per_n is not None
        unit, k, n = self.design.unit.body, self.design.n_units, 3 * self.design.n_units
        rest = pillar_vectors(unit)
        own = self._influence.reshape(k, -1, 3, n)[:, unit.layout.pillar_top]
        by_eq1 = 2 * np.einsum("pi,kpin->kpn", rest / (rest**2).sum(axis=1)[:, None], own)
        at_rest = unit_conductances(unit).pillars_per_mm * pillar_volumes(unit) / (rest**2).sum(axis=1)
        wanted = (self._resistance_per_n.reshape(k, -1, n)[:, self._loaded] - by_eq1) * at_rest[:, None]
        forces, found = PROBE_N * np.eye(n), []
        for array in (self.coarse, self.fine):
            u, moved = array.linear(forces).u, (forces @ array.influence.T).reshape(n, k, -1, 3)
            up, down = (self._read(array, sign * u, sign * moved)[0] for sign in (1, -1))
            seen = (up - down).reshape(n, -1).T / (2 * PROBE_N)
            found.append(wanted.reshape(-1, n) - seen)
        return found[0], found[1]

    def _is_unwanted(self, state: State) -> NDArray[np.bool_]:
        """Which states (m,) of the coarse grid need no answer."""
        if self._unwanted is None:
            return np.zeros(len(state.u), dtype=bool)
        return self._unwanted(self._corrected(self.coarse, state))


def _norms(moved: FloatArray) -> FloatArray:
    """Of each sample, (m,)."""
    return np.linalg.norm(moved.reshape(len(moved), -1), axis=1)


def typical_conduction(design: SensorDesign) -> ReducedConduction:
    """Reduced conduction of a design's units, from samples of 2 × 2 of them: a minute, then from the cache."""
    typical = replace(
        design,
        unit=design.unit.body,
        array=replace(design.array, rows=2, cols=2),
        electrics=replace(design.electrics, model="eq1"),
    )

    def make() -> ReducedConduction:
        piezo = Piezoresistivity.of(design.electrics)
        return reduced_conduction(design.unit, _typical_deformations(typical), piezo)

    key = digest("reduced conduction", TYPICAL_METHOD, TYPICAL, typical)
    return kept_value(ReducedConduction, "conduction.npz", key, make)[0]


def _typical_deformations(design: SensorDesign) -> Deformations:
    """Deformation gradients of both grids in all units of an array of eq. 1, in random samples that others resemble."""
    generator, k = np.random.default_rng(0), design.n_units
    force_n = np.empty((TYPICAL, k, 3))
    force_n[..., 2] = -generator.uniform(0, HIGHEST, (TYPICAL, k))
    angle, share = generator.uniform(0, 2 * np.pi, (TYPICAL, k)), np.sqrt(generator.uniform(0, 1, (TYPICAL, k)))
    force_n[..., 0] = FRICTION * share * np.cos(angle) * force_n[..., 2]
    force_n[..., 1] = FRICTION * share * np.sin(angle) * force_n[..., 2]
    solver = SampleSolver(design)
    fields = solver.fields(force_n * (solver.coarse.young_mpa * design.pad.size_mm**2))

    def deformations(points_mm: FloatArray, pillar: IntArray, weight_mm3: FloatArray) -> Iterator[FloatArray]:
        for centre in unit_middles(design):
            slopes = [array.slopes(points_mm + centre) for array in (solver.coarse, solver.fine)]
            for H in (gradients(rows, u) for field in fields for rows, u in zip(slopes, field, strict=True)):
                F, good = mended(np.eye(3) + H[:, None], pillar, weight_mm3)
                yield from F[good]

    return deformations


def unit_middles(design: SensorDesign) -> FloatArray:
    """Of all units on the base, (k, 3) [mm]."""
    return np.pad(unit_centres(design), ((0, 0), (0, 1)))


def gradients(slopes: sp.csr_matrix, displacement_mm: FloatArray) -> FloatArray:
    """∂u/∂X (m, n, 3, 3) of m states of the nodes (m, n_nodes, 3) [mm] by `slopes_at` (3 n, n_nodes)."""
    m = len(displacement_mm)
    found = slopes @ displacement_mm.transpose(1, 0, 2).reshape(-1, 3 * m)
    return np.ascontiguousarray(found.reshape(3, -1, m, 3).transpose(2, 1, 3, 0))
