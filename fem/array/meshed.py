"""A design's cell as a system: a grid where it is of one rubber, tetrahedra with pillars of another or from its CAD.

A cell is x, y ∈ [−a, a], or the part of it beyond mirror planes. Its base is clamped, its side faces are free.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from skfem import MeshTet

from fem.array.cell import CellSides, CondensedCell, Free, PortModes, condense
from fem.array.coupled_cells import Kinds, places
from fem.kernel.elements import Basis, hexahedra
from fem.kernel.field import Field, Places
from fem.kernel.law import LAWS
from fem.kernel.loads import DeadLoad, Load, StiffLoad
from fem.kernel.mirrors import QUARTER, Mirror
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from fem.levels import richardson_factor
from fem.meshes.grid import Grid, mirrored
from fem.meshes.lines import Attractor, graded_lines
from fem.meshes.tetrahedra import Tetrahedra
from fem.scene.scene import Probe, Scene, Sensor
from fem.scene.solution import Stopwatch
from fem.scene.tetrahedra import AdaptedTetrahedra
from geometry.design import Material, SensorDesign
from geometry.layout import FloatArray, electrode_squares, pad_squares
from geometry.mesh import sensor_mesh, suited_settings


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
ORDER = 2  #: of a grid's elements
MESH_LEVEL, MESH_DEGREE = 1, 5  #: of a cell with pillars of another rubber
CAD_LEVEL = 0.5  #: edges of the coarsest mesh of CAD solids, relative to `suited_settings`: half as fine
PUSH = (0.5, 0.5, -1.0)  #: on the pad of a cell whose mesh is refined, by direction
#: convergence that is reckoned with: of grids as level^(−rate); of tetrahedra as unknowns^(−rate), 0.9 to 1.6 being
#: measured under soft pads and 0.5 to 0.6 under stiff ones, whose edges are more singular
GRID_RATE, MESH_RATE = 2.5, {"soft": 1.1, "stiff": 0.65}


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
    grid, (element, pressure) = Grid(lines), hexahedra(ORDER)
    basis = Basis(grid.mesh, element)
    mixed = np.ones((1, grid.mesh.nelements, 1))
    if shares is not None:
        places = basis.mapping.F(basis.X)
        x, y, z = (np.searchsorted(quadrature_lines(line), at) - 1 for line, at in zip(lines, places, strict=True))
        mixed = shares[:, x, y, z]
    body = Rubber(basis, pressure, LAWS["linear"].of(rubbers[: len(mixed)], mixed))
    return System(body, plate_on(plate), mirrors)


def quadrature_lines(lines: FloatArray) -> FloatArray:
    """Lines of a grid along an axis, and those between the boxes that its points of integration stand for."""
    ends = np.concatenate([[0.0], np.cumsum(np.polynomial.legendre.leggauss(ORDER + 1)[1]) / 2])
    return np.append((lines[:-1, None] + np.diff(lines)[:, None] * ends[:-1]).ravel(), lines[-1])


def lone_unit(design: SensorDesign) -> SensorDesign:
    """The design with one unit, whose slab is the cell."""
    return replace(design, array=replace(design.array, rows=1, cols=1))


def functionals(design: SensorDesign) -> FloatArray:
    """Rectangles (1 + n_upper, 4) of a cell's pad and its upper electrodes."""
    alone = lone_unit(design)
    return np.vstack([pad_squares(alone), electrode_squares(alone)])


def pad_plate(design: SensorDesign) -> FloatArray | None:
    """Rectangle (4,) of the plate on a cell's pad, None for soft pads."""
    return None if design.pad.kind == "soft" else pad_squares(lone_unit(design))[0]


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
    of prisms, or of the solids of CAD. Rectangles (k, 4) are loaded or observed of the cell's top face, a plate is
    bonded to one (4,).
    """

    def __init__(
        self, design: SensorDesign, rectangles: FloatArray, plate: FloatArray | None = None, from_cad: bool = False
    ) -> None:
        self.design, self.rectangles, self.plate, self.from_cad = design, rectangles, plate, from_cad
        self.is_grid = design.is_homogeneous and not from_cad
        self.seconds = dict.fromkeys(("mesh", "condense", "couple"), 0.0)  #: by the clock
        self._bodies: list[Rubber] = []
        self._cells: dict[tuple[int, Free], CondensedCell] = {}
        self._sides: dict[tuple[int, Free], CellSides] = {}

    @cached_property
    def _adapted(self) -> AdaptedTetrahedra:
        squares, design = functionals(self.design), self.design
        load: Load = DeadLoad(**_sides(squares[0]), traction_mpa=PUSH)
        if self.plate is not None:
            load = StiffLoad(**_sides(self.plate), force_n=PUSH)
        probes = tuple(Probe(name=str(k), kind="mean", **_sides(square)) for k, square in enumerate(squares))
        unit = Sensor(design=design, kind="unit")
        scene = Scene(body=unit, material=design.matrix_material, loads=(load,), probes=probes)
        regions = [region for region in scene.regions if region[1] != scene.material]
        return AdaptedTetrahedra(scene, regions, self.rectangles, cad_mesh(design) if self.from_cad else None)

    def tetrahedra(self, level: int) -> Rubber:
        """The cell's body on the mesh of a level."""
        start = perf_counter()
        while len(self._bodies) <= level:
            if self._bodies:
                self._adapted.refine(self._adapted.solve(Stopwatch()).indicators, np.inf)
            self._bodies.append(self._adapted.body)
        self.seconds["mesh"] += perf_counter() - start
        return self._bodies[level]

    def condensed(self, level: int, degree: int, free: Free = ()) -> CondensedCell:
        """The cell condensed at a level onto ports of a degree; of tetrahedra with some sides free.

        None is condensed twice.
        """
        known = self._cells.get((level, free))
        if known is None or known.ports.degree < degree:
            known = self._cells[level, free] = self._condensed(level, degree, free)
        return known.of_degree(degree)

    def _condensed(self, level: int, degree: int, free: Free) -> CondensedCell:
        design = self.design
        if self.is_grid:
            ports = PortModes(design.array.pitch_mm / 2, design.unit.height_mm, degree)
            mirrors = cell_mirrors(design)
            lines = cell_lines(design, level, mirrors)
            system = grid_system(lines, [design.matrix_material], self.plate, mirrors)
            return condense(system, ports, self.rectangles, len(mirrors) == 2 and np.array_equal(lines[0], lines[1]))
        never_shared = tuple(side for side in free if all(side in other for other in self._places))
        if (level, never_shared) not in self._sides:
            system = System(self.tetrahedra(level), plate_on(self.plate))
            self._sides[level, never_shared] = CellSides.of(system, self.rectangles, never_shared)
        return self._sides[level, never_shared].cell(degree, free)

    @property
    def _places(self) -> list[Free]:
        return places(self.design.array.rows, self.design.array.cols)

    def kinds(self, level: int, degree: int) -> Kinds:
        """The cell of every place in the design's array; grids have one for all."""
        found = [()] if self.is_grid else self._places
        return {free: self.condensed(level, degree, free) for free in found}

    def error_factor(self, coarse: int, fine: int) -> float:
        """Error of the finer of two levels over their change."""
        if self.is_grid:
            return richardson_factor(coarse, fine, GRID_RATE)
        one, other = (System(self._bodies[level]).n_unknowns for level in (coarse, fine))
        return richardson_factor(one, other, MESH_RATE[self.design.pad.kind])


def cad_mesh(design: SensorDesign) -> MeshTet:
    """A coarse mesh of a design's lone unit, from the solids of CAD (build123d) by pytetwild, or from the cache."""
    alone = lone_unit(design)
    mesh, *_ = sensor_mesh(alone, suited_settings(alone).finer(CAD_LEVEL))
    return MeshTet(np.ascontiguousarray(mesh.points_mm.T), np.ascontiguousarray(mesh.cells.T))


def plate_on(plate: FloatArray | None) -> list[Load]:
    """A plate on a rectangle (4,), as a load without force; none if there is none."""
    return [] if plate is None else [StiffLoad(**_sides(plate), force_n=(0.0, 0.0, 0.0))]


def _sides(rectangle: FloatArray) -> dict[str, Any]:
    """Centre and size of a rectangle (4,)."""
    x0, y0, x1, y1 = rectangle.tolist()
    return {"center_mm": ((x0 + x1) / 2, (y0 + y1) / 2), "size_mm": (x1 - x0, y1 - y0)}


@dataclass(frozen=True, eq=False, kw_only=True)
class CellInterior:
    """A condensed cell, and what every one of its amplitudes does inside.

    An amplitude is a port displacement [mm], n_modes·3 of them, or a force on a rectangle [N], three for each.
    """

    cell: CondensedCell
    field: Field  #: displacements (n_nodes, 3, n_amplitudes) per unit amplitude


def design_interior(
    design: SensorDesign,
    rectangles_mm: FloatArray,
    plate: FloatArray | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> CellInterior:
    """Solve a design's cell inside, with rectangles (k, 4) of its top to load, and a plate bonded to one (4,).

    `progress` is called with the name of each step as it begins.
    """
    degree, spots = (GRID_DEGREE, [*rectangles_mm]) if design.is_homogeneous else (MESH_DEGREE, [])
    where: Places
    if design.is_homogeneous:
        progress("cell")
        lines = cell_lines(design, GRID_LEVEL)
        where, system = Grid(lines), grid_system(lines, [design.matrix_material], plate)
    else:
        progress("mesh")
        body = DesignCell(design, rectangles_mm, plate).tetrahedra(MESH_LEVEL)
        progress("cell")
        where, system = Tetrahedra(body.basis.mesh), System(body, plate_on(plate))
    inside: list[FloatArray] = []
    ports = PortModes(design.array.pitch_mm / 2, design.unit.height_mm, degree)
    cell = condense(system, ports, rectangles_mm, inside=inside)
    moved = np.ascontiguousarray(inside[0].transpose(1, 2, 0))
    # tetrahedra have no edges along those of loads
    field = Field(places=where, body=system.body, displacement_mm=moved, loaded_mm=spots)
    return CellInterior(cell=cell, field=field)
