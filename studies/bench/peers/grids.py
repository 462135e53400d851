"""The parts that the peers share: which scenes they can take, the answer they give back, and structured grids.

The lines of a grid go through the outlines of loads, probes and inclusions.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fem.discretization.grid import geometric_line
from fem.scene.scene import Inclusion, Pillar, Scene, Sensor
from geometry.layout import FloatArray

Lines = tuple[FloatArray, FloatArray, FloatArray]  #: of a grid along x, y and z [mm]


@dataclass(frozen=True)
class Solved:
    """A scene's probes, and what they took."""

    probes: dict[str, FloatArray]  #: displacement of each probe, shape (3,) [mm]
    unknowns: int
    seconds: dict[str, float]  #: by step, without imports; their sum is the run time


def fits_boxes(scene: Scene) -> bool:
    """True for what hexahedra between lines can follow: one material in any body, upright inclusions in a box."""
    if isinstance(scene.body, Sensor):
        return scene.body.design.is_homogeneous
    return all(inclusion.is_upright for inclusion in scene.inclusions)


def is_homogeneous(scene: Scene) -> bool:
    """True for one material in any body."""
    return fits_boxes(scene) and not scene.inclusions


def is_homogeneous_block(scene: Scene) -> bool:
    """True for an upright box of one material: the scenes that every peer can be handed."""
    return is_homogeneous(scene) and scene.outline.is_upright


def scene_lines(scene: Scene, n: float, graded: bool) -> Lines:
    """Grid lines along x, y and z, in the coordinates of the top face: of a body that leans, shift them by `lean`.

    Parameters
    ----------
    scene : Scene
        Inclusions must be upright.
    n : float
        Elements along half of the smallest load or inclusion, or along the height if that is less.
    graded : bool
        Shrink elements toward load outlines, the top and inclusions, as the square root of the distance, which suits
        quadratic elements; else all are about as large.
    """
    sections = [load.size_mm for load in scene.loads] + [inclusion.section_mm for inclusion in scene.inclusions]
    size_mm = min(scene.height_mm, *(min(section) / 2 for section in sections))
    return _each_axis(scene, lambda stops, edges: _line(sorted(stops), sorted(edges), size_mm, n, graded))


def geometric_lines(scene: Scene, layers: int, ratio: float = 0.2) -> Lines:
    """Few lines, geometrically closer toward load outlines, the top and inclusions: for elements of high order."""
    widest_mm = max(scene.height_mm, min(min(load.size_mm) for load in scene.loads) / 2)

    def line(stops: set[float], edges: set[float]) -> FloatArray:
        return geometric_line(dict.fromkeys(stops, 0) | dict.fromkeys(edges, layers), ratio, widest_mm)

    return _each_axis(scene, line)


def inclusion_box(inclusion: Inclusion) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest corner of an upright inclusion."""
    corners = inclusion.corners()
    return corners.min(axis=0), corners.max(axis=0)


def lean(scene: Scene, z_mm: FloatArray | float) -> FloatArray:
    """Distance of the body's axis from the top face's centre at some heights, along x and y; shape (..., 2) [mm]."""
    outline = scene.outline
    slope = (np.array(outline.top_mm) - np.array(outline.base_mm))[:2] / outline.height_mm
    return np.multiply.outer(np.asarray(z_mm) - outline.height_mm, slope)


def _each_axis(scene: Scene, line: Callable[[set[float], set[float]], FloatArray]) -> Lines:
    """Lines by where each axis must have one, and where the stress is singular: a free pillar's ends among them."""
    corners = [inclusion_box(inclusion) for inclusion in scene.inclusions]
    lines = []
    for d in range(2):
        edges = set(scene.load_rectangles_mm[:, [d, d + 2]].ravel().tolist())
        edges |= {float(corner[d]) for pair in corners for corner in pair}
        stops = {scene.top_mm[d], scene.top_mm[d + 2], *scene.probe_rectangles_mm[:, [d, d + 2]].ravel().tolist()}
        lines.append(line(stops | edges, edges))
    heights = {scene.height_mm, *(float(corner[2]) for pair in corners for corner in pair)}
    if isinstance(scene.body, Pillar):
        heights.add(0.0)
    return lines[0], lines[1], line({0.0, *heights}, heights)


def _line(stops: list[float], edges: list[float], size_mm: float, n: float, graded: bool) -> FloatArray:
    """Lines through the stops, about size_mm / n apart, or less near edges and more away from them."""
    line = [np.array(stops[:1])]
    for left, right in pairwise(stops):
        x = np.linspace(left, right, 2001)
        distance = np.abs(x[:, None] - np.array(edges)).min(axis=1)
        width = 2 * np.sqrt(size_mm * distance) / n + size_mm / n**2 if graded else np.full(x.shape, size_mm / n)
        count = np.concatenate([[0.0], np.cumsum((1 / width[1:] + 1 / width[:-1]) / 2 * np.diff(x))])
        elements = max(1, round(float(count[-1])))
        line.append(np.interp(np.linspace(0.0, count[-1], elements + 1)[1:], count, x))
        line[-1][-1] = right
    return np.concatenate(line)
