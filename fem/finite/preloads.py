"""An array with stiff pads on one grid: its equilibria under uniform pressures, and samples by their tangents."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fem.boxes.boxes import Boxes
from fem.factor import Factor
from fem.finite.relaxation import Relaxation, Relaxed
from fem.finite.series import BaseState, load_series
from fem.rubber.body import RubberBody
from fem.scene.loads import Load, StiffLoad
from fem.system import System
from geometry.design import SensorDesign
from geometry.layout import FloatArray, unit_centres, upper_electrodes

MAX_ITERATIONS = 16  #: with one tangent
RENEWALS = 2  #: of the tangent, of samples that have not settled then
NEARLY = 0.1  #: change below which displacements tell whether a sample is wanted at all

#: displacements (m, k, n_upper, 3) of electrodes to booleans (m,): of samples that need no answer
Unwanted = Callable[[FloatArray], NDArray[np.bool_]]


@dataclass(frozen=True, kw_only=True)
class Lines:
    """Lines of a grid within a unit, as shares of the gap beside the pad, of the pad, and of the height."""

    gap: tuple[float, ...] = (1.0,)
    pad: tuple[float, ...]
    height: tuple[float, ...]

    def boxes(self, design: SensorDesign) -> Boxes:
        """The whole slab, with lines along the pads' edges and between units."""
        pitch, size, height = design.array.pitch_mm, design.pad.size_mm, design.unit.height_mm
        lines = []
        for count, offset in ((design.array.cols, design.pad.offset_x_mm), (design.array.rows, design.pad.offset_y_mm)):
            low, high = pitch / 2 + offset - size / 2, pitch / 2 + offset + size / 2
            own = [low * share for share in self.gap] + [low + size * share for share in self.pad]
            own += [high + (pitch - high) * share for share in self.gap]
            unit = np.unique(np.round(own, 9))
            lines.append(np.concatenate([[0.0], *(unit + k * pitch for k in range(count))]) - count * pitch / 2)
        return Boxes.between([*lines, height * np.array([0.0, *self.height])])


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
        self.body = RubberBody.of(lines.boxes(design), [replace(design.matrix_material, model="neo-hookean")])
        offset = [design.pad.offset_x_mm, design.pad.offset_y_mm, 0.0]
        self.arm = (
            upper_electrodes(design.unit) * (1.0, 1.0, 0.0) - offset
        )  #: of the electrodes on their plates, (n_upper, 3)
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

    def _system(self, preload_mpa: float) -> System:
        pad = self.design.pad
        loads: list[Load] = [
            StiffLoad(
                center_mm=(float(x + pad.offset_x_mm), float(y + pad.offset_y_mm)),
                size_mm=(pad.size_mm, pad.size_mm),
                force_n=(0.0, 0.0, -preload_mpa * pad.size_mm**2),
            )
            for x, y in unit_centres(self.design)
        ]
        return System(self.body, loads)

    def electrodes(self, shift: FloatArray, rotation: FloatArray) -> FloatArray:
        """Displacements (m, k, n_upper, 3) [mm] of the electrodes under plates of these motions."""
        return np.asarray(shift[:, :, None] + np.einsum("mkij,ej->mkei", rotation, self.arm) - self.arm)

    @cached_property
    def influence(self) -> FloatArray:
        """Linear displacement of the electrodes per newton on each pad, (3 n_upper k, 3 k) [mm/N]."""
        k, rest = self.design.n_units, self._bases.get(0.0) or BaseState.of(self._system(0.0))
        moves, spins = rest.compliance()[:, : 3 * k].T.reshape(3 * k, 2, k, 3).swapaxes(0, 1)
        spins = spins / rest.system.plates.half_mm[:, None]
        return np.asarray((moves[:, :, None] + np.cross(spins[:, :, None], self.arm)).reshape(3 * k, -1).T)

    @cached_property
    def forces_of(self) -> FloatArray:
        """Forces (3 k) that move the linear array most nearly by displacements (3 n_upper k), as a matrix [N/mm]."""
        return np.asarray(np.linalg.pinv(self.influence))

    def linear_field(self, force_n: FloatArray) -> FloatArray:
        """Linear displacements (n_nodes, 3) [mm] of the array at rest under forces (3 k,) on its pads [N]."""
        rest = self.base(0.0)
        loads = np.zeros((1, rest.system.n_blocks, 3))
        loads[0, -2 * self.design.n_units : -self.design.n_units] = force_n.reshape(-1, 3)
        return np.asarray(rest.system.nodal_change(rest.state.rotation, rest.solve(loads)[0]))

    def solve(
        self,
        preload_mpa: float,
        force_n: FloatArray,
        tolerance: float,
        unwanted: Unwanted,
    ) -> Relaxed:
        """Equilibria of samples under forces (m, k, 3) [N], by the tangent of a preload and, if need be, their own.

        Samples that are not wanted keep the change they had.
        """
        found = self._relaxed(self.base(preload_mpa), force_n, tolerance, unwanted)
        for number in np.flatnonzero((found.change > tolerance) & np.isfinite(found.change)):
            own, sample = found.state.part(int(number)), slice(number, number + 1)
            for _ in range(RENEWALS):
                if unwanted(self.electrodes(found.state.shift[sample], found.state.rotation[sample]))[0]:
                    break
                about = BaseState.about(self.base(preload_mpa).system, own, self._factor)
                last = self._relaxed(about, force_n[sample], tolerance, unwanted)
                for name in ("u", "p", "shift", "turn"):
                    getattr(found.state, name)[number] = getattr(last.state, name)[0]
                found.change[number] = last.change[0]
                found.iterations[number] += last.iterations[0]
                if last.change[0] <= tolerance:
                    break
                own = last.state.part(0)
        return found

    def _relaxed(
        self,
        base: BaseState,
        force_n: FloatArray,
        tolerance: float,
        unwanted: Unwanted,
    ) -> Relaxed:
        def hopeless(shift: FloatArray, rotation: FloatArray, change: FloatArray) -> NDArray[np.bool_]:
            return (change < NEARLY) & unwanted(self.electrodes(shift, rotation))

        relaxation = Relaxation(base, _over(base, force_n))
        return relaxation.relax(relaxation.start(), MAX_ITERATIONS, tolerance, hopeless)

    def series(self, preload_mpa: float, force_n: FloatArray, orders: int) -> tuple[FloatArray, FloatArray]:
        """Series of the electrodes and of the nodes under forces (m, k, 3) [N], see `series.py`.

        Terms of the electrodes' displacements (orders + 1, m, k, n_upper, 3) [mm], and the sum of those of the nodes
        (m, n_nodes, 3) [mm].

        The first one is the preload's own. With R = (I + 2 q₀ [v] + 2 [v]²) R₀ and v = Σ sⁱ vᵢ the order n of an
        electrode at a from its plate's middle moves by cₙ + 2 vₙ × a + 2 Σ vᵢ × (vₙ₋ᵢ × a) up to n = 3, but for the
        changes of q₀, which are of the order of |v|³.
        """
        base = self.base(preload_mpa)
        found = load_series(base, _over(base, force_n), orders)
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


def _over(base: BaseState, force_n: FloatArray) -> FloatArray:
    """Loads (m, 2, k, 3) of forces (m, k, 3) beyond those of a base state; no moments [N]."""
    loads = np.zeros((len(force_n), 2, *force_n.shape[1:]))
    loads[:, 0] = force_n - base.system.force_n
    return loads
