"""Thousands of finite-strain samples of an array with stiff pads: a coarse grid solves, a finer one corrects by series.

A sample is relaxed on a coarse grid by the tangent of the preload nearest to the middle of its pressures; one factor
serves every sample. A finer grid adds the difference of both grids' power series in the load about that preload, to the
third order: what a grid gets wrong falls as fast with the order as the terms do. What a grid gets wrong at small strain
is put right by a linear response: with influence matrices A, of a much finer grid, and B, its own, an answer d becomes
d + (A − B) g, where g are the forces that would move the linear array most nearly by d. What is left falls from the
coarse grid to the finer one by a factor that is nearly constant, and is extrapolated.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.boxes.boxes import Boxes
from fem.conduction.reduced import REDUCED_ERROR
from fem.finite.conducted import PillarReader, gradients
from fem.finite.preloads import Lines, PreloadedArray, Unwanted
from fem.finite.relaxation import Relaxed
from geometry.design import SensorDesign
from geometry.errors import DesignError
from geometry.layout import FloatArray

PRELOADS_MPA = (0.0, 2.0)  #: uniform pressures from which samples are solved
TOLERANCE = 5e-4  #: relative change of the pads' motion by an iteration at which a sample ends
ORDERS = 3  #: of the series by which the finer grid corrects
AT_ONCE = 4  #: samples solved together, which bounds the memory
COARSE = Lines(pad=(0.5, 1.0), height=(0.5, 1.0))
FINE = Lines(pad=(0.2, 0.8, 1.0), height=(0.2, 0.8, 1.0))
#: error of the finer grid over the difference of both, from pairs of units at strains of 0.1 to 0.3 on a grid of ten
#: times the elements; and how much of the difference may be left after it is subtracted, as in arrays of 3 × 3 units
EXTRAPOLATED, LEFT = 0.28, 0.4
TRUNCATED = 0.5  #: of the last term of the series, left by those that follow

IntArray = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class FiniteSamples:
    """Answers to m samples of loads on an array of k units."""

    displacement_mm: FloatArray  #: of the electrodes, (m, k, n_upper, 3)
    settled: NDArray[np.bool_]  #: where it is an answer, (m,)
    change: FloatArray  #: of the pads' motion by the last iteration, relative, (m,); infinite where none converged
    iterations: IntArray  #: (m,)
    error_estimate: FloatArray  #: of the displacements, relative, (m,)
    resistance_ratio: (
        FloatArray  #: resistances by conduction over those of eq. 1, (m, k, n_pillars); 1 where eq. 1 is asked for
    )
    ratio_error: FloatArray  #: largest estimated error of these, (m,)


class SampleSolver:
    """Finite-strain response of an array of one rubber whose pads are rigid plates.

    Parameters
    ----------
    design : SensorDesign
    influence_mm_per_n : array, shape (k, n_upper, 3, k, 3), optional
        Linear response of the electrodes by a much finer grid, per newton on each pad; None leaves each grid its own.
    unwanted : function, optional
        Displacements (m, k, n_upper, 3) to booleans (m,): of samples that need no answer, such as those far beyond a
        cap of strain. These are given up before they have settled; they are the slowest.

    Raises
    ------
    DesignError
        If the array has two rubbers, or one of another law than the neo-Hookean.

    Notes
    -----
    Where the design's electrics are conduction, displacement gradients in the pillars are the coarse grid's with the
    difference of both series, and what that makes of the resistances is extrapolated as displacements are.
    """

    def __init__(
        self,
        design: SensorDesign,
        influence_mm_per_n: FloatArray | None = None,
        unwanted: Unwanted | None = None,
    ) -> None:
        if not design.is_homogeneous:
            raise DesignError("finite strain takes arrays of one rubber so far: give the pillars the matrix's.")
        if design.matrix_material.model == "mooney-rivlin":
            raise DesignError(
                "model='mooney-rivlin' is for scenes: the power series of samples know neo-Hookean rubber only; write "
                "model = 'neo-hookean'."
            )
        self.design, self._influence, self._unwanted = design, influence_mm_per_n, unwanted
        self.coarse, self.fine = PreloadedArray(design, COARSE), PreloadedArray(design, FINE)
        self._reader = PillarReader(design) if design.electrics.is_conduction else None

    def displacements(self, force_n: FloatArray) -> FiniteSamples:
        """Displacements of the electrodes under forces on the pads.

        Parameters
        ----------
        force_n : array, shape (m, k, 3)
            Along x, y, z; z negative pushes down [N].

        Returns
        -------
        FiniteSamples
            To the last bit the same for the same samples in the same order, on one machine and one thread; other
            neighbours change it by rounding.

        Raises
        ------
        UnreachableLoadError
            If a uniform preload near a sample has no equilibrium.
        """
        preload = self._nearest_preloads(force_n)
        m, k = force_n.shape[:2]
        layout = self.design.unit.layout
        moved, estimate, change = np.empty((m, k, len(layout.upper), 3)), np.empty(m), np.zeros(m)
        iterations = np.zeros(m, dtype=np.int64)
        ratio, ratio_error = np.ones((m, k, len(layout.pillars))), np.zeros(m)
        for level in PRELOADS_MPA:
            mine = np.flatnonzero(preload == level)
            for first in range(0, len(mine), AT_ONCE):
                own = mine[first : first + AT_ONCE]
                answer = self._together(level, force_n[own])
                moved[own], estimate[own], change[own], iterations[own], ratio[own], ratio_error[own] = answer
        return FiniteSamples(
            displacement_mm=moved,
            settled=change <= TOLERANCE,
            change=change,
            iterations=iterations,
            error_estimate=np.hypot(estimate, change),
            resistance_ratio=ratio,
            ratio_error=ratio_error,
        )

    def on_coarse_grid(self, force_n: FloatArray, displacement_mm: FloatArray) -> tuple[Boxes, FloatArray]:
        """For pictures: the coarse boxes and its displacements (n_nodes, 3) [mm] under forces (k, 3) [N].

        Small linear ones are added that bring the electrodes to their answer (k, n_upper, 3) [mm], as nearly as forces
        can.
        """
        preload = float(self._nearest_preloads(force_n[None])[0])
        found = self.coarse.solve(preload, force_n[None], TOLERANCE, self._unwanted_on(self.coarse))
        missing = displacement_mm - self.coarse.electrodes(found.state.shift, found.state.rotation)[0]
        more = self.coarse.linear_field(self.coarse.forces_of @ missing.ravel())
        return self.coarse.body.boxes, found.state.u[0] + more

    def _nearest_preloads(self, force_n: FloatArray) -> FloatArray:
        """Of `PRELOADS_MPA` those nearest to the middle of the pressures of samples (m, k, 3) [N], (m,)."""
        middle = -(force_n[..., 2].min(axis=1) + force_n[..., 2].max(axis=1)) / 2 / self.design.pad.size_mm**2
        levels = np.array(PRELOADS_MPA)
        return np.asarray(levels[np.abs(middle[:, None] - levels).argmin(axis=1)])

    def _together(
        self, preload: float, force_n: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, FloatArray, FloatArray]:
        """Displacements (m, k, n_upper, 3), the grids' error that is left, last changes and iterations of some samples.

        Also ratios of resistances (m, k, n_pillars) and their largest error (m,).

        The series cost nothing where a sample has not settled.
        """
        coarse = self.coarse.solve(preload, force_n, TOLERANCE, self._unwanted_on(self.coarse))
        moved = self._answers(self.coarse, coarse)
        change = coarse.change
        left = np.full(len(force_n), np.inf)
        ratio = np.ones((*force_n.shape[:2], len(self.design.unit.layout.pillars)))
        ratio_error = np.zeros(len(force_n))
        on = np.flatnonzero(coarse.change <= TOLERANCE)
        if not len(on):
            return moved, left, change, coarse.iterations, ratio, ratio_error
        of_grids = [array.series(preload, force_n[on], ORDERS) for array in (self.coarse, self.fine)]
        more = of_grids[1][0] - of_grids[0][0]
        uncorrected = self.coarse.electrodes(coarse.state.shift[on], coarse.state.rotation[on]) + more.sum(axis=0)
        answers = self._corrected(self.fine, uncorrected)
        difference = answers - moved[on]
        moved[on] = answers + EXTRAPOLATED * difference
        size = np.maximum(_norms(moved[on]), 1e-300)
        left[on] = np.hypot(LEFT * _norms(difference), TRUNCATED * _norms(more[-1])) / size
        if self._reader is not None:
            on_coarse, on_fine = self._slopes
            gradient = gradients(on_coarse, coarse.state.u[on])
            finer = gradient + gradients(on_fine, of_grids[1][1]) - gradients(on_coarse, of_grids[0][1])
            electrodes = uncorrected - more.sum(axis=0)
            rough, sound = self._reader.ratios(gradient, electrodes)
            smooth, both = self._reader.ratios(finer, uncorrected)
            ratio[on] = smooth + EXTRAPOLATED * (smooth - rough)
            ratio_error[on] = np.hypot(LEFT * np.abs(smooth - rough).max(axis=(1, 2)), REDUCED_ERROR)
            change[on[~(sound & both)]] = np.inf
        return moved, left, change, coarse.iterations, ratio, ratio_error

    @cached_property
    def _slopes(self) -> tuple[sp.csr_matrix, sp.csr_matrix]:
        assert self._reader is not None
        return self._reader.slopes_on(self.coarse), self._reader.slopes_on(self.fine)

    def _answers(self, array: PreloadedArray, found: Relaxed) -> FloatArray:
        return self._corrected(array, array.electrodes(found.state.shift, found.state.rotation))

    def _corrected(self, array: PreloadedArray, moved: FloatArray) -> FloatArray:
        """Displacements (m, k, n_upper, 3) with the much finer linear response in place of the grid's own."""
        if self._influence is None:
            return moved
        flat = moved.reshape(len(moved), -1)
        return moved + (flat @ self._corrections[array is self.fine].T).reshape(moved.shape)

    @cached_property
    def _corrections(self) -> tuple[FloatArray, FloatArray]:
        """(A − B) B⁺ of the coarse and of the finer grid."""
        assert self._influence is not None
        A = self._influence.reshape(self.coarse.influence.shape)
        coarse, fine = ((A - array.influence) @ array.forces_of for array in (self.coarse, self.fine))
        return coarse, fine

    def _unwanted_on(self, array: PreloadedArray) -> Unwanted:
        def unwanted(moved: FloatArray) -> NDArray[np.bool_]:
            if self._unwanted is None:
                return np.zeros(len(moved), dtype=bool)
            return self._unwanted(self._corrected(array, moved))

        return unwanted


def _norms(moved: FloatArray) -> FloatArray:
    """Of each sample, (m,)."""
    return np.linalg.norm(moved.reshape(len(moved), -1), axis=1)
