"""Shares of boxes that a unit's pillars fill, for grids of boxes in which pillars are of another rubber."""

import itertools

import numpy as np

from common.errors import DesignError
from geometry.design import Unit
from geometry.layout import FloatArray, pillar_ends, pillar_sections
from geometry.prism import Prism, unit_prisms

MAX_GROUPS = 500  #: of as many pillars each that lie in one place: they double with every pillar
LEVEL = 1e-12  #: part along x of a side's normal, below which it runs along x but for rounding
ACROSS = 24  #: Gauss points along y of such a section in each box


def pillar_shares(unit: Unit, x_mm: FloatArray, y_mm: FloatArray, z_mm: FloatArray) -> FloatArray:
    """Share of each box between lines (nx + 1,), (ny + 1,), (nz + 1,) of the unit's frame that its pillars fill.

    Shape (nx, ny, nz). By 8 Gauss points along z of every box: exact where no pillar's face crosses its uprights. Of
    sections that are no rectangles along x and y also by `ACROSS` points along y: the area over all boxes is exact of
    round ones, of others to 0.2 %, as a box's part of it is.

    >>> around_z = np.array([-6.0, -4.0]), np.array([-6.0, -4.0])
    >>> round(float(pillar_shares(Unit(), *around_z, np.array([4.0, 6.0]))[0, 0, 0]), 9)
    1.0
    """
    unit = unit.body
    points, weights = np.polynomial.legendre.leggauss(8)
    z = (z_mm[:-1] + z_mm[1:])[:, None] / 2 + np.diff(z_mm)[:, None] / 2 * points
    ends = pillar_ends(unit)[:, :, :2]
    middle = ends[:, 0, None, None] + (z / unit.height_mm)[..., None] * (ends[:, 1] - ends[:, 0])[:, None, None]
    half = pillar_sections(unit)[:, None, None] / 2
    sections = np.stack([middle - half, middle + half])  # (2, n_pillars, nz, 8, 2): low and high corners of each

    def filled(pillars: tuple[int, ...]) -> FloatArray:
        """Area of the boxes that all of some pillars cover, its mean along z."""
        low, high = sections[0, pillars].max(axis=0), sections[1, pillars].min(axis=0)
        low, high = (np.moveaxis(ends, -1, 0) for ends in (low, high))
        along = (
            np.maximum(np.minimum(line[1:, None, None], top) - np.maximum(line[:-1, None, None], bottom), 0.0)
            for line, bottom, top in zip((x_mm, y_mm), low, high, strict=True)
        )
        return np.einsum("xzq,yzq,q->xyz", *along, weights / 2)

    prisms = unit_prisms(unit)
    is_chord = [not one.is_rectangular for one in prisms]
    places, widths = np.polynomial.legendre.leggauss(ACROSS)

    def filled_chords(pillars: tuple[int, ...]) -> FloatArray:
        """The same where some are round or turned, from lines along x at y = c + b sin θ of the first such one."""
        first = next(k for k in pillars if is_chord[k])
        c, b = middle[first, ..., 1], half[first, 0, 0, 1]
        low, high = (np.arcsin(((line[:, None, None] - c) / b).clip(-1, 1)) for line in (y_mm[:-1], y_mm[1:]))
        angle = ((low + high)[..., None] + (high - low)[..., None] * places) / 2  # (ny, nz, 8, ACROSS)
        y = c[..., None] + b * np.sin(angle)
        left, right = np.full(y.shape, -np.inf), np.full(y.shape, np.inf)
        for k in pillars:
            cx, cy = np.moveaxis(middle[k], -1, 0)[..., None]
            start, end = _chord(prisms[k], half[k, 0, 0], y - cy)
            left, right = np.maximum(left, cx + start), np.minimum(right, cx + end)
        weight = half[first, 0, 0, 1] * np.cos(angle) * (high - low)[..., None] / 2 * widths
        return np.stack(
            [
                np.einsum("yzqa,yzqa,q->yz", (right.clip(max=x1) - left.clip(min=x0)).clip(0), weight, weights / 2)
                for x0, x1 in itertools.pairwise(x_mm)
            ]
        )

    # of the union: what one pillar covers less what two do, and so on, as far as any are in one place
    whole, sign = np.zeros((len(x_mm) - 1, len(y_mm) - 1, len(z_mm) - 1)), 1.0
    groups: list[tuple[int, ...]] = [(k,) for k in range(len(ends))]
    while groups:
        if len(groups) > MAX_GROUPS:
            raise DesignError("too many pillars of a unit lie in one place: join fewer at an electrode, 11 at most.")
        areas = {group: (filled_chords if any(is_chord[k] for k in group) else filled)(group) for group in groups}
        for area in areas.values():
            whole += sign * area
        groups = [(*group, k) for group, area in areas.items() if area.any() for k in range(group[-1] + 1, len(ends))]
        sign = -sign
    found = whole / (np.diff(x_mm)[:, None, None] * np.diff(y_mm)[:, None])
    return found.clip(0.0, 1.0) if any(is_chord) else found


def _chord(prism: Prism, half_mm: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ends along x of a line at y, both from the section's middle; the first above the last where it misses.

    `half_mm` (2,) are half extents of the rectangle along x and y around the section.
    """
    if prism.is_round:  # |x p + y q| ≤ 1, with (p, q) the turn over the half extents
        p, q = (prism.turn / (np.array(prism.section_mm) / 2)[:, None]).T
        inside = 1 - (y / half_mm[1]) ** 2
        middle, wide = -(p @ q) / (p @ p) * y, np.sqrt(inside.clip(0) / (p @ p))
        wide = np.where(inside < 0, -np.inf, wide)
        return middle - wide, middle + wide
    low, high = np.full(y.shape, -np.inf), np.full(y.shape, np.inf)
    normals, off_mm = prism.sides
    for (u, v), off in zip(normals @ prism.turn, off_mm, strict=True):  # x u + y v ≤ off
        if abs(u) < LEVEL:
            high = np.where(y * v > off, -np.inf, high)
        elif u > 0:
            high = np.minimum(high, (off - y * v) / u)
        else:
            low = np.maximum(low, (off - y * v) / u)
    return low, high
