"""Pictures of deformed bodies in three dimensions, by pyvista: bodies, their colour bars, a scale bar and axes.

Letters face the reader from wherever one looks. Names, axes and colour bars are in strips of their own.
"""

import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil
from pathlib import Path
from textwrap import wrap
from typing import Any, Literal

import numpy as np
import pyvista as pv
from matplotlib import colormaps, get_data_path
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LinearSegmentedColormap, ListedColormap, Normalize, to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from vtkmodules.vtkRenderingCore import vtkFollower

from fem.kernel.field import pressure, von_mises
from fem.pictures.parts import Part, Parts
from geometry.layout import FloatArray

Triple = tuple[float, float, float]
Medium = Literal["file", "film", "window", "page", "live"]
Colour = Literal["displacement", "vertical", "mises", "pressure"]
Camera = Literal["iso", "top", "front", "side"]

WIDE_PX = {1: (992, 1376), 2: (640, 880)}  #: least and most of one picture, and of each of several
HIGH_PX = 880  #: of a picture, where its width leaves a choice
NAME_PX, LEGEND_PX = 64, 112  #: heights of the strips above and below pictures
NOTE = 34  #: letters of a line beside the colour bars
MARGIN = 0.03  #: of a picture's width or height, around what it shows
NUMBERED = 1.2  #: of a body, that it takes with numbers around it
VIEW_ANGLE = 30.0  #: degrees, of the camera; pages know no other
SHARP = 60.0  #: degrees, between faces that meet in an edge that is drawn
#: of the body's height, by which electrodes are drawn before the pillars' ends, and pads' outlines above them
LIFT, PAD_LIFT = 0.015, 0.02
SOLID = {"ambient": 0.3, "diffuse": 0.75, "specular": 0.2, "specular_power": 18}
GLASSY = {"ambient": 0.2, "specular": 0.7, "specular_power": 12}
INK = "#21292f"
FONT = Path(get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")  #: of names, as of legends
#: of a body's larger side: height of letters beside it, and distance of the scale bar, and of its letters from that
LETTER, BESIDE = 0.02, 0.025
#: from what is seen to the camera, and upright in the picture
VIEWS: dict[Camera, tuple[Triple, Triple]] = {
    "iso": ((1.0, -1.65, 1.1), (0.0, 0.0, 1.0)),
    "top": ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
    "front": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    "side": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
}

SHOWN_SHARE = 0.98  #: of the volume, whose stress ends the colours: at edges it has no bound
ROOM = 0.15  #: of a scale, that a label takes
SHADES = 255  #: colours of a scale; odd, so that the middle one of a scale of both signs is white
#: from 0 up, without the darkest colours, which a dark page hides
FAR, TENSE = (ListedColormap(colormaps[name](np.linspace(0.3, 1.0, 1021))) for name in ("viridis", "plasma"))
#: from below 0 to above
SIGNED = LinearSegmentedColormap.from_list("", ["#053061", "#3f8ec0", "#ffffff", "#d6604d", "#67001f"], N=1021)
#: outlines of pads, from unloaded to the most
LOADED = LinearSegmentedColormap.from_list("", ["#a7b0b8", "#ee8f77", "#de2d26", "#67000d"], N=1021)
#: titles of the bar of pads' outlines, by the part that is outlined: uniform traction, or what a plate passes on
PAD_TITLES = {"pads": "traction on a pad [MPa]", "plates": "mean traction under a plate [MPa]"}
COLOURED_NOT = ("matrix", "electrodes", *PAD_TITLES)  #: parts whose colour says nothing of a field
ROUND = MaxNLocator(5, steps=[1, 2, 2.5, 5, 10])  #: values: at most five steps of 1, 2, 2.5 or 5 times a power of ten


@dataclass(frozen=True)
class Quantity:
    """A quantity that colour can show."""

    title: str
    of: Callable[[Part], FloatArray]  #: a part to values (n,) at its points
    colours: Colormap = field(default_factory=lambda: SIGNED)
    of_stress: bool = False  #: it has no bound at edges, then: the largest value means nothing


QUANTITIES: dict[Colour, Quantity] = {
    "displacement": Quantity("displacement [mm]", lambda p: np.linalg.norm(p.displacement_mm, axis=1), FAR),
    "vertical": Quantity("vertical displacement [mm]", lambda p: p.displacement_mm[:, 2]),
    "mises": Quantity("von Mises stress [MPa]", lambda p: von_mises(p.stress), TENSE, of_stress=True),
    "pressure": Quantity("pressure [MPa]", lambda p: pressure(p.stress), of_stress=True),
}


@dataclass(frozen=True, kw_only=True)
class Bar:
    """A colour bar: its title, the values at its ends, and its colours from one to the other as #rrggbb."""

    title: str
    low: float
    high: float
    colours: list[str]
    is_cut: bool = False  #: values beyond its ends are drawn in the colours of the ends

    @property
    def labels(self) -> dict[float, str]:
        """Labels by value: both ends as they are, and round numbers between them that leave room.

        >>> [*Bar(title="", low=0.0, high=3.89, colours=[]).labels.values()]
        ['0', '1', '2', '3', '3.89']
        """
        ticks, room = np.array(ROUND.tick_values(self.low, self.high)), ROOM * (self.high - self.low)
        inside = ticks[(ticks > self.low + room) & (ticks < self.high - 1.5 * room)].tolist()  # the end has most digits
        words = {tick: f"{tick:.3g}".replace("-", "−") for tick in (self.low, *inside, self.high)}
        if self.is_cut:
            words[self.high] = f"≥ {words[self.high]}"
            words[self.low] = f"≤ {words[self.low]}" if self.low < 0 else words[self.low]
        return words

    @property
    def look(self) -> dict[str, Any]:
        """How a mesh shows values in its colours."""
        colours = {"cmap": self.colours, "n_colors": len(self.colours), "clim": (self.low, self.high)}
        return {"show_scalar_bar": False, **colours}


def bar_of(quantity: Quantity, panels: Iterable[Parts], min_size: float = 0.0) -> Bar:
    """One colour bar for several pictures: it ends at the least and the largest value, 0 among its values.

    Values up to `min_size` are within it. Of stress, which has no bound at edges, it ends where 98 % of the volume (of
    surfaces: of the area) has less, and says so. A share of the points instead would depend on how many of them a mesh
    has at the edges.
    """
    solid = [(name, part) for parts in panels for name, part in parts.items() if name not in COLOURED_NOT]
    values = np.concatenate([quantity.of(part) for _, part in solid])
    whose = "" if solid[0][0] == "body" else f" of the {solid[0][0]}"
    low, high = values.min(), values.max()
    if quantity.of_stress:
        sizes, shares = np.concatenate([part.sizes for _, part in solid]), [1 - SHOWN_SHARE, SHOWN_SHARE]
        low, high = np.quantile(values, shares, weights=sizes, method="inverted_cdf")
    low, high = min(float(low), -min_size if quantity.colours is SIGNED else 0.0), max(float(high), min_size)
    if low == high:
        high = 1.0
    title, colours = quantity.title.replace(" [", f"{whose} ["), shades(quantity.colours, low, high)
    return Bar(title=title, low=low, high=high, colours=colours, is_cut=quantity.of_stress)


def pads_bar(panels: Iterable[Parts]) -> Bar | None:
    """The bar of the outlines of pads or plates, from no traction to the largest; None where none is loaded."""
    pads = [(name, parts[name]) for parts in panels for name in PAD_TITLES if name in parts]
    high, name = max(((float(part.strength_mpa.max()), name) for name, part in pads), default=(0.0, ""))
    return Bar(title=PAD_TITLES[name], low=0.0, high=high, colours=shades(LOADED)) if high else None


def shades(colours: Colormap, low: float = 0.0, high: float = 1.0) -> list[str]:
    """Colours #rrggbb from one end of a scale to the other.

    `SIGNED` are white at 0, low being at most 0 and high at least 0, and as strong for −1 as for 1.

    >>> shades(SIGNED, -2.0, 2.0)[127]
    '#ffffff'
    """
    share = np.linspace(0.0, 1.0, SHADES)
    if colours is SIGNED:
        share = 0.5 + (low + share * (high - low)) / max(-low, high) / 2
    return [to_hex(colour) for colour in colours(share)]


def legend(bars: Sequence[Bar], notes: Sequence[str], wide: int) -> Figure:
    """Bars side by side, the first one the widest, and notes at the right, one line each; so many pixels wide."""
    figure, left, gap = Figure(dpi=100), (LEGEND_PX + 20) / wide, 0.05
    note = (12 * max(map(len, notes)) + 40) / wide  # letters are about 0.55 of their height wide
    shares = np.array([1.6] + [1.0] * (len(bars) - 1))
    widths = shares / shares.sum() * (0.96 - left - note - gap * (len(bars) - 1))
    for bar, width in zip(bars, widths, strict=True):
        axes = figure.add_axes((left, 0.44, width, 0.14))
        colours = ScalarMappable(Normalize(bar.low, bar.high), ListedColormap(bar.colours))
        drawn = figure.colorbar(colours, cax=axes, orientation="horizontal")
        drawn.set_ticks([*bar.labels], labels=[*bar.labels.values()], fontsize=13.5, color=INK)
        drawn.outline.set_visible(False)
        axes.tick_params(length=0)
        axes.set_title(bar.title, loc="left", fontsize=13.5, color=INK)
        left += width + gap
    figure.text(0.96, 0.5, "\n".join(notes), ha="right", va="center", fontsize=13.5, color=INK, linespacing=1.3)
    return figure


def scale_bar(points_mm: FloatArray, camera: Camera) -> FloatArray:
    """Corners (4, 3) [mm] of a scale bar with its letters, before points (n, 3) as a camera sees them.

    The first two are the ends of its line, which is of a round length.
    """
    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    right, up = np.eye(3)[1 if camera == "side" else 0], np.eye(3)[1 if camera in ("iso", "top") else 2]
    width, away = float((high - low) @ right), BESIDE * float((high - low).max()) * up
    length = float(ROUND.tick_values(0.0, width)[1])
    ends = low - away + np.array([[width - length], [width]]) * right
    return np.vstack([ends, ends - 3 * away])


def add_words(plotter: pv.Plotter, words: Iterable[tuple[str, FloatArray]], height_mm: float) -> list[vtkFollower]:
    """Write words, each about a place (3,), with letters of a height that turn with the camera."""
    written = []
    for word, place_mm in words:
        letters = vtkFollower()
        letters.SetMapper(pv.DataSetMapper(pv.Text3D(word, depth=0.0, height=height_mm)))
        letters.SetPosition(*place_mm)
        letters.SetCamera(plotter.camera)
        letters.GetProperty().SetColor(pv.Color(INK).float_rgb)
        letters.GetProperty().LightingOff()
        plotter.add_actor(letters, reset_camera=False)
        written.append(letters)
    return written


def add_axes(plotter: pv.Plotter, viewport: Sequence[float], colour: str = INK, letter: float = 0.24) -> None:
    """Show axes in a part (left, lower, right, upper end) of a picture; letters are a fraction of that part high."""
    names = {f"{axis}label": axis for axis in "xyz"}
    plotter.add_axes(line_width=3, color=colour, viewport=viewport, label_size=(letter / 0.6, letter), **names)
    plotter.renderer.axes_widget.SetZoom(1.4)


class DeformedPicture:
    """Loaded bodies side by side, coloured by one scale: pillars in a translucent matrix, and how they were at rest.

    Each has a scale bar; below all are the axes, the colour bars and the factor of displacement.

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
        self._quantity, self._scale, self._is_live = QUANTITIES[colour], scale, medium == "live"
        self.names = tuple(panels)
        shown = [*panels.values()] if over is None else over
        pads = pads_bar(shown)
        self.bars = (bar_of(self._quantity, shown), *([] if pads is None else [pads]))
        self.note = "displacement: true scale" if scale == 1 else f"displacement × {scale:g}"
        self.warning = warning
        self.moving: list[Moving] = []
        at_rest = {name: {each: part.times(0.0) for each, part in parts.items()} for name, parts in panels.items()}
        self._steps = [at_rest, *before, panels]  # equal ones of the load
        self.actors: dict[str, pv.Actor] = {}  #: by name of the part, of the last panel
        seen = [
            part.points_mm + share * scale * part.displacement_mm
            for parts in panels.values() for part in parts.values() for share in (0.0, 1.0)
        ]  # fmt: skip
        body_mm = np.vstack(seen)
        bar_mm, middle_mm = scale_bar(body_mm, camera), (body_mm.min(axis=0) + body_mm.max(axis=0)) / 2
        seen.append(middle_mm + NUMBERED * (body_mm - middle_mm) if medium == "page" else bar_mm)
        view, is_parallel, is_bare = VIEWS[camera], camera != "iso", medium in ("page", "live")
        #: width over height of one picture
        self.aspect = place(pv.Camera(), np.vstack(seen), *view, 1.0, is_parallel)
        self._line = 2.0 if medium in ("file", "window") else 1.0  # supersampling thins lines
        columns = columns or len(panels)
        rows = ceil(len(panels) / columns)
        self.plotter = self._plotter(rows, columns, medium, is_bare)
        self.plotter.link_views()
        place(self.plotter.camera, np.vstack(seen), *view, self.aspect, is_parallel)
        self._titles: dict[str, Any] = {}
        for number, (name, parts) in enumerate(panels.items()):
            row, column = divmod(number, columns)
            self.plotter.subplot(row if is_bare else 2 * row + 1, column)
            self._draw(name, parts)
            if medium == "page":  # browsers know this one alone
                titles = {f"{axis}title": f"{axis} [mm]" for axis in "xyz"}
                self.plotter.show_bounds(mesh=pv.PolyData(body_mm), color=INK, **titles)
            if not is_bare:
                self.plotter.add_lines(bar_mm[:2], color=INK, width=2 * self._line)
                said, size_mm = f"{np.linalg.norm(bar_mm[1] - bar_mm[0]):g} mm", np.ptp(body_mm, axis=0).max()
                add_words(self.plotter, [(said, bar_mm[[0, 2]].mean(axis=0))], LETTER * size_mm)
                self.plotter.enable_anti_aliasing("msaa" if medium == "film" else "ssaa", all_renderers=False)
                self.plotter.subplot(2 * row, column)
                text = self.plotter.add_text(
                    name, position=(0.5, 0.3), viewport=True, font_size=12, font_file=str(FONT), color=INK
                )
                text.prop.justification_horizontal = "center"
                self._titles[name] = text
        if not is_bare:
            self.plotter.subplot(2 * rows, 0)
            notes, wide = wrap(self.note, NOTE) + wrap(warning, NOTE), self.plotter.window_size[0]
            chart = pv.ChartMPL(legend(self.bars, notes, wide), redraw_on_render=False)
            chart.border_style = None
            self.plotter.add_chart(chart)
            add_axes(self.plotter, (0, 0, LEGEND_PX / wide, 1))
        for renderer in self.plotter.renderers:
            renderer.reset_camera_clipping_range()
        self.press(1.0)

    def press(self, share: float) -> None:
        """Show everything under a share of its load, linear between the steps that are known."""
        step, further = divmod(share * (len(self._steps) - 1), 1.0)
        for moving in self.moving:
            seen = self._values(self._steps[int(step)], moving)
            if further:
                more = self._values(self._steps[int(step) + 1], moving)
                seen = {name: low + further * (more[name] - low) for name, low in seen.items()}
            mesh, shift = moving.mesh, seen.pop("moved")
            mesh.points = moving.rest_mm + self._scale * shift
            for name, values in seen.items():
                mesh[name] = values
            if "Normals" in mesh.array_names:
                turned = mesh.compute_normals(cell_normals=False, split_vertices=False, consistent_normals=False)
                mesh["Normals"] = turned["Normals"]
        for name, text in self._titles.items():
            text.input = name if share == 1 else f"{share:.0%} of {name}"

    def recolour(self, panels: Mapping[str, Parts], quantity: Quantity, scale: float, min_size: float = 0.0) -> Bar:
        """Show the same bodies under other loads, coloured by a quantity from end to end; its bar, as of `bar_of`."""
        self._quantity, self._scale, bar = quantity, scale, bar_of(quantity, panels.values(), min_size)
        mapper = self.actors["pillars"].mapper
        mapper.lookup_table.apply_cmap(bar.colours, len(bar.colours))
        mapper.scalar_range = bar.low, bar.high
        self.load(panels)
        return bar

    def load(self, panels: Mapping[str, Parts]) -> None:
        """Show the same bodies under other loads, in the colours of the first ones."""
        self._steps[-1] = panels
        self.press(1.0)

    def _values(self, panels: Mapping[str, Parts], moving: "Moving") -> dict[str, FloatArray]:
        """What is seen at the points of a mesh."""
        part = panels[moving.panel][moving.name]
        values = {"moved": part.displacement_mm}
        if moving.name not in COLOURED_NOT:
            values["shown"] = self._quantity.of(part)
        if part.traction_mpa is not None:
            values["strength"] = np.zeros(len(part.points_mm))
            values["strength"][part.cells] = part.strength_mpa[:, None]  # pads share no points between them
        return {name: found[moving.mesh["point"]] for name, found in values.items()}

    def _plotter(self, rows: int, columns: int, medium: Medium, is_bare: bool) -> pv.Plotter:
        """An empty plotter for rows of pictures, each with its name above, and one legend below all of them."""
        least, most = WIDE_PX[min(columns, 2)]
        wide = 16 * round(min(max(HIGH_PX * self.aspect, least), most) / 16)
        high = 16 * round(wide / self.aspect / 16)  # films want multiples of 16
        heights = [high] * rows if is_bare else [NAME_PX, high] * rows + [LEGEND_PX]
        plotter = pv.Plotter(
            off_screen=medium != "window", shape=(len(heights), columns), row_weights=heights, border=False,
            groups=None if is_bare else [(2 * rows, slice(None))], window_size=(columns * wide, sum(heights)),
            lighting="none" if self._is_live else "light kit",
        )  # fmt: skip
        if self._is_live:  # smooth edges, and each further light, cost software half as much again and more
            plotter.render_window.SetMultiSamples(0)
            plotter.add_light(pv.Light(light_type="headlight"))
        plotter.set_background("white", all_renderers=True)
        return plotter

    def _draw(self, panel: str, parts: Parts) -> None:
        solid, glassy = ({}, {}) if self._is_live else (SOLID, GLASSY)
        height_mm = max(float(np.ptp(part.points_mm[:, 2])) for part in parts.values())
        for name, part in parts.items():
            if self._is_live and name == "electrodes":
                continue
            whole = part.grid
            whole["point"] = np.arange(len(part.points_mm))
            if part.traction_mpa is not None:
                skin = whole.extract_surface(algorithm="dataset_surface").extract_feature_edges(
                    boundary_edges=True, feature_edges=False, manifold_edges=False
                )
                skin.points[:, 2] += PAD_LIFT * height_mm
                look = {"scalars": "strength", "line_width": 2.5 * self._line, "lighting": False, **self.bars[-1].look}
            else:
                skin = whole.extract_surface(algorithm="dataset_surface")
                look = {"scalars": "shown", **self.bars[0].look, **solid}
            if name == "matrix":
                look = {"color": "#a9c4d8", "opacity": 0.2, **glassy}
                if not self._is_live:
                    skin = skin.compute_normals(cell_normals=False, split_vertices=True, feature_angle=SHARP)
            elif name == "electrodes":
                look = {"color": "#c98a4b", **solid}
                skin.points[:, 2] += LIFT * height_mm * np.sign(skin.points[:, 2] - part.points_mm[:, 2].mean())
            self.actors[name] = self.plotter.add_mesh(self._moved(panel, name, skin), **look)
            if name == "matrix":  # PyVista's own smooth shading would draw a copy, which stays at rest
                self.actors[name].prop.interpolation = "flat" if self._is_live else "phong"
            if name in ("matrix", "body"):
                edges = skin.extract_feature_edges(SHARP, boundary_edges=name == "matrix")
                self.plotter.add_mesh(edges.copy(), color="#9aa5ad", line_width=1 * self._line)  # as it was at rest
                self.plotter.add_mesh(self._moved(panel, name, edges), color="#3d5468", line_width=1.5 * self._line)

    def _moved(self, panel: str, name: str, mesh: pv.PolyData) -> pv.PolyData:
        """The mesh, from now on moved by loads."""
        self.moving.append(Moving(panel, name, mesh, mesh.points.copy()))
        for key, values in self._values(self._steps[-1], self.moving[-1]).items():
            mesh[key] = values
        return mesh


@dataclass
class Moving:
    """A mesh that loads move."""

    panel: str
    name: str  #: of the part
    mesh: pv.PolyData
    rest_mm: FloatArray  #: (n, 3), its points


def draw_off_screen() -> None:
    """Let VTK draw where there is no display; before the first plotter."""
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")  # no X server: do not ask for one


def frame(direction: Triple, up: Triple) -> FloatArray:
    """Directions to the right, upright in the picture and toward the camera of a view of `VIEWS`, one a row."""
    toward = np.array(direction) / np.linalg.norm(direction)
    right = np.cross(up, toward)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(toward, right), toward])


def place(
    camera: pv.Camera, points_mm: FloatArray, direction: Triple, up: Triple, aspect: float, is_parallel: bool = False
) -> float:
    """Put a camera as near as lets all points (n, 3) be seen, with a margin; width over height of them as seen.

    `direction` and `up` are as of `VIEWS`, `aspect` is width over height of the picture. A parallel projection knows no
    perspective: what is twice as far is as large.
    """
    right, upright, toward = frame(direction, up)
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
