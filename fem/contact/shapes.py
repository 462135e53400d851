"""Rigid indenters as heights of their underside above its lowest point: sphere, cylinder, flat punch, files.

Capsules and convex bodies stand as they are turned in space, for simulators that move them; the others turn about z.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from common.errors import TriPillarError
from geometry.layout import FloatArray

MAX_MM = 1e4  #: of a radius or a length
UNITS = {"mm": 1.0, "cm": 10.0, "inch": 25.4, "m": 1000.0}  #: of files, in mm
LIKELY_MM = (3.0, 500.0)  #: extents of tools for which a unit is proposed
MIN_SLOPE = 1e-9  #: of the z of a face's normal; others stand upright


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

    high_mm = np.inf  # of its highest point above its lowest one, where pressing deeper would bury it
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
        require_lengths(radius_mm=self.radius_mm, length_mm=self.length_mm)

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
            require_lengths(**{"size_mm" if self.radius_mm is None else "radius_mm": length})

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
    high_mm: float = np.inf  #: of its highest point

    def own_heights_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Between points of the map; infinite where one of them is."""
        lines = (self.y_mm, self.x_mm)
        between = RegularGridInterpolator(lines, self.map_mm, bounds_error=False, fill_value=np.inf)
        with np.errstate(invalid="ignore"):
            found = between(np.stack(np.broadcast_arrays(y_mm, x_mm), axis=-1))
        return np.asarray(np.where(np.isfinite(found), found, np.inf))

    def own_extents_mm(self, height_mm: float) -> tuple[float, float]:
        x, y = (line[low < height_mm] for line, low in self._lowest)
        return float(np.abs(x).max()), float(np.abs(y).max())

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
        require_lengths(radius_mm=self.radius_mm, **{"length_mm": self.length_mm} if self.length_mm else {})

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


def _arc(across_mm: FloatArray, radius_mm: float) -> FloatArray:
    """Height of a circle above its lowest point; without cancellation near it."""
    inside = np.abs(across_mm) < radius_mm
    flat = np.where(inside, across_mm, 0.0) ** 2
    return np.where(inside, flat / (radius_mm + np.sqrt(radius_mm**2 - flat)), np.inf)


def _half_chord(radius_mm: float, height_mm: float) -> float:
    return float(np.sqrt(height_mm * (2 * radius_mm - height_mm))) if height_mm < radius_mm else radius_mm


def proposed_units(extent: float, least_mm: float = 0.0) -> str:
    """What to give where a number in a file is no likely extent of a tool: units by which it is."""
    low, high = max(LIKELY_MM[0], least_mm), LIKELY_MM[1]
    fit = [f"unit={unit} ({extent * mm:.3g} mm)" for unit, mm in UNITS.items() if low <= extent * mm <= high]
    return " or ".join(fit or ["its unit= or scale="])


def require_lengths(**lengths: float) -> None:
    """Refuse lengths that no shape has [mm]."""
    for name, length in lengths.items():
        if not 1e-3 <= length <= MAX_MM:
            raise ShapeError(f"{name}={length:g} must be from 0.001 to {MAX_MM:g} mm.")
