"""Straight prisms between equal horizontal polygons or ellipses: the shape of slab, pillars and inclusions."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from common.quantity import OPTIONAL
from geometry.layout import (
    SECTIONS,
    FloatArray,
    Pair,
    extents_around,
    half_extents,
    leans_both_ways,
    pad_squares,
    pillar_ends,
    pillar_sections,
    pillar_vectors,
    pillar_widths,
    polygon_area,
    rest_lengths,
    unit_centres,
)

if TYPE_CHECKING:
    from geometry.design import SensorDesign, Unit

SIDES = 24  #: of the polygon that is drawn for a circle: flat faces meet exactly, and lie within 1 % of its radius
#: of the one that is meshed: six round pillars make 1.7 times the cells of square ones, by 24 sides nine
MESHED_SIDES = 8
Triple = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Prism:
    """A straight prism between two equal horizontal sections, such as rectangles: every body, every inclusion."""

    base_mm: Triple  #: centre of the lower end
    top_mm: Triple  #: centre of the upper end
    section_mm: Pair  #: extent of the horizontal section along x and y
    section: str = field(default="square", metadata=OPTIONAL)  #: which of `SECTIONS` is stretched to these extents
    is_turned: bool = field(default=False, metadata=OPTIONAL)  #: whether its extents are along its lean and across it

    @property
    def is_upright(self) -> bool:
        """True if its sides are vertical, so that it is a box."""
        return self.base_mm[:2] == self.top_mm[:2]

    @property
    def is_round(self) -> bool:
        """True if its section is an ellipse."""
        return not SECTIONS[self.section]

    @property
    def is_rectangular(self) -> bool:
        """True if its section is a rectangle along x and y."""
        return self.section == "square" and not self.is_turned

    @property
    def height_mm(self) -> float:
        return self.top_mm[2] - self.base_mm[2]

    @property
    def axis_mm(self) -> FloatArray:
        """From the middle of the lower end to that of the upper one, (3,)."""
        return np.subtract(self.top_mm, self.base_mm)

    @property
    def lean(self) -> Pair:
        """Shift of the axis along x and y per height."""
        x, y, z = self.axis_mm.tolist()
        return x / z, y / z

    @property
    def volume_mm3(self) -> float:
        a, b = half_extents(self.section)
        return self.section_mm[0] * self.section_mm[1] * self.height_mm * polygon_area(self.section) / (4 * a * b)

    @property
    def turn(self) -> FloatArray:
        """Directions of the section's two extents, one a row, (2, 2)."""
        if not self.is_turned:
            return np.eye(2)
        x, y = self.axis_mm[:2] / math.hypot(*self.axis_mm[:2])
        return np.array([[x, y], [-y, x]])

    def own(self, across_mm: FloatArray) -> FloatArray:
        """Horizontal offsets (n, 2) along the section's extents."""
        return across_mm @ self.turn.T if self.is_turned else across_mm

    def placed(self, own_mm: FloatArray) -> FloatArray:
        """Offsets (n, 2) along the section's extents along x and y."""
        return own_mm @ self.turn if self.is_turned else own_mm

    @property
    def extents_mm(self) -> FloatArray:
        """Of the rectangle along x and y around the section, (2,)."""
        widths_mm = np.divide(self.section_mm, half_extents(self.section))
        return extents_around(self.section, self.turn * widths_mm[:, None])

    @property
    def polygon(self) -> FloatArray:
        """Corners of the section along its extents, anticlockwise, (n, 2) [mm]; an ellipse has none."""
        corners = np.reshape(SECTIONS[self.section], (-1, 2))
        return np.asarray(corners / half_extents(self.section) * self.section_mm / 2)

    @property
    def sides(self) -> tuple[FloatArray, FloatArray]:
        """Outward normals (n, 2) of the polygon's sides, from a corner to the next, and their distances (n,) [mm]."""
        corners = self.polygon
        edges = np.roll(corners, -1, axis=0) - corners
        normals = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.linalg.norm(edges, axis=1, keepdims=True)
        return normals, (normals * corners).sum(axis=1)

    def axis_at(self, z_mm: FloatArray) -> FloatArray:
        """Centre of the section at heights (n,), shape (n, 2) [mm]."""
        share = (z_mm - self.base_mm[2]) / self.height_mm
        return np.array(self.base_mm[:2]) + share[:, None] * self.axis_mm[:2]

    def holds(self, points_mm: FloatArray, slack_mm: float = 0.0) -> NDArray[np.bool_]:
        """True for points (n, 3) inside or on its faces, or no further away than a slack, shape (n,)."""
        return self.distance(points_mm) <= slack_mm

    def distance(self, points_mm: FloatArray) -> FloatArray:
        """Distance of points (n, 3) from the prism across the face that they are furthest beyond, shape (n,) [mm].

        From an ellipse it is that from one of the same shape, along the shorter axis.
        """
        z, half = points_mm[:, 2], np.array(self.section_mm) / 2
        level = np.clip(z, self.base_mm[2], self.top_mm[2])
        own = self.own(points_mm[:, :2] - self.axis_at(level))
        if self.is_round:
            across = (np.linalg.norm(own / half, axis=1, keepdims=True) - 1) * half.min()
        else:
            normals, off_mm = self.sides
            across = own @ normals.T - off_mm
        return np.maximum(np.column_stack([across, np.abs(z - level)]).max(axis=1), 0.0)

    def corners(self, sides: int = SIDES) -> FloatArray:
        """The corners of the lower end, anticlockwise from above, then those of the upper, shape (2 n, 3) [mm].

        n is its section's, of an ellipse the sides of a polygon of the same area.
        """
        across = self.polygon
        if self.is_round:
            angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
            larger = math.sqrt(2 * np.pi / (sides * math.sin(2 * np.pi / sides)))
            across = larger * np.column_stack([np.cos(angle), np.sin(angle)]) * self.section_mm / 2
        half = np.pad(self.placed(across), ((0, 0), (0, 1)))
        return np.vstack([np.array(self.base_mm) + half, np.array(self.top_mm) + half])

    def cuts(self, other: "Prism", slack_mm: float) -> bool:
        """True if two prisms share more than faces: penetration by up to the slack counts as touching.

        Of sections that are no rectangles along x and y those around them count.
        """
        low = max(self.base_mm[2], other.base_mm[2])
        high = min(self.top_mm[2], other.top_mm[2])
        if high - low <= slack_mm:
            return False
        # the offset of the axes is linear in z, so each axis overlaps over one interval of z
        at_low, at_high = (self.axis_at(np.array([z]))[0] - other.axis_at(np.array([z]))[0] for z in (low, high))
        halves = (self.extents_mm + other.extents_mm) / 2 - slack_mm
        first, last = 0.0, 1.0
        for start, end, half in zip(at_low, at_high, halves, strict=True):
            if start == end:
                if not abs(start) < half:
                    return False
                continue
            one, two = sorted(((half - start) / (end - start), (-half - start) / (end - start)))
            first, last = max(first, one), min(last, two)
        return bool((last - first) * (high - low) > slack_mm)


def slab_prism(design: "SensorDesign") -> Prism:
    """The slab of a sensor, pillars and matrix together."""
    x, y, h = design.slab_mm
    return Prism(base_mm=(0.0, 0.0, 0.0), top_mm=(0.0, 0.0, h), section_mm=(x, y))


def pillar_prisms(design: "SensorDesign") -> list[Prism]:
    """The pillars of every unit; those of a unit overlap at common electrodes."""
    return [one for centre in unit_centres(design) for one in unit_prisms(design.unit, (*centre, 0.0))]


def unit_prisms(unit: "Unit", centre_mm: Sequence[float] = (0.0, 0.0, 0.0)) -> list[Prism]:
    """The pillars of one unit, without references."""
    unit = unit.body
    pillars, widths = unit.layout.pillars, np.array(pillar_widths(unit))
    # a section that a quarter turn changes is turned along any lean
    is_same = [{(-y, x) for x, y in SECTIONS[one.section]} == {*SECTIONS[one.section]} for one in pillars]
    turned = np.where(is_same, leans_both_ways(unit), pillar_vectors(unit)[:, :2].any(axis=1))
    along_lean = np.column_stack([widths * rest_lengths(unit) / unit.height_mm, widths])
    along_lean *= [half_extents(one.section) for one in pillars]
    sections = np.where(turned[:, None], along_lean, pillar_sections(unit))
    return [
        Prism(
            base_mm=tuple((centre_mm + base).tolist()),
            top_mm=tuple((centre_mm + top).tolist()),
            section_mm=tuple(section.tolist()),
            section=pillar.section,
            is_turned=is_turned,
        )
        for (base, top), section, pillar, is_turned in zip(
            pillar_ends(unit), sections, pillars, turned.tolist(), strict=True
        )
    ]


def pad_prisms(design: "SensorDesign", depth_mm: float) -> list[Prism]:
    """A layer of the slab under every pad, at most half as thick as the slab."""
    top, size, pads = design.unit.height_mm, design.pad.size_mm, pad_squares(design)
    base = top - min(depth_mm, top / 2)
    return [
        Prism(base_mm=(x, y, base), top_mm=(x, y, top), section_mm=(size, size))
        for x, y in ((pads[:, :2] + pads[:, 2:]) / 2).tolist()
    ]


def prisms_at(points_mm: FloatArray, prisms: Sequence[Prism]) -> NDArray[np.int64]:
    """The prism that each of the points (n, 3) lies in: 0 for none, i + 1 for prisms[i]; the last wins."""
    numbers = np.zeros(len(points_mm), dtype=np.int64)
    for number, prism in enumerate(prisms, start=1):
        numbers[prism.holds(points_mm)] = number
    return numbers
