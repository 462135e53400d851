"""The array in 3-D: pillars inside a translucent slab under its pads, moved in place as loads change."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pyvista as pv

from fem.fields.array_field import FieldState, Observer
from fem.fields.deformed import APART_MM, Part, Surface, pillar_surface
from fem.pictures.colours import QUANTITIES, SHADES, Bar, Colour, bar_of, mixed, shades
from fem.pictures.deformation import draw_off_screen, place
from fem.pictures.scenery import scenery, unit_names
from fem.scene.solution import QUADRILATERAL
from geometry.layout import PILLARS, FloatArray, unit_centres
from tripillar.viewer.page.camera import Gestures
from tripillar.viewer.page.cell_points import IntArray, pad_outline, rims, side_face, top_face, upright_edge
from tripillar.viewer.page.superposition import Superposition

RESISTANCE: Literal["resistance"] = "resistance"  #: the one colour of the page's own: of each pillar as a whole
TITLES = {name: quantity.title for name, quantity in QUANTITIES.items()} | {RESISTANCE: "change of resistance [%]"}
MIN_CHANGE = 1.0  #: [%], end of the colour bar of resistances at least
SLICES = 8  #: of a pillar along its axis
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


@dataclass(frozen=True, kw_only=True)
class Shown:
    """How the array is drawn."""

    colour: Colour | Literal["resistance"] = "displacement"
    scale: float = 1.0  #: of displacements
    chosen: int = 0  #: unit whose pad is marked
    dark: bool = False


@dataclass(frozen=True, eq=False)
class Place:
    """Points of some units that move with the field."""

    observer: Observer
    units: IntArray  #: (m,): whose points these are
    rest_mm: FloatArray  #: (m, k, 3): undeformed

    def moved_mm(self, state: FieldState) -> FloatArray:
        """Displacement of the points, (m, k, 3) [mm]."""
        return self.observer.displacement_mm(of_units(state, self.units))


@dataclass(frozen=True, eq=False)
class Moving:
    """A mesh that moves with the field; one of many places draws faster than many."""

    places: list[Place]
    mesh: pv.PolyData

    def move(self, state: FieldState, scale: float) -> FloatArray:
        """Take the points to where the field moves them, `scale` times as far; their displacement (n, 3) [mm]."""
        moved_mm = np.concatenate([place.moved_mm(state).reshape(-1, 3) for place in self.places])
        rest_mm = np.concatenate([place.rest_mm.reshape(-1, 3) for place in self.places])
        self.mesh.points = (rest_mm + scale * moved_mm).astype(np.float32)
        return moved_mm


def of_units(state: FieldState, units: IntArray) -> FieldState:
    """The same state, of some of the units alone."""
    return FieldState(force_n=state.force_n[units], port_mm=state.port_mm[units])


class ArrayScene:
    """A plotter with the array in it; draws nothing by itself."""

    def __init__(self, loads: Superposition) -> None:
        draw_off_screen()
        field = loads.field
        self._field, self._loads = field, loads
        design = field.design
        rows, cols = design.array.rows, design.array.cols
        everyone = np.arange(design.n_units)
        row, col = np.divmod(everyone, cols)
        at_end = {(0, -1): col == 0, (0, 1): col == cols - 1, (1, -1): row == 0, (1, 1): row == rows - 1}
        pillars = pillar_surface(design.unit, SLICES, around=1, apart_mm=APART_MM)
        self._owner = np.repeat(np.arange(len(PILLARS)), len(pillars[0]) // len(PILLARS))
        faces = [(top_face(design), everyone)]
        faces += [(side_face(design, *side), everyone[there]) for side, there in at_end.items()]
        edges = [(rims(design, *side), everyone[there]) for side, there in at_end.items()]
        edges += [
            (upright_edge(design, x_end, y_end), everyone[at_end[0, x_end] & at_end[1, y_end]])
            for x_end in (-1, 1)
            for y_end in (-1, 1)
        ]
        self._pillars = self._moving([(pillars, everyone)])
        self._stress = field.observe(pillars[0], region=1)
        self._faces, self._edges = self._moving(faces), self._moving(edges)
        self._pads = self._moving([(pad_outline(design), everyone)])
        self._mark = pv.lines_from_points(self._outline(0), close=True)
        self.plotter = pv.Plotter(off_screen=True, window_size=(800, 600), lighting="none")
        self._fill()

    def show(self, traction_mpa: FloatArray, change: FloatArray, shown: Shown) -> Bar:
        """Bring the scene to a load.

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
            colours = shades(None, -most, most)
            return self._coloured(Bar(title=TITLES[RESISTANCE], low=-most, high=most, colours=colours), values)
        quantity = QUANTITIES[shown.colour]
        stress = self._stress.stress_mpa(state).reshape(-1, 6) if quantity.of_stress else None
        part = Part(
            points_mm=moved_mm, cells=np.empty((0, 4), dtype=np.int64), cell_type=QUADRILATERAL,
            displacement_mm=moved_mm, stress_mpa=stress,
        )  # fmt: skip
        return self._coloured(bar_of(quantity, [{"pillars": part}]), quantity.of(part))

    def _coloured(self, bar: Bar, values: FloatArray) -> Bar:
        """Colour the pillars by values (n_points,)."""
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
        self._start = self.plotter.camera.position
        self.gestures = Gestures(self.plotter.camera)

    def fit(self) -> None:
        """Fill a window of another size, unless the camera has been moved."""
        if self.plotter.camera.position == self._start:
            self.look_from_the_start()

    @property
    def _outline_size(self) -> int:
        """Points of a pad's outline."""
        return self._pads.places[0].rest_mm.shape[1]

    def _outline(self, unit: int) -> FloatArray:
        """Where the outline of a unit's pad is now, (k, 3) [mm]."""
        return np.asarray(self._pads.mesh.points).reshape(-1, self._outline_size, 3)[unit].copy()

    def _moving(self, surfaces: list[tuple[Surface, IntArray]]) -> Moving:
        """One mesh of surfaces of the cell, each in some of the units."""
        places, cells, n_points = [], [], 0
        for (points, own), units in surfaces:
            centres = np.pad(unit_centres(self._field.design)[units], ((0, 0), (0, 1)))
            places.append(Place(self._field.observe(points), units, centres[:, None] + points))
            size, copies = own.shape[1], np.arange(len(units))[:, None, None]
            numbers = n_points + (own + len(points) * copies).reshape(-1, size)
            cells.append(np.column_stack([np.full(len(numbers), size), numbers]).ravel())
            n_points += len(points) * len(units)
        rest_mm = np.concatenate([place.rest_mm.reshape(-1, 3) for place in places]).astype(np.float32)
        counted = np.concatenate(cells)
        return Moving(places, pv.PolyData(rest_mm, lines=counted) if size == 2 else pv.PolyData(rest_mm, faces=counted))

    def _fill(self) -> None:
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
        beside = scenery(np.vstack([corners, names.points]), "iso")
        self._letters = plotter.add_mesh(pv.merge([names, beside]), color=LETTERS[False], lighting=False)
        self.reach_mm = np.vstack([corners, names.points, beside.points])
        plotter.add_mesh(self._mark, color=CHOSEN, line_width=4)
        self.look_from_the_start()
