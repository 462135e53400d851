"""Derivatives of an array's response by the uncertain parameters of its design.

One modulus is exact: B ~ 1/E. The others are differences of condensed cells on one grid whose lines move with the edges
of the design, so that discretisation errors cancel; derivatives of the coupled array follow from those of its cell.
Pillars of another rubber are mixed into what points of integration stand for: meshes of tetrahedra differ by chance, by
more than a step changes.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from common.errors import DesignError
from common.storage.cache import kept_value
from common.storage.files import digest
from fem.array.cell import CondensedCell, PortModes, condense
from fem.array.coupled_cells import CoupledArray, TruncatedArray
from fem.array.design_cell import (
    PADS,
    cell_lines,
    cell_mirrors,
    electrode_means,
    functionals,
    grid_system,
    pad_plate,
)
from fem.array.solving import ResponseSettings, array_response, response_cache_key
from fem.kernel.mixed import quadrature_lines
from geometry.design import SensorDesign
from geometry.layout import FloatArray
from geometry.shares import pillar_shares
from geometry.tolerances import RESISTIVITY, changed, usual_deviations, value_of

VERSION = 5  #: raise when the same design gives other derivatives, so that cached ones are not reused
LEVEL, DEGREE = 2, 5  #: of the grid and of the port modes
STEP = 0.01  #: of a parameter's deviation
#: parameters that move edges of pads over those of electrodes, where B bends: a whole deviation to either side is taken
EDGES = ("unit.span_mm", "pad.size_mm", "pad.offset_x_mm", "pad.offset_y_mm")
TRUNCATION = 1e-3  #: of a pad's own influence: what is smaller is left out of the derivatives of large arrays
Change = tuple[FloatArray, FloatArray, FloatArray]  #: of a cell's stiffness, transfer and compliance, per unit
PILLARS_YOUNG = "pillar_material.young_mpa"
SCALES = ("rubber.young_mpa", "matrix_material.young_mpa")  #: the modulus that the others and B itself tell


@dataclass(frozen=True, eq=False, kw_only=True)
class ResponseSensitivities:
    """Derivatives of an influence matrix by k parameters of the design, and how far each may be off.

    Moving edges, `EDGES`, have the slope of the chord over a deviation to either side.
    """

    design: SensorDesign
    parameters: tuple[str, ...]  #: keys of the design, see `geometry.tolerances`; those alone that bend the body
    deviation: FloatArray  #: (k,): standard deviation of each before anything is measured, in its key's unit
    influence_mm_per_n: FloatArray  #: (k, rows, cols, n_upper, 3, rows, cols, 3): ∂B/∂θ [mm/N per the key's unit]

    @property
    def values(self) -> FloatArray:
        """Each parameter's value in the design, (k,)."""
        return np.array([value_of(self.design, name) for name in self.parameters])

    def with_tolerances(self, deviation: Mapping[str, float]) -> Self:
        """The same with other standard deviations; what is known exactly (0) is left out."""
        known = [deviation.get(name, usual) for name, usual in zip(self.parameters, self.deviation, strict=True)]
        uncertain = np.flatnonzero(known)
        return replace(
            self,
            parameters=tuple(self.parameters[k] for k in uncertain),
            deviation=np.array(known)[uncertain],
            influence_mm_per_n=self.influence_mm_per_n[uncertain],
        )


def response_sensitivities(
    design: SensorDesign,
    settings: ResponseSettings | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> tuple[ResponseSensitivities, Path, bool]:
    """Derivatives of a sensor's response, from the cache if they are there.

    Parameters and errors as of `array_response`, which is scaled for the derivative by the matrix's E; the others
    come from cells, whatever the method. Returns them, their file, and whether it was there already.

    Notes
    -----
    E_p ∂B/∂E_p + E_m ∂B/∂E_m = −B of pillars and matrix, as B halves where both moduli double.
    """
    settings = (settings or ResponseSettings()).suited(design)
    cache_key = digest("sensitivities", VERSION, response_cache_key(design, settings))

    deviations = {name: sd for name, sd in usual_deviations(design).items() if name != RESISTIVITY}

    def make() -> dict[str, FloatArray]:
        response, _, _ = array_response(design, settings, progress)
        derivatives = _derivatives(design, deviations, progress)
        by_scale = -response.influence_mm_per_n
        if PILLARS_YOUNG in derivatives:
            by_scale = by_scale - value_of(design, PILLARS_YOUNG) * derivatives[PILLARS_YOUNG]
        derivatives |= dict.fromkeys(SCALES, by_scale / design.matrix_material.young_mpa)
        return {name: derivatives[name] for name in deviations}

    derivatives, path, reused = kept_value(dict[str, FloatArray], "sensitivities.npz", cache_key, make)
    found = ResponseSensitivities(
        design=design,
        parameters=tuple(deviations),
        deviation=np.array(list(deviations.values())),
        influence_mm_per_n=np.stack([derivatives[name] for name in deviations]),
    )
    return found, path, reused


def _derivatives(
    design: SensorDesign, deviations: Mapping[str, float], progress: Callable[[str], None]
) -> dict[str, FloatArray]:
    """∂B/∂θ of all parameters but those of `SCALES`, each (rows, cols, n_upper, 3, rows, cols, 3)."""
    nominal, changes = cell_changes(design, deviations, progress)
    array = TruncatedArray.of(design, TRUNCATION)
    rows, cols = array.smaller
    progress(f"coupling {rows} × {cols}")
    found, _ = CoupledArray(nominal, rows, cols).derivatives(list(changes.values()), PADS, electrode_means(design))
    blocks = found.reshape(len(found), rows, cols, -1, 3, rows, cols, 3)
    return {name: array.expanded(du) for name, du in zip(changes, blocks, strict=True)}


def cell_changes(
    design: SensorDesign, deviations: Mapping[str, float], progress: Callable[[str], None] = lambda step: None
) -> tuple[CondensedCell, dict[str, Change]]:
    """A design's condensed cell and its derivatives by every parameter but those of `SCALES`."""
    sides = {
        name: _sides(design, name, sd) if name in EDGES else _sides(design, name, STEP * sd)[:1]
        for name, sd in deviations.items()
        if name not in SCALES
    }
    soft = design.pad.kind == "soft"
    on_top = [name for name in sides if soft and name.startswith("pad.")]
    if design.is_homogeneous:
        on_top.append("unit.span_mm")
    # loads and electrodes on the same cell: one condensation sees all their places
    asked = np.stack([functionals(one) for one in (design, *(side for name in on_top for side, _ in sides[name]))])
    different, number = np.unique(asked.reshape(-1, 4), axis=0, return_inverse=True)
    progress("cell")
    cell = _condensed(design, design, different)
    every = np.eye(cell.transfer.shape[1]).reshape(-1, len(different), 3)
    nominal, *moved = (cell.loaded_by(every[:, own].reshape(len(every), -1)) for own in number.reshape(asked.shape[:2]))
    cells = {name: [(moved.pop(0), by) for _, by in sides[name]] for name in on_top}
    for name in sides:
        if name not in cells:
            progress(f"cell, {name}")
            cells[name] = [(_condensed(design, side, functionals(side)), by) for side, by in sides[name]]
    changes = {name: _slope(*[*cells[name], (nominal, 0.0)][:2]) for name in sides}
    return nominal, changes


def _sides(design: SensorDesign, name: str, step: float) -> list[tuple[SensorDesign, float]]:
    """Designs a step above and below in one parameter, as far as they can be made, and the steps."""
    found = []
    for by in (step, -step):
        with suppress(DesignError):
            found.append((changed(design, name, by), by))
    return found


def _slope(one: tuple[CondensedCell, float], other: tuple[CondensedCell, float]) -> Change:
    (plus, above), (minus, below) = one, other
    width = above - below
    dS, dL, dC = (
        (getattr(plus, name) - getattr(minus, name)) / width for name in ("stiffness", "transfer", "compliance")
    )
    return dS, dL, dC


def _condensed(design: SensorDesign, side: SensorDesign, rectangles: FloatArray) -> CondensedCell:
    """The cell of a design near another, on the other's grid, its lines moved along with the height and the plate."""
    ports = PortModes(design.array.pitch_mm / 2, side.unit.height_mm, DEGREE)
    mirrors = tuple(plane for plane in cell_mirrors(design) if plane in cell_mirrors(side))
    *across, z = cell_lines(design, LEVEL, mirrors)
    lines, half = [], design.array.pitch_mm / 2
    for axis, line in enumerate(across):
        before, after = (functionals(one)[0, axis::2] for one in (design, side))
        stiff = design.pad.kind == "stiff"
        lines.append(np.interp(line, [-half, *before, half], [-half, *after, half]) if stiff else line)
    lines.append(z * (side.unit.height_mm / design.unit.height_mm))
    shares = None if side.is_homogeneous else pillar_shares(side.unit, *map(quadrature_lines, lines))
    shares = None if shares is None else np.stack([1 - shares, shares])
    rubbers = [side.matrix_material, side.pillar_material]
    is_square = len(mirrors) == 2 and np.array_equal(lines[0], lines[1])
    return condense(grid_system(lines, rubbers, pad_plate(side), mirrors, shares), ports, rectangles, is_square)
