"""Parts of a loaded sensor or scene: points and cells with displacement and stress, from which pictures are drawn."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from skfem import ElementTetP2

from fem.array.meshed import cell_lines
from fem.boxes.boxes import QUADRATIC, SKFEM_NODES, VTK_NODES, Boxes
from fem.fields.array_field import ArrayField, FieldState, solve_array_field
from fem.fields.finite_pictures import (
    FiniteArrayField,
    boxes_of,
    finite_array_field,
    finite_field,
    no_stress,
)
from fem.fields.stress import nodal_stress
from fem.methods.box_field import picture_field
from fem.methods.plan import make_plan
from fem.methods.solving import follow
from fem.scene.cells import design_of_cells, forces_on_cells
from fem.scene.loads import Rectangle
from fem.scene.scene import Scene, Sensor
from fem.scene.solution import (
    HEXAHEDRON,
    QUADRATIC_TETRAHEDRON,
    QUADRILATERAL,
    TRIQUADRATIC_HEXAHEDRON,
    Field,
)
from fem.tetrahedra.elements import Elements
from fem.tetrahedra.mixed import IntArray
from geometry.design import Unit
from geometry.layout import FloatArray, electrode_centres, unit_centres
from geometry.prism import Prism, unit_prisms

SLICES, AROUND = 16, 3  #: of a pillar's surface: along it, and along each of its four sides
ACROSS = 12  #: squares along a pad's side
APART_MM = 0.02  #: by which a unit's pillars are drawn smaller, each more than the one before: no two faces coincide
FINENESS = 2  #: level of the cell's grid by whose lines the matrix is cut

#: corners of VTK's cells that span them: the first, and its neighbours
SPANNED_BY = {
    QUADRILATERAL: (0, 1, 3),
    HEXAHEDRON: (0, 1, 3, 4),
    TRIQUADRATIC_HEXAHEDRON: (0, 1, 3, 4),
    QUADRATIC_TETRAHEDRON: (0, 1, 2, 3),
}

VTK_CORNERS = [0, 4, 6, 2, 1, 5, 7, 3]  #: of a box's, z fastest

Quads = tuple[FloatArray, NDArray[np.int64]]  #: points (n, 3) and quadrilaterals (m, 4)


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
    def sizes(self) -> FloatArray:
        """Weight of the points, (n,): sum of the volumes or areas of the cells that meet there, up to a constant."""
        first, *others = (self.points_mm[self.cells[:, k]] for k in SPANNED_BY[self.cell_type])
        sides = np.stack([corner - first for corner in others], axis=1)
        size = np.sqrt(np.abs(np.linalg.det(sides @ sides.swapaxes(1, 2))))
        sums = np.bincount(self.cells.ravel(), np.repeat(size, self.cells.shape[1]), len(self.points_mm))
        return sums.astype(np.float64, copy=False)  # they are already; numpy's type stubs do not know

    @property
    def strength_mpa(self) -> FloatArray:
        """Size of the traction on the cells, (m,); ValueError where there is none."""
        if self.traction_mpa is None:
            raise ValueError("this part has no traction: only pads have.")
        return np.linalg.norm(self.traction_mpa, axis=1)

    def times(self, share: float) -> "Part":
        """The same under a share of the load: everything is linear."""
        seen = {name: getattr(self, name) for name in ("displacement_mm", "stress_mpa", "traction_mpa")}
        return replace(self, **{name: share * values for name, values in seen.items() if values is not None})


Parts = Mapping[str, Part]  #: by name: pillars, matrix, electrodes, pads (plates where they are stiff)


def sensor_parts(array: ArrayField | FiniteArrayField, state: FieldState, stress: bool = True) -> dict[str, Part]:
    """Pillars, matrix, electrodes and pads of a loaded array; stiff pads are named plates.

    Pillars, electrodes (upper and lower) and pads are surfaces, the matrix is the whole slab in boxes. Where a unit's
    pillars overlap their faces would coincide with each other and with the slab's: they are made smaller by 0.02 to
    0.06 mm all around, which nobody sees.
    """
    unit = array.design.unit
    return {
        "pillars": _on_units(array, state, pillar_surface(unit, apart_mm=APART_MM), stress, region=1),
        "matrix": _slab(array, state, stress),
        "electrodes": _on_units(array, state, electrode_surface(unit), stress, region=1),
        "plates" if array.has_plates else "pads": _pads(array, state, stress),
    }


def pillar_surface(unit: Unit, slices: int = SLICES, around: int = AROUND, apart_mm: float = 0.0) -> Quads:
    """The pillars of a unit in its own frame, one after the other, cut so finely that they can bend.

    The first is smaller by `apart_mm` all around, the second by twice as much: no two of their faces coincide.
    """
    prisms = enumerate(unit_prisms(unit), start=1)
    return joined([column_surface(prism, slices, around, number * apart_mm) for number, prism in prisms])


def column_surface(prism: Prism, slices: int, around: int, inward_mm: float) -> Quads:
    """A straight column between equal rectangles at its two ends, smaller by so much all around."""
    axis = prism.axis_mm * (1 - 2 * inward_mm / prism.height_mm)
    a, b = np.diag([*prism.section_mm, 0.0])[:2] * (1 - 2 * inward_mm / np.array([prism.section_mm]).T)
    foot = (np.array(prism.base_mm) + prism.top_mm - axis - a - b) / 2
    sides, ends = ((foot, a), (foot + b, a), (foot, b), (foot + a, b)), (foot, foot + axis)
    walls = [sheet(corner, side, axis, around, slices) for corner, side in sides]
    return joined([*walls, *(sheet(corner, a, b, around, around) for corner in ends)])


def electrode_surface(unit: Unit) -> Quads:
    """The electrodes of a unit in its own frame, the upper ones first."""
    size = np.full(2, unit.electrode_mm)
    return joined([rectangle_surface(at, size, AROUND) for at in electrode_centres(unit)])


def rectangle_surface(centre_mm: FloatArray, size_mm: FloatArray, steps: int) -> Quads:
    """A horizontal rectangle of steps × steps quadrilaterals."""
    a, b = np.diag([*size_mm, 0.0])[:2]
    return sheet(centre_mm - (a + b) / 2, a, b, steps, steps)


def sheet(corner: FloatArray, a: FloatArray, b: FloatArray, n_a: int, n_b: int) -> Quads:
    """A parallelogram from a corner along two sides, cut into n_a × n_b quadrilaterals."""
    points = corner + np.linspace(0.0, a, n_a + 1)[:, None] + np.linspace(0.0, b, n_b + 1)
    number = np.arange((n_a + 1) * (n_b + 1)).reshape(n_a + 1, n_b + 1)
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    return points.reshape(-1, 3), quads.reshape(-1, 4)


def joined(surfaces: list[Quads]) -> Quads:
    """Several surfaces as one; points are not shared between them."""
    first = np.cumsum([0, *(len(points) for points, _ in surfaces)])
    quads = [quads + start for (_, quads), start in zip(surfaces, first[:-1], strict=True)]
    return np.vstack([points for points, _ in surfaces]), np.vstack(quads)


def _on_units(
    array: ArrayField | FiniteArrayField,
    state: FieldState,
    surface: Quads,
    stress: bool,
    region: int | None,
    units: slice | IntArray = slice(None),
) -> Part:
    """A surface of the cell on all units, or some."""
    points, quads = surface
    observer = array.observe(points, region)
    centres = np.pad(unit_centres(array.design), ((0, 0), (0, 1)))[units]
    copies = np.arange(len(centres))[:, None, None] * len(points)
    return Part(
        points_mm=(centres[:, None] + points).reshape(-1, 3),
        cells=(copies + quads).reshape(-1, 4),
        cell_type=QUADRILATERAL,
        displacement_mm=observer.displacement_mm(state)[units].reshape(-1, 3),
        stress_mpa=observer.stress_mpa(state)[units].reshape(-1, 6) if stress else None,
    )


def _pads(array: ArrayField | FiniteArrayField, state: FieldState, stress: bool) -> Part:
    """The rectangles that are loaded, each with its traction; all if none is."""
    parts, tractions = [], []
    forces = state.force_n.reshape(array.design.n_units, -1, 3)
    for number, (x0, y0, x1, y1) in enumerate(array.rectangles_mm):
        units = np.flatnonzero(forces[:, number].any(axis=1) | ~forces.any())
        centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, array.design.unit.height_mm])
        surface = rectangle_surface(centre, np.array([x1 - x0, y1 - y0]), ACROSS)
        parts.append(_on_units(array, state, surface, stress, None, units))
        traction = forces[units, number] / ((x1 - x0) * (y1 - y0))
        tractions.append(np.repeat(traction, ACROSS**2, axis=0))
    points, cells = joined([(part.points_mm, part.cells) for part in parts])
    return Part(
        points_mm=points,
        cells=cells,
        cell_type=QUADRILATERAL,
        displacement_mm=np.vstack([part.displacement_mm for part in parts]),
        stress_mpa=np.vstack([part.stress for part in parts]) if stress else None,
        traction_mpa=np.vstack(tractions),
    )


def _slab(array: ArrayField | FiniteArrayField, state: FieldState, stress: bool) -> Part:
    """The whole slab in boxes, units sharing the points between them."""
    rows, cols = array.design.array.rows, array.design.array.cols
    local = np.stack(np.meshgrid(*cell_lines(array.design, FINENESS), indexing="ij"), axis=-1)
    nx, ny, nz = (count - 1 for count in local.shape[:3])
    shape = (cols * nx, rows * ny, nz)
    x, y, z = np.indices([count + 1 for count in shape]).reshape(3, -1)
    i, j = np.minimum(y // ny, rows - 1), np.minimum(x // nx, cols - 1)
    # the unit of each point, and which point of its cell it is
    place = i * cols + j, np.ravel_multi_index((x - j * nx, y - i * ny, z), local.shape[:3])
    points = local.reshape(-1, 3)
    observer = array.observe(points, region=0)
    return Part(
        points_mm=np.pad(unit_centres(array.design), ((0, 0), (0, 1)))[place[0]] + points[place[1]],
        cells=Boxes.between([np.arange(count + 1.0) for count in shape], order=1).nodes[:, VTK_CORNERS],
        cell_type=HEXAHEDRON,
        displacement_mm=observer.displacement_mm(state)[place],
        stress_mpa=observer.stress_mpa(state)[place] if stress else None,
    )


TOLERANCE = 1e-2  #: of a picture, where the scene asks for a finer one
SAME_PLACE = 1e-9  #: of the body's size: how far apart rounding may put copies of a point


def solve_scene_parts(
    scene: Scene, stress: bool, progress: Callable[[str], None] = lambda step: None
) -> dict[str, Part]:
    """Solve a scene and cut what is seen of it into parts.

    A unit or an array has pillars, matrix, electrodes and pads, these being the loaded rectangles. A block has
    inclusions in a matrix, and is a body without any.

    Raises
    ------
    SceneError, GeometryError, SolverError
        If it cannot be solved.
    """
    if stress and not scene.is_linear:
        raise no_stress()
    if isinstance(scene.body, Sensor) and scene.is_linear:
        return _sensor(scene, scene.body, stress, progress)
    progress("solve")
    if isinstance(scene.body, Sensor):
        pressed = finite_array_field(scene, scene.body)
        return sensor_parts(pressed, pressed.state, stress=False)
    if not scene.is_linear:
        return _at_finite_strain(scene)
    coarse = replace(scene, tolerance=max(scene.tolerance, TOLERANCE))
    plan = make_plan(coarse, field=True)
    found = picture_field(coarse, plan) if plan.method == "boxes" else follow(plan, coarse, field=True).field
    assert found is not None  # it was asked for
    field = merged(found)
    progress("stress" if stress else "parts")
    inside, outside = field.region > 0, field.region == 0
    if not inside.any():
        return {"body": _part(field, outside, stress)}
    return {"inclusions": _part(field, inside, stress), "matrix": _part(field, outside, stress)}


def _at_finite_strain(scene: Scene) -> dict[str, Part]:
    """A block or a pillar; inclusions are surfaces that the grid's displacement moves."""
    field = finite_field(scene)
    body = _part(field, np.ones(len(field.cells), dtype=bool), False)
    if not scene.inclusions:
        return {"body": body}
    points, quads = joined([column_surface(one, SLICES, AROUND, APART_MM) for one in scene.inclusions])
    moved = boxes_of(field).at(points) @ field.displacement_mm
    inside = Part(points_mm=points, cells=quads, cell_type=QUADRILATERAL, displacement_mm=moved)
    return {"inclusions": inside, "matrix": body}


def _sensor(scene: Scene, body: Sensor, stress: bool, progress: Callable[[str], None]) -> dict[str, Part]:
    """By superposition on one cell, whatever the pillars are of."""
    local: dict[Rectangle, int] = {}
    newtons = forces_on_cells(scene, body, local)
    if not local:  # unloaded: its pads are shown instead
        array = solve_array_field(body.design, progress)
        return sensor_parts(array, array.state(np.zeros((body.design.n_units, 3))), stress)
    design = design_of_cells(scene, body)
    array = solve_array_field(design, progress, None if scene.stiff_loads else np.array(list(local)))
    return sensor_parts(array, array.under(newtons.reshape(len(newtons), -1)), stress)


def _part(field: Field, own: NDArray[np.bool_], stress: bool) -> Part:
    """Some cells of a field; at points of several regions the stress is the mean of theirs."""
    used, cells = np.unique(field.cells[own], return_inverse=True)
    found = None
    if stress:
        elements, u = elements_of(field), field.displacement_mm
        of_regions = [nodal_stress(elements, list(field.material), u, int(k)) for k in np.unique(field.region[own])]
        found = np.nanmean([values[used] for values in of_regions], axis=0)
    return Part(
        points_mm=field.points_mm[used],
        cells=cells.reshape(-1, field.cells.shape[1]),
        cell_type=field.cell_type,
        displacement_mm=field.displacement_mm[used],
        stress_mpa=found,
    )


def merged(field: Field) -> Field:
    """The same with one point in each place: where a mirror copied part of a body there are two."""
    close = SAME_PLACE * np.ptp(field.points_mm, axis=0).max()
    _, first, number = np.unique(np.round(field.points_mm / close), axis=0, return_index=True, return_inverse=True)
    return replace(
        field,
        points_mm=field.points_mm[first],
        displacement_mm=field.displacement_mm[first],
        cells=number.reshape(-1)[field.cells],
    )


def elements_of(field: Field) -> Elements:
    """The elements of a field, their nodes in scikit-fem's order."""
    element, cells = ElementTetP2(), field.cells
    if field.cell_type == TRIQUADRATIC_HEXAHEDRON:
        element, cells = QUADRATIC, cells[:, (SKFEM_NODES[:, None] == VTK_NODES).argmax(axis=1)]
    return Elements(element, field.points_mm, cells, field.region)
