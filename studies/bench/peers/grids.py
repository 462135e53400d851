"""Structured grids for programs that take a mesh: lines through the outlines of loads and probes."""

from itertools import pairwise

import numpy as np

from fem.grid import geometric_line
from fem.scene import Scene
from geometry.layout import FloatArray


def scene_lines(scene: Scene, n: float, graded: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Grid lines along x, y and z in the scene's coordinates.

    Parameters
    ----------
    scene : Scene
        Its body must be an upright box.
    n : float
        Elements along half of the smallest load.
    graded : bool
        Shrink elements toward load outlines and the top, as the square root of the distance, which suits quadratic
        elements; else all are about as large.
    """
    size_mm = min(min(load.size_mm) for load in scene.loads) / 2
    x0, y0, x1, y1 = scene.top_mm
    lines = []
    for d, (start, end) in enumerate(((x0, x1), (y0, y1))):
        edges = sorted({float(rectangle[i]) for rectangle in scene.load_rectangles_mm for i in (d, d + 2)})
        stops = {float(rectangle[i]) for rectangle in scene.probe_rectangles_mm for i in (d, d + 2)}
        lines.append(_line(sorted({start, end, *edges, *stops}), edges, size_mm, n, graded))
    return lines[0], lines[1], _line([0.0, scene.height_mm], [scene.height_mm], size_mm, n, graded)


def geometric_lines(scene: Scene, layers: int, ratio: float = 0.2) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Few lines, geometrically closer toward load outlines and the top: for elements of high order."""
    x0, y0, x1, y1 = scene.top_mm
    lines = []
    for d, ends in enumerate(((x0, x1), (y0, y1))):
        wanted = dict.fromkeys([*ends, *scene.probe_rectangles_mm[:, [d, d + 2]].ravel().tolist()], 0)
        wanted |= dict.fromkeys(scene.load_rectangles_mm[:, [d, d + 2]].ravel().tolist(), layers)
        lines.append(geometric_line(wanted, ratio, widest_mm=scene.height_mm))
    return lines[0], lines[1], geometric_line({0.0: 0, scene.height_mm: layers}, ratio, widest_mm=scene.height_mm)


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
