"""Parts of a loaded sensor or scene: points and cells with displacement and stress, from which pictures are drawn."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from math import ceil
from pathlib import Path

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from skfem import Element
from skfem.refdom import RefHex
from vtkmodules.vtkCommonDataModel import vtkQuadraticTetra, vtkTriQuadraticHexahedron

from common.storage.files import vtk_content, write_bytes
from fem.array.design_cell import cell_lines
from fem.finite.solving import finite_body, finite_grid
from fem.kernel.factor import Factor, checked_solve
from fem.kernel.field import Field, same_places, unfolded
from fem.kernel.loads import Rectangle
from fem.kernel.mirrors import parities
from fem.kernel.reference import tabulated
from fem.kernel.system import System
from fem.methods.cell_scene import design_of_cells, forces_on_cells, has_alike_plates
from fem.methods.plan import Plan, make_plan
from fem.methods.solving import follow
from fem.pictures.arrays import FINITE_TOLERANCE, ArrayField, FieldState, solve_array_field
from fem.pictures.pressed import FiniteArrayField, Watch, no_stress, pressed_array
from fem.scene.scene import Scene, Sensor
from geometry.design import Unit, lone_unit
from geometry.layout import FloatArray, electrode_centres, pad_squares, unit_centres
from geometry.prism import Prism, unit_prisms

SLICES, AROUND = 16, 3  #: of a pillar's surface: along it, and along each of its four sides
#: slices, around, squares along a pad's side, and level of the cell's grid by whose lines the matrix is cut
FINE, COARSE = (SLICES, AROUND, 12, 2), (8, 1, 6, 1)
INSIDE = 1e-9  #: of a pad's side, by which it is drawn smaller: stress jumps at its edge
APART = 0.002  #: of the height, by which pillars are drawn smaller, each more than the one before: no faces coincide
TOLERANCE = 1e-2  #: of a picture, where the scene asks for a finer one
LEVEL = 2  #: of the grid of a picture of boxes
QUADRILATERAL, HEXAHEDRON, QUADRATIC_TETRAHEDRON, TRIQUADRATIC = 9, 12, 24, 29  #: VTK's numbers of cells

Cells = tuple[FloatArray, NDArray[np.int64]]  #: points (n, 3) and cells (m, k) between them


@dataclass(frozen=True, eq=False, kw_only=True)
class Part:
    """Points, cells between them, and what was found at the points."""

    points_mm: FloatArray  #: (n, 3), at rest
    cells: NDArray[np.int64]  #: (m, k), in VTK's order of points
    cell_type: int  #: VTK's number
    displacement_mm: FloatArray  #: (n, 3)
    stress_mpa: FloatArray | None = None  #: (n, 6) where asked for: xx, yy, zz, yz, xz, xy; tension positive
    traction_mpa: FloatArray | None = None  #: (m, 3), on the cells of a part that is loaded

    @property
    def stress(self) -> FloatArray:
        """Stress at the points, (n, 6) [MPa]; ValueError where it was not asked for."""
        if self.stress_mpa is None:
            raise ValueError("this part has no stress: ask for it where parts are made.")
        return self.stress_mpa

    @property
    def strength_mpa(self) -> FloatArray:
        """Size of the traction on the cells, (m,); ValueError where there is none."""
        if self.traction_mpa is None:
            raise ValueError("this part has no traction: only pads have.")
        return np.linalg.norm(self.traction_mpa, axis=1)

    @property
    def grid(self) -> pv.UnstructuredGrid:
        """The part at rest, without what was found on it."""
        return pv.UnstructuredGrid({pv.CellType(self.cell_type): self.cells}, self.points_mm)

    @property
    def sizes(self) -> FloatArray:
        """Weight of the points, (n,): sum of the volumes or areas of the cells that meet there."""
        found = self.grid.compute_cell_sizes(length=False)
        size = np.repeat(np.asarray(found["Area"] + found["Volume"]), self.cells.shape[1])
        return np.asarray(np.bincount(self.cells.ravel(), size, len(self.points_mm)), np.float64)

    def times(self, share: float) -> "Part":
        """The same under a share of the load: everything is linear."""
        seen = {name: getattr(self, name) for name in ("displacement_mm", "stress_mpa", "traction_mpa")}
        return replace(self, **{name: share * values for name, values in seen.items() if values is not None})


Parts = Mapping[str, Part]  #: by name: pillars, matrix, electrodes, pads (plates where they are stiff)


class ArrayParts:
    """Pillars, matrix, electrodes and pads of an array, under one load after the other; stiff pads are named plates.

    Pillars, electrodes (upper and lower) and pads are surfaces, the matrix is the whole slab in boxes. Where a unit's
    pillars overlap their faces would coincide with each other and with the slab's: they are made smaller by
    0.2 % of the height and more all around, which nobody sees. `is_coarse` parts are drawn and moved more quickly.
    """

    def __init__(self, array: ArrayField | FiniteArrayField, is_coarse: bool = False) -> None:
        unit, self._array = array.design.unit, array
        slices, around, across, fineness = COARSE if is_coarse else FINE
        slab = pv.RectilinearGrid(*cell_lines(array.design, fineness)).cast_to_structured_grid()
        boxes = np.asarray(slab.points), slab.cast_to_unstructured_grid().cells_dict[HEXAHEDRON]
        pads = []
        for x0, y0, x1, y1 in array.rectangles_mm:
            a, b = np.diag([x1 - x0, y1 - y0, 0.0])[:2]
            corner = np.array([x0, y0, unit.height_mm]) + INSIDE / 2 * (a + b)
            pads.append(sheet(corner, (1 - INSIDE) * a, (1 - INSIDE) * b, across, across))
        self._pads = "plates" if array.has_plates else "pads"
        self._parts = {
            "pillars": _on_units(array, pillar_surface(unit, slices, around, APART * unit.height_mm), region=1),
            "matrix": _on_units(array, boxes, region=0, cell_type=HEXAHEDRON),
            "electrodes": _on_units(array, electrode_surface(unit), region=1),
            self._pads: _on_units(array, joined(pads)),
        }

    def under(self, state: FieldState, stress: bool = True) -> dict[str, Part]:
        """The parts under a load, each pad with its traction."""
        parts = {name: under(state, stress) for name, under in self._parts.items()}
        pads, (low, high) = parts[self._pads], np.split(self._array.rectangles_mm, 2, axis=1)
        traction = (state.force_n.reshape(-1, len(low), 3) / (high - low).prod(axis=1)[:, None]).reshape(-1, 3)
        on_cells = np.repeat(traction, len(pads.cells) // len(traction), axis=0)
        return parts | {self._pads: replace(pads, traction_mpa=on_cells)}


def sensor_parts(array: ArrayField | FiniteArrayField, state: FieldState, stress: bool = True) -> dict[str, Part]:
    """The parts of a loaded array, as `ArrayParts` has them."""
    return ArrayParts(array).under(state, stress)


def pillar_surface(unit: Unit, slices: int = SLICES, around: int = AROUND, apart_mm: float = 0.0) -> Cells:
    """The pillars of a unit in its own frame, one after the other, cut so finely that they can bend.

    The first is smaller by `apart_mm` all around, the second by twice as much and so on, each otherwise than the two
    before and those that share an electrode: no two of their faces coincide.
    """
    pairs, numbers = unit.layout.body.pillar_terminals, list[int]()
    for k, pair in enumerate(pairs):
        near = {numbers[j] for j in range(k) if k - j <= 2 or {*pairs[j]} & {*pair}}
        numbers.append(min({*range(1, k + 2)} - near))
    prisms = zip(numbers, unit_prisms(unit), strict=True)
    return joined([column_surface(prism, slices, around, number * apart_mm) for number, prism in prisms])


def column_surface(prism: Prism, slices: int, around: int, inward_mm: float) -> Cells:
    """A straight column between equal sections at its two ends, smaller by so much all around."""
    axis = prism.axis_mm * (1 - 2 * inward_mm / prism.height_mm)
    foot = (np.array(prism.base_mm) + prism.top_mm - axis) / 2
    if prism.is_round:
        angle = np.linspace(0.0, 2 * np.pi, 8 * around + 1)
        outline = np.column_stack([np.cos(angle), np.sin(angle)]) / 2
    else:
        corners = np.vstack([prism.polygon, prism.polygon[:1]]) / prism.section_mm
        place = np.arange((len(corners) - 1) * around + 1) / around
        outline = np.column_stack([np.interp(place, range(len(corners)), along) for along in corners.T])
    ring = np.pad(outline * (np.array(prism.section_mm) - 2 * inward_mm) @ prism.turn, ((0, 0), (0, 1)))
    points, walls = sheet(foot, np.zeros(3), axis, len(ring) - 1, slices)
    points = (points.reshape(len(ring), -1, 3) + ring[:, None]).reshape(-1, 3)
    fan = np.arange(0, len(ring) - 1, 2)[:, None] + np.arange(4)
    fan[:, 0] = 0  # the middle
    caps = [(np.vstack([middle, middle + ring]), fan) for middle in (foot, foot + axis)]
    return joined([(points, walls), *caps])


def electrode_surface(unit: Unit) -> Cells:
    """The electrodes of a unit in its own frame, the upper ones first."""
    a, b = np.eye(3)[:2] * unit.electrode_mm
    return joined([sheet(at - (a + b) / 2, a, b, AROUND, AROUND) for at in electrode_centres(unit)])


def sheet(corner: FloatArray, a: FloatArray, b: FloatArray, n_a: int, n_b: int) -> Cells:
    """A parallelogram from a corner along two sides, cut into n_a × n_b quadrilaterals."""
    points = corner + np.linspace(0.0, a, n_a + 1)[:, None] + np.linspace(0.0, b, n_b + 1)
    number = np.arange((n_a + 1) * (n_b + 1)).reshape(n_a + 1, n_b + 1)
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    return points.reshape(-1, 3), quads.reshape(-1, 4)


def joined(surfaces: list[Cells]) -> Cells:
    """Several surfaces as one; points are not shared between them."""
    first = np.cumsum([0, *(len(points) for points, _ in surfaces)])
    cells = [cells + start for (_, cells), start in zip(surfaces, first[:-1], strict=True)]
    return np.vstack([points for points, _ in surfaces]), np.vstack(cells)


def _on_units(
    array: ArrayField | FiniteArrayField, seen: Cells, region: int | None = None, cell_type: int = QUADRILATERAL
) -> Callable[[FieldState, bool], Part]:
    """Cells of the unit on all units of an array, under a load, with stress if asked; boxes share their points."""
    points, cells = seen
    centres = np.pad(unit_centres(array.design), ((0, 0), (0, 1)))
    places = (centres[:, None] + points).reshape(-1, 3)
    first = number = np.arange(len(places))
    if cell_type == HEXAHEDRON:
        first, number = same_places(places)
    copies = number.reshape(len(centres), -1)[:, cells].reshape(-1, cells.shape[1])
    rest = Part(points_mm=places[first], cells=copies, cell_type=cell_type, displacement_mm=0 * places[first])
    observer = array.observe(points, region)

    def under(state: FieldState, stress: bool) -> Part:
        moved = observer.displacement_mm(state).reshape(-1, 3)[first]
        stresses = observer.stress_mpa(state).reshape(-1, 6)[first] if stress else None
        return replace(rest, displacement_mm=moved, stress_mpa=stresses)

    return under


def solve_scene_parts(scene: Scene, stress: bool, watch: Watch | None = None) -> dict[str, Part]:
    """Solve a scene and cut what is seen of it into parts.

    A unit or an array has pillars, matrix, electrodes and pads, these being the loaded rectangles. A block has
    inclusions in a matrix, and is a body without any.

    Raises
    ------
    SceneError, GeometryError, SolverError
        If it cannot be solved.
    """
    watch = watch or Watch()
    progress = watch.progress
    if stress and not scene.is_linear:
        no_stress()
    if isinstance(scene.body, Sensor):
        return sensor_parts(*_loaded_array(scene, scene.body, watch), stress)
    progress("solve")
    field = scene_field(scene)
    progress("stress" if stress else "parts")
    if scene.inclusions and not scene.is_linear:  # of whatever rubber: surfaces that the field moves
        apart_mm = [APART * (one.top_mm[2] - one.base_mm[2]) for one in scene.inclusions]
        points, quads = joined(
            [column_surface(each, SLICES, AROUND, mm) for each, mm in zip(scene.inclusions, apart_mm, strict=True)]
        )
        moved = field.displacement_at(points)
        inclusions = Part(points_mm=points, cells=quads, cell_type=QUADRILATERAL, displacement_mm=moved)
        return {"inclusions": inclusions, "matrix": quadratic(field, field.body.region == 0)}
    inside = field.body.region > 0
    if not inside.any():
        return {"body": quadratic(field, stress=stress)}
    return {"inclusions": quadratic(field, inside, stress), "matrix": quadratic(field, ~inside, stress)}


def _loaded_array(scene: Scene, body: Sensor, watch: Watch) -> tuple[ArrayField | FiniteArrayField, FieldState]:
    """A scene's unit or array: by superposition on one cell, or at finite strain; unloaded it shows its pads."""
    design, local = body.design, dict[Rectangle, int]()
    force_n = forces_on_cells(scene, body, local).reshape(design.n_units, -1)
    rectangles = np.array(list(local)) if local else pad_squares(lone_unit(design))
    if not local:
        force_n = np.zeros((design.n_units, 3))
    elif scene.is_linear:
        design = design_of_cells(scene, body)
    if scene.is_linear:
        array = solve_array_field(design, watch.progress, rectangles if local and not scene.stiff_loads else None)
        return array, array.under(force_n)
    (x0, y0, x1, y1), has_plates = rectangles[0].tolist(), bool(scene.stiff_loads)
    is_square = len(local) == 1 and np.isclose(x1 - x0, y1 - y0)
    if is_square and (has_alike_plates(scene) or not has_plates):
        pad = replace(design.pad, size_mm=x1 - x0, offset_x_mm=(x0 + x1) / 2, offset_y_mm=(y0 + y1) / 2)
        own = replace(design, pad=replace(pad, kind="stiff" if has_plates else "soft"))
        pressed = pressed_array(own, force_n, scene.loads, make_plan(scene, field=True).mirrors, watch)
    else:
        watch.progress("solve")
        pressed = FiniteArrayField(
            design=design, rectangles_mm=rectangles, force_n=force_n, has_plates=has_plates, field=scene_field(scene)
        )
    return pressed, pressed.state


def scene_field(scene: Scene) -> Field:
    """Displacement of a scene's whole body, for pictures."""
    coarse = replace(scene, tolerance=max(scene.tolerance, TOLERANCE if scene.is_linear else FINITE_TOLERANCE))
    plan = make_plan(coarse, field=True)
    found = picture_field(coarse, plan) if plan.method == "boxes" else follow(plan, coarse, field=True).field
    assert found is not None  # it was asked for
    return found


def quadratic(field: Field, own: NDArray[np.bool_] | None = None, stress: bool = False) -> Part:
    """Elements of a field, all unless told, as VTK's quadratic cells; those of order 3 and more are halved.

    With stress, which may jump between regions, cells of several share no points. Cells of one element follow each
    other.
    """
    body, mesh = field.body, field.body.basis.mesh
    is_hex = mesh.refdom is RefHex
    places = np.reshape((vtkTriQuadraticHexahedron() if is_hex else vtkQuadraticTetra()).GetParametricCoords(), (-1, 3))
    halves, n = ceil(body.basis.elem.maxdeg / 2), len(places)
    places = ((np.array(list(product(range(halves), repeat=3)))[:, None] + places) / halves).reshape(-1, 3)
    element = np.arange(mesh.nelements) if own is None else np.flatnonzero(own)
    # local axes may be left-handed, VTK's are not
    turned = mesh.mapping().detDF(np.full((3, 1), 0.25), tind=element)[:, 0] < 0

    def seen(elem: Element, values: FloatArray) -> FloatArray:
        """At the places of all elements, (m·k, ...), from values (m, n, ...) of an element's functions."""
        out = np.empty((len(element), len(places), values.shape[2]))
        for some, local in ((~turned, places), (turned, places[:, [1, 0, 2]])):
            out[some] = tabulated(elem, local.T)[0].T @ values[some]
        return out.reshape(-1, values.shape[2])

    points = seen(mesh.elem(), mesh.p.T[mesh.t.T[element]])
    moved = seen(body.basis.elem, field.displacement_mm[body.nodes[element]])
    stresses = seen(mesh.elem(), field.corner_stress[field.corners[element]]) if stress else None
    keys = same_places(points)[1]
    if stress:
        keys += (keys.max() + 1) * np.repeat(body.region[element], len(places))
    _, first, cells = np.unique(keys, return_index=True, return_inverse=True)
    return Part(
        points_mm=points[first],
        cells=cells.reshape(-1, n),
        cell_type=TRIQUADRATIC if is_hex else QUADRATIC_TETRAHEDRON,
        displacement_mm=moved[first],
        stress_mpa=None if stresses is None else stresses[first],
    )


def write_field(field: Field, path: Path) -> None:
    """Write the displacement of the whole body as VTU, whole or not at all."""
    part = quadratic(field)
    grid = part.grid
    grid.point_data["displacement_mm"] = part.displacement_mm
    grid.cell_data["region"] = np.repeat(field.body.region, len(part.cells) // len(field.body.region))
    write_bytes(path, vtk_content(grid))


def picture_field(scene: Scene, plan: Plan) -> Field:
    """A body of boxes on one grid of many small ones: few large ones have the right stress only at certain points."""
    mirrors = tuple(mirror for mirror in plan.mirrors if len(mirror.parities) == 1)
    grid = finite_grid(scene, LEVEL, mirrors)
    system = System(finite_body(scene, grid), scene.loads, mirrors, parities(mirrors)[0])
    y, _ = checked_solve(Factor(system.rest_matrix(), definite=True, upper=True), system.full_loads)
    return unfolded(grid, system.body, mirrors, [(system.parity, system.displaced(y)[0])])
