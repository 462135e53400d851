"""The scale bar and the axes beside a body in a picture, as meshes in its coordinates.

So they are right in perspective, in a film and turned in a browser, too.
"""

from typing import Literal

import numpy as np
import pyvista as pv

from fem.pictures.colours import round_step
from geometry.layout import FloatArray

Camera = Literal["iso", "top", "front", "side"]

LETTER = 0.024  #: height of letters, of the body's larger side
AXES = 0.08  #: length of the axes' arrows, of the same


def draw_scenery(points_mm: FloatArray, camera: Camera) -> pv.PolyData:
    """A scale bar with its length and named arrows along the axes, before and left of the body as a camera sees it.

    Parameters
    ----------
    points_mm : array, shape (n, 3)
        What the body fills, at rest and loaded.
    camera : {"iso", "top", "front", "side"}
    """
    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    right, up = directions(camera)
    if camera in ("front", "side"):  # in the middle of the depth, or the nearest plane that is drawn would cut it off
        low = np.where(right + up > 0, low, (low + high) / 2)
    size = float((high - low).max())
    letter, width = LETTER * size, float((high - low) @ right)
    length = bar_length(width)
    end = low + width * right - 1.8 * letter * up
    meshes = _bar(end - length * right, length, letter, right, up)
    corner = low - (AXES * size + 2.2 * letter) * right
    across = np.cross(right, up)
    for axis, name in zip(np.eye(3), "xyz", strict=True):
        if camera == "iso" or abs(across @ axis) < 0.5:  # not at the onlooker
            meshes += _arrow(corner, AXES * size, axis, name, letter, right, axis if name == "z" else up)
    return pv.merge(meshes)


def directions(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Axes along which letters run and stand for a camera: on the ground, or on the side that it looks at."""
    right, up = np.eye(3)[1 if camera == "side" else 0], np.eye(3)[1 if camera in ("iso", "top") else 2]
    return right, up


def unit_names(rows: int, cols: int, pitch_mm: float) -> pv.PolyData:
    """Names of an array's rows and columns as numbered in files, on the ground right of it and before it."""
    letter = LETTER * pitch_mm * max(rows, cols)
    x, y = (pitch_mm * (np.arange(n) - (n - 1) / 2) for n in (cols, rows))
    right, up = directions("iso")
    edge, front = pitch_mm * cols / 2, -pitch_mm * rows / 2
    places = [(f"col {j}" if j == 0 else f"{j}", (at, front - 1.2 * letter)) for j, at in enumerate(x)]
    places += [(f"row {i}" if i == 0 else f"{i}", (edge + 1.6 * letter, at)) for i, at in enumerate(y)]
    return pv.merge([_word(text, np.array([*place, 0.0]), letter, right, up) for text, place in places])


def bar_length(width_mm: float) -> float:
    """A round length of about a quarter of a width [mm].

    >>> bar_length(90.0), bar_length(30.0)
    (20.0, 5.0)
    """
    return round_step(width_mm)


def _bar(start: FloatArray, length: float, letter: float, right: FloatArray, up: FloatArray) -> list[pv.PolyData]:
    """A line between two ticks, its length below it."""
    corners = [start, start + length * right]
    thick = 0.07 * letter
    line = _strip(corners[0], corners[1], thick * up)
    ticks = [_strip(at - 0.3 * letter * up, at + 0.3 * letter * up, thick * right) for at in corners]
    words = _word(f"{length:g} mm", start + length / 2 * right - 1.3 * letter * up, letter, right, up)
    return [line, *ticks, words]


def _arrow(
    start: FloatArray, length: float, axis: FloatArray, name: str, letter: float, right: FloatArray, up: FloatArray
) -> list[pv.PolyData]:
    """An arrow along an axis, with its name beyond its tip."""
    arrow = pv.Arrow(
        start=start, direction=axis, scale=length, tip_length=0.3, tip_radius=0.1, shaft_radius=0.03,
        tip_resolution=16, shaft_resolution=10,
    )  # fmt: skip
    return [arrow, _word(name, start + (length + 0.9 * letter) * axis, letter, right, up)]


def _strip(start: FloatArray, end: FloatArray, half: FloatArray) -> pv.PolyData:
    """A flat line, twice as wide as `half` is long."""
    return pv.PolyData(np.array([start - half, end - half, end + half, start + half]), faces=[4, 0, 1, 2, 3])


def _word(text: str, centre: FloatArray, height: float, right: FloatArray, up: FloatArray) -> pv.PolyData:
    """Flat letters about a point, along two directions; x heights vary, so lines of figures set their size."""
    flat = pv.Text3D(text, depth=0.0)
    points = np.asarray(flat.points, dtype=float)
    reference = float(np.ptp(np.asarray(pv.Text3D("0", depth=0.0).points)[:, 1]))
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    place = (points - middle) * (height / reference)
    moved = centre + place[:, :1] * right + place[:, 1:2] * up
    return pv.PolyData(moved, faces=flat.faces)
