"""Structured grids of boxes, graded toward the edges where the stress is singular.

A grid is three sets of lines. For quadratic elements (`graded_lines`) sizes grow around each attractor (the edge of a
loaded patch, a face of the body) as distance^(2/3), so that errors at the edge and away from it fall together, as the
fourth power of the number of lines. For elements of high order (`geometric_line`) they shrink geometrically.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from geometry.layout import FloatArray

GRADING = 3.0  #: the k-th line lies about k³ from its attractor; 3 balances u ~ r^0.6 at clamped edges (2·0.6·3 ≈ 4)
FAR = 8.0  #: lengths from an attractor beyond which sizes grow with the distance
GROWTH = 0.3  #: distance of an element of high order from the nearest edge, over the distance of its far end
SPREAD = 0.25  #: width of such elements over that distance, where they may be wider than the widest


@dataclass(frozen=True, eq=False, kw_only=True)
class Grid:
    """Boxes between lines, possibly sheared so that their uprights lean; the base is z = 0."""

    x: FloatArray  #: (nx + 1,) at the base [mm]
    y: FloatArray  #: (ny + 1,) at the base [mm]
    z: FloatArray  #: (nz + 1,) [mm]
    lean: tuple[float, float] = (0.0, 0.0)  #: x and y by which points shift per mm of height
    region: NDArray[np.int64] = field(default_factory=lambda: np.zeros((1, 1, 1), dtype=np.int64))
    #: (nx, ny, nz), or broadcastable to it: which material fills each box

    @property
    def lines(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.x, self.y, self.z

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of boxes along each axis."""
        return len(self.x) - 1, len(self.y) - 1, len(self.z) - 1

    @property
    def height_mm(self) -> float:
        return float(self.z[-1])


@dataclass(frozen=True)
class Attractor:
    """A place on an axis where lines crowd."""

    position_mm: float
    length_mm: float  #: scale of the problem around it: one line more every length, far away
    weight: float = 1.0  #: 1 where the stress is singular and matters; less where it matters less


def graded_lines(stops: Sequence[float], attractors: Sequence[Attractor], level: int) -> FloatArray:
    """Lines from the first to the last stop, crowding at the attractors.

    Parameters
    ----------
    stops : sequence of float
        Places that must be lines [mm]; the least and the greatest are the ends.
    attractors : sequence of Attractor
        Where lines crowd.
    level : int
        Refinement: every interval between stops has `level` times as many elements as at level 1, and
        the lines of level 1 stay.

    Returns
    -------
    array, shape (n + 1,)
        Increasing positions [mm].

    Notes
    -----
    An attractor at a counts C(x) = w·sign(x − a)·(|x − a|/L)^(1/3) elements from itself to x, and beyond `FAR` lengths
    only their logarithm more. Counts of all attractors add up; lines lie where their sum is a whole number of steps.

    Examples
    --------
    >>> graded_lines([0, 8], [Attractor(0.0, 8.0, weight=2.0)], level=1)
    array([0., 1., 8.])
    """
    ends = np.unique(np.round(np.asarray(stops, dtype=float), 9))
    lines = [ends[:1]]
    for low, high in pairwise(ends):
        # sample densely toward every attractor, or steep parts of the count would be missed
        spread = np.linspace(-1.0, 1.0, 401) ** GRADING * (high - low)
        near = np.concatenate([np.clip(a.position_mm, low, high) + spread for a in attractors] + [low + (1 + spread)])
        places = np.unique(np.clip(near, low, high))
        count = sum(
            (
                a.weight * np.sign(places - a.position_mm) * _steps(np.abs(places - a.position_mm) / a.length_mm)
                for a in attractors
            ),
            start=np.zeros_like(places),
        )
        steps = level * max(1, round(count[-1] - count[0]))
        if count[-1] == count[0]:  # nothing attracts: evenly
            count = places
        inner = np.interp(np.linspace(count[0], count[-1], steps + 1)[1:-1], count, places)
        lines.append(np.append(inner, high))
    return np.concatenate(lines)


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
        Layers begin at this distance at most, where there are any [mm]; from there on elements grow, see `GROWTH`.

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
        return min((1 / GROWTH - 1) * found[-1], max(widest_mm, SPREAD * found[-1]))

    while end - found[-1] > 1e-9 * end and (end + beyond - found[-1] - (found[-1] if beyond else 0.0)) > step():
        found.append(found[-1] + step())
    if found[-1] > end:
        found = [start + (place - start) * (end - start) / (found[-1] - start) for place in found]
    return np.array(found)


def _steps(lengths: FloatArray) -> FloatArray:
    """Elements from an attractor to so many lengths away: the cube root, continued smoothly by a logarithm."""
    near = np.cbrt(np.minimum(lengths, FAR))
    return near + np.cbrt(FAR) / 3 * np.log(np.maximum(lengths, FAR) / FAR)
