"""A design's cell as a body: boxes where it is of one rubber, tetrahedra with pillars of another.

A `CellBody` is a cell x, y ∈ [−a, a], or the part of it beyond mirror planes, as a linear system of n nodes and m
unknowns. Its base is clamped, its side faces are free. Unknowns of a parity are those of a problem of the part.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.array.cell import CellSides, CondensedCell, Free, PortModes, condense
from fem.array.coupled_cells import Kinds, places
from fem.boxes.boxes import Boxes
from fem.field import Field
from fem.kernel.factor import SparseMatrix
from fem.kernel.law import LAWS
from fem.kernel.loads import DeadLoad, Load, StiffLoad
from fem.kernel.mirrors import QUARTER, Mirror, Parity
from fem.levels import richardson_factor
from fem.meshes.lines import Attractor, graded_lines
from fem.rubber.body import RubberBody
from fem.scene.scene import Probe, Scene, Sensor
from fem.scene.solution import Stopwatch
from fem.system import System
from fem.tetrahedra.adapted import AdaptedTetrahedra
from fem.tetrahedra.mixed import TaylorHood
from fem.tetrahedra.system import TetrahedralSystem
from geometry.design import Material, SensorDesign
from geometry.layout import FloatArray, electrode_squares, pad_squares


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
PUSH = (0.5, 0.5, -1.0)  #: on the pad of a cell whose mesh is refined, by direction
#: convergence that is reckoned with: of boxes as level^(−rate); of tetrahedra as unknowns^(−rate), 0.9 to 1.6 being
#: measured under soft pads and 0.5 to 0.6 under stiff ones, whose edges are more singular
BOX_RATE, MESH_RATE = 2.5, {"soft": 1.1, "stiff": 0.65}


@dataclass(frozen=True, eq=False)
class CellBody:
    """A cell of boxes, or its part beyond mirrors; or a whole one of tetrahedra."""

    system: System | TetrahedralSystem  #: at rest; its loads are plates without force

    @classmethod
    def of(
        cls,
        lines: Sequence[FloatArray],
        rubbers: Sequence[Material],
        plate: FloatArray | None = None,
        mirrors: tuple[Mirror, ...] = (),
        shares: FloatArray | None = None,
    ) -> "CellBody":
        """Boxes between lines, with a plate bonded to a rectangle (4,) of the whole cell.

        Boxes hold shares (n_rubbers, nx, ny, nz) of the rubbers, evenly mixed: stiffer than truth where rubbers meet
        inside a box; of the first alone without them.
        """
        boxes = Boxes.between(lines)
        every = np.ones((1, len(boxes.nodes), 1)) if shares is None else shares.reshape(len(rubbers), -1, 1)
        body = RubberBody(boxes, LAWS["linear"].of(rubbers[: len(every)], every))
        return cls(System(body, plate_on(plate), mirrors))

    @classmethod
    def of_tetrahedra(cls, body: TaylorHood, plate: FloatArray | None = None) -> "CellBody":
        """A whole cell of Taylor-Hood tetrahedra, with a plate as of `of`."""
        return cls(TetrahedralSystem(body, plate_on(plate)))

    @property
    def definite(self) -> bool:
        """True if its matrices are."""
        return not self.system.n_mixed

    @property
    def mirrors(self) -> tuple[Mirror, ...]:
        """Planes beyond which the part lies."""
        return self.system.mirrors

    @property
    def points_mm(self) -> FloatArray:
        """Positions of the nodes, (n, 3)."""
        return self.system.points_mm

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        """Unknown that moves each node along each axis, and no other node; −1 where there is none, (n, 3)."""
        found = np.full((len(self.points_mm), 3), -1)
        found[self.system.free] = np.arange(3 * len(self.system.free)).reshape(-1, 3)
        return found

    @property
    def is_square(self) -> bool:
        """True if the body stays the same when x and y are exchanged."""
        if isinstance(self.system, TetrahedralSystem):
            return False
        boxes, law = self.system.body.boxes, self.system.body.law
        moduli = [part.reshape(boxes.shape) for part in (law.lame_mpa, law.mu_mpa)]
        plates = [load.size_mm[0] == load.size_mm[1] for load in self.system.whole_loads]
        same = np.array_equal(*boxes.lines[:2]) and all(plates)
        return same and all(np.array_equal(part, part.swapaxes(0, 1)) for part in moduli)

    @cached_property
    def _tangent(self) -> Any:
        return self.system.rest_tangent()

    def matrix(self, parity: Parity) -> SparseMatrix:
        """Upper triangle of the system of a parity, (m, m); rows of nodes in whole blocks, if it is stored in such."""
        return self.system.matrix(self._tangent, parity)

    def integrals(self, rectangles: FloatArray) -> sp.csr_matrix:
        """∫ φ dA of every node's function over what the part has of rectangles (k, 4) of the top face, (k, n) [mm²]."""
        return self.system.integrals(rectangles)

    def gathered(self, forces: FloatArray, parity: Parity) -> FloatArray:
        """Forces (m, k) on the unknowns of forces (k, n, 3) on the nodes [N]."""
        return self.system.of_parity(parity).rest_loads(forces)

    def displacements(self, solution: FloatArray) -> FloatArray:
        """Displacements (k, n, 3) of the nodes by unknowns (m, k) [mm]."""
        return self.system.displaced(solution)


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


def mirrored(lines: FloatArray) -> FloatArray:
    """Lines of a quarter, from 0 on, and their mirror images."""
    return np.concatenate([-lines[:0:-1], lines])


class DesignCell:
    """A design's cell at levels of refinement: boxes where it is of one rubber, else nested meshes of tetrahedra.

    A level of boxes divides their edges. That of tetrahedra counts how often the coarsest mesh was halved where it
    errs: for the lone unit under a load on its pad, as its pad and electrodes see it (`fem.tetrahedra.adapted`).
    Rectangles (k, 4) are loaded or observed of the cell's top face, a plate is bonded to one (4,).
    """

    def __init__(self, design: SensorDesign, rectangles: FloatArray, plate: FloatArray | None = None) -> None:
        self.design, self.rectangles, self.plate = design, rectangles, plate
        self.seconds = dict.fromkeys(("mesh", "condense", "couple"), 0.0)  #: by the clock
        self._bodies: list[TaylorHood] = []
        self._indicators: list[FloatArray] = []  #: of all meshes but the last
        self._cells: dict[tuple[int, Free], CondensedCell] = {}
        self._sides: dict[tuple[int, Free], CellSides] = {}

    @cached_property
    def _adapted(self) -> AdaptedTetrahedra:
        squares = functionals(self.design)
        load: Load = DeadLoad(**_sides(squares[0]), traction_mpa=PUSH)
        if self.plate is not None:
            load = StiffLoad(**_sides(self.plate), force_n=PUSH)
        probes = tuple(Probe(name=str(k), kind="mean", **_sides(square)) for k, square in enumerate(squares))
        unit = Sensor(design=self.design, kind="unit")
        scene = Scene(body=unit, material=self.design.matrix_material, loads=(load,), probes=probes)
        return AdaptedTetrahedra(scene, scene.regions, self.rectangles)

    def body(self, level: int) -> CellBody:
        """The cell at a level."""
        if self.design.is_homogeneous:
            mirrors = cell_mirrors(self.design)
            lines = cell_lines(self.design, level, mirrors)
            return CellBody.of(lines, [self.design.matrix_material], self.plate, mirrors)
        return CellBody.of_tetrahedra(self.tetrahedra(level), self.plate)

    def tetrahedra(self, level: int) -> TaylorHood:
        """The cell's body on the mesh of a level."""
        start = perf_counter()
        mesh = self._adapted
        while len(self._bodies) <= level:
            if self._bodies:
                self._indicators.append(mesh.solve(Stopwatch()).indicators)
                mesh.refine(self._indicators[-1], np.inf)
            self._bodies.append(mesh.body)
        self.seconds["mesh"] += perf_counter() - start
        return self._bodies[level]

    def condensed(self, level: int, degree: int, free: Free = ()) -> CondensedCell:
        """The cell condensed at a level onto ports of a degree; of tetrahedra with some sides free.

        None is condensed twice.
        """
        known = self._cells.get((level, free))
        if known is None or known.ports.side < degree:
            known = self._cells[level, free] = self._condensed(level, degree, free)
        return known.of_degree(degree)

    def _condensed(self, level: int, degree: int, free: Free) -> CondensedCell:
        if self.design.is_homogeneous:
            ports = PortModes(self.design.array.pitch_mm / 2, self.design.unit.height_mm, degree, degree)
            return condense(self.body(level), ports, self.rectangles)
        never_shared = tuple(side for side in free if all(side in other for other in self._places))
        if (level, never_shared) not in self._sides:
            self._sides[level, never_shared] = CellSides.of(self.body(level), self.rectangles, never_shared)
        return self._sides[level, never_shared].cell(degree, free)

    @property
    def _places(self) -> list[Free]:
        return places(self.design.array.rows, self.design.array.cols)

    def kinds(self, level: int, degree: int) -> Kinds:
        """The cell of every place in the design's array; boxes have one for all."""
        found = [()] if self.design.is_homogeneous else self._places
        return {free: self.condensed(level, degree, free) for free in found}

    def error_factor(self, coarse: int, fine: int) -> float:
        """Error of the finer of two levels over their change."""
        if self.design.is_homogeneous:
            return richardson_factor(coarse, fine, BOX_RATE)
        one, other = (self._bodies[level].n_unknowns for level in (coarse, fine))
        return richardson_factor(one, other, MESH_RATE[self.design.pad.kind])


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
    material = [design.matrix_material, design.pillar_material]
    if design.is_homogeneous:
        progress("cell")
        body, degree = CellBody.of(cell_lines(design, GRID_LEVEL), material[:1], plate), GRID_DEGREE
    else:
        progress("mesh")
        tetrahedra = DesignCell(design, rectangles_mm, plate).tetrahedra(MESH_LEVEL)
        progress("cell")
        body, degree = CellBody.of_tetrahedra(tetrahedra, plate), MESH_DEGREE
    ports = PortModes(design.array.pitch_mm / 2, design.unit.height_mm, degree, degree)
    inside: list[FloatArray] = []
    cell = condense(body, ports, rectangles_mm, inside)
    moved = np.ascontiguousarray(inside[0].transpose(1, 2, 0))
    loaded = [*rectangles_mm] if design.is_homogeneous else []  # tetrahedra have no edges along those of loads
    rubber = body.system.body
    mesh = rubber.boxes if isinstance(rubber, RubberBody) else rubber.elements
    field = Field(mesh=mesh, displacement_mm=moved, material=material, loaded_mm=loaded)
    return CellInterior(cell=cell, field=field)
