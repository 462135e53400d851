"""Lines of a grid that lean with the faces of a body and of what lies in it: mapped hexahedra, whose edges they are.

A line lies at a place x, or y, at each of some heights, and is straight between them. Between two lines and two heights
places are bilinear, as the mapping of a hexahedron there is. Every place of the body is named by where its line starts
at the lowest height: there all lines are upright, and all prisms boxes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.layout import FloatArray
from geometry.prism import Prism

SAME = 1e-12  #: of the body's extent: how far rounding may take lines apart
LEVER = 1e-3  #: of the body's height, over which a line's lean is taken
MIN_GAP = 0.05  #: of two neighbouring lines, the least distance at a height over the greatest


@dataclass(frozen=True, eq=False)
class Leaning:
    """Lines along x and along y, at some heights."""

    heights_mm: FloatArray  #: ascending, (m,)
    lines_mm: tuple[FloatArray, FloatArray]  #: places at these heights, in order at each, (n, m)

    @classmethod
    def of(cls, outline: Prism, prisms: Sequence[Prism], slack_mm: float) -> "Leaning | None":
        """Lines along the faces of a body of a rectangular section and of prisms in it; upright beyond a prism's ends.

        None where they would meet or cross, or sections are no rectangles along x and y.
        """
        every = [outline, *prisms]
        if not all(prism.is_rectangular for prism in every):
            return None
        leaning = [prism for prism in every if not prism.is_upright]
        ends = [outline.base_mm[2], outline.top_mm[2]]
        ends += [end for prism in leaning for end in (prism.base_mm[2], prism.top_mm[2])]
        heights = np.array(apart(ends, slack_mm))
        across = []
        for axis in range(2):
            lines = np.array(
                [
                    prism.axis_at(np.clip(heights, prism.base_mm[2], prism.top_mm[2]))[:, axis] + side / 2
                    for prism in every
                    for side in (-prism.section_mm[axis], prism.section_mm[axis])
                ]
            )
            lines = lines[np.lexsort(lines.T[::-1])]
            new = np.append(True, (np.diff(lines, axis=0) > slack_mm).any(axis=1))
            gaps = np.diff(lines[new], axis=0)
            if (gaps.min(axis=1) < MIN_GAP * gaps.max(axis=1)).any():
                return None
            across.append(lines[new])
        return cls(heights, (across[0], across[1]))

    def kinks(self, axis: int) -> FloatArray:
        """Starts of lines, along z heights, where the lean changes, (k,): no hexahedron may hold one inside."""
        if axis == 2:
            return self.heights_mm[1:-1]
        lines = self.lines_mm[axis]
        moved = lines - lines[:, :1]
        return lines[:, 0] if (np.abs(moved - moved[0]) > SAME * np.ptp(lines)).any() else np.zeros(0)

    @property
    def bends(self) -> bool:
        """True if some lines lean apart."""
        return any(len(self.kinks(axis)) for axis in range(2))

    def leans_at(self, starts_mm: FloatArray) -> FloatArray:
        """Shift along x and y per height of the lines of places named by their starts (n, 3), (n, 2)."""
        step = np.array([0.0, 0.0, LEVER * float(np.ptp(self.heights_mm))])
        return (self.placed(starts_mm + step) - self.placed(starts_mm))[:, :2] / step[2]

    def placed(self, starts_mm: FloatArray) -> FloatArray:
        """Places (n, 3) in space of places named by their lines' starts (n, 3)."""
        return self._moved(starts_mm, from_starts=True)

    def starts(self, points_mm: FloatArray) -> FloatArray:
        """The inverse of `placed`, (n, 3)."""
        return self._moved(points_mm, from_starts=False)

    def _moved(self, points: FloatArray, from_starts: bool) -> FloatArray:
        found, z = np.array(points, dtype=float), points[:, 2]
        j = np.clip(np.searchsorted(self.heights_mm, z, side="right") - 1, 0, len(self.heights_mm) - 2)
        share = (z - self.heights_mm[j]) / (self.heights_mm[j + 1] - self.heights_mm[j])
        for axis in range(2):
            lines, rows = self.lines_mm[axis], np.arange(len(points))
            if (lines == lines[:, :1]).all():
                continue
            there = lines[:, j] * (1 - share) + lines[:, j + 1] * share  # (n_lines, n)
            first = np.broadcast_to(lines[:, :1], there.shape)
            given, wanted = (first, there) if from_starts else (there, first)
            i = np.clip((given <= points[:, axis]).sum(axis=0) - 1, 0, len(lines) - 2)
            low, high = given[i, rows], given[i + 1, rows]
            along = (points[:, axis] - low) / (high - low)
            found[:, axis] = wanted[i, rows] + along * (wanted[i + 1, rows] - wanted[i, rows])
        return found


def apart(places: Sequence[float], slack: float) -> list[float]:
    """Places in order, without those that only rounding tells from one named before: the body's own come first."""
    kept: list[float] = []
    for place in places:
        if all(abs(place - other) > slack for other in kept):
            kept.append(place)
    return sorted(kept)
