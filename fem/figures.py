"""Pictures of a deformed sensor: by pyvista in three dimensions, and its electrodes by matplotlib."""

import os
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pyvista as pv

from fem.array_field import ArrayField
from fem.deformed import Part, Parts, sensor_parts
from fem.response import ArrayResponse
from fem.stress import pressure, von_mises
from geometry.files import replacing
from geometry.layout import FloatArray, unit_centres, upper_electrodes

Colour = Literal["displacement", "vertical", "mises", "pressure"]
Camera = Literal["iso", "top", "front", "side"]
Triple = tuple[float, float, float]
Medium = Literal["file", "film", "window", "page"]

SIZE_PX = {1: (1376, 800), 2: (880, 560)}  #: of one picture, and of each of several
PAGE_PX = (1440, 720)  #: of a page that holds all
BAR_PX = 224  #: width of the colour bar's column
MARGIN = 0.06  #: of a picture's width or height, around what it shows
VIEW_ANGLE = 30.0  #: degrees, of the camera; pages know no other
LEAST_STRENGTH = 0.02  #: of the strongest traction: pads with less are not outlined
SHARP = 60.0  #: degrees, between faces that meet in an edge that is drawn
LIFT_MM = 0.15  #: by which electrodes are drawn before the pillars' ends
MOST = 99.8  #: percentile of the stress that ends its colours: at edges it has no bound
SOLID = {"ambient": 0.3, "diffuse": 0.75, "specular": 0.2, "specular_power": 18}
GLASSY = {"ambient": 0.2, "specular": 0.7, "specular_power": 12}
VIEWS: dict[Camera, tuple[Triple, Triple]] = {
    "iso": ((1.0, -1.65, 1.1), (0.0, 0.0, 1.0)),
    "top": ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
    "front": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    "side": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
}


@dataclass(frozen=True)
class Quantity:
    """What colour shows."""

    title: str
    of: Callable[[Part], FloatArray]  #: a part to values (n,) at its points
    colours: str
    of_stress: bool = False  #: it has no bound at edges, then: the largest value means nothing


QUANTITIES: dict[Colour, Quantity] = {
    "displacement": Quantity("displacement\n[mm]", lambda p: np.linalg.norm(p.displacement_mm, axis=1), "viridis"),
    "vertical": Quantity("vertical\ndisplacement\n[mm]", lambda p: p.displacement_mm[:, 2], "viridis_r"),
    "mises": Quantity("von Mises\nstress\n[MPa]", lambda p: von_mises(p.stress), "plasma", of_stress=True),
    "pressure": Quantity("pressure\n[MPa]", lambda p: pressure(p.stress), "YlOrRd", of_stress=True),
}


def draw_deformed(
    field: ArrayField,
    traction_mpa: Mapping[str, FloatArray],
    path: Path,
    colour: Colour = "displacement",
    scale: float = 1.0,
    camera: Camera = "iso",
) -> None:
    """Write a PNG of a loaded array, as the paper's figure 7: one picture for each load, on one colour scale.

    Parameters
    ----------
    field : ArrayField
    traction_mpa : mapping of names to arrays (n_units, 3)
        Traction on each pad, z negative pushing down [MPa]; the name stands above the picture.
    path : Path
        PNG file to write.
    colour, scale, camera
        As in `DeformedPicture`.
    """
    stress = QUANTITIES[colour].of_stress
    panels = {name: sensor_parts(field, field.state(traction), stress) for name, traction in traction_mpa.items()}
    picture = DeformedPicture(panels, colour, scale, camera)
    with replacing(path) as temporary:
        picture.plotter.screenshot(temporary)
    picture.plotter.close()


def draw_electrode_grid(
    response: ArrayResponse, traction_mpa: FloatArray | None, path: Path, scale: float = 1.0
) -> None:
    """Write a PNG of the grid of upper electrodes U1, as the paper's figures 6 and 8; needs matplotlib.

    Circles are the electrodes at rest; loaded, a net joins where they have moved to, coloured by how far.

    Parameters
    ----------
    response : ArrayResponse
    traction_mpa : array, shape (n_units, 3), optional
        Traction on each pad, z negative pushing down [MPa]; None: the grid at rest (figure 6).
    path : Path
        PNG file to write.
    scale : float
        Factor by which displacement is drawn; 1 is true.
    """
    from matplotlib.figure import Figure

    design = response.design
    shape = (design.array.rows, design.array.cols, 3)
    height = design.unit.height_mm
    rest = (np.pad(unit_centres(design), ((0, 0), (0, 1))) + upper_electrodes(design.unit)[0]).reshape(shape)
    moved = np.zeros(shape)
    if traction_mpa is not None:
        force = (np.asarray(traction_mpa) * design.pad.size_mm**2).reshape(shape)
        moved = np.tensordot(response.influence_mm_per_n[:, :, 0], force, axes=3)
    now, far = rest + scale * moved, np.linalg.norm(moved, axis=2)
    figure = Figure(figsize=(8.0, 5.2), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    for lines in (now, now.swapaxes(0, 1)):
        for line in lines:
            axes.plot(*line.T, color="#5f7486", linewidth=1)
    axes.scatter(*rest.reshape(-1, 3).T, s=26, facecolors="none", edgecolors="black", label="at rest", depthshade=False)
    if traction_mpa is not None:
        dots = axes.scatter(
            *now.reshape(-1, 3).T, c=far.ravel(), s=30, cmap="viridis", vmin=0.0, label="loaded", depthshade=False
        )
        bar = figure.colorbar(dots, ax=axes, shrink=0.6, pad=0.1)
        bar.set_label("displacement of the electrode [mm]")
        times = "" if scale == 1 else f", displacement drawn {scale:g} times"
        axes.legend(loc="upper left", title=f"electrodes U1{times}", frameon=False)
    reach = np.abs(np.concatenate([rest, now])[..., :2]).max() * 1.05
    low = min(0.0, float(now[..., 2].min()))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(low, max(height, float(now[..., 2].max())) * 1.1))
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    axes.set_box_aspect((1, 1, 0.35), zoom=1.05)  # more would cut the corners off
    axes.view_init(elev=24, azim=-58)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=160)


class DeformedPicture:
    """Loaded bodies side by side, coloured by one scale: pillars in a translucent matrix, and how they were at rest.

    Parameters
    ----------
    panels : mapping of names to parts
        One picture each, its name above it. Parts named matrix are translucent, pads are outlined, the rest is solid.
    colour : {"displacement", "vertical", "mises", "pressure"}
        What colour shows.
    scale : float
        Factor by which displacement is drawn; 1 is true.
    camera : {"iso", "top", "front", "side"}
    medium : {"file", "film", "window", "page"}
        What it is drawn for. Frames of films are smoothed less, which is quicker. Pages have no text and no colour bar:
        they add their own, by `names`, `title` and `limits`.
    """

    def __init__(
        self,
        panels: Mapping[str, Parts],
        colour: Colour = "displacement",
        scale: float = 1.0,
        camera: Camera = "iso",
        medium: Medium = "file",
    ) -> None:
        draw_off_screen()
        self._quantity, self._scale = QUANTITIES[colour], scale
        self.names, self.title, self.colours = tuple(panels), self._quantity.title, self._quantity.colours
        self.limits = colour_limits(panels.values(), self._quantity)
        self._moving: list[tuple[pv.PolyData, FloatArray]] = []
        n, on_page = len(panels), medium == "page"
        width, height = self._size = (PAGE_PX[0] // n, PAGE_PX[1]) if on_page else SIZE_PX[min(n, 2)]
        self._line = 2.0 if medium in ("file", "window") else 1.0  # supersampling thins lines
        bar = [] if on_page else [BAR_PX]
        self.plotter = pv.Plotter(
            off_screen=medium != "window",
            shape=(1, n + len(bar)),
            col_weights=[width] * n + bar,
            window_size=(n * width + sum(bar), height),
            border=False,
        )
        self.plotter.set_background("white", all_renderers=True)
        if medium != "page":
            self.plotter.enable_anti_aliasing("msaa" if medium == "film" else "ssaa", all_renderers=True)
        self._texts = []
        for column, (name, parts) in enumerate(panels.items()):
            self.plotter.subplot(0, column)
            mapper = self._draw(parts)
            if not on_page:
                text = self.plotter.add_text(name, position="upper_edge", color="black", font_size=13)
                self._texts.append((name, text))
            rest = np.vstack([part.points_mm for part in parts.values()])
            moved = rest + scale * np.vstack([part.displacement_mm for part in parts.values()])
            self._look(camera, np.vstack([rest, moved]))
        if bar:
            self.plotter.subplot(0, n)
            self._draw_bar(mapper)
        self.press(1.0)

    def press(self, share: float) -> None:
        """Show everything under a share of its load."""
        for mesh, rest in self._moving:
            mesh.points = rest + share * self._scale * mesh["full"]
            if "of full" in mesh.array_names:
                mesh["shown"] = share * mesh["of full"]
            if "Normals" in mesh.array_names:
                turned = mesh.compute_normals(cell_normals=False, split_vertices=False, consistent_normals=False)
                mesh["Normals"] = turned["Normals"]
        for name, text in self._texts:
            text.set_text("upper_edge", name if share == 1 else f"{share:.0%} of {name}")

    def _draw(self, parts: Parts) -> pv.DataSetMapper:
        mapper = None
        for name, part in parts.items():
            whole = grid_of(part)
            whole["full"] = part.displacement_mm
            if part.traction_mpa is not None:
                self._draw_pads(whole, part.traction_mpa)
                continue
            if name not in ("matrix", "electrodes"):
                whole["of full"] = self._quantity.of(part)
            skin = whole.extract_surface(algorithm="dataset_surface")
            if name == "electrodes":
                middle = part.points_mm[:, 2].mean()
                skin.points[:, 2] += LIFT_MM * np.sign(skin.points[:, 2] - middle)
            if name == "matrix":
                skin = skin.compute_normals(cell_normals=False, split_vertices=True, feature_angle=SHARP)
                actor = self.plotter.add_mesh(self._moved(skin), color="#a9c4d8", opacity=0.2, **GLASSY)
                # PyVista's own smooth shading would draw a copy, which stays at rest
                actor.prop.interpolation = "phong"
            elif name == "electrodes":
                self.plotter.add_mesh(self._moved(skin), color="#c98a4b", **SOLID)
            else:
                skin["shown"] = skin["of full"]
                actor = self.plotter.add_mesh(
                    self._moved(skin), scalars="shown", clim=self.limits, cmap=self._quantity.colours,
                    show_scalar_bar=False, **SOLID,
                )  # fmt: skip
                mapper = actor.mapper
            if name in ("matrix", "body"):
                edges = skin.extract_feature_edges(SHARP, boundary_edges=name == "matrix")
                self.plotter.add_mesh(edges.copy(), color="#9aa5ad", line_width=1 * self._line)  # as it was at rest
                self.plotter.add_mesh(self._moved(edges), color="#3d5468", line_width=1.5 * self._line)
        return mapper

    def _draw_pads(self, whole: pv.UnstructuredGrid, traction_mpa: FloatArray) -> None:
        """Outline loaded pads in the strength of their traction."""
        strength = np.linalg.norm(traction_mpa, axis=1)
        whole.cell_data["strength"] = strength / max(strength.max(), 1e-300)
        whole = whole.extract_cells(strength >= LEAST_STRENGTH * strength.max())
        outlines = whole.extract_surface(algorithm="dataset_surface").extract_feature_edges(
            boundary_edges=True, feature_edges=False, manifold_edges=False
        )
        self.plotter.add_mesh(
            self._moved(outlines), scalars="strength", cmap="Reds", clim=(-0.3, 1.1), line_width=2.5 * self._line,
            show_scalar_bar=False,
        )  # fmt: skip

    def _draw_bar(self, mapper: pv.DataSetMapper) -> None:
        labels = len(colour_ticks(*self.limits))
        self.plotter.add_scalar_bar(
            title=self._quantity.title, mapper=mapper, color="black", fmt="%.3g", n_labels=labels, vertical=True,
            position_x=0.15, position_y=0.12, width=0.42, height=0.76, title_font_size=20, label_font_size=20,
        )  # fmt: skip

    def _look(self, camera: Camera, points_mm: FloatArray) -> None:
        """Turn the camera and bring it as near as lets all points be seen."""
        direction, up = VIEWS[camera]
        place(self.plotter.camera, points_mm, direction, up, self._size[0] / self._size[1])
        self.plotter.reset_camera_clipping_range()

    def _moved(self, mesh: pv.PolyData) -> pv.PolyData:
        self._moving.append((mesh, mesh.points.copy()))
        return mesh


def draw_off_screen() -> None:
    """Let VTK draw where there is no display; before the first plotter."""
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")  # no X server: do not ask for one


def place(camera: pv.Camera, points_mm: FloatArray, direction: Triple, up: Triple, aspect: float) -> None:
    """Put a camera as near as lets all points be seen, with a margin.

    Parameters
    ----------
    camera : pyvista.Camera
    points_mm : array, shape (n, 3)
    direction, up : three numbers each
        From what is seen to the camera, and what is upright in the picture.
    aspect : float
        Width over height of the picture.
    """
    toward = np.array(direction) / np.linalg.norm(direction)
    right = np.cross(up, toward)
    right /= np.linalg.norm(right)
    upright = np.cross(toward, right)
    half = np.tan(np.radians(VIEW_ANGLE / 2)) * (1 - 2 * MARGIN)
    focus, distance = points_mm.mean(axis=0), 4 * np.ptp(points_mm, axis=0).max()
    for _ in range(20):  # a fixed point: it settles in a few rounds
        seen = points_mm - focus
        depth = distance - seen @ toward
        across, upward = seen @ right / depth, seen @ upright / depth
        aside = (across.max() + across.min()) / 2 * right + (upward.max() + upward.min()) / 2 * upright
        focus = focus + distance * aside
        distance *= max(np.ptp(across) / aspect, np.ptp(upward)) / (2 * half)
    camera.view_angle, camera.focal_point, camera.up = VIEW_ANGLE, focus, upright
    camera.position = focus + distance * toward


def colour_limits(panels: Iterable[Parts], quantity: Quantity) -> tuple[float, float]:
    """Round ends of one colour scale for several pictures, 0 among its values."""
    solid = [part for parts in panels for name, part in parts.items() if name not in ("matrix", "electrodes", "pads")]
    values = np.concatenate([quantity.of(part) for part in solid])
    share = MOST if quantity.of_stress else 100.0
    low, high = (float(np.percentile(values, q)) for q in (100 - share, share))
    low, high = min(low, 0.0), max(high, 0.0)
    step = round_step(high - low)
    low, high = step * np.floor(round(low / step, 6)), step * np.ceil(round(high / step, 6))
    return float(low), float(high if high > low else low + step)


def colour_ticks(low: float, high: float) -> FloatArray:
    """Round values from one end of a colour scale to the other, the ends included."""
    return np.linspace(low, high, 1 + round((high - low) / round_step(high - low)))


def round_step(most: float) -> float:
    """The step of 1, 2, 2.5 or 5 times a power of ten of which four or a few more reach up to a value.

    >>> round_step(2.66), round_step(0.41)
    (0.5, 0.1)
    """
    if not most > 0:
        return 1.0
    tens = 10.0 ** np.floor(np.log10(most / 4))
    return float(max(step * tens for step in (1, 2, 2.5, 5) if step * tens <= most / 4))


def grid_of(part: Part) -> pv.UnstructuredGrid:
    """A part at rest, without what was found on it."""
    return pv.UnstructuredGrid({pv.CellType(part.cell_type): part.cells}, part.points_mm)
