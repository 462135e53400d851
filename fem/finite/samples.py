"""Thousands of finite-strain samples of an array with stiff pads, on a coarse grid and, from there, on a finer one.

A sample is relaxed on a coarse grid by the tangent of the preload nearest to the middle of its pressures, and from its
answer on a finer grid in a few iterations more; one factor of each grid serves every sample. What a grid gets wrong at
small strain is put right by a linear response: with influence matrices A, of a much finer grid, and B, its own, an
answer d becomes d + (A − B) g, where g are the forces that would move the linear array most nearly by d; resistances by
conduction are put right in the same way. What is left falls from the coarse grid to the finer one by a factor that is
nearly constant, and is extrapolated.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from common.errors import DesignError
from common.storage.cache import kept_value
from common.storage.files import digest
from fem.conduction.potentials import Piezoresistivity, pillars_per_mm, unit_conductances
from fem.conduction.reduced import Deformations, ReducedConduction, reduced_conduction
from fem.finite.preloads import PreloadedArray, Refinement, Unwanted
from fem.kernel.chord import Chord, Relaxed
from fem.kernel.system import State
from geometry.design import SensorDesign
from geometry.layout import FloatArray, pillar_vectors, pillar_volumes, unit_centres

PRELOADS_MPA = (0.0, 2.0)  #: uniform pressures from whose tangents samples are solved
TOLERANCE = 5e-5  #: relative change of the pads' motion by an iteration at which a sample ends
#: most iterations on the finer grid: where rubber at pads' edges needs more, the answer is left as it is, and what it
#: may be off by of the last change is stated
FINER, STALLED = 5, 4.0
AT_ONCE = 8  #: samples solved together, which bounds the memory
#: lines of the grids, as shares of the pad and of the height
COARSE = (0.5, 1.0), (0.5, 1.0)
FINE = (0.2, 0.8, 1.0), (0.2, 0.8, 1.0)
#: error of the finer grid over the difference of both, from pairs of units at strains of 0.1 to 0.3 on a grid of eight
#: times the elements; and how much of the difference may be left after it is subtracted, as in arrays of 3 × 3 units
EXTRAPOLATED, LEFT = 0.15, 0.4
#: the same of ratios of resistances, from arrays of 2 × 2 units at strains to 0.3 and whole conduction on such a grid
RATIO_EXTRAPOLATED, RATIO_LEFT = 0.2, 0.45
#: share of its volume from which a pillar's point begins to count, and from which it counts in full: rubber of ν = 0.49
#: keeps far more than either
TORN, WHOLE = 0.2, 0.8
PROBE_N = 0.1  #: force on a pad by which resistances are differentiated: strains of 1e-4, errors of their square
MIN_WEIGHT = 0.5  #: share of a pillar's volume below which a state is no answer
#: samples of 2 × 2 units whose deformations the reduced conduction is made of; their highest pressure over Young's
#: modulus, and largest shear over pressure
TYPICAL, HIGHEST, FRICTION = 12, 0.8, 0.3
LOWERED = 0.7  #: what of its load a typical sample keeps that has no answer
TYPICAL_METHOD = 2  #: raise when the same design gives another reduced conduction
REDUCED_ERROR = 2e-3  #: largest relative error of a resistance by few potentials and points, of 48 in other samples

IntArray = NDArray[np.int64]


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
        return self.change <= TOLERANCE


class SampleSolver:
    """Finite-strain response of an array of one rubber whose pads are rigid plates.

    Parameters
    ----------
    design : SensorDesign
        Of one neo-Hookean rubber, or a `DesignError`.
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
        unwanted: Unwanted | None = None,
        typical: SensorDesign | None = None,
    ) -> None:
        if not design.is_homogeneous:
            raise DesignError("finite strain takes arrays of one rubber so far: give the pillars the matrix's.")
        if (model := design.matrix_material.model) in ("mooney-rivlin", "yeoh"):
            raise DesignError(
                f"model='{model}' is for scenes: samples are solved of neo-Hookean rubber only so far; write "
                "model = 'neo-hookean'."
            )
        self.design, self._influence, self._unwanted = design, influence_mm_per_n, unwanted
        self._resistance_per_n = resistance_per_n
        self._loaded = [*design.unit.layout.loaded]
        self.coarse, self.fine = PreloadedArray(design, *COARSE), PreloadedArray(design, *FINE)
        self._reader = PillarReader(design, typical or design) if design.electrics.is_conduction else None

    def displacements(self, force_n: FloatArray) -> FiniteSamples:
        """Displacements of the electrodes under forces (m, k, 3) on the pads along x, y, z, down negative [N].

        To the last bit the same for the same samples in the same order, on one machine and one thread; other neighbours
        change it by rounding. An `UnreachableLoadError` says that a uniform preload near a sample has no equilibrium.
        """
        m, found = len(force_n), dict[str, Any]()
        nearest = self._nearest(force_n)
        for preload in PRELOADS_MPA:
            own = np.flatnonzero(nearest == preload)
            for some in np.split(own, range(AT_ONCE, len(own), AT_ONCE)) if len(own) else []:
                for name, values in vars(self._together(preload, force_n[some])).items():
                    found.setdefault(name, np.zeros((m, *values.shape[1:]), values.dtype))[some] = values
        return FiniteSamples(**found)

    def _nearest(self, force_n: FloatArray) -> FloatArray:
        """The preload (m,) nearest to the middle of the pressures of samples (m, k, 3) [N]."""
        middle = -(force_n[..., 2].min(axis=1) + force_n[..., 2].max(axis=1)) / 2 / self.design.pad.size_mm**2
        return np.where(middle < np.mean(PRELOADS_MPA), *PRELOADS_MPA)

    def _solved(self, preload: float, force_n: FloatArray) -> tuple[Relaxed, NDArray[np.bool_], Relaxed | None]:
        """Samples on the coarse grid, which of them have settled, and these on the finer one."""
        coarse = self.coarse.solve(preload, force_n, TOLERANCE, self._is_unwanted)
        on = coarse.change <= TOLERANCE
        if not on.any():
            return coarse, on, None
        start = self._refinement.steps(preload, coarse.state.part(np.flatnonzero(on)))
        return coarse, on, Chord(self.fine.base(preload), force_n[on]).relax(TOLERANCE, FINER, start)

    @cached_property
    def _refinement(self) -> Refinement:
        return Refinement(self.coarse, self.fine)

    def _together(self, preload: float, force_n: FloatArray) -> FiniteSamples:
        """Answers to some samples by one preload; the finer grid costs nothing where a sample has not settled."""
        coarse, on, fine = self._solved(preload, force_n)
        rough = self._corrected(self.coarse, self.coarse.electrodes(coarse.state))
        moved, change, left = rough.copy(), coarse.change, np.full(len(force_n), np.inf)
        ratio = np.ones((*force_n.shape[:2], len(self.design.unit.layout.pillars)))
        ratio_error = np.zeros(len(force_n))
        if fine is not None:
            coarse.iterations[on] += fine.iterations
            answers = self._corrected(self.fine, self.fine.electrodes(fine.state))
            difference = answers - rough[on]
            moved[on] = answers + EXTRAPOLATED * difference
            size = np.maximum(_norms(moved[on]), 1e-300)
            left[on] = np.hypot(LEFT * _norms(difference) / size, STALLED * fine.change)
        if fine is not None and self._reader is not None:
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
        assert self._reader is not None
        return self.coarse.slopes(self._reader.points_mm), self.fine.slopes(self._reader.points_mm)

    def _ratios(self, array: PreloadedArray, state: State) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Ratios (m, k, n_loaded) of resistances by a grid, with the much finer linear response; which are answers."""
        assert self._reader is not None
        moved = array.electrodes(state)
        found, good = self._reader.ratios(gradients(self._slopes[array is self.fine], state.u), moved)
        if self._resistance_per_n is not None:
            changes = array.forces_of(moved) @ self._missing_ratios[array is self.fine].T
            found = found + changes.reshape(found.shape)
        return found, good

    def _corrected(self, array: PreloadedArray, moved: FloatArray) -> FloatArray:
        """Displacements (m, k, n_upper, 3) with the much finer linear response in place of the grid's own."""
        if self._influence is None:
            return moved
        added = self._influence.reshape(array.influence.shape) - array.influence
        return moved + (array.forces_of(moved) @ added.T).reshape(moved.shape)

    @cached_property
    def _missing_ratios(self) -> tuple[FloatArray, FloatArray]:
        """What the coarse and the finer grid miss of the ratios per newton, (n_pillars k, 3 k) [1/N]."""
        assert self._influence is not None
        assert self._resistance_per_n is not None
        assert self._reader is not None
        unit, k, n = self.design.unit.body, self.design.n_units, 3 * self.design.n_units
        rest = pillar_vectors(unit)
        own = self._influence.reshape(k, -1, 3, n)[:, unit.layout.pillar_top]
        by_eq1 = 2 * np.einsum("pi,kpin->kpn", rest / (rest**2).sum(axis=1)[:, None], own)
        at_rest = unit_conductances(unit).pillars_per_mm * pillar_volumes(unit) / (rest**2).sum(axis=1)
        wanted = (self._resistance_per_n.reshape(k, -1, n)[:, self._loaded] - by_eq1) * at_rest[:, None]
        forces, found = PROBE_N * np.eye(n), []
        for array, slopes in zip((self.coarse, self.fine), self._slopes, strict=True):
            H = gradients(slopes, array.linear_fields(forces))
            moved = (forces @ array.influence.T).reshape(n, k, -1, 3)
            up, down = (self._reader.ratios(sign * H, sign * moved)[0] for sign in (1, -1))
            seen = (up - down).reshape(n, -1).T / (2 * PROBE_N)
            found.append(wanted.reshape(-1, n) - seen)
        return found[0], found[1]

    def _is_unwanted(self, moved: FloatArray) -> NDArray[np.bool_]:
        """Samples (m,) by displacements (m, k, n_upper, 3) of the coarse grid."""
        if self._unwanted is None:
            return np.zeros(len(moved), dtype=bool)
        return self._unwanted(self._corrected(self.coarse, moved))


def _smooth_step(x: FloatArray, low: float, high: float) -> FloatArray:
    """0 below, 1 above, and a cubic without kinks between."""
    share = np.clip((x - low) / (high - low), 0.0, 1.0)
    return np.asarray(share**2 * (3 - 2 * share))


def _norms(moved: FloatArray) -> FloatArray:
    """Of each sample, (m,)."""
    return np.linalg.norm(moved.reshape(len(moved), -1), axis=1)


class PillarReader:
    """Conduction in the pillars of every unit of an array of k units, as its electrics say."""

    def __init__(self, design: SensorDesign, typical: SensorDesign) -> None:
        self.unit = design.unit.body
        self._piezo, self._reduced = Piezoresistivity.of(design.electrics), typical_conduction(typical)
        centres = np.pad(unit_centres(design), ((0, 0), (0, 1)))
        #: places in the pillars where gradients are wanted, (k·n, 3)
        self.points_mm = (centres[:, None] + self._reduced.points_mm).reshape(-1, 3)
        self._shape = (len(centres), len(self._reduced.points_mm), 3, 3)

    def ratios(self, gradient: FloatArray, electrode_mm: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Resistances over eq. 1's (m, k, n_loaded), by ∂u/∂X (m, k·n, 3, 3) and displacements (m, k, n_upper, 3).

        Also which states are answers, (m,): every pillar has kept `MIN_WEIGHT` of its volume; of others ratios are 1.
        Points under the edge of a plate, where coarse grids tear the rubber, are blended with the mean of their pillar.
        """
        reduced = self._reduced
        F, kept_volume = _mended(
            np.eye(3) + gradient.reshape(len(gradient), *self._shape), reduced.pillar, reduced.weight_mm3
        )
        good = np.asarray(kept_volume.all(axis=1))
        along = pillar_vectors(self.unit) + electrode_mm[good][..., self.unit.layout.pillar_top, :]
        ratios = np.ones((*electrode_mm.shape[:2], len(self.unit.layout.pillars)))
        per_mm = pillars_per_mm(reduced.conductances(F[good], self._piezo), self.unit.layout.pillar_terminals)
        ratios[good] = per_mm * pillar_volumes(self.unit) / (along**2).sum(axis=-1)
        return ratios, good


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
    fields = solver.fields(force_n * (design.matrix_material.young_mpa * design.pad.size_mm**2))

    def deformations(points_mm: FloatArray, pillar: IntArray, weight_mm3: FloatArray) -> Iterator[FloatArray]:
        for centre in np.pad(unit_centres(design), ((0, 0), (0, 1))):
            slopes = [array.slopes(points_mm + centre) for array in (solver.coarse, solver.fine)]
            for H in (gradients(rows, u) for field in fields for rows, u in zip(slopes, field, strict=True)):
                F, good = _mended(np.eye(3) + H[:, None], pillar, weight_mm3)
                yield from F[good]

    return deformations


def gradients(slopes: sp.csr_matrix, displacement_mm: FloatArray) -> FloatArray:
    """∂u/∂X (m, n, 3, 3) of m states of the nodes (m, n_nodes, 3) [mm] by `slopes_at` (3 n, n_nodes)."""
    m = len(displacement_mm)
    found = slopes @ displacement_mm.transpose(1, 0, 2).reshape(-1, 3 * m)
    return np.ascontiguousarray(found.reshape(3, -1, m, 3).transpose(2, 1, 3, 0))


def _mended(F: FloatArray, pillar: IntArray, weight_mm3: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Deformations (m, k, n, 3, 3) of points, torn ones blended with the mean of their pillar; which are answers."""
    weight = _smooth_step(np.linalg.det(F), TORN, WHOLE)  # so that resistances have no jumps
    volume = np.eye(pillar.max() + 1)[pillar] * weight_mm3[:, None]
    total = weight @ volume  # (m, k, n_pillars)
    of_whole = (weight[..., None, None] * F).reshape(*F.shape[:3], 9).swapaxes(2, 3) @ volume  # (m, k, 9, n_pillars)
    mean = (of_whole / np.maximum(total, 1e-9)[:, :, None]).swapaxes(2, 3).reshape(*total.shape, 3, 3)[:, :, pillar]
    mended = mean + weight[..., None, None] * (F - mean)
    good = (total > MIN_WEIGHT * volume.sum(axis=0)).all(axis=2) & (np.linalg.det(mended) > 0).all(axis=2)
    return mended, np.asarray(good)
