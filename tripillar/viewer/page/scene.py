"""The array in 3-D: pillars inside a translucent slab under its pads, moved in place as loads change.

`Superposition` gives the field under any load; the scene moves its meshes by it; `Camera` is turned by the mouse.
Points are given in the cell's own coordinates (origin at the unit's centre, base z = 0) and are the same in every unit,
so one observer of the displacement field serves all units.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from fem.fields.array_field import ArrayField, FieldState, Observer
from fem.fields.deformed import APART_MM, Part, Quads, pillar_surface, rectangle_surface
from fem.pictures.colours import QUANTITIES, SHADES, Bar, Colour, bar_of, mixed, shades
from fem.pictures.deformation import draw_off_screen, place
from fem.pictures.scenery import draw_scenery, unit_names
from fem.scene.solution import QUADRILATERAL
from geometry.design import SensorDesign
from geometry.layout import PILLARS, FloatArray, unit_centres

IntArray = NDArray[np.int64]

RESISTANCE: Literal["resistance"] = "resistance"  #: the one colour of the page's own: of each pillar as a whole
TITLES = {name: quantity.title for name, quantity in QUANTITIES.items()} | {RESISTANCE: "change of resistance [%]"}
MIN_CHANGE = 1.0  #: [%], smallest end of the colour bar of resistances
SLICES = 8  #: of a pillar along its axis
DIVISIONS, LEVELS = 6, 3  #: of the cell's side and of its height: coarse enough to be quick
AMBIENT = 0.3  #: light on pillars from everywhere
MAX_PRESSED_MPA = 5.0  #: traction at which a pad's outline is darkest
BACKGROUND = {False: "#ffffff", True: "#323b45"}  #: by whether it is dark; not so dark that dark pillars are lost
LETTERS = {False: "#21292f", True: "#e4e9ed"}
SLAB, EDGE, CHOSEN = "#8fb0cc", "#6b8299", "#ff8c00"
#: of the pads' outlines, grey where unloaded
PADS_BAR = Bar(
    title="traction on a pad [MPa]", low=0.0, high=MAX_PRESSED_MPA, colours=mixed(("#93a1ad", "#d64541"), SHADES)
)
VIEW = (1.0, -1.65, 1.5)  #: the direction one looks from at first
STEEPEST_DEG = 89.0  #: of the camera: straight from above there is no upright
NEAREST, FARTHEST = 0.1, 5.0  #: of the distance from which all is seen
MAX_UNITS = 150  #: whose answers to unit loads are kept, 240 MB; a larger array is solved for every load


class Superposition:
    """States of an array's field under any loads, as sums of its answers to unit loads.

    Solving the coupled cells of a 6 × 6 array takes 9 ms of a processor's time, adding the answers to its 108 unit
    loads 0.6 ms.
    """

    def __init__(self, field: ArrayField) -> None:
        self.field = field
        n = field.design.n_units
        self._unit_ports: FloatArray | None = None
        if n <= MAX_UNITS:
            ports, _ = field.coupled.port_displacements(np.eye(3 * n).reshape(n, 3, 3 * n))
            self._unit_ports = np.ascontiguousarray(ports.reshape(-1, 3 * n).T)

    def state(self, traction_mpa: FloatArray) -> FieldState:
        """As `ArrayField.state`: tractions (n_units, 3), z negative pushing down [MPa]."""
        if self._unit_ports is None:
            return self.field.state(traction_mpa)
        force_n = traction_mpa * self.field.design.pad.size_mm**2
        port_mm = (force_n.ravel() @ self._unit_ports).reshape(len(force_n), -1)
        return FieldState(force_n=force_n, port_mm=port_mm)


@dataclass(frozen=True, kw_only=True)
class Shown:
    """Options of the drawing."""

    colour: Colour | Literal["resistance"] = "displacement"
    scale: float = 1.0  #: of displacements
    chosen: int = 0  #: unit whose pad is marked
    dark: bool = False


@dataclass(frozen=True, eq=False)
class Moving:
    """A mesh that moves with the field; one mesh of many surfaces draws faster than many meshes."""

    observed: list[tuple[Observer, IntArray]]  #: points of a surface, and the units that have it
    rest_mm: FloatArray  #: (n, 3): all points, undeformed
    mesh: pv.PolyData

    def move(self, state: FieldState, scale: float) -> FloatArray:
        """Take the points to where the field moves them, `scale` times as far; their displacement (n, 3) [mm]."""
        moved = []
        for observer, units in self.observed:
            of_units = FieldState(force_n=state.force_n[units], port_mm=state.port_mm[units])
            moved.append(observer.displacement_mm(of_units).reshape(-1, 3))
        moved_mm = np.concatenate(moved)
        self.mesh.points = (self.rest_mm + scale * moved_mm).astype(np.float32)
        return moved_mm


class ArrayScene:
    """A plotter with the array in it; draws nothing by itself."""

    def __init__(self, loads: Superposition) -> None:
        draw_off_screen()
        self._field, self._loads = loads.field, loads
        design = self._field.design
        rows, cols = design.array.rows, design.array.cols
        everyone = np.arange(design.n_units)
        row, col = np.divmod(everyone, cols)
        at_end = {(0, -1): col == 0, (0, 1): col == cols - 1, (1, -1): row == 0, (1, 1): row == rows - 1}
        pillars = pillar_surface(design.unit, SLICES, around=1, apart_mm=APART_MM)
        self._owner = np.repeat(np.arange(len(PILLARS)), len(pillars[0]) // len(PILLARS))
        faces = [(top_face(design), everyone)]
        faces += [(side_face(design, *side), everyone[there]) for side, there in at_end.items()]
        edges = [(rims(design, *side), everyone[there]) for side, there in at_end.items()]
        for x_end in (-1, 1):
            for y_end in (-1, 1):
                corner = everyone[at_end[0, x_end] & at_end[1, y_end]]
                edges.append((upright_edge(design, x_end, y_end), corner))
        self._pillars = self._moving([(pillars, everyone)])
        self._stress = self._field.observe(pillars[0], region=1)
        self._faces, self._edges = self._moving(faces), self._moving(edges)
        outline = pad_outline(design)
        self._outline_size = len(outline[0])
        self._pads = self._moving([(outline, everyone)])
        self._mark = pv.lines_from_points(self._outline(0), close=True)
        self.plotter = pv.Plotter(off_screen=True, window_size=(800, 600), lighting="none")
        self.camera = Camera(self.plotter.camera)
        self._fill()
        self.look_from_the_start()

    def show(self, traction_mpa: FloatArray, change: FloatArray, shown: Shown) -> Bar:
        """Bring the scene to a load; returns the colour bar of the pillars.

        Parameters
        ----------
        traction_mpa : array, shape (n_units, 3)
        change : array, shape (n_units, 3)
            Of the resistances of the z, x and y pillars from rest, relative.
        shown : Shown
        """
        state = self._loads.state(traction_mpa)
        moved_mm = self._pillars.move(state, shown.scale)
        for moving in (self._faces, self._edges, self._pads):
            moving.move(state, shown.scale)
        strength = np.linalg.norm(traction_mpa, axis=1)
        self._pads.mesh["strength"] = np.repeat(strength, self._outline_size).astype(np.float32)
        self._mark.points = self._outline(shown.chosen)
        self.plotter.set_background(BACKGROUND[shown.dark])
        self._letters.prop.color = LETTERS[shown.dark]
        if shown.colour == RESISTANCE:
            values = 100.0 * change[:, self._owner].ravel()
            most = max(float(np.abs(values).max()), MIN_CHANGE)
            bar = Bar(title=TITLES[RESISTANCE], low=-most, high=most, colours=shades(None, -most, most))
        else:
            quantity = QUANTITIES[shown.colour]
            stress = self._stress.stress_mpa(state).reshape(-1, 6) if quantity.of_stress else None
            part = Part(
                points_mm=moved_mm, cells=np.empty((0, 4), dtype=np.int64), cell_type=QUADRILATERAL,
                displacement_mm=moved_mm, stress_mpa=stress,
            )  # fmt: skip
            bar, values = bar_of(quantity, [{"pillars": part}]), quantity.of(part)
        self._pillars.mesh["shown"] = values.astype(np.float32)
        mapper = self._actor.mapper
        mapper.lookup_table.apply_cmap(bar.colours, len(bar.colours))
        mapper.scalar_range = bar.low, bar.high
        return bar

    def look_from_the_start(self) -> None:
        """Put the camera where it was at first: the undeformed array fills the window."""
        wide, high = self.plotter.render_window.GetSize()
        place(self.plotter.camera, self.reach_mm, VIEW, (0.0, 0.0, 1.0), wide / high)
        self.plotter.reset_camera_clipping_range()
        self.camera.set_home()

    def fit(self) -> None:
        """Fill a window of another size, unless the camera has been moved."""
        if self.camera.is_home:
            self.look_from_the_start()

    def _outline(self, unit: int) -> FloatArray:
        """The outline of a unit's pad as deformed, (k, 3) [mm]."""
        return np.asarray(self._pads.mesh.points).reshape(-1, self._outline_size, 3)[unit].copy()

    def _moving(self, surfaces: list[tuple[Quads, IntArray]]) -> Moving:
        """One mesh of surfaces of the cell, each in some of the units."""
        observed, rest, cells, n_points = [], [], [], 0
        for (points, own), units in surfaces:
            centres = np.pad(unit_centres(self._field.design)[units], ((0, 0), (0, 1)))
            observed.append((self._field.observe(points), units))
            rest.append((centres[:, None] + points).reshape(-1, 3))
            size, copies = own.shape[1], np.arange(len(units))[:, None, None]
            numbers = n_points + (own + len(points) * copies).reshape(-1, size)
            cells.append(np.column_stack([np.full(len(numbers), size), numbers]).ravel())
            n_points += len(points) * len(units)
        rest_mm = np.concatenate(rest)
        kind = "lines" if size == 2 else "faces"
        mesh = pv.PolyData(rest_mm.astype(np.float32), **{kind: np.concatenate(cells)})
        return Moving(observed, rest_mm, mesh)

    def _fill(self) -> None:
        """Put the meshes, letters and light into the plotter."""
        plotter = self.plotter
        plotter.render_window.SetMultiSamples(0)  # smooth edges cost software three to five times the time
        plotter.add_light(pv.Light(light_type="headlight"))  # each further light, half as much again
        self._pillars.mesh["shown"] = np.zeros(self._pillars.mesh.n_points, np.float32)
        self._pads.mesh["strength"] = np.zeros(self._pads.mesh.n_points, np.float32)
        plotter.add_mesh(self._faces.mesh, color=SLAB, opacity=0.18)
        plotter.add_mesh(self._edges.mesh, color=EDGE, line_width=2)
        self._actor = plotter.add_mesh(
            self._pillars.mesh, scalars="shown", show_scalar_bar=False, ambient=AMBIENT, diffuse=1.0 - AMBIENT
        )
        plotter.add_mesh(
            self._pads.mesh, scalars="strength", cmap=PADS_BAR.colours, clim=(PADS_BAR.low, PADS_BAR.high),
            line_width=2, show_scalar_bar=False, lighting=False,
        )  # fmt: skip
        x, y, z = self._field.design.slab_mm
        corners = np.array([[x * i / 2, y * j / 2, z * k] for i in (-1, 1) for j in (-1, 1) for k in (0, 1)])
        array = self._field.design.array
        names = unit_names(array.rows, array.cols, array.pitch_mm)
        beside = draw_scenery(np.vstack([corners, names.points]), "iso")
        self._letters = plotter.add_mesh(pv.merge([names, beside]), color=LETTERS[False], lighting=False)
        self.reach_mm = np.vstack([corners, names.points, beside.points])
        plotter.add_mesh(self._mark, color=CHOSEN, line_width=4)


class Camera:
    """A camera of VTK that the mouse turns about what it looks at, moves and brings nearer; z stays upright."""

    def __init__(self, camera: Any) -> None:
        self._camera = camera

    def set_home(self) -> None:
        """Take the present place for the one from which all is seen: it bounds how far the camera goes."""
        self._home = self._camera.GetPosition()
        self._middle = self._focus
        self._distance = float(np.linalg.norm(self._home - self._middle))

    @property
    def is_home(self) -> bool:
        """Whether the camera has not been moved since."""
        return bool(self._camera.GetPosition() == self._home)

    def turn(self, right_deg: float, up_deg: float) -> None:
        """Turn the array to the right and up."""
        r, azimuth, elevation = self._spherical()
        steepest = math.radians(STEEPEST_DEG)
        elevation = min(max(elevation - math.radians(up_deg), -steepest), steepest)
        self._place(self._focus, r, azimuth - math.radians(right_deg), elevation)

    def approach(self, factor: float) -> None:
        """Come nearer by a factor above 1, or go away by one below."""
        r, azimuth, elevation = self._spherical()
        r = min(max(r / factor, NEAREST * self._distance), FARTHEST * self._distance)
        self._place(self._focus, r, azimuth, elevation)

    def move(self, right: float, up: float) -> None:
        """Move the array, by fractions of the picture's height."""
        r, azimuth, elevation = self._spherical()
        inward = self._focus - np.array(self._camera.GetPosition())
        across = np.cross(inward, (0.0, 0.0, 1.0))
        across /= np.linalg.norm(across)
        upward = np.cross(across, inward / r)
        height = 2.0 * r * math.tan(math.radians(self._camera.GetViewAngle() / 2))
        focus = self._focus - height * (right * across + up * upward)
        away = np.clip(focus - self._middle, -self._distance, self._distance)
        self._place(self._middle + away, r, azimuth, elevation)

    @property
    def _focus(self) -> FloatArray:
        return np.array(self._camera.GetFocalPoint())

    def _spherical(self) -> tuple[float, float, float]:
        """Distance, azimuth and elevation of the camera from what it looks at."""
        x, y, z = np.array(self._camera.GetPosition()) - self._focus
        return math.hypot(x, y, z), math.atan2(y, x), math.atan2(z, math.hypot(x, y))

    def _place(self, focus: FloatArray, r: float, azimuth: float, elevation: float) -> None:
        flat = r * math.cos(elevation)
        away = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), r * math.sin(elevation)])
        self._camera.SetFocalPoint(*focus)
        self._camera.SetPosition(*(focus + away))
        self._camera.SetViewUp(0.0, 0.0, 1.0)


# the cell's surfaces: points (k, 3) [mm] and the quadrilaterals (m, 4) or lines (m, 2) between them


def top_face(design: SensorDesign) -> Quads:
    """The cell's top."""
    pitch_mm = design.array.pitch_mm
    return rectangle_surface(np.array([0.0, 0.0, design.unit.height_mm]), np.full(2, pitch_mm), DIVISIONS)


def side_face(design: SensorDesign, axis: int, end: int) -> Quads:
    """The cell's side at the lower (-1) or upper (+1) end of axis 0 or 1."""
    half, height = design.array.pitch_mm / 2, design.unit.height_mm
    along, z = np.meshgrid(np.linspace(-half, half, DIVISIONS + 1), np.linspace(0.0, height, LEVELS + 1))
    points = np.empty((along.size, 3))
    points[:, axis], points[:, 1 - axis], points[:, 2] = end * half, along.ravel(), z.ravel()
    corner = (np.arange(LEVELS)[:, None] * (DIVISIONS + 1) + np.arange(DIVISIONS)).reshape(-1, 1)
    return points, corner + np.array([0, 1, DIVISIONS + 2, DIVISIONS + 1])


def rims(design: SensorDesign, axis: int, end: int) -> Quads:
    """The upper and lower edge of a side, as lines."""
    side = side_face(design, axis, end)[0].reshape(LEVELS + 1, DIVISIONS + 1, 3)
    line = _steps(DIVISIONS)
    return side[[0, -1]].reshape(-1, 3), np.concatenate([line, line + DIVISIONS + 1])


def upright_edge(design: SensorDesign, x_end: int, y_end: int) -> Quads:
    """The upright edge at the lower (-1) or upper (+1) end of x and y, as lines."""
    half = design.array.pitch_mm / 2
    points = np.tile([x_end * half, y_end * half, 0.0], (LEVELS + 1, 1))
    points[:, 2] = np.linspace(0.0, design.unit.height_mm, LEVELS + 1)
    return points, _steps(LEVELS)


def pad_outline(design: SensorDesign) -> Quads:
    """The outline of the cell's pad, as lines from each point to the next and back to the first."""
    half = design.pad.size_mm / 2
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    share = np.linspace(0.0, 1.0, DIVISIONS, endpoint=False)[:, None]
    around = np.concatenate([a + share * (b - a) for a, b in pairwise(corners)])
    around += (design.pad.offset_x_mm, design.pad.offset_y_mm)
    line = _steps(len(around))
    return np.column_stack([around, np.full(len(around), design.unit.height_mm)]), line % len(around)


def _steps(n: int) -> IntArray:
    """Lines between n + 1 points in a row."""
    return np.stack([np.arange(n), np.arange(n) + 1], axis=1)
