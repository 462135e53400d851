"""The array in 3-D: pillars inside a translucent slab under its pads, moved in place as loads change.

`Superposition` gives the field under any load; the scene moves its meshes by it; `Camera` is turned by the mouse.
Points are given in the cell's own coordinates (origin at the unit's centre, base z = 0) and are the same in every unit,
so one observer of the displacement field serves all units.
"""

import math
from itertools import pairwise, product
from typing import Literal

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from fem.pictures.arrays import ArrayField, FieldState, FiniteArrayField
from fem.pictures.deformation import draw_off_screen, place
from fem.pictures.parts import APART_MM, QUADRILATERAL, Part, pillar_surface
from fem.pictures.scenery import (
    PAD_TITLES,
    QUANTITIES,
    SIGNED,
    Bar,
    Colour,
    bar_of,
    draw_scenery,
    shades,
    unit_names,
)
from geometry.design import SensorDesign
from geometry.layout import PILLARS, FloatArray, unit_centres

IntArray = NDArray[np.int64]
Drawn = list[tuple[IntArray, IntArray]]  #: cells, and the units in which they are drawn

Shown = Colour | Literal["resistance"]
RESISTANCE: Literal["resistance"] = "resistance"  #: the one colour of the page's own: of each pillar as a whole
TITLES = {name: quantity.title for name, quantity in QUANTITIES.items()} | {RESISTANCE: "change of resistance [%]"}
MIN_CHANGE = 1.0  #: [%], smallest end of the colour bar of resistances
SLICES = 8  #: of a pillar along its axis
DIVISIONS, LEVELS = 6, 3  #: of the cell's side and of its height: coarse enough to be quick
AMBIENT = {False: 0.3, True: 0.5}  #: light on pillars from everywhere, more on a dark ground
HAZE = {False: 0.18, True: 0.05}  #: opacity of the slab, which on a dark ground veils the pillars
MAX_PRESSED_MPA = 5.0  #: traction at which a pad's outline is darkest
BACKGROUND = {False: "#ffffff", True: "#1f262d"}  #: by whether it is dark, as the page has it
LETTERS = {False: "#21292f", True: "#e4e9ed"}
SLAB, EDGE, CHOSEN = "#8fb0cc", "#6b8299", "#ff8c00"
PAD_COLOURS = shades(("#93a1ad", "#d64541"))  #: of the pads' outlines, grey where unloaded
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


class ArrayScene:
    """A plotter with the array in it; draws nothing by itself."""

    def __init__(self, loads: Superposition) -> None:
        draw_off_screen()
        self._loads = loads
        field, design = loads.field, loads.field.design
        title = PAD_TITLES["plates" if field.has_plates else "pads"]
        self.pads_bar = Bar(title=title, low=0.0, high=MAX_PRESSED_MPA, colours=PAD_COLOURS)
        pillars, quads = pillar_surface(design.unit, SLICES, around=1, apart_mm=APART_MM)
        sides, faces, edges = cell_sides(design)
        outline = pad_outline(design)
        self._owner = np.repeat(np.arange(len(PILLARS)), len(pillars) // len(PILLARS))
        self._points_mm = np.concatenate([pillars, sides, outline])
        ends = np.cumsum([0, len(pillars), len(sides), len(outline)])
        of_pillars, of_sides, of_pads = (slice(*each) for each in pairwise(ends))
        self._displacement = field.observe(self._points_mm)
        self._stress = field.observe(pillars, region=1)
        centres = np.pad(unit_centres(design), ((0, 0), (0, 1)))
        self._rest_mm = centres[:, None] + self._points_mm  # (n_units, n_points, 3)
        everyone = np.arange(design.n_units)
        self.pillars = self._mesh(of_pillars, [(quads, everyone)])
        self._quads = self.pillars.regular_faces
        self._faces, self._edges = self._mesh(of_sides, faces), self._mesh(of_sides, edges)
        self._pads = self._mesh(of_pads, [(_lines(np.r_[: len(outline), 0]), everyone)])
        self._moving = (
            (self._faces, of_sides), (self._edges, of_sides), (self.pillars, of_pillars), (self._pads, of_pads)
        )  # fmt: skip
        self.mark = pv.lines_from_points(self._outline(0), close=True)  #: of the chosen pad
        self.plotter = pv.Plotter(off_screen=True, window_size=(800, 600), lighting="none")
        self.camera = Camera(self.plotter.camera)
        self._fill()
        self.look_from_the_start()

    def show(
        self,
        traction_mpa: FloatArray,
        change: FloatArray,
        colour: Shown,
        scale: float,
        chosen: int,
        is_dark: bool,
        finite: FiniteArrayField | None = None,
    ) -> Bar:
        """Bring the scene to a load; returns the colour bar of the pillars.

        Parameters
        ----------
        traction_mpa : array, shape (n_units, 3)
        change : array, shape (n_units, 3)
            Relative change from rest of the resistances of the z, x and y pillars.
        colour : str
            One of `TITLES`.
        scale : float
            Factor of displacements as drawn.
        chosen : int
            Unit whose pad is marked.
        is_dark : bool
        finite : FiniteArrayField, optional
            The array under this load at finite strain, to be drawn in place of linear rubber; without stress.
        """
        state = self._loads.state(traction_mpa)
        if finite is None:
            moved_mm = self._displacement.displacement_mm(state)
        else:
            moved_mm = finite.observe(self._points_mm).displacement_mm(finite.state)
        drawn_mm = (self._rest_mm + scale * moved_mm).astype(np.float32)
        for mesh, own in self._moving:
            mesh.points = drawn_mm[:, own].reshape(-1, 3)
        strength = np.linalg.norm(traction_mpa, axis=1).astype(np.float32)
        self._pads["strength"] = np.repeat(strength, self._pads.n_points // len(strength))
        self.mark.points = self._outline(chosen)
        self.plotter.set_background(BACKGROUND[is_dark])
        self._letters.prop.color = LETTERS[is_dark]
        self._slab.prop.opacity = HAZE[is_dark]
        self._actor.prop.ambient, self._actor.prop.diffuse = AMBIENT[is_dark], 1.0 - AMBIENT[is_dark]
        if colour == RESISTANCE:
            values = 100.0 * change[:, self._owner].ravel()
            most = max(float(np.abs(values).max()), MIN_CHANGE)
            bar = Bar(title=TITLES[RESISTANCE], low=-most, high=most, colours=shades(SIGNED, -most, most))
        else:
            quantity = QUANTITIES[colour]
            k = len(self._owner)
            part = Part(
                points_mm=self._rest_mm[:, :k].reshape(-1, 3), cells=self._quads, cell_type=QUADRILATERAL,
                displacement_mm=moved_mm[:, :k].reshape(-1, 3),
                stress_mpa=self._stress.stress_mpa(state).reshape(-1, 6) if quantity.of_stress else None,
            )  # fmt: skip
            bar, values = bar_of(quantity, [{"pillars": part}]), quantity.of(part)
        self.pillars["shown"] = values.astype(np.float32)
        mapper = self._actor.mapper
        mapper.lookup_table.apply_cmap(bar.colours, len(bar.colours))
        mapper.scalar_range = bar.low, bar.high
        return bar

    def look_from_the_start(self) -> None:
        """Put the camera where it was at first: the undeformed array fills the window."""
        wide, high = self.plotter.render_window.GetSize()
        place(self.plotter.camera, self.reach_mm, VIEW, (0.0, 0.0, 1.0), wide / high)
        self.camera.set_home()

    def fit(self) -> None:
        """Fill a window of another size, unless the camera has been moved."""
        if self.camera.is_home:
            self.look_from_the_start()

    def _outline(self, unit: int) -> FloatArray:
        """The outline of a unit's pad as deformed, (k, 3) [mm]."""
        return np.array(self._pads.points).reshape(len(self._rest_mm), -1, 3)[unit]

    def _mesh(self, part: slice, drawn: Drawn) -> pv.PolyData:
        """One mesh of some of the cell's points in every unit: it draws faster than a mesh for each unit."""
        points = self._rest_mm[:, part]
        numbers = np.concatenate(
            [(units[:, None, None] * points.shape[1] + cells).reshape(-1, cells.shape[1]) for cells, units in drawn]
        )
        size = numbers.shape[1]
        cells = np.column_stack([np.full(len(numbers), size), numbers]).ravel()
        return pv.PolyData(points.reshape(-1, 3).astype(np.float32), **{"lines" if size == 2 else "faces": cells})

    def _fill(self) -> None:
        """Put the meshes, letters and light into the plotter."""
        plotter, design = self.plotter, self._loads.field.design
        plotter.render_window.SetMultiSamples(0)  # smooth edges cost software three to five times the time
        plotter.add_light(pv.Light(light_type="headlight"))  # each further light, half as much again
        self.pillars["shown"] = np.zeros(self.pillars.n_points, np.float32)
        self._pads["strength"] = np.zeros(self._pads.n_points, np.float32)
        self._slab = plotter.add_mesh(self._faces, color=SLAB, opacity=HAZE[False])
        plotter.add_mesh(self._edges, color=EDGE, line_width=2)
        self._actor = plotter.add_mesh(self.pillars, scalars="shown", show_scalar_bar=False)
        plotter.add_mesh(
            self._pads, scalars="strength", cmap=self.pads_bar.colours, clim=(self.pads_bar.low, self.pads_bar.high),
            line_width=2, show_scalar_bar=False, lighting=False,
        )  # fmt: skip
        x, y, z = design.slab_mm
        corners = np.array([*product((-x / 2, x / 2), (-y / 2, y / 2), (0.0, z))])
        names = unit_names(design.array.rows, design.array.cols, design.array.pitch_mm)
        beside = draw_scenery(np.vstack([corners, names.points]), "iso")
        self._letters = plotter.add_mesh(pv.merge([names, beside]), color=LETTERS[False], lighting=False)
        self.reach_mm = np.vstack([corners, names.points, beside.points])
        plotter.add_mesh(self.mark, color=CHOSEN, line_width=4)


class Camera:
    """A camera of VTK that the mouse turns about its focus, moves and brings nearer; z stays upright."""

    def __init__(self, camera: pv.Camera) -> None:
        self._camera = camera

    def set_home(self) -> None:
        """Take the present place for the one from which all is seen: it bounds how far the camera goes."""
        self._middle, self._distance = np.array(self._camera.focal_point), self._camera.distance
        self._camera.up = (0.0, 0.0, 1.0)
        self.is_home = True  #: the camera has not been moved since

    def turn(self, right_deg: float, up_deg: float) -> None:
        """Turn the array to the right and up."""
        elevation = math.degrees(math.asin(-self._camera.direction[2]))
        self._camera.Azimuth(-right_deg)
        self._camera.Elevation(min(max(elevation - up_deg, -STEEPEST_DEG), STEEPEST_DEG) - elevation)
        self.is_home = False

    def approach(self, factor: float) -> None:
        """Come nearer by a factor above 1, or go away by one below."""
        least, most = (self._camera.distance / (limit * self._distance) for limit in (FARTHEST, NEAREST))
        self._camera.Dolly(min(max(factor, least), most))
        self.is_home = False

    def move(self, right: float, up: float) -> None:
        """Move the array, by fractions of the picture's height."""
        camera, before = self._camera, np.array(self._camera.focal_point)
        height = 2.0 * camera.distance * math.tan(math.radians(camera.view_angle / 2))
        across = np.cross(camera.direction, camera.up)
        across /= np.linalg.norm(across)
        focus = before - height * (right * across + up * np.cross(across, camera.direction))
        shift = self._middle + np.clip(focus - self._middle, -self._distance, self._distance) - before
        camera.position, camera.focal_point = np.array(camera.position) + shift, before + shift
        self.is_home = False


# the cell's surfaces: points (k, 3) [mm]; cells are quadrilaterals (m, 4) or lines (m, 2) between them


def cell_sides(design: SensorDesign) -> tuple[FloatArray, Drawn, Drawn]:
    """Points of the cell, and its faces and edges that are seen of the array: tops, and sides at the array's ends."""
    x, y = (lines_along(design, axis) for axis in (0, 1))
    z = np.linspace(0.0, design.unit.height_mm, LEVELS + 1)
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    number = np.arange(points[..., 0].size).reshape(points.shape[:3])
    units = np.arange(design.n_units).reshape(design.array.rows, design.array.cols)
    faces = [(_quads(number[:, :, -1]), units.ravel())]
    edges = []
    for end in (0, -1):
        for side, there in ((number[end], units[:, end]), (number[:, end], units[end])):
            faces.append((_quads(side), there))
            edges += [(_lines(rim), there) for rim in (side[:, 0], side[:, -1])]
        edges += [(_lines(number[end, other]), units[[other], [end]]) for other in (0, -1)]
    return points.reshape(-1, 3), faces, edges


def lines_along(design: SensorDesign, axis: int) -> FloatArray:
    """Places along x or y where the cell's surfaces are cut, (DIVISIONS + 1,) [mm]: stiff pads stay plane."""
    half = design.array.pitch_mm / 2
    if design.pad.kind == "soft":
        return np.linspace(-half, half, DIVISIONS + 1)
    middle = (design.pad.offset_x_mm, design.pad.offset_y_mm)[axis]
    edge = design.pad.size_mm / 2
    return np.array([-half, *np.linspace(middle - edge, middle + edge, DIVISIONS - 1), half])


def pad_outline(design: SensorDesign) -> FloatArray:
    """Points around the cell's pad."""
    share = np.linspace(-0.5, 0.5, DIVISIONS, endpoint=False)
    half = np.full(DIVISIONS, 0.5)
    x, y = np.concatenate([share, half, -share, -half]), np.concatenate([-half, share, half, -share])
    flat = design.pad.size_mm * np.column_stack([x, y]) + (design.pad.offset_x_mm, design.pad.offset_y_mm)
    return np.column_stack([flat, np.full(len(flat), design.unit.height_mm)])


def _quads(number: IntArray) -> IntArray:
    """Quadrilaterals between neighbours of a grid of points."""
    return np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)


def _lines(number: IntArray) -> IntArray:
    """Lines from each point to the next."""
    return np.column_stack([number[:-1], number[1:]])
