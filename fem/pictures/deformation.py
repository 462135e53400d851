"""Pictures of deformed bodies in three dimensions, by pyvista."""

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil
from typing import Any, Literal

import numpy as np
import pyvista as pv

from fem.pictures.parts import Parts
from fem.pictures.scenery import (
    COLOURED_NOT,
    INK,
    QUANTITIES,
    Bar,
    Camera,
    Colour,
    Quantity,
    bar_of,
    draw_legend,
    draw_scenery,
    pads_bar,
    words_at,
)
from geometry.layout import FloatArray

Triple = tuple[float, float, float]
Medium = Literal["file", "film", "window", "page", "live"]

WIDE_PX = {1: (992, 1376), 2: (640, 880)}  #: least and most of one picture, and of each of several
HIGH_PX = 880  #: of a picture, where its width leaves a choice
NAME_PX, LEGEND_PX = 64, 112  #: heights of the strips above and below pictures
MARGIN = 0.03  #: of a picture's width or height, around what it shows
VIEW_ANGLE = 30.0  #: degrees, of the camera; pages know no other
MIN_STRENGTH = 0.02  #: of the strongest traction: pads with less are not outlined
SHARP = 60.0  #: degrees, between faces that meet in an edge that is drawn
LIFT_MM, PAD_LIFT_MM = 0.15, 0.2  #: by which electrodes are drawn before the pillars' ends, and pads' outlines above
SOLID = {"ambient": 0.3, "diffuse": 0.75, "specular": 0.2, "specular_power": 18}
GLASSY = {"ambient": 0.2, "specular": 0.7, "specular_power": 12}
VIEWS: dict[Camera, tuple[Triple, Triple]] = {
    "iso": ((1.0, -1.65, 1.1), (0.0, 0.0, 1.0)),
    "top": ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
    "front": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    "side": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
}


class DeformedPicture:
    """Loaded bodies side by side, coloured by one scale: pillars in a translucent matrix, and how they were at rest.

    Each has a scale bar and axes beside it; below all are the colour bar, a key to the reds of loaded pads and the
    factor of displacement.

    `panels` are one picture each, its name above it: parts named matrix are translucent, pads are outlined, the rest is
    solid. Displacement is drawn `scale` times as large; all cameras but "iso" are parallel projections. Frames of films
    are smoothed less, which is quicker; pages have no text and no colour bars: they add their own, by `names`, `bars`,
    `note` and `aspect`; live pictures are plain and quick. `over` is what the colour bars are to hold where the picture
    is to show more than its panels, by `load`; `columns` are panels beside each other, all by default; `warning` is
    said below the pictures. `before` are the same bodies under smaller loads, in equal steps up to the panels', for
    `press` where they are not linear.
    """

    def __init__(
        self,
        panels: Mapping[str, Parts],
        colour: Colour = "displacement",
        scale: float = 1.0,
        camera: Camera = "iso",
        medium: Medium = "file",
        over: Sequence[Parts] | None = None,
        columns: int | None = None,
        warning: str = "",
        before: Sequence[Mapping[str, Parts]] = (),
    ) -> None:
        draw_off_screen()
        self._quantity, self._scale, self._medium = QUANTITIES[colour], scale, medium
        self.names = tuple(panels)
        self._shows_all_pads, shown = over is not None, [*panels.values()] if over is None else over
        pads = pads_bar(shown)
        self.bars = (bar_of(self._quantity, shown), *([] if pads is None else [pads]))
        self.note = "displacement: true scale" if scale == 1 else f"displacement × {scale:g}"
        self.warning = warning
        self.moving: list[Moving] = []
        self._is_bare = medium in ("page", "live")
        self.actors: dict[str, pv.Actor] = {}  #: by name of the part, of the last panel
        points = {name: filled_points(parts, scale) for name, parts in panels.items()}
        stage = {name: draw_scenery(at, camera) for name, at in points.items()}
        seen = {name: np.vstack([points[name], mesh.points]) for name, mesh in stage.items()}
        #: width over height of one picture
        self.aspect = min(look(pv.Camera(), at, camera, 1.0) for at in seen.values())
        self._line = 2.0 if medium in ("file", "window") else 1.0  # supersampling thins lines
        columns = columns or len(panels)
        rows = ceil(len(panels) / columns)
        self.plotter = self._plotter(rows, columns, medium)
        self._titles: list[tuple[str, pv.Text]] = []
        for number, (name, parts) in enumerate(panels.items()):
            row, column = divmod(number, columns)
            self.plotter.subplot(row if self._is_bare else 2 * row + 1, column)
            self._draw(name, parts)
            if medium != "live":
                self.plotter.add_mesh(stage[name], color=INK, lighting=False)
            look(self.plotter.camera, seen[name], camera, self.aspect)
            self.plotter.reset_camera_clipping_range()
            if not self._is_bare:
                self.plotter.subplot(2 * row, column)
                self._titles.append((name, words_at(self.plotter, name, 0.5, 0.5, "center", size=24)))
        if not self._is_bare:
            self.plotter.subplot(2 * rows, 0)
            wide, _ = self.plotter.window_size
            draw_legend(self.plotter, self.bars, [note for note in (self.note, warning) if note], wide, LEGEND_PX)
        for moving in self.moving:
            moving.steps[1:1] = [self._values(smaller[moving.panel], moving) for smaller in before]
        self.press(1.0)

    def press(self, share: float) -> None:
        """Show everything under a share of its load, linear between the steps that are known."""
        for moving in self.moving:
            mesh, steps = moving.mesh, moving.steps
            step = min(int(share * (len(steps) - 1)), len(steps) - 2)
            further = share * (len(steps) - 1) - step
            seen = {name: low + further * (steps[step + 1][name] - low) for name, low in steps[step].items()}
            mesh.points = moving.rest_mm + self._scale * seen.pop("moved")
            for name, values in seen.items():
                mesh[name] = values
            if "Normals" in mesh.array_names:
                turned = mesh.compute_normals(cell_normals=False, split_vertices=False, consistent_normals=False)
                mesh["Normals"] = turned["Normals"]
        for name, text in self._titles:
            text.input = name if share == 1 else f"{share:.0%} of {name}"

    def recolour(self, panels: Mapping[str, Parts], quantity: Quantity, scale: float) -> Bar:
        """Show the same bodies under other loads, coloured by a quantity from end to end; its bar."""
        self._quantity, self._scale, bar = quantity, scale, bar_of(quantity, panels.values())
        mapper = self.actors["pillars"].mapper
        mapper.lookup_table.apply_cmap(bar.colours, len(bar.colours))
        mapper.scalar_range = bar.low, bar.high
        self.load(panels)
        return bar

    def load(self, panels: Mapping[str, Parts]) -> None:
        """Show the same bodies under other loads, in the colours of the first ones."""
        for moving in self.moving:
            moving.steps[-1] = self._values(panels[moving.panel], moving)
        self.press(1.0)

    def _values(self, parts: Parts, moving: "Moving") -> dict[str, FloatArray]:
        """What is seen at the points of a mesh."""
        part = parts[moving.name]
        values = {"moved": part.displacement_mm}
        if moving.name not in COLOURED_NOT:
            values["shown"] = self._quantity.of(part)
        if part.traction_mpa is not None:
            values["strength"] = np.zeros(len(part.points_mm))
            values["strength"][part.cells] = part.strength_mpa[:, None]  # pads share no points between them
        return {name: found[moving.mesh["point"]] for name, found in values.items()}

    def _plotter(self, rows: int, columns: int, medium: Medium) -> pv.Plotter:
        """An empty plotter for rows of pictures, each with its name above, and one legend below all of them."""
        off_screen = medium != "window"
        least, most = WIDE_PX[min(columns, 2)]
        wide = 16 * round(min(max(HIGH_PX * self.aspect, least), most) / 16)
        high = 16 * round(wide / self.aspect / 16)  # films want multiples of 16
        weights = [NAME_PX, high] * rows + [LEGEND_PX]
        if self._is_bare:
            window = (columns * wide, rows * high)
            lights = "none" if medium == "live" else "light kit"
            plotter = pv.Plotter(
                off_screen=off_screen, shape=(rows, columns), window_size=window, border=False, lighting=lights
            )
            if medium == "live":  # smooth edges, and each further light, cost software half as much again and more
                plotter.render_window.SetMultiSamples(0)
                plotter.add_light(pv.Light(light_type="headlight"))
        else:
            plotter = pv.Plotter(
                off_screen=off_screen, shape=(2 * rows + 1, columns), groups=[(2 * rows, slice(None))],
                row_weights=weights, window_size=(columns * wide, sum(weights)), border=False,
            )  # fmt: skip
            plotter.enable_anti_aliasing("msaa" if medium == "film" else "ssaa", all_renderers=True)
        plotter.set_background("white", all_renderers=True)
        return plotter

    def _draw(self, panel: str, parts: Parts) -> None:
        is_live = self._medium == "live"
        solid, glassy = ({}, {}) if is_live else (SOLID, GLASSY)
        for name, part in parts.items():
            if is_live and name == "electrodes":
                continue
            whole = part.grid
            whole["point"] = np.arange(len(part.points_mm))

            def moved(mesh: pv.PolyData, name: str = name) -> pv.PolyData:
                moving = Moving(panel, name, mesh, mesh.points.copy())
                full = self._values(parts, moving)
                moving.steps += [{key: 0 * values for key, values in full.items()}, full]
                for key, values in full.items():
                    mesh[key] = values
                self.moving.append(moving)
                return mesh

            if part.traction_mpa is not None:
                if not self._shows_all_pads:
                    whole = whole.extract_cells(part.strength_mpa >= MIN_STRENGTH * part.strength_mpa.max())
                outlines = whole.extract_surface(algorithm="dataset_surface").extract_feature_edges(
                    boundary_edges=True, feature_edges=False, manifold_edges=False
                )
                outlines.points[:, 2] += PAD_LIFT_MM
                width = {"line_width": 2.5 * self._line, "lighting": False}
                look = _coloured("strength", self.bars[-1]) | width
                self.actors[name] = self.plotter.add_mesh(moved(outlines), **look)
                continue
            skin = whole.extract_surface(algorithm="dataset_surface")
            if name == "matrix":
                if not is_live:
                    skin = skin.compute_normals(cell_normals=False, split_vertices=True, feature_angle=SHARP)
                self.actors[name] = self.plotter.add_mesh(moved(skin), color="#a9c4d8", opacity=0.2, **glassy)
                # PyVista's own smooth shading would draw a copy, which stays at rest
                self.actors[name].prop.interpolation = "flat" if is_live else "phong"
            elif name == "electrodes":
                skin.points[:, 2] += LIFT_MM * np.sign(skin.points[:, 2] - part.points_mm[:, 2].mean())
                self.actors[name] = self.plotter.add_mesh(moved(skin), color="#c98a4b", **solid)
            else:
                self.actors[name] = self.plotter.add_mesh(moved(skin), **_coloured("shown", self.bars[0]), **solid)
            if name in ("matrix", "body"):
                edges = skin.extract_feature_edges(SHARP, boundary_edges=name == "matrix")
                self.plotter.add_mesh(edges.copy(), color="#9aa5ad", line_width=1 * self._line)  # as it was at rest
                self.plotter.add_mesh(moved(edges), color="#3d5468", line_width=1.5 * self._line)


def _coloured(name: str, bar: Bar) -> dict[str, Any]:
    """How a mesh shows its values of a name in the colours of a bar."""
    colours = {"cmap": bar.colours, "n_colors": len(bar.colours), "clim": (bar.low, bar.high)}
    return {"scalars": name, "show_scalar_bar": False, **colours}


@dataclass
class Moving:
    """A mesh that loads move, and what is seen on it at equal steps of the load, from rest."""

    panel: str
    name: str  #: of the part
    mesh: pv.PolyData
    rest_mm: FloatArray  #: (n, 3), its points
    steps: list[dict[str, FloatArray]] = field(default_factory=list)


def filled_points(parts: Parts, scale: float) -> FloatArray:
    """All points that parts fill, at rest and with their displacement `scale` times as large, (n, 3) [mm]."""
    rest = np.vstack([part.points_mm for part in parts.values()])
    return np.vstack([rest, rest + scale * np.vstack([part.displacement_mm for part in parts.values()])])


def draw_off_screen() -> None:
    """Let VTK draw where there is no display; before the first plotter."""
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")  # no X server: do not ask for one


def look(camera: pv.Camera, points_mm: FloatArray, name: Camera, aspect: float) -> float:
    """Point a camera as one of a picture's does; width over height of what it sees."""
    direction, up = VIEWS[name]
    return place(camera, points_mm, direction, up, aspect, is_parallel=name != "iso")


def place(
    camera: pv.Camera, points_mm: FloatArray, direction: Triple, up: Triple, aspect: float, is_parallel: bool = False
) -> float:
    """Put a camera as near as lets all points (n, 3) be seen, with a margin; width over height of them as seen.

    `direction` is from what is seen to the camera, `up` upright in the picture, `aspect` width over height of that. A
    parallel projection knows no perspective: what is twice as far is as large.
    """
    toward = np.array(direction) / np.linalg.norm(direction)
    right = np.cross(up, toward)
    right /= np.linalg.norm(right)
    upright = np.cross(toward, right)
    half = np.tan(np.radians(VIEW_ANGLE / 2)) * (1 - 2 * MARGIN)
    focus, distance = points_mm.mean(axis=0), 4 * np.ptp(points_mm, axis=0).max()
    for _ in range(20):  # a fixed point: it settles in a few rounds
        seen = points_mm - focus
        depth = distance - (0.0 if is_parallel else 1.0) * (seen @ toward)
        across, upward = seen @ right / depth, seen @ upright / depth
        aside = (across.max() + across.min()) / 2 * right + (upward.max() + upward.min()) / 2 * upright
        focus = focus + distance * aside
        distance *= max(np.ptp(across) / aspect, np.ptp(upward)) / (2 * half)
    camera.view_angle, camera.focal_point, camera.up = VIEW_ANGLE, focus, upright
    camera.parallel_projection = is_parallel
    camera.parallel_scale = distance * np.tan(np.radians(VIEW_ANGLE / 2))
    if is_parallel:  # outside of the body; how far makes no difference
        distance = 2 * np.linalg.norm(np.ptp(points_mm, axis=0))
    camera.position = focus + distance * toward
    return float(np.ptp(across) / np.ptp(upward))
