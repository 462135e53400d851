"""The array in 3-D: pillars inside a translucent slab under its pads, moved in place as loads change."""

import os
import sys
from dataclasses import dataclass

import numpy as np
import pyvista as pv

from fem.array_field import ArrayField, FieldState, Observer
from geometry.layout import FloatArray, unit_centres
from studies.viewer.page.cell_points import (
    IntArray,
    Patch,
    corner_patch,
    pad_patch,
    pillar_patch,
    rim_patch,
    side_patch,
    top_patch,
)
from studies.viewer.page.quantities import QUANTITIES, Quantity, pressure, von_mises

MOST_PRESSED_MPA = 5.0  #: traction at which a pad's outline is darkest
BACKGROUND = {False: "#ffffff", True: "#14181d"}  #: by whether it is dark
SLAB, EDGE, PADS, CHOSEN = "#8fb0cc", "#6b8299", "Reds", "#ff8c00"
FROM = (0.75, -1.65, 1.15)  #: the direction one looks from at first


@dataclass(frozen=True, kw_only=True)
class Shown:
    """How the array is drawn."""

    colour: str = "displacement"  #: one of QUANTITIES
    scale: float = 1.0  #: of displacements
    chosen: int = 0  #: unit whose pad is marked
    dark: bool = False


@dataclass(frozen=True, kw_only=True)
class Legend:
    """The colour bar: what it shows, and where it ends."""

    quantity: Quantity
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Moving:
    """Points of some units that move with the field."""

    observer: Observer
    units: IntArray  #: (m,): whose points these are
    rest_mm: FloatArray  #: (m, k, 3): undeformed
    mesh: pv.PolyData

    def move(self, state: FieldState, scale: float) -> FloatArray:
        """Take the points to where the field moves them, `scale` times as far; the displacement (m, k, 3) [mm]."""
        moved_mm = self.observer.displacement_mm(of_units(state, self.units))
        self.mesh.points = (self.rest_mm + scale * moved_mm).reshape(-1, 3).astype(np.float32)
        return moved_mm


def of_units(state: FieldState, units: IntArray) -> FieldState:
    """The same state, of some of the units alone."""
    return FieldState(
        traction_mpa=state.traction_mpa[units], force_n=state.force_n[units], port_mm=state.port_mm[units]
    )


class ArrayScene:
    """A plotter with the array in it; draws nothing by itself."""

    def __init__(self, field: ArrayField) -> None:
        if sys.platform == "linux" and not os.environ.get("DISPLAY"):
            os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")  # no X server: do not ask for one
        self._field = field
        design = field.design
        rows, cols = design.array.rows, design.array.cols
        everyone = np.arange(design.n_units)
        row, col = np.divmod(everyone, cols)
        at_end = {(0, -1): col == 0, (0, 1): col == cols - 1, (1, -1): row == 0, (1, 1): row == rows - 1}
        patch, self._owner = pillar_patch(design)
        self._pillars = self._moving(patch, everyone)
        self._stress = field.observe(patch.points_mm, region=1)
        self._faces = [self._moving(top_patch(design), everyone)]
        self._faces += [self._moving(side_patch(design, *side), everyone[there]) for side, there in at_end.items()]
        self._edges = [self._moving(rim_patch(design, *side), everyone[there]) for side, there in at_end.items()]
        self._edges += [
            self._moving(corner_patch(design, x_end, y_end), everyone[at_end[0, x_end] & at_end[1, y_end]])
            for x_end in (-1, 1)
            for y_end in (-1, 1)
        ]
        self._pads = self._moving(pad_patch(design), everyone)
        self._mark = pv.lines_from_points(self._outline(0), close=True)
        self.plotter = pv.Plotter(off_screen=True, window_size=(800, 600))
        self._fill()

    def show(self, traction_mpa: FloatArray, change: FloatArray, shown: Shown) -> Legend:
        """Bring the scene to a load.

        Parameters
        ----------
        traction_mpa : array, shape (n_units, 3)
        change : array, shape (n_units, 3)
            Of the resistances of the z, x and y pillars from rest, relative.
        shown : Shown
        """
        state = self._field.state(traction_mpa)
        moved_mm = self._pillars.move(state, shown.scale)
        for part in (*self._faces, *self._edges, self._pads):
            part.move(state, shown.scale)
        self._pads.mesh["strength"] = np.repeat(
            np.linalg.norm(traction_mpa, axis=1), self._pads.rest_mm.shape[1]
        ).astype(np.float32)
        self._mark.points = self._outline(shown.chosen)
        quantity = QUANTITIES[shown.colour]
        values = self._values(shown.colour, state, moved_mm, change)
        low, high = quantity.range_of(values)
        self._pillars.mesh["shown"] = values.reshape(-1).astype(np.float32)
        self._actor.mapper.lookup_table.apply_cmap(quantity.colours, 256)
        self._actor.mapper.scalar_range = (low, high)
        self.plotter.set_background(BACKGROUND[shown.dark])
        return Legend(quantity=quantity, low=low, high=high)

    def look_from_the_start(self) -> None:
        """Put the camera where it was at first."""
        self.plotter.view_vector(FROM, viewup=(0.0, 0.0, 1.0))
        self.plotter.reset_camera(bounds=self._bounds)
        self.plotter.camera.zoom(1.25)

    def _values(self, colour: str, state: FieldState, moved_mm: FloatArray, change: FloatArray) -> FloatArray:
        """The quantity at the pillars' points, (n_units, k)."""
        if colour == "displacement":
            return np.linalg.norm(moved_mm, axis=2)
        if colour == "vertical":
            return moved_mm[..., 2]
        if colour == "resistance":
            return 100.0 * change[:, self._owner]
        return {"von-mises": von_mises, "pressure": pressure}[colour](self._stress.stress_mpa(state))

    def _outline(self, unit: int) -> FloatArray:
        """Where the outline of a unit's pad is now, (k, 3) [mm]."""
        k = self._pads.rest_mm.shape[1]
        return np.asarray(self._pads.mesh.points)[unit * k : (unit + 1) * k].copy()

    def _moving(self, patch: Patch, units: IntArray) -> Moving:
        centres = unit_centres(self._field.design)[units]
        rest = patch.points_mm + np.column_stack([centres, np.zeros(len(centres))])[:, None, :]
        k, size = len(patch.points_mm), patch.cells.shape[1]
        cells = (patch.cells + k * np.arange(len(units))[:, None, None]).reshape(-1, size)
        counted = np.column_stack([np.full(len(cells), size), cells]).ravel()
        points = rest.reshape(-1, 3).astype(np.float32)
        mesh = pv.PolyData(points, lines=counted) if size == 2 else pv.PolyData(points, faces=counted)
        return Moving(self._field.observe(patch.points_mm), units, rest, mesh)

    def _fill(self) -> None:
        plotter = self.plotter
        plotter.render_window.SetMultiSamples(0)  # costs software three to five times the time
        self._pillars.mesh["shown"] = np.zeros(self._pillars.mesh.n_points, np.float32)
        self._pads.mesh["strength"] = np.zeros(self._pads.mesh.n_points, np.float32)
        for face in self._faces:
            plotter.add_mesh(face.mesh, color=SLAB, opacity=0.18)
        for edge in self._edges:
            plotter.add_mesh(edge.mesh, color=EDGE, line_width=2)
        self._actor = plotter.add_mesh(self._pillars.mesh, scalars="shown", show_scalar_bar=False)
        plotter.add_mesh(
            self._pads.mesh, scalars="strength", cmap=PADS, clim=(-0.3 * MOST_PRESSED_MPA, MOST_PRESSED_MPA),
            line_width=2, show_scalar_bar=False,
        )  # fmt: skip
        plotter.add_mesh(self._mark, color=CHOSEN, line_width=4)
        self._bounds = plotter.bounds
        self.look_from_the_start()
