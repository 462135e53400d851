"""Sensors and scenes at finite strain, for pictures: one grid under one load, seen at points of every unit.

Nothing is superposed: every load is solved for itself, on the coarsest grid that is right to 2 % as estimated.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from fem.boxes.boxes import Boxes
from fem.fields.array_field import PAD_LOADS, FieldState, Observer
from fem.finite.samples import SampleSolver
from fem.finite.solving import solve_finite
from fem.methods.cell_scene import forces_on_cells
from fem.methods.plan import make_plan
from fem.scene.checks import SceneError
from fem.scene.loads import FollowerLoad, Load, Rectangle, StiffLoad
from fem.scene.scene import Probe, Scene, Sensor
from fem.scene.solution import Field
from geometry.design import SensorDesign
from geometry.layout import FloatArray, pad_squares, unit_centres

TOLERANCE = 2e-2  #: of a picture, where the scene asks for a finer one


@dataclass(frozen=True, eq=False, kw_only=True)
class FiniteArrayField:
    """An array under one load at finite strain, seen as an `ArrayField` is."""

    design: SensorDesign
    rectangles_mm: FloatArray  #: (k, 4): what is loaded on each cell
    state: FieldState
    has_plates: bool  #: whether those are rigid plates
    boxes: Boxes = field(repr=False)  #: of the whole slab
    displacement_mm: FloatArray = field(repr=False)  #: (n, 3), at their nodes

    def observe(self, points_mm: FloatArray, region: int | None = None) -> Observer:
        """Choose points of the cell to look at; the region makes no difference to displacement."""
        centres, points = np.pad(unit_centres(self.design), ((0, 0), (0, 1))), np.atleast_2d(points_mm)

        def moved(state: FieldState) -> FloatArray:
            """Of the array's only state."""
            rows = self.boxes.at((centres[:, None] + points).reshape(-1, 3))
            return np.asarray(rows @ self.displacement_mm).reshape(len(centres), -1, 3)

        def refused(state: FieldState) -> FloatArray:
            raise no_stress()

        return Observer(moved, refused)


def no_stress() -> SceneError:
    """The refusal of pictures of stress at finite strain."""
    return SceneError(
        "stress at finite strain is not drawn yet: show displacement or vertical, and save .png, .html or .mp4."
    )


def finite_field(scene: Scene) -> Field:
    """Displacement of a neo-Hookean scene's whole body, for pictures; errors as of `solve_finite`."""
    coarse = replace(scene, tolerance=max(scene.tolerance, TOLERANCE))
    found = solve_finite(coarse, make_plan(coarse).mirrors, with_field=True).field
    assert found is not None  # it was asked for
    return found


def boxes_of(field: Field) -> Boxes:
    """Boxes between all nodes of an upright grid, linear in each as the matrix around inclusions is drawn."""
    return Boxes.between([np.unique(along) for along in field.points_mm.T], order=1)


def finite_array_field(scene: Scene, body: Sensor) -> FiniteArrayField:
    """Solve a neo-Hookean scene of a unit or an array.

    Raises
    ------
    SceneError, UnreachableLoadError
        If it cannot be solved.
    """
    local: dict[Rectangle, int] = {}
    newtons = forces_on_cells(scene, body, local)
    grid = finite_field(scene)
    return FiniteArrayField(
        design=body.design,
        rectangles_mm=np.array(list(local) or pad_squares(body.design)[:1]),
        state=FieldState(force_n=newtons.reshape(len(newtons), -1), port_mm=np.zeros((len(newtons), 0))),
        has_plates=bool(scene.stiff_loads),
        boxes=boxes_of(grid),
        displacement_mm=grid.displacement_mm,
    )


def sampled_array_field(solver: SampleSolver, force_n: FloatArray, displacement_mm: FloatArray) -> FiniteArrayField:
    """An array under forces (n_units, 3) [N] on its stiff pads, on the solver's coarse grid.

    Its electrodes lie within 1 % of their answer (n_units, n_upper, 3) [mm].
    """
    boxes, u = solver.on_coarse_grid(force_n, displacement_mm)
    return FiniteArrayField(
        design=solver.design,
        rectangles_mm=pad_squares(solver.design)[:1],
        state=FieldState(force_n=force_n, port_mm=np.zeros((len(force_n), 0))),
        has_plates=True,
        boxes=boxes,
        displacement_mm=u,
    )


def pressed_sensor(design: SensorDesign, load: str, pressure_mpa: float) -> Scene:
    """A neo-Hookean design with a load of `PAD_LOADS` on its pads: by plates, or as a pressure that follows the rubber.

    On soft pads the pressure follows, since from about half of E a dead traction has no equilibrium.
    """
    tractions, side = PAD_LOADS[load](design, pressure_mpa), design.pad.size_mm
    loads: list[Load] = []
    for (x0, y0, x1, y1), traction in zip(pad_squares(design).tolist(), tractions, strict=True):
        middle, size, (tx, ty, tz) = ((x0 + x1) / 2, (y0 + y1) / 2), (side, side), traction.tolist()
        if design.pad.kind == "stiff":
            force = tx * side**2, ty * side**2, tz * side**2
            loads.append(StiffLoad(center_mm=middle, size_mm=size, force_n=force))
        elif traction.any():
            loads.append(FollowerLoad(center_mm=middle, size_mm=size, pressure_mpa=-tz, traction_mpa=(tx, ty)))
    x0, y0, x1, y1 = pad_squares(design)[int(np.abs(tractions[:, 2]).argmax())].tolist()
    probe = Probe(name="pad", kind="mean", center_mm=((x0 + x1) / 2, (y0 + y1) / 2), size_mm=(side, side))
    body = Sensor(design=design)
    return Scene(body=body, material=design.matrix_material, loads=tuple(loads), probes=(probe,), tolerance=TOLERANCE)
