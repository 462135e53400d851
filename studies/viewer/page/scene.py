"""The array in 3-D: pillars inside a translucent slab under its pads, moved in place as loads change."""

import os
import sys
from dataclasses import dataclass

import numpy as np
import pyvista as pv

from fem.array_field import ArrayField, FieldState, Observer
from fem.stress import pressure, von_mises
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
from studies.viewer.page.quantities import QUANTITIES, Quantity

MOST_PRESSED_MPA = 5.0  #: traction at which a pad's outline is darkest
BACKGROUND = {False: "#ffffff", True: "#14181d"}  #: by whether it is dark
SLAB, EDGE, PADS, CHOSEN = "#8fb0cc", "#6b8299", "Reds", "#ff8c00"
FILLED = 0.92  #: of the window, by the undeformed array
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
    """The colour bar: what it shows, where it ends, and some of its colours from low to high."""

    quantity: Quantity
    low: float
    high: float
    colours: list[str]


@dataclass(frozen=True, eq=False)
class Part:
    """Points of some units that move with the field."""

    observer: Observer
    units: IntArray  #: (m,): whose points these are
    rest_mm: FloatArray  #: (m, k, 3): undeformed

    def moved_mm(self, state: FieldState) -> FloatArray:
        """Displacement of the points, (m, k, 3) [mm]."""
        return self.observer.displacement_mm(of_units(state, self.units))


@dataclass(frozen=True, eq=False)
class Moving:
    """A mesh that moves with the field; one of many parts draws faster than many."""

    parts: list[Part]
    mesh: pv.PolyData

    def move(self, state: FieldState, scale: float) -> FloatArray:
        """Take the points to where the field moves them, `scale` times as far; their displacement (n, 3) [mm]."""
        moved_mm = np.concatenate([part.moved_mm(state).reshape(-1, 3) for part in self.parts])
        rest_mm = np.concatenate([part.rest_mm.reshape(-1, 3) for part in self.parts])
        self.mesh.points = (rest_mm + scale * moved_mm).astype(np.float32)
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
        faces = [(top_patch(design), everyone)]
        faces += [(side_patch(design, *side), everyone[there]) for side, there in at_end.items()]
        edges = [(rim_patch(design, *side), everyone[there]) for side, there in at_end.items()]
        edges += [
            (corner_patch(design, x_end, y_end), everyone[at_end[0, x_end] & at_end[1, y_end]])
            for x_end in (-1, 1)
            for y_end in (-1, 1)
        ]
        self._pillars = self._moving([(patch, everyone)])
        self._stress = field.observe(patch.points_mm, region=1)
        self._faces, self._edges = self._moving(faces), self._moving(edges)
        self._pads = self._moving([(pad_patch(design), everyone)])
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
        moved_mm = self._pillars.move(state, shown.scale).reshape(len(traction_mpa), -1, 3)
        for moving in (self._faces, self._edges, self._pads):
            moving.move(state, shown.scale)
        strength = np.linalg.norm(traction_mpa, axis=1)
        self._pads.mesh["strength"] = np.repeat(strength, self._outline_size).astype(np.float32)
        self._mark.points = self._outline(shown.chosen)
        quantity = QUANTITIES[shown.colour]
        values = self._values(shown.colour, state, moved_mm, change)
        low, high = quantity.range_of(values)
        self._pillars.mesh["shown"] = values.reshape(-1).astype(np.float32)
        table = self._actor.mapper.lookup_table
        table.apply_cmap(quantity.colours, 256)
        self._actor.mapper.scalar_range = (low, high)
        self.plotter.set_background(BACKGROUND[shown.dark])
        some = [f"rgb({red},{green},{blue})" for red, green, blue, _ in table.values[::17].tolist()]
        return Legend(quantity=quantity, low=low, high=high, colours=some)

    def look_from_the_start(self) -> None:
        """Put the camera where it was at first: the undeformed array fills the window."""
        camera, renderer = self.plotter.camera, self.plotter.renderer
        wide, high = self.plotter.render_window.GetSize()
        x, y, z = self._field.design.slab_mm
        corners = np.array([[x * i / 2, y * j / 2, z * k] for i in (-1, 1) for j in (-1, 1) for k in (0, 1)])
        self.plotter.view_vector(FROM, viewup=(0.0, 0.0, 1.0))
        for _ in range(4):  # distance and perspective depend on each other
            matrix = camera.GetCompositeProjectionTransformMatrix(wide / high, -1.0, 1.0)
            project = pv.array_from_vtkmatrix(matrix)
            seen = np.column_stack([corners, np.ones(len(corners))]) @ project.T
            seen = seen[:, :2] / seen[:, 3:]
            middle, half = (seen.max(axis=0) + seen.min(axis=0)) / 2, (seen.max(axis=0) - seen.min(axis=0)) / 2
            at = np.array(camera.focal_point)
            depth = np.linalg.norm(at - camera.position)
            up_mm = depth * np.tan(np.radians(camera.view_angle / 2))
            forward = (at - camera.position) / depth
            right = np.cross(forward, (0.0, 0.0, 1.0))
            right /= np.linalg.norm(right)
            at = at + up_mm * (middle[0] * wide / high * right + middle[1] * np.cross(right, forward))
            camera.focal_point = at
            camera.position = at - forward * depth * half.max() / FILLED
        renderer.ResetCameraClippingRange()

    def _values(self, colour: str, state: FieldState, moved_mm: FloatArray, change: FloatArray) -> FloatArray:
        """The quantity at the pillars' points, (n_units, k)."""
        if colour == "displacement":
            return np.linalg.norm(moved_mm, axis=2)
        if colour == "vertical":
            return moved_mm[..., 2]
        if colour == "resistance":
            return 100.0 * change[:, self._owner]
        return {"von-mises": von_mises, "pressure": pressure}[colour](self._stress.stress_mpa(state))

    @property
    def _outline_size(self) -> int:
        """Points of a pad's outline."""
        return self._pads.parts[0].rest_mm.shape[1]

    def _outline(self, unit: int) -> FloatArray:
        """Where the outline of a unit's pad is now, (k, 3) [mm]."""
        return np.asarray(self._pads.mesh.points).reshape(-1, self._outline_size, 3)[unit].copy()

    def _moving(self, patches: list[tuple[Patch, IntArray]]) -> Moving:
        """One mesh of patches of the cell, each in some of the units."""
        parts, cells, n_points = [], [], 0
        for patch, units in patches:
            centres = unit_centres(self._field.design)[units]
            rest_mm = patch.points_mm + np.column_stack([centres, np.zeros(len(centres))])[:, None, :]
            parts.append(Part(self._field.observe(patch.points_mm), units, rest_mm))
            size, k = patch.cells.shape[1], len(patch.points_mm)
            numbers = n_points + (patch.cells + k * np.arange(len(units))[:, None, None]).reshape(-1, size)
            cells.append(np.column_stack([np.full(len(numbers), size), numbers]).ravel())
            n_points += k * len(units)
        points = np.concatenate([part.rest_mm.reshape(-1, 3) for part in parts]).astype(np.float32)
        counted = np.concatenate(cells)
        return Moving(parts, pv.PolyData(points, lines=counted) if size == 2 else pv.PolyData(points, faces=counted))

    def _fill(self) -> None:
        plotter = self.plotter
        plotter.render_window.SetMultiSamples(0)  # costs software three to five times the time
        self._pillars.mesh["shown"] = np.zeros(self._pillars.mesh.n_points, np.float32)
        self._pads.mesh["strength"] = np.zeros(self._pads.mesh.n_points, np.float32)
        plotter.add_mesh(self._faces.mesh, color=SLAB, opacity=0.18)
        plotter.add_mesh(self._edges.mesh, color=EDGE, line_width=2)
        self._actor = plotter.add_mesh(self._pillars.mesh, scalars="shown", show_scalar_bar=False)
        plotter.add_mesh(
            self._pads.mesh, scalars="strength", cmap=PADS, clim=(-0.3 * MOST_PRESSED_MPA, MOST_PRESSED_MPA),
            line_width=2, show_scalar_bar=False,
        )  # fmt: skip
        plotter.add_mesh(self._mark, color=CHOSEN, line_width=4)
        plotter.reset_camera()
        self.look_from_the_start()
