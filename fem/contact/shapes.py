"""Rigid indenters as heights of their underside above its lowest point: sphere, cylinder, flat punch, file.

Capsules and convex bodies stand as they are turned in space, for simulators that move them; the others turn about z.
"""

import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from common.errors import TriPillarError
from common.pool import open_pool
from geometry.layout import FloatArray

MAX_MM = 1e4  #: of a radius or a length
MIN_SLOPE = 1e-9  #: of the z of a face's normal; others stand upright
UNITS = {"mm": 1.0, "cm": 10.0, "inch": 25.4, "m": 1000.0}  #: of files, in mm
TOOL_FILES = (".stl", ".obj", ".ply", ".step", ".stp")
USUAL_MM, LIKELY_MM = (1.0, 2000.0), (1.0, 500.0)  #: extents that are taken for mm unasked, and that a unit is to give
SMALL_MM = 3.0  #: under which that is said: larger tools in cm and inches look so
MAX_BYTES, MAX_TRIANGLES = (120_000_000, 30_000_000), 1_000_000  #: of files of triangles and of STEP
STEP_SHARE, STEP_ANGLE = 2e-5, 0.05  #: of triangles off its surfaces: of its size, [rad]
STEP_S, STEP_WAIT_S = 50, 600.0  #: of processor time to read a STEP file, and to wait for that [s]
RASTER, FINE_MM, MAX_RASTER = 800, 0.05, 1600  #: points along a map's longer side; or so near, but not more
MAX_LAYERS, MAX_POINTS = 50.0, 1_000_000  #: triangles over a point, else there are fewer; points at a time
UPRIGHT, MAX_CRACKS, MIN_INWARD = 1e-13, 1e-4, 1e-3  #: shares of areas from below that do not count
FAR, MIX = 1e9, (np.exp(0.5), np.pi**0.5)  #: from the origin; no angle's: make one number of three, and lines off edges
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])  #: of a binary STL
VERTEX = re.compile(rb"(?i)\bvertex" + 3 * rb"\s+(\S{1,40})")  #: of a text STL


class ShapeError(TriPillarError, ValueError):
    """A shape without a size, or a file that holds no solid."""


def about_z(angle_deg: float) -> FloatArray:
    """Rotation (3, 3) about z, from x towards y."""
    if not abs(angle_deg) <= 360:
        raise ShapeError(f"turn_deg={angle_deg:g} must be from -360 to 360 degrees.")
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Shape:
    """A rigid body that touches with its underside.

    One that gives `own_heights_mm` and `own_extents_mm` has its origin at its lowest point and turns about z alone.
    """

    high_mm = in_file = np.inf  #: of its highest point above its lowest one, and that in numbers of its file
    #: rotation (3, 3) from its own axes to the sensor's
    turn: FloatArray = field(default_factory=lambda: np.eye(3), kw_only=True)

    def __post_init__(self) -> None:
        if self.turn[2, 2] < 1 - MIN_SLOPE:
            raise ShapeError("this shape turns about z alone: tip a Convex or a Capsule.")

    @property
    def lowest_mm(self) -> float:
        """Height of its lowest point above its origin."""
        return 0.0

    def heights_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Height of the underside above its lowest point, infinite where there is none [mm]; x and y broadcast."""
        cos, sin = self.turn[:2, 0]
        return self.own_heights_mm(x_mm * cos + y_mm * sin, y_mm * cos - x_mm * sin)

    def half_extents_mm(self, height_mm: float) -> tuple[float, float]:
        """Half the extent along x and y of what lies below a height [mm], or of a box that turns along."""
        (cos, sin), (x, y) = np.abs(self.turn[:2, 0]), self.own_extents_mm(height_mm)
        return float(x * cos + y * sin), float(x * sin + y * cos)

    def own_heights_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """`heights_mm` along its own axes."""
        raise NotImplementedError

    def own_extents_mm(self, height_mm: float) -> tuple[float, float]:
        """`half_extents_mm` along its own axes."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Cylinder(Shape):
    """A round bar lying along x, its ends cut square."""

    radius_mm: float
    length_mm: float = MAX_MM

    def __post_init__(self) -> None:
        super().__post_init__()
        _require(radius_mm=self.radius_mm, length_mm=self.length_mm)

    def own_heights_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        return np.where(np.abs(x_mm) <= self.length_mm / 2, _arc(y_mm, self.radius_mm), np.inf)

    def own_extents_mm(self, height_mm: float) -> tuple[float, float]:
        return self.length_mm / 2, _half_chord(self.radius_mm, height_mm)


@dataclass(frozen=True, eq=False)
class Flat(Shape):
    """A flat punch with square edges: a rectangle, or a disc if it has a radius."""

    size_mm: tuple[float, float] = (0.0, 0.0)  #: along x and y
    radius_mm: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for length in self.size_mm if self.radius_mm is None else (self.radius_mm,):
            _require(**{"size_mm" if self.radius_mm is None else "radius_mm": length})

    def own_heights_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        half_x, half_y = self.own_extents_mm(0.0)
        inside = (np.abs(x_mm) <= half_x) & (np.abs(y_mm) <= half_y)
        if self.radius_mm is not None:
            inside = np.hypot(x_mm, y_mm) <= self.radius_mm
        return np.where(inside, 0.0, np.inf)

    def own_extents_mm(self, height_mm: float) -> tuple[float, float]:
        radius_mm = self.radius_mm
        return (self.size_mm[0] / 2, self.size_mm[1] / 2) if radius_mm is None else (radius_mm, radius_mm)


@dataclass(frozen=True, eq=False)
class Solid(Shape):
    """The underside of any solid as a map of heights; `read_solid` makes one of a file."""

    x_mm: FloatArray  #: (nx,), increasing, about the middle of its box
    y_mm: FloatArray  #: (ny,)
    map_mm: FloatArray  #: (ny, nx), 0 at the lowest point, infinite where the solid is not
    high_mm: float = np.inf
    in_file: float = np.inf
    notes: tuple[str, ...] = ()  #: what was mended of its file

    def own_heights_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Between points of the map; infinite where one of them is."""
        lines = (self.y_mm, self.x_mm)
        between = RegularGridInterpolator(lines, self.map_mm, bounds_error=False, fill_value=np.inf)
        with np.errstate(invalid="ignore"):
            found = between(np.stack(np.broadcast_arrays(y_mm, x_mm), axis=-1))
        return np.asarray(np.where(np.isfinite(found), found, np.inf))

    def own_extents_mm(self, height_mm: float) -> tuple[float, float]:
        x, y = (np.abs(line[low < height_mm]).max() for line, low in self._lowest)
        return float(x), float(y)

    @cached_property
    def _lowest(self) -> list[tuple[FloatArray, FloatArray]]:
        """The lines of its map along x and y, and the lowest point of each."""
        return [(line, self.map_mm.min(axis=axis)) for axis, line in enumerate((self.x_mm, self.y_mm))]


@dataclass(frozen=True, eq=False)
class Capsule(Shape):
    """All points within a radius of a line along its own z, about its middle; without a length a ball."""

    radius_mm: float
    length_mm: float = 0.0  #: of the line

    def __post_init__(self) -> None:
        _require(radius_mm=self.radius_mm, **{"length_mm": self.length_mm} if self.length_mm else {})

    @property
    def lowest_mm(self) -> float:
        return -self.radius_mm - abs(float(self.turn[2, 2])) * self.length_mm / 2

    def heights_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        (ax, ay, az), r = self.turn[:, 2], self.radius_mm
        flat = float(np.hypot(ax, ay))
        cos, sin = (ax / flat, ay / flat) if flat else (1.0, 0.0)
        along, across2 = x_mm * cos + y_mm * sin, (y_mm * cos - x_mm * sin) ** 2
        # the lowest of all balls over a point touches where the line's slope is its own
        at = (along - np.sqrt(np.maximum(r**2 - across2, 0.0)) * az) / flat if flat else -np.sign(az) * np.inf
        middle = np.clip(at, -self.length_mm / 2, self.length_mm / 2)
        beside2 = (along - flat * middle) ** 2 + across2
        return _arc(np.sqrt(beside2), r) + abs(az) * self.length_mm / 2 + az * middle

    def half_extents_mm(self, height_mm: float) -> tuple[float, float]:
        half = _half_chord(self.radius_mm, height_mm)
        x, y, _ = np.abs(self.turn[:, 2]) * self.length_mm / 2
        return float(x + half), float(y + half)


@dataclass(frozen=True, eq=False)
class Sphere(Capsule):
    """A ball; its origin is its lowest point, that of a `Capsule` without a length its middle."""

    length_mm: float = field(default=0.0, init=False)

    @property
    def lowest_mm(self) -> float:
        return 0.0


@dataclass(frozen=True, eq=False)
class Convex(Shape):
    """A convex body by its faces."""

    corners_mm: FloatArray  #: (n, 3), about its origin, along its own axes
    faces: FloatArray  #: (m, 4): normals outwards, and −normal · point [mm]

    def __post_init__(self) -> None:
        """It may be tipped."""

    @classmethod
    def hull(cls, points_mm: FloatArray) -> "Convex":
        """The convex hull of points (n, 3); `ShapeError` if they bound no volume."""
        from scipy.spatial import ConvexHull, QhullError

        try:
            found = ConvexHull(points_mm)
        except (QhullError, ValueError):
            raise ShapeError("these points bound no volume: give four or more that do not lie in a plane.") from None
        return cls(np.asarray(points_mm)[found.vertices], np.unique(found.equations.round(9), axis=0))

    @cached_property
    def lowest_mm(self) -> float:
        return float((self.corners_mm @ self.turn[2]).min())

    def heights_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        normals = self.faces[:, :3] @ self.turn.T
        at = normals[:, 0] * x_mm[..., None] + normals[:, 1] * y_mm[..., None] + self.faces[:, 3]
        up, down = normals[:, 2] > MIN_SLOPE, normals[:, 2] < -MIN_SLOPE
        low = (-at[..., down] / normals[down, 2]).max(axis=-1)
        high = (-at[..., up] / normals[up, 2]).min(axis=-1)
        inside = (low <= high) & (at[..., ~(up | down)] <= 0.0).all(axis=-1)
        return np.where(inside, low - self.lowest_mm, np.inf)

    def half_extents_mm(self, height_mm: float) -> tuple[float, float]:
        x, y, _ = np.abs(self.corners_mm @ self.turn.T).max(axis=0)
        return float(x), float(y)


def read_solid(path: Path, unit: str | None = None, scale: float = 1.0, turn_deg: Sequence[float] = (0, 0, 0)) -> Solid:
    """Read an STL, OBJ, PLY or STEP file as an indenter that moves down along z; its notes say what was mended.

    Numbers without a unit of `UNITS` are mm, if that makes a tool of a usual size; STEP states its own. It is turned
    about x, then y, then z, and presses with its lowest surface, whichever way that faces. A `ShapeError` says that the
    file is missing, damaged or too large, its surface not closed, or its unit in doubt.
    """
    ending = path.suffix.lower()
    is_step = ending in (".step", ".stp")
    if unit not in (None, *UNITS) or (unit and is_step):
        raise ShapeError(f"unit={unit} must be {', '.join(UNITS)}, and left out of STEP files, which state it.")
    if not 0 < scale < np.inf or not np.abs(turn_deg).max() <= 360:
        raise ShapeError(f"scale={scale:g} must be above 0, and angles of turn_deg= from -360 to 360 degrees.")
    if not path.is_file() or ending not in TOOL_FILES:
        raise ShapeError(f"{path}: there is no such file, or it is none of a closed surface in STL, OBJ, PLY or STEP.")
    if path.stat().st_size > MAX_BYTES[is_step]:
        raise ShapeError(f"{path}: over {MAX_BYTES[is_step] / 1e6:g} MB: leave out what does not press.")
    notes: list[str] = []
    try:
        if is_step:  # what is damaged may end its reader, and prints pages
            if b"END-ISO-10303-21" not in path.read_bytes():
                raise ShapeError(f"{path}: no STEP file, or cut off: export it again.")
            with open_pool(1) as pool:
                triangles = pool.executor.submit(_of_step, path).result(STEP_WAIT_S)
        else:
            triangles = _of_mesh(path, ending[1:], notes)
    except ShapeError:
        raise
    except Exception:  # their readers raise of many kinds
        raise ShapeError(f"{path}: damaged, cut off, too large, or no {ending[1:].upper()}: export it again.") from None
    if not 0 < len(triangles) <= MAX_TRIANGLES or not np.abs(triangles).max() < FAR:
        raise ShapeError(f"{path}: holds no triangles, over {MAX_TRIANGLES:,}, or corners without a place.")
    large = np.ptp(triangles, axis=(0, 1)).max()
    if unit is None and scale == 1.0 and not is_step and not USUAL_MM[0] <= large <= USUAL_MM[1]:
        raise ShapeError(f"{path}: {large:.3g} mm large if in mm: give {proposed_units(large)}, or unit=mm if so.")
    if unit is None and scale == 1.0 and not is_step and large < SMALL_MM:
        notes.append(f"{path}: states no unit and is taken for mm: give {proposed_units(large)}")
    turned = triangles @ Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix().T
    factor = scale * UNITS[unit or "mm"]
    return _solid_of(turned * factor, factor, path, notes)


def proposed_units(extent: float, least_mm: float = 0.0) -> str:
    """What to give where a number in a file is no likely extent of a tool: units by which it is."""
    fit = [unit for unit, mm in UNITS.items() if max(least_mm, LIKELY_MM[0]) <= extent * mm <= LIKELY_MM[1]]
    return " or ".join(f"unit={unit} ({extent * UNITS[unit]:.3g} mm)" for unit in fit) or "its unit= or scale="


@np.errstate(all="ignore")
def _of_mesh(path: Path, ending: str, notes: list[str]) -> FloatArray:
    """Triangles (n, 3 corners, 3) of a file of triangles."""
    data = path.read_bytes()
    if (is_text := b"\0" not in data) and re.search(rb"\d,\d", data):
        notes.append(f"{path}: its decimal commas are read as points")
        data = data.replace(b",", b".")
    if ending == "stl" and is_text:
        return np.array(VERTEX.findall(data)).astype(float).reshape(-1, 3, 3)
    if ending == "stl":
        stated, there = int.from_bytes(data[80:84], "little"), (len(data) - 84) // 50
        if there < stated <= 1000 * there:
            raise ShapeError(f"{path}: cut off: it holds {there:,} of {stated:,} triangles: copy or export it again.")
        return np.frombuffer(data, RECORD, stated or there, 84)["corners"].astype(float)
    import trimesh

    return np.asarray(trimesh.load(BytesIO(data), file_type=ending, force="mesh", process=False).triangles @ np.eye(3))


def _of_step(path: Path) -> FloatArray:
    """In a process of its own, which ends where the file takes it too long."""
    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (STEP_S, resource.getrlimit(resource.RLIMIT_CPU)[1]))
    from build123d import import_step

    shape = import_step(path)
    vertices, faces = shape.tessellate(STEP_SHARE * shape.bounding_box().diagonal, STEP_ANGLE)
    return np.array([tuple(vertex) for vertex in vertices])[np.array(faces)]


def _solid_of(triangles_mm: FloatArray, factor: float, path: Path, notes: list[str]) -> Solid:
    """Height map of a closed surface's triangles, (n, 3 corners, 3), by the lowest over each point."""
    low, high = triangles_mm.min(axis=(0, 1)), triangles_mm.max(axis=(0, 1))
    size = high - low
    _require(**{f"{path}: extent along {axis}": length for axis, length in zip("xyz", size, strict=True)})
    corners = triangles_mm - np.array([*(low + high)[:2] / 2, low[2]])
    doubled = np.linalg.det(np.diff(corners[..., :2], axis=1))  # 0 of upright faces, which have no area from below
    wide, layers = size[:2].max(), np.abs(doubled) / 2 / size[:2].prod()
    corners, faces_in = corners[layers > UPRIGHT], doubled[layers > UPRIGHT] > 0
    step = max(wide / MAX_RASTER, min(FINE_MM, wide / RASTER)) * max(1.0, layers.sum() / MAX_LAYERS) ** 0.5
    x, y = (np.linspace(-length / 2, length / 2, max(2, round(length / step)) + 1) for length in size[:2])
    beside = x[:-1:2] + (x[1] - x[0]) / MIX[0], y[:-1:2] + (y[1] - y[0]) / MIX[1]
    # bodies that touch share triangles: those that are there twice are taken once only if that leaves it closed
    mixed = np.sort(corners[..., 0] + MIX[0] * corners[..., 1] + MIX[1] * corners[..., 2])
    once = np.unique(mixed[:, 0] + MIX[0] * mixed[:, 1] + MIX[1] * mixed[:, 2], return_index=True)[1]
    for taken in (corners[once], corners):  # upright lines meet it an even number of times, but for cracks
        count = sum(np.bincount(place, minlength=beside[1].size * beside[0].size) for place, _ in _met(taken, *beside))
        if np.sum(count % 2) < MAX_CRACKS * np.sum(count > 0):
            break
    else:
        raise ShapeError(f"{path}: the surface is not closed: mend the holes, so that it bounds a solid.")
    if twice := len(corners) - len(taken):
        notes.append(f"{path}: {twice:,} of its triangles are there twice: they are taken once")
    tip = corners.reshape(-1, 3)[corners[..., 2].argmin()]
    x, y = np.union1d(x, tip[0]), np.union1d(y, tip[1])
    outward, inward = (_lowest(corners[side], x, y) for side in (~faces_in, faces_in))
    heights, is_inward = np.minimum(outward, inward), inward < outward - 1e-6 * step
    if (share := is_inward.sum() / np.isfinite(heights).sum()) > MIN_INWARD:
        notes.append(f"{path}: {share:.0%} of its underside faces inwards: it presses as if all faced outwards")
    return Solid(x, y, np.where(is_inward, heights, outward) - tip[2], size[2], size[2] / factor, tuple(notes))


def _lowest(corners: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Height of the lowest triangle over each point of a raster, (ny, nx), infinite where there is none."""
    heights = np.full(len(y) * len(x), np.inf)
    for place, z in _met(corners, x, y):
        np.minimum.at(heights, place, z)
    return heights.reshape(len(y), len(x))


def _met(corners: FloatArray, x: FloatArray, y: FloatArray) -> Iterator[tuple[np.ndarray, FloatArray]]:
    """Points of a raster, row by row, where triangles lie, and their heights there; of some triangles at a time."""
    edge = 1e-9 * np.ptp(x) / len(x)
    low, high = corners.min(axis=1) - edge, corners.max(axis=1) + edge
    (x0, x1), (y0, y1) = (np.searchsorted(line, [low[:, d], high[:, d]]) for d, line in enumerate((x, y)))
    a, to_b, to_c = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    parts = 1 + ((x1 - x0) * (y1 - y0)).sum() // MAX_POINTS
    for part in range(parts):
        k, column = _each(np.arange(part, len(a), parts), x0[part::parts], x1[part::parts])
        (ux, uy, uz), (vx, vy, vz) = to_b[k].T, to_c[k].T
        px, doubled = x[column] - a[k, 0], ux * vy - uy * vx
        # the shares of its corners in a point, here for y = 0, are all above 0 between two y of each column
        share = np.array([px * vy, -px * uy, doubled - px * (vy - uy)]) / doubled + 1e-6
        slope = np.array([-vx, ux, vx - ux]) / doubled
        with np.errstate(divide="ignore", invalid="ignore"):
            root = a[k, 1] - share / slope
        first = np.searchsorted(y, np.where(slope > 0, root, -np.inf).max(axis=0))
        last = np.searchsorted(y, np.where(slope < 0, root, np.inf).min(axis=0))
        n, row = _each(np.arange(len(k)), np.maximum(first, y0[k]), np.minimum(last, y1[k]))
        k, py, doubled = k[n], y[row] - a[k[n], 1], doubled[n]
        b, c = ((px * vy)[n] - py * vx[n]) / doubled, (py * ux[n] - (px * uy)[n]) / doubled
        inside = (b >= -1e-9) & (c >= -1e-9) & (b + c <= 1 + 1e-9)
        yield (row * len(x) + column[n])[inside], (a[k, 2] + b * uz[n] + c * vz[n])[inside]


def _each(owner: np.ndarray, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Owners and numbers of all numbers from the first up to before the last of each."""
    count = np.maximum(last - first, 0)
    return np.repeat(owner, count), np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - first, count)


def _arc(across_mm: FloatArray, radius_mm: float) -> FloatArray:
    """Height of a circle above its lowest point; without cancellation near it."""
    inside = np.abs(across_mm) < radius_mm
    flat = np.where(inside, across_mm, 0.0) ** 2
    return np.where(inside, flat / (radius_mm + np.sqrt(radius_mm**2 - flat)), np.inf)


def _half_chord(radius_mm: float, height_mm: float) -> float:
    return float(np.sqrt(height_mm * (2 * radius_mm - height_mm))) if height_mm < radius_mm else radius_mm


def _require(**lengths: float) -> None:
    for name, length in lengths.items():
        if not 1e-3 <= length <= MAX_MM:
            raise ShapeError(f"{name}={length:g} must be from 0.001 to {MAX_MM:g} mm.")
