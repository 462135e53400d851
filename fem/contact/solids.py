"""Tools of files as indenters: the lowest of a closed surface's triangles over each point of a raster.

The lowest surface presses whichever way its faces look, so that parts may be mirrored or inside out. Upright lines tell
whether it is closed: each meets it an even number of times.
"""

import logging
import re
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fem.contact.shapes import UNITS, ShapeError, Solid, proposed_units, require_lengths
from geometry.layout import FloatArray

USUAL_MM = (3.0, 2000.0)  #: extents of tools that are taken for mm unasked
MAX_BYTES, MAX_TRIANGLES = 500_000_000, 2_000_000
RASTER, FINE_MM = 800, 0.05  #: points along the longer side of a height map, and more where they lie further apart
MAX_RASTER = 1600
MAX_POINTS = 1_000_000  #: of a raster within the boxes of triangles that are looked at together
ASIDE = (0.382, 0.586)  #: of a step, beside the raster: lines that meet no edge
OPEN_SHARE = 1e-4  #: of the lines over a solid, that may meet its surface an odd number of times: cracks
INWARD_SHARE = 1e-3  #: of the underside that faces inwards, from which on that is said
STEP_DEVIATION, STEP_ANGLE = 1e-4, 0.1  #: of triangles from a STEP file's surfaces: of its size, and [rad]
LOG = logging.getLogger("tripillar")
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])  #: of a binary STL
VERTEX = re.compile(rb"\bvertex[ \t]+(\S+[ \t]+\S+[ \t]+\S+)", re.IGNORECASE)
COMMA = re.compile(rb"^\s*(?:vertex|v)?[\d\s.eE+-]*\d,\d", re.MULTILINE)


def read_solid(
    path: Path,
    *,
    unit: str | None = None,
    scale: float = 1.0,
    turn_deg: Sequence[float] = (0.0, 0.0, 0.0),
    say: Callable[[str], None] = LOG.warning,
) -> Solid:
    """Read an STL, OBJ, PLY or STEP file as an indenter that moves down along z.

    Parameters
    ----------
    path : path
    unit : str, optional
        Of the file's numbers: mm, cm, m or inch; default: mm, where that makes a tool of a usual size. STEP states it.
    scale : float
        Makes the tool so many times as large.
    turn_deg : sequence of float
        Angles by which the tool is turned about x, then y, then z.
    say : function
        Takes notes on what was mended.

    Raises
    ------
    ShapeError
        If the file is missing or damaged, its surface not closed, or its unit in doubt.
    """
    is_step = path.suffix.lower() in (".step", ".stp")
    if unit not in (None, *UNITS) or (unit and is_step):
        raise ShapeError(
            f"unit={unit} must be {', '.join(UNITS)}." if not is_step else f"unit={unit}: {path} states its own."
        )
    if not 0 < scale < np.inf:
        raise ShapeError(f"scale={scale:g} must be above 0.")
    if np.shape(turn_deg) != (3,) or not np.abs(turn_deg).max() <= 360:
        raise ShapeError(f"turn_deg={turn_deg} must be three angles from -360 to 360 degrees: about x, y and z.")
    if not path.is_file():
        raise ShapeError(f"{path}: there is no such file: give an STL, OBJ, PLY or STEP file of a closed surface.")
    if path.stat().st_size > MAX_BYTES:
        raise ShapeError(f"{path}: over {MAX_BYTES / 1e6:g} MB: reduce it to {MAX_TRIANGLES:,} triangles.")
    try:
        triangles = _of_step(path) if is_step else _triangles(path, path.read_bytes(), say)
    except ShapeError:
        raise
    except Exception:  # their readers raise of many kinds
        kind = path.suffix[1:].upper()
        raise ShapeError(f"{path}: damaged, or no {kind}: give a {kind} file of a closed surface.") from None
    if not len(triangles) or not np.isfinite(triangles).all():
        raise ShapeError(f"{path}: holds no triangles: give an STL, OBJ, PLY or STEP file of a closed surface.")
    if len(triangles) > MAX_TRIANGLES:
        raise ShapeError(f"{path}: has {len(triangles):,} triangles: reduce it to {MAX_TRIANGLES:,}.")
    large = float(np.ptp(triangles, axis=(0, 1)).max())
    if unit is None and scale == 1.0 and not is_step and not USUAL_MM[0] <= large <= USUAL_MM[1]:
        raise ShapeError(
            f"{path}: a tool of {large:.3g} mm, if its numbers are mm: give {proposed_units(large)}, or unit=mm if it is so."
        )
    turned = triangles @ Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix().T
    return _solid_of(turned * (scale * UNITS[unit or "mm"]), path, say)


def _triangles(path: Path, data: bytes, say: Callable[[str], None]) -> FloatArray:
    """Triangles (n, 3 corners, 3) of the text or bytes of a file."""
    is_stl, is_text = path.suffix.lower() == ".stl", b"\0" not in data
    if is_text and COMMA.search(data):
        say(f"warning: {path}: its decimal commas are read as points")
        data = data.replace(b",", b".")
    if is_stl and is_text:
        lines = VERTEX.findall(data)
        if len(lines) % 3:
            raise ShapeError(f"{path}: cut off within a triangle: copy or export it again.")
        return np.loadtxt(lines, ndmin=2).reshape(-1, 3, 3) if lines else np.zeros((0, 3, 3))
    if is_stl:
        stated, there = int.from_bytes(data[80:84], "little"), max(len(data) - 84, 0) // RECORD.itemsize
        if there < stated <= 1000 * max(there, 1):
            raise ShapeError(
                f"{path}: cut off: it holds {there:,} of the {stated:,} triangles that its head states: copy or "
                "export it again."
            )
        return np.frombuffer(data, RECORD, stated, 84)["corners"].astype(float)
    import trimesh

    mesh = trimesh.load(BytesIO(data), file_type=path.suffix[1:].lower(), force="mesh", process=False)
    return np.asarray(mesh.triangles, dtype=float)


def _of_step(path: Path) -> FloatArray:
    from build123d import import_step

    shape = import_step(path)
    vertices, faces = shape.tessellate(STEP_DEVIATION * shape.bounding_box().diagonal, STEP_ANGLE)
    return np.array([tuple(vertex) for vertex in vertices])[np.array(faces)]


def _solid_of(triangles_mm: FloatArray, path: Path, say: Callable[[str], None]) -> Solid:
    """Height map of a closed surface's triangles, shape (n, 3 corners, 3)."""
    low, high = triangles_mm.min(axis=(0, 1)), triangles_mm.max(axis=(0, 1))
    size = high - low
    require_lengths(**{f"extent along {axis}": length for axis, length in zip("xyz", size, strict=True)})
    corners = triangles_mm - np.array([*(low + high)[:2] / 2, low[2]])
    step = max(size[:2].max() / MAX_RASTER, min(FINE_MM, size[:2].max() / RASTER))
    x, y = (np.linspace(-length / 2, length / 2, max(2, round(length / step)) + 1) for length in size[:2])
    beside = [line[:-1:2] + share * (line[1] - line[0]) for line, share in zip((x, y), ASIDE, strict=True)]
    if not _is_closed(corners, *beside):
        _, places = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        _, once = np.unique(np.sort(places.reshape(-1, 3)), axis=0, return_index=True)
        if len(once) == len(corners) or not _is_closed(corners[once], *beside):
            raise ShapeError(f"{path}: the surface is not closed: mend the holes, so that it bounds a solid.")
        say(f"warning: {path}: {len(corners) - len(once):,} of its triangles are there twice: they are taken once")
    tip = corners.reshape(-1, 3)[corners[..., 2].argmin()]
    x, y = (
        line if np.abs(line - at).min() < 1e-6 * step else np.union1d(line, at)
        for line, at in zip((x, y), tip[:2], strict=True)
    )
    (ax, ay), (bx, by), (cx, cy) = corners[..., :2].transpose(1, 2, 0)
    doubled = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)  # 0 of upright faces, which have no area from below
    outward, inward = (_lowest(corners[side], x, y) for side in (doubled < 0, doubled > 0))
    faces_in = inward < outward - 1e-6 * step
    heights = np.where(faces_in, inward, outward)
    share = faces_in.sum() / np.isfinite(heights).sum()
    if share > INWARD_SHARE:
        say(f"warning: {path}: {share:.0%} of its underside faces inwards: it presses as if all faced outwards")
    return Solid(x, y, heights, float(size[2]))


def _is_closed(corners: FloatArray, x: FloatArray, y: FloatArray) -> bool:
    """Whether upright lines meet triangles an even number of times, but for cracks."""
    count = np.zeros(len(y) * len(x), dtype=int)
    for place, _ in _met(corners, x, y):
        count += np.bincount(place, minlength=len(count))
    return bool((count % 2).sum() <= OPEN_SHARE * (count > 0).sum())


def _lowest(corners: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Height of the lowest triangle over each point of a raster, (ny, nx), infinite where there is none."""
    heights = np.full(len(y) * len(x), np.inf)
    for place, z in _met(corners, x, y):
        np.minimum.at(heights, place, z)
    return heights.reshape(len(y), len(x))


def _met(corners: FloatArray, x: FloatArray, y: FloatArray) -> Iterator[tuple[NDArray[np.int_], FloatArray]]:
    """Points of a raster, row by row, over or under triangles, and these's heights there; some triangles at a time."""
    edge = 1e-9 * np.ptp(x) / len(x)
    (x0, x1), (y0, y1) = (
        np.searchsorted(line, [corners[..., d].min(axis=1) - edge, corners[..., d].max(axis=1) + edge])
        for d, line in enumerate((x, y))
    )
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corners.transpose(1, 2, 0)
    doubled = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    points = (x1 - x0) * (y1 - y0) * (doubled != 0)
    some = np.flatnonzero(points)
    for block in np.split(some, np.flatnonzero(np.diff(np.cumsum(points[some]) // MAX_POINTS)) + 1):
        k, column = _each(block, x0[block], x1[block])
        px = x[column] - ax[k]
        # b, c and 1 - b - c are at least 0 in a triangle: between two y of each column
        slope = np.array([(ax - cx)[k], (bx - ax)[k], (cx - bx)[k]]) / doubled[k]
        at_a = np.array([px * (cy - ay)[k], px * (ay - by)[k], px * (by - cy)[k] + doubled[k]]) / doubled[k] + 1e-6
        with np.errstate(divide="ignore", invalid="ignore"):
            root = ay[k] - at_a / slope
        first = np.searchsorted(y, np.where(slope > 0, root, -np.inf).max(axis=0))
        last = np.searchsorted(y, np.where(slope < 0, root, np.inf).min(axis=0))
        number, row = _each(np.arange(len(k)), np.maximum(first, y0[k]), np.minimum(last, y1[k]))
        k, column, px = k[number], column[number], px[number]
        py = y[row] - ay[k]
        b = (px * (cy - ay)[k] - py * (cx - ax)[k]) / doubled[k]
        c = (py * (bx - ax)[k] - px * (by - ay)[k]) / doubled[k]
        inside = (b >= -1e-9) & (c >= -1e-9) & (b + c <= 1 + 1e-9)
        z = az[k] + b * (bz - az)[k] + c * (cz - az)[k]
        yield (row * len(x) + column)[inside], z[inside]


def _each(
    owners: NDArray[np.int_], first: NDArray[np.int_], last: NDArray[np.int_]
) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Owners and numbers of all numbers from a first up to before a last one."""
    count = np.maximum(last - first, 0)
    return np.repeat(owners, count), np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - first, count)
