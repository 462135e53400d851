"""A design's cell: a grid where it is of one rubber, tetrahedra with pillars of another or from its CAD solids.

Boxes that pillars of another rubber cut are in `cut_cell.py`, which chooses.

A cell is x, y ∈ [−a, a], or the part of it beyond mirror planes. Its base is clamped, its side faces are free. It is
refined until the answer of an array of its copies is as accurate as asked.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from skfem import MeshTet

from fem.array.cell import CondensedCell, PortModes, condense
from fem.kernel.field import Field, Places
from fem.kernel.loads import DeadLoad, Load, StiffLoad
from fem.kernel.mirrors import QUARTER, Mirror
from fem.kernel.mixed import mixed_rubber
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from fem.levels import richardson_factor
from fem.meshes.grid import Grid, mirrored
from fem.meshes.lines import Attractor, graded_lines
from fem.meshes.tetrahedra import Tetrahedra
from fem.scene.scene import Probe, Scene, Sensor
from fem.scene.solution import Stopwatch
from fem.scene.tetrahedra import AdaptedTetrahedra
from geometry.design import Material, SensorDesign, at_rest, lone_unit
from geometry.law import LAWS
from geometry.layout import FloatArray, electrode_squares, pad_squares
from geometry.mesh import sensor_mesh


class Weights(NamedTuple):
    """Weights of the attractors of a cell's grid; side and base count at the rim of the array."""

    pad_edge: float
    top: float
    electrode_edge: float
    side: float
    base: float


#: stress at the edge of a stiff pad is singular as r^(−1/2), of a soft one as log r; electrodes under a plate are rigid
WEIGHTS = {"soft": Weights(1.0, 1.5, 0.3, 0.5, 1.0), "stiff": Weights(2.0, 2.0, 0.0, 0.2, 0.7)}


#: of a homogeneous cell: electrodes of the paper's sensor err by 0.6 % (level 3: 0.3 %, in four times the time); with
#: degree 8 it changes a contact's forces at a rim by 0.2 %
GRID_LEVEL, GRID_DEGREE = 2, 6
MESH_LEVEL, MESH_DEGREE = 1, 5  #: of a cell with pillars of another rubber
CAD_LEVEL = 1.0  #: of the coarsest mesh of CAD solids: the mesher makes a lower one no coarser, in twice the time
PUSH = (0.5, 0.5, -1.0)  #: on the pad of a cell whose mesh is refined, by direction
#: convergence that is reckoned with: of grids as level^(−rate); of tetrahedra as unknowns^(−rate), 0.9 to 1.6 being
#: measured under soft pads and 0.5 to 0.6 under stiff ones, whose edges are more singular
GRID_RATE, MESH_RATE = 2.5, {"soft": 1.1, "stiff": 0.65}

Asked = Callable[[CondensedCell], FloatArray]  #: of an array of copies of a cell
Difference = Callable[[FloatArray, FloatArray], float]  #: how far one answer is from another, relative
Stage = tuple[int, int, int]  #: of refinement: coarse and fine level, and the degree of the port modes
#: stages of grids; edges of stiff pads ask for ports of a higher degree
GRID_STAGES: dict[str, tuple[Stage, ...]] = {
    "soft": ((1, 2, 6), (2, 3, 7), (3, 4, 8), (4, 6, 9)),
    "stiff": ((1, 2, 6), (2, 3, 8), (3, 4, 9), (4, 6, 10)),
}
#: the same for tetrahedra, whose levels count refinements
MESH_STAGES: tuple[Stage, ...] = ((0, 1, 6), (0, 2, 8), (2, 3, 9), (2, 4, 9), (3, 5, 10))
COARSE, FINE = 3e-3, 5e-4  #: tolerances: above the first, begin with stage 1; below the second, allow the last stage
MESH_LIMITS = (2e-2, 4e-3, 2e-3)  #: tolerances below which tetrahedra begin with stages 2, 3 and 4
#: fraction of the extrapolation's step that is taken for its error: with the ports' the estimates are 1.05 to 13 times
#: the error of 24 designs (pitches of 10 to 20 mm, heights of 6 to 20 mm, pads of 6.5 to 15.5 mm, ν from 0.3 to 0.499)
EXTRAPOLATION_ERROR = {"soft": 0.6, "stiff": 0.41}
COMPARED_DEGREE = 4  #: of the ports with which levels are compared: the coarsest grid knows no more
#: with pillars of another rubber: the error over the extrapolation's step, and what the ports leave over what their two
#: highest degrees changed. So the estimates are 2.3 to 3.8 times the error of lone units under soft pads (pillars 6 and
#: 120 times as stiff as the matrix and 20 times as soft), all of whose sides are free, and 1.5 times that under a stiff
#: pad (6 times as stiff), by meshes of levels 4 and 3 on which sides moved as their nodes do. By finer stages of their
#: own, at tolerances of 1e-2 and 2e-2, they are 1.5 to 6.5 times the error of eight lone units and 1.25 to 2.2 times
#: that of 2 × 2 units of four of these (1/20 to 121 times as stiff, square and round pillars, soft and stiff pads, ν of
#: the matrix 0.49 and 0.499, pitches of 15 and 20 mm). Ports hold free sides back: at degree 6 by 0.13 to 0.18 % of a
#: lone unit's answer, at degree 8 by 0.07 to 0.08 %
MESH_EXTRAPOLATION_ERROR, MESH_PORTS = 0.8, 1.0
PADS = range(3)  #: numbers of a cell's functionals that are forces on its pad
MAX_TESTED = 3  #: rows and columns of the array on which a cell is judged, at most: it has every neighbourhood


@dataclass(frozen=True, eq=False, kw_only=True)
class RefinedCell:
    """Condensed cells with what is known of the error of arrays of them."""

    cells: tuple[tuple[float, CondensedCell], ...]  #: whose answers, times these weights, add up to the best one
    error_estimate: float  #: of the answer, relative; of a response of any block, relative to the loaded unit's own
    steps: tuple[str, ...]  #: one line a stage of refinement
    seconds: dict[str, float] = field(default_factory=dict)  #: by step, of a cell that was not in the cache

    def answered(self, answer: Asked) -> FloatArray:
        """The weighted sum of the cells' answers."""
        return np.sum([weight * answer(cell) for weight, cell in self.cells], axis=0)

    @property
    def finest(self) -> CondensedCell:
        """The finest cell."""
        return self.cells[0][1]

    @property
    def residual(self) -> float:
        """The largest of the cells' residuals."""
        return max(cell.residual for _, cell in self.cells)


@dataclass(frozen=True, eq=False, kw_only=True)
class CellInterior:
    """A condensed cell, and what every one of its amplitudes does inside.

    An amplitude is a port displacement [mm], n_modes·3 of them, or a force on a rectangle [N], three for each.
    """

    cell: CondensedCell
    field: Field  #: displacements (n_nodes, 3, n_amplitudes) per unit amplitude


def grid_system(
    lines: Sequence[FloatArray],
    rubbers: Sequence[Material],
    plate: FloatArray | None = None,
    mirrors: tuple[Mirror, ...] = (),
    shares: FloatArray | None = None,
) -> System:
    """A cell of quadratic hexahedra between lines, with a plate bonded to a rectangle (4,) of the whole cell.

    Points of integration have shares (n_rubbers, nx, ny, nz) of the rubbers between `quadrature_lines`; without them
    all is of the first.
    """
    return System(mixed_rubber(Grid(lines), LAWS["linear"], rubbers, shares), plate_on(plate), mirrors)


def functionals(design: SensorDesign) -> FloatArray:
    """Rectangles (1 + n_upper, 4) of a cell's pad and its upper electrodes."""
    alone = lone_unit(design)
    return np.vstack([pad_squares(alone), electrode_squares(alone)])


def electrode_means(design: SensorDesign) -> range:
    """Numbers of a cell's functionals that are mean displacements of its upper electrodes."""
    return range(3, 3 + 3 * len(design.unit.layout.upper))


def pad_plate(design: SensorDesign) -> FloatArray | None:
    """Rectangle (4,) of the plate on a cell's pad, None for soft pads."""
    return functionals(design)[0] if design.pad.kind == "stiff" else None


def cell_mirrors(design: SensorDesign) -> tuple[Mirror, ...]:
    """Planes in which a cell is its own image: both, but with pillars of another rubber or a plate off its middle."""
    if not design.is_homogeneous:
        return ()
    off = (design.pad.offset_x_mm, design.pad.offset_y_mm)
    return tuple(plane for plane in QUARTER if design.pad.kind == "soft" or off[plane.axis] == 0.0)


def cell_lines(design: SensorDesign, level: int, mirrors: tuple[Mirror, ...] = ()) -> tuple[FloatArray, ...]:
    """Lines along x, y and z of a cell, or of its part beyond mirrors, crowding at the edges of pad and electrodes."""
    half, height = design.array.pitch_mm / 2, design.unit.height_mm
    squares = functionals(design)
    length = min(height, design.pad.size_mm)
    weights = WEIGHTS[design.pad.kind]
    lines = []
    for axis in (0, 1):
        pad_edges, electrode_edges = (
            np.unique(np.round(np.abs(some[:, axis::2]), 9)) for some in (squares[:1], squares[1:])
        )
        places = dict.fromkeys(electrode_edges.tolist(), weights.electrode_edge)
        places |= dict.fromkeys(pad_edges.tolist(), weights.pad_edge)
        attractors = [Attractor(sign * place, length, weight) for place, weight in places.items() for sign in (-1, 1)]
        attractors.append(Attractor(half, length, weights.side))
        line = graded_lines([0.0, half, *pad_edges], attractors, level)
        lines.append(line if any(mirror.axis == axis for mirror in mirrors) else mirrored(line))
    ends = [Attractor(height, length, weights.top), Attractor(0.0, length, weights.base)]
    return *lines, graded_lines([0.0, height], ends, level)


class DesignCell:
    """A design's cell at levels of refinement: a grid where it is of one rubber, else nested meshes of tetrahedra.

    A level of a grid divides its edges. That of tetrahedra counts how often the coarsest mesh was halved where it errs:
    for the lone unit under a load on its pad, as its pad and electrodes see it (`fem.scene.tetrahedra`). That mesh is
    of prisms, or of the solids of CAD. Rubber of whatever law is taken by its tangent at rest. Rectangles (k, 4) are
    loaded or observed of the cell's top face, by default the `functionals`; meshes of tetrahedra have edges beside
    these, or beside others that are to be resolved. A stiff pad's plate is bonded to it unless `has_plate` says
    otherwise.
    """

    def __init__(
        self,
        design: SensorDesign,
        rectangles_mm: FloatArray | None = None,
        from_cad: bool = False,
        has_plate: bool = True,
        resolved_mm: FloatArray | None = None,
    ) -> None:
        self.squares, self.resolved = functionals(design), resolved_mm
        self.design, self.from_cad = at_rest(design), from_cad
        self.rectangles = self.squares if rectangles_mm is None else rectangles_mm
        self.plate = self.squares[0] if has_plate and design.pad.kind == "stiff" else None
        self.is_grid = design.is_homogeneous and not from_cad
        self._watch = Stopwatch("mesh", "condense", "couple")
        self._bodies: list[Rubber] = []
        self._cells: dict[int, CondensedCell] = {}

    @cached_property
    def _adapted(self) -> AdaptedTetrahedra:
        design, squares = self.design, self.squares
        load: Load = DeadLoad(**_sides(squares[0]), traction_mpa=PUSH)
        if self.plate is not None:
            load = StiffLoad(**_sides(self.plate), force_n=PUSH)
        probes = tuple(Probe(name=str(k), kind="mean", **_sides(square)) for k, square in enumerate(squares))
        unit = Sensor(design=design, kind="unit")
        scene = Scene(body=unit, material=design.matrix_material, loads=(load,), probes=probes)
        regions = [region for region in scene.regions if region[1] != scene.material]
        mesh = None
        if self.from_cad:
            made, *_ = sensor_mesh(unit.design, CAD_LEVEL)
            mesh = MeshTet(np.ascontiguousarray(made.points_mm.T), np.ascontiguousarray(made.cells.T))
        resolved = self.rectangles if self.resolved is None else self.resolved
        return AdaptedTetrahedra(scene, regions, resolved, mesh)

    def tetrahedra(self, level: int) -> Rubber:
        """The cell's body on the mesh of a level."""
        while len(self._bodies) <= level:
            if self._bodies:
                self._adapted.refine(self._adapted.solve(Stopwatch()).indicators, np.inf)
            self._bodies.append(self._adapted.body)
        self._watch.spent("mesh")
        return self._bodies[level]

    def condensed(self, level: int, degree: int) -> CondensedCell:
        """The cell condensed at a level onto ports of a degree; none is condensed twice to the same or a lower one."""
        known = self._cells.get(level)
        if known is None or known.ports.degree < degree:
            known = self._cells[level] = self._condensed(level, degree)
        self._watch.spent("condense")
        return known.of_degree(degree)

    def _condensed(self, level: int, degree: int) -> CondensedCell:
        if not self.is_grid:
            system = System(self.tetrahedra(level), plate_on(self.plate))
            return condense(system, self._ports(degree), self.rectangles)
        mirrors = cell_mirrors(self.design)
        lines = cell_lines(self.design, level, mirrors)
        system = grid_system(lines, [self.design.matrix_material], self.plate, mirrors)
        is_square = len(mirrors) == 2 and np.array_equal(lines[0], lines[1])
        return condense(system, self._ports(degree), self.rectangles, is_square)

    def _ports(self, degree: int) -> PortModes:
        return PortModes(self.design.array.pitch_mm / 2, self.design.unit.height_mm, degree)

    def interior(self, progress: Callable[[str], None] = lambda step: None) -> CellInterior:
        """The cell solved inside, at one level; `progress` is called with the name of each step as it begins."""
        inside: list[FloatArray] = []
        where: Places
        if self.is_grid:
            progress("cell")
            lines, degree, loaded = cell_lines(self.design, GRID_LEVEL), GRID_DEGREE, [*self.rectangles]
            where, system = Grid(lines), grid_system(lines, [self.design.matrix_material], self.plate)
        else:
            progress("mesh")
            body, degree, loaded = self.tetrahedra(MESH_LEVEL), MESH_DEGREE, []  # no edges along those of loads
            progress("cell")
            where, system = Tetrahedra(body.basis.mesh), System(body, plate_on(self.plate))
        cell = condense(system, self._ports(degree), self.rectangles, inside=inside)
        moved = np.ascontiguousarray(inside[0].transpose(1, 2, 0))
        return CellInterior(
            cell=cell, field=Field(places=where, body=system.body, displacement_mm=moved, loaded_mm=loaded)
        )

    def refined(
        self,
        tolerance: float,
        answer: Asked,
        difference: Difference,
        progress: Callable[[str], None] = lambda step: None,
    ) -> tuple[RefinedCell, FloatArray]:
        """The cell refined stage by stage until the estimated error meets the tolerance, or the stages end.

        The answer by the refined cell comes with it.
        """
        steps: tuple[str, ...] = ()
        for stage in self.stages(tolerance):
            progress(f"cell, level {stage[1]:g}")
            cell, found = self.at_stage(stage, answer, difference)
            steps += cell.steps
            if cell.error_estimate <= tolerance:
                break
        return replace(cell, steps=steps), found

    def stages(self, tolerance: float) -> tuple[Stage, ...]:
        """Stages that may be needed for a tolerance."""
        if not self.is_grid:
            return MESH_STAGES[sum(tolerance < limit for limit in MESH_LIMITS) :]
        stages = GRID_STAGES[self.design.pad.kind][int(tolerance < COARSE) :]
        return stages if tolerance < FINE else stages[:-1]

    @property
    def extrapolation_error(self) -> float:
        """Error over the extrapolation's step, of a grid."""
        return EXTRAPOLATION_ERROR[self.design.pad.kind]

    def at_stage(self, stage: Stage, answer: Asked, difference: Difference) -> tuple[RefinedCell, FloatArray]:
        """Cells condensed at the levels of a stage, and an answer by them.

        Levels are extrapolated as Richardson does: cells of grids themselves, of tetrahedra the answers, since
        extrapolated cells need not be definite. A fraction of that step is the levels' error. The ports' is what their
        highest degree changed, of tetrahedra a fraction of what the highest two did: the last is small now and then.
        """
        coarse, fine, degree = stage
        one, two = self.condensed(coarse, COMPARED_DEGREE), self.condensed(fine, degree)
        factor, low = self.error_factor(coarse, fine), two.of_degree(COMPARED_DEGREE)
        cells: tuple[tuple[float, CondensedCell], ...]
        if self.is_grid:
            better = two.extrapolated(one, factor)
            if better.is_definite:  # extrapolated in these degrees alone
                of_levels = difference(answer(low), answer(better.of_degree(COMPARED_DEGREE)))
                of_levels *= self.extrapolation_error
            else:
                better, of_levels = two, factor * difference(answer(one), answer(low))
            cells, found = ((1.0, better),), answer(better)
            of_ports = difference(answer(better.of_degree(degree - 1)), found)
        else:
            cells = ((1.0, two), (factor, low), (-factor, one))
            plain, step = answer(two), factor * (answer(low) - answer(one))
            found = plain + step
            of_levels = MESH_EXTRAPOLATION_ERROR * difference(plain, found)
            of_ports = MESH_PORTS * difference(answer(two.of_degree(degree - 2)) + step, found)
        self._watch.spent("couple")
        line = (
            f"levels {coarse:g} and {fine:g}, ports of degree {degree}: {two.unknowns} unknowns in the cell, "
            f"{two.stiffness.shape[0]} at its ports; estimated error {of_levels:.1e} of the cell, {of_ports:.1e} of "
            "the ports"
        )
        seconds, error = self._watch.seconds, of_levels + of_ports
        return RefinedCell(cells=cells, error_estimate=error, steps=(line,), seconds=seconds), found

    def error_factor(self, coarse: int, fine: int) -> float:
        """Error of the finer of two levels over their change."""
        if self.is_grid:
            return richardson_factor(coarse, fine, GRID_RATE)
        one, other = (System(self._bodies[level]).n_unknowns for level in (coarse, fine))
        return richardson_factor(one, other, MESH_RATE[self.design.pad.kind])


def plate_on(plate: FloatArray | None) -> list[Load]:
    """A plate on a rectangle (4,), as a load without force; none if there is none."""
    return [] if plate is None else [StiffLoad(**_sides(plate), force_n=(0.0, 0.0, 0.0))]


def _sides(rectangle: FloatArray) -> dict[str, Any]:
    """Centre and size of a rectangle (4,)."""
    x0, y0, x1, y1 = rectangle.tolist()
    return {"center_mm": ((x0 + x1) / 2, (y0 + y1) / 2), "size_mm": (x1 - x0, y1 - y0)}
