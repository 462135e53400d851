"""Pictures of the deformed sensor, by pyvista; drawn off screen."""

import os
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyvista as pv

from fem.field import displacement_field
from geometry.design import SensorDesign
from geometry.files import replacing
from geometry.layout import FloatArray, pad_squares, pillar_ends, pillar_sections, unit_centres
from geometry.mesh import TetMesh


def bell_pressure(design: SensorDesign, peak_mpa: float) -> FloatArray:
    """Tractions (n_units, 3) [MPa] of a round indenter over the middle of the array, one pitch wide."""
    centres = unit_centres(design)
    traction = np.zeros((design.n_units, 3))
    squared = (centres**2).sum(axis=1)
    nearest = squared.min()
    traction[:, 2] = -peak_mpa * np.exp(-(squared - nearest) / (2 * design.array.pitch_mm**2))
    return traction


def draw_deformed(design: SensorDesign, mesh: TetMesh, traction_mpa: FloatArray, path: Path) -> None:
    """Draw the deformed pillars inside a translucent matrix, at true scale, and write a PNG.

    Colour is the size of the displacement; loaded pads are outlined in the strength of their pressure.

    Parameters
    ----------
    design : SensorDesign
    mesh : TetMesh
        Of that design.
    traction_mpa : array, shape (n_units, 3)
        Traction on each pad, z negative pushing down [MPa].
    path : Path
        PNG file to write.
    """
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")  # no X server: do not ask for one
    moved_mm = displacement_field(design, mesh, traction_mpa)
    body = pv.UnstructuredGrid({pv.CellType.TETRA: mesh.cells}, mesh.points_mm)
    body.point_data["u"] = moved_mm
    pillars = _warped(pillar_surfaces(design), body)
    pads = _warped(_pad_outlines(design, traction_mpa), body)
    slab = body.extract_surface(algorithm="dataset_surface").warp_by_vector("u")
    largest_mm = float(np.linalg.norm(moved_mm, axis=1).max())

    plotter = pv.Plotter(off_screen=True, window_size=(1800, 1000))
    plotter.set_background("white")
    plotter.add_mesh(slab, color="#9db7cc", opacity=0.16)
    plotter.add_mesh(slab.extract_feature_edges(70), color="#5b7185", line_width=2)
    plotter.add_mesh(
        pillars,
        scalars="displacement [mm]",
        clim=(0.0, largest_mm),
        cmap="viridis",
        smooth_shading=False,
        scalar_bar_args={
            "title": "displacement [mm]", "color": "black", "fmt": "%.1f", "n_labels": 5, "vertical": True,
            "position_x": 0.86, "position_y": 0.2, "height": 0.6, "title_font_size": 26, "label_font_size": 24,
        },
    )  # fmt: skip
    plotter.add_mesh(pads, scalars="pressure", cmap="Reds", clim=(-0.5, 1.0), line_width=4, show_scalar_bar=False)
    plotter.view_vector((1.0, -1.65, 1.1), viewup=(0.0, 0.0, 1.0))
    plotter.camera.zoom(1.35)
    with replacing(path) as temporary:
        plotter.screenshot(temporary)
    plotter.close()


def pillar_surfaces(design: SensorDesign, slices: int = 12) -> pv.PolyData:
    """Surfaces of all pillars, cut into slices along z so that they can bend."""
    centres = unit_centres(design)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    share = np.linspace(0.0, 1.0, slices + 1)
    blocks = []
    for (bottom, top), section in zip(pillar_ends(design.unit), pillar_sections(design.unit), strict=True):
        axis = bottom + share[:, None] * (top - bottom)
        ring = np.column_stack([corners * section, np.zeros(4)])
        for centre in centres:
            points = (axis[:, None, :] + ring + np.append(centre, 0.0)).reshape(-1, 4, 3)
            blocks.append(pv.StructuredGrid(*_closed(points)).extract_surface(algorithm="dataset_surface"))
            blocks += [pv.PolyData(points[end], [4, 0, 1, 2, 3]) for end in (0, -1)]
    return pv.merge(blocks, merge_points=False)


def _closed(rings: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coordinates of a tube's wall (slices + 1, 5 with the first corner again, 1)."""
    around = np.concatenate([rings, rings[:, :1]], axis=1)[:, :, None, :]
    return around[..., 0], around[..., 1], around[..., 2]


def _pad_outlines(design: SensorDesign, traction_mpa: FloatArray) -> pv.PolyData:
    """Outlines of the pads on the top face, each with its share of the largest pressure."""
    size = np.linalg.norm(traction_mpa, axis=1)
    outlines = []
    for (x0, y0, x1, y1), share in zip(pad_squares(design), size / max(size.max(), 1e-300), strict=True):
        steps = np.linspace(0.0, 1.0, 9)[:-1, None]
        around = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
        points = np.vstack([a + steps * (b - a) for a, b in pairwise(around)])
        outline = pv.lines_from_points(
            np.column_stack([points, np.full(len(points), design.unit.height_mm)]), close=True
        )
        outline.point_data["pressure"] = np.full(outline.n_points, share)
        outlines.append(outline)
    return pv.merge(outlines, merge_points=False)


def _warped(surface: pv.PolyData, body: pv.UnstructuredGrid) -> pv.PolyData:
    """A surface inside the body, moved with it."""
    sampled = surface.sample(body, snap_to_closest_point=True)
    sampled["displacement [mm]"] = np.linalg.norm(sampled["u"], axis=1)
    return sampled.warp_by_vector("u")
