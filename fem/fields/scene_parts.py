"""The parts of a loaded scene, with displacement and stress: as `fem.fields.deformed` has those of a sensor."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from skfem import Element, ElementHex2, ElementTetP2

from fem.discretization.elements import Elements
from fem.fields.array_field import solve_array_field
from fem.fields.deformed import Part, sensor_parts
from fem.fields.stress import nodal_stress
from fem.methods.box_field import VTK_PLACES
from fem.methods.cell_scene import forces_on_cells
from fem.methods.picture_grid import picture_field
from fem.methods.plan import make_plan
from fem.methods.solving import follow
from fem.scene.scene import Rectangle, Scene, Sensor
from fem.scene.solution import QUADRATIC_TETRAHEDRON, TRIQUADRATIC_HEXAHEDRON, Field

TOLERANCE = 1e-2  #: of a picture, where the scene asks for a finer one
SAME_PLACE = 1e-9  #: of the body's size: how far apart rounding may put copies of a point
#: scikit-fem's element of VTK's cells
ELEMENTS: dict[int, Element] = {
    QUADRATIC_TETRAHEDRON: ElementTetP2(),
    TRIQUADRATIC_HEXAHEDRON: ElementHex2(),
}


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
    if isinstance(scene.body, Sensor):
        return _sensor(scene, scene.body, stress, progress)
    progress("solve")
    coarse = replace(scene, tolerance=max(scene.tolerance, TOLERANCE))
    plan = make_plan(coarse, field=True)
    found = picture_field(coarse, plan) if plan.method == "grid" else follow(plan, coarse, field=True).field
    assert found is not None  # it was asked for
    field = merged(found)
    progress("stress" if stress else "parts")
    inside, outside = field.region > 0, field.region == 0
    if not inside.any():
        return {"body": _part(field, outside, stress)}
    return {"inclusions": _part(field, inside, stress), "matrix": _part(field, outside, stress)}


def _sensor(scene: Scene, body: Sensor, stress: bool, progress: Callable[[str], None]) -> dict[str, Part]:
    """By superposition on one cell, whatever the pillars are of."""
    local: dict[Rectangle, int] = {}
    newtons = forces_on_cells(scene, body, local)
    if not local:  # unloaded: its pads are shown instead
        array = solve_array_field(body.design, progress)
        return sensor_parts(array, array.state(np.zeros((body.design.n_units, 3))), stress)
    array = solve_array_field(body.design, progress, np.array(list(local)))
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
    element = ELEMENTS[field.cell_type]
    order = np.arange(len(element.doflocs))
    if field.cell_type == TRIQUADRATIC_HEXAHEDRON:
        places = np.rint(element.doflocs * 2).astype(np.int64)
        order = (places[:, None] == VTK_PLACES).all(axis=2).argmax(axis=1)
    return Elements(element, field.points_mm, field.cells[:, order], field.region)
