"""Cells of two rubbers on grids whose boxes the faces of pillars cut, and the choice between these and tetrahedra.

Boxes cost an eighth of tetrahedra where they are accurate enough (`fem.kernel.kinks`).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from fem.array.cell import CondensedCell, condense
from fem.array.design_cell import WEIGHTS, Asked, DesignCell, Difference, RefinedCell, Stage
from fem.kernel.elements import Basis, hexahedra
from fem.kernel.kinks import KinkedRubber
from fem.kernel.mixed import ORDER
from fem.kernel.system import System
from fem.levels import richardson_factor
from fem.meshes.grid import Grid
from fem.meshes.lines import Attractor, graded_lines
from geometry.design import SensorDesign
from geometry.layout import FloatArray
from geometry.prism import Prism, unit_prisms

#: of pillars stiffer and softer than the matrix: of the first, level 3 would cost as much as tetrahedra
STAGES: tuple[tuple[Stage, ...], ...] = (((1, 2, 6),), ((1, 2, 7), (2, 3, 7)))
RATE = 2.3
#: error over the extrapolation's step, which is a quarter of the levels' change. So the estimates of responses of 1 × 1
#: and 2 × 2 units are 1.9 to 6.6 times the error of 13 designs (pillars 3 to 20 times as stiff and 1.75 to 3 mm wide,
#: pitches of 13 to 20 mm, heights of 6 to 16 mm, pads of 7 to 12 mm, ν of the matrix 0.3 and 0.49, 3 or 4 pillars), by
#: tetrahedra of level 3, extrapolated; of ten others, drawn at random afterwards, 1.24 times at least. They are smaller
#: beside the error at 50 and 121 times as stiff, and 0.75 times it where pillars are thinner than boxes. Of softer
#: pillars half is enough: 1.2 to 7 times the error of 2 × 2 units on six designs (1/5 to 4/5 times as stiff)
EXTRAPOLATION_ERRORS = 3.0, 1.5
MIN_GAP = 0.005  #: of the pitch, between a face and another line, if it is to be one
Z_LINES, CROWDING = 3, 0.09  #: boxes along z at level 1, and how far they crowd at both ends
#: what boxes are tried for: the tolerance at least, and how many times the pillars are as stiff as the matrix
MIN_TOLERANCE, CONTRASTS = 5e-3, (0.24, 15.0)


def cut_lines(design: SensorDesign, pillars: Sequence[Prism], level: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Lines between the boxes of a whole cell with a soft pad along x, y and z; upright faces of pillars are lines."""
    half, height = design.array.pitch_mm / 2, design.unit.height_mm
    length, weights = min(height, design.pad.size_mm), WEIGHTS["soft"]
    across = list[FloatArray]()
    for axis, offset in enumerate((design.pad.offset_x_mm, design.pad.offset_y_mm)):
        pad, stops = offset + np.array([-1, 1]) * design.pad.size_mm / 2, [0.0, -half, half]
        upright = [one for one in pillars if one.lean[axis] == 0]
        faces = np.array([one.base_mm[axis] + side * one.section_mm[axis] / 2 for one in upright for side in (-1, 1)])
        for place in (*pad, *faces, *-faces):
            if min(abs(place - stop) for stop in stops) > MIN_GAP * 2 * half:
                stops.append(place)
        attractors = [Attractor(edge, length, weights.pad_edge) for edge in pad]
        attractors += [Attractor(side, length, weights.side) for side in (-half, half)]
        across.append(graded_lines(stops, attractors, level))
    t = np.linspace(0.0, 1.0, Z_LINES * level + 1)
    up = height * (t - CROWDING * np.sin(2 * np.pi * t))
    return across[0], across[1], up


def cut_system(design: SensorDesign, level: int) -> System:
    """The whole cell of two rubbers with a soft pad, on boxes that leaning pillars cut."""
    element, pressure = hexahedra(ORDER)
    rubbers, pillars = (design.matrix_material, design.pillar_material), unit_prisms(design.unit)
    basis = Basis(Grid(cut_lines(design, pillars, level)).mesh, element)
    return System(KinkedRubber(basis, pressure, rubbers, pillars))


def _contrast(design: SensorDesign) -> float:
    """How many times the pillars are as stiff as the matrix."""
    return design.pillar_material.lame_mpa[1] / design.matrix_material.lame_mpa[1]


def why_tetrahedra(design: SensorDesign, tolerance: float) -> str | None:
    """Why a cell of two rubbers is of tetrahedra at once; None where boxes are tried first."""
    contrast = _contrast(design)
    least, most = CONTRASTS
    if not least <= contrast <= most:
        return f"pillars are {contrast:.3g} times as stiff as the matrix, boxes are for {least:g} to {most:g} times"
    if tolerance < MIN_TOLERANCE:
        return f"boxes are for tolerances from {MIN_TOLERANCE:g}"
    if design.pad.kind == "stiff":
        return "boxes are for soft pads"
    pillars = unit_prisms(design.unit)
    if not all(prism.is_rectangular for prism in pillars):
        return "boxes are for square pillars that lean along x or y"
    lines = cut_lines(design, pillars, STAGES[contrast < 1][0][1])
    for prism, axis in product(pillars, (0, 1)):
        low, high = sorted((prism.base_mm[axis], prism.top_mm[axis]))
        crossed = (lines[axis][1:] > low) & (lines[axis][:-1] < high)
        if prism.lean[axis] and np.diff(lines[axis])[crossed].max() > prism.section_mm[axis] * (1 + 1e-9):
            return "pillars are thinner than boxes"
    return None


class CutCell(DesignCell):
    """The cell of two rubbers on boxes, at levels of refinement."""

    def __init__(self, design: SensorDesign) -> None:
        super().__init__(design)
        self.is_grid = True

    def _condensed(self, level: int, degree: int) -> CondensedCell:
        return condense(cut_system(self.design, level), self._ports(degree), self.rectangles)

    def stages(self, tolerance: float) -> tuple[Stage, ...]:
        return STAGES[_contrast(self.design) < 1]

    @property
    def extrapolation_error(self) -> float:
        return EXTRAPOLATION_ERRORS[_contrast(self.design) < 1]

    def error_factor(self, coarse: int, fine: int) -> float:
        return richardson_factor(coarse, fine, RATE)


def refine(
    design: SensorDesign,
    tolerance: float,
    answer: Asked,
    difference: Difference,
    progress: Callable[[str], None] = lambda step: None,
    from_cad: bool = False,
) -> tuple[RefinedCell, FloatArray]:
    """The cell of a design, of the elements that suit it, refined to a tolerance, and the answer by it.

    Parameters are those of `DesignCell` and of its `refined`. Of two rubbers the steps say which elements and why.
    """
    if design.is_homogeneous or from_cad:
        return DesignCell(design, from_cad=from_cad).refined(tolerance, answer, difference, progress)
    steps: tuple[str, ...] = ()
    spent: dict[str, float] = {}
    why = why_tetrahedra(design, tolerance)
    if why is None:
        found, answered = CutCell(design).refined(tolerance, answer, difference, progress)
        steps = ("boxes that pillars cut, much cheaper than tetrahedra", *found.steps)
        if found.error_estimate <= tolerance:
            return replace(found, steps=steps), answered
        why, spent = "boxes miss the tolerance", found.seconds
    found, answered = DesignCell(design).refined(tolerance, answer, difference, progress)
    seconds = {step: time + spent.get(step, 0.0) for step, time in found.seconds.items()}
    return replace(found, steps=(*steps, f"tetrahedra: {why}", *found.steps), seconds=seconds), answered
