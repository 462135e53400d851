"""The parts that the peers share: which scenes they can take, the answer they give back, and structured grids.

The lines of a grid go through the outlines of loads, probes and inclusions.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fem.scene.scene import Inclusion, Pillar, Scene, Sensor
from geometry.layout import FloatArray

Lines = tuple[FloatArray, FloatArray, FloatArray]  #: of a grid along x, y and z [mm]
OUTWARD = 0.3  #: distance of an element of high order from the nearest edge, over the distance of its far end
SPREAD = 0.25  #: width of such elements over that distance, where they may be wider than the widest


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


def geometric_line(layers: Mapping[float, int], ratio: float, widest_mm: float, reach_mm: float = np.inf) -> FloatArray:
    """Lines through given positions, shrinking geometrically toward those that ask for layers.

    Parameters
    ----------
    layers : mapping
        Position [mm] → number of layers on either side of it; the lowest and highest bound the line.
    ratio : float
        Distance of each layer's line from the position, over the next one's; about 0.15 suits functions of order 3 to 6
        (Schwab, *p- and hp-finite element methods*, 1998).
    widest_mm : float
        No element is wider [mm], but those far from all positions: they may grow with the distance, see `SPREAD`.
    reach_mm : float
        Layers begin at this distance at most, where there are any [mm]; from there on elements grow, see `OUTWARD`.

    Examples
    --------
    >>> geometric_line({0.0: 0, 8.0: 2}, ratio=0.25, widest_mm=10.0)
    array([0. , 6. , 7.5, 8. ])
    """
    positions = sorted(layers)
    lines = [np.array(positions[:1])]
    for left, right in pairwise(positions):
        sides = [layers[left] > 0, layers[right] > 0]
        share = (right - left) / max(1, sum(sides))  # of the gap, that each side with layers fills
        if not any(sides):
            inner = np.linspace(left, right, int(np.ceil(share / widest_mm - 1e-9)) + 1)[1:-1]
        else:
            start = min(share, reach_mm, widest_mm)
            outward = _outward(start, share, (right - left) - share, widest_mm)
            near, far = (
                np.append(start * ratio ** np.arange(count, 0, -1.0), outward) if side else np.zeros(0)
                for side, count in zip(sides, (layers[left], layers[right]), strict=True)
            )
            inner = np.unique(np.concatenate([left + near, right - far]).round(12))
            inner = inner[(inner - left > 1e-9 * share) & (right - inner > 1e-9 * share)]
        lines.append(np.append(inner, right))
    return np.concatenate(lines)


def _outward(start: float, end: float, beyond: float, widest_mm: float) -> FloatArray:
    """Distances from an edge at which lines lie, from where its layers begin to where its side of a gap ends.

    `beyond` is the width of the gap's other side, which has the same lines in reverse: 0 if this is the only one.
    """
    found = [start]

    def step() -> float:
        return min((1 / OUTWARD - 1) * found[-1], max(widest_mm, SPREAD * found[-1]))

    while end - found[-1] > 1e-9 * end and (end + beyond - found[-1] - (found[-1] if beyond else 0.0)) > step():
        found.append(found[-1] + step())
    if found[-1] > end:
        found = [start + (place - start) * (end - start) / (found[-1] - start) for place in found]
    return np.array(found)


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
