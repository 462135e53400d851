"""Lines between boxes, graded toward the places where the stress is singular.

Sizes of quadratic elements grow around each attractor (the edge of a loaded patch, a face of the body) as
distance^(2/3), so that errors at the edge and away from it fall together, as the fourth power of the number of lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from geometry.layout import FloatArray

GRADING = 3.0  #: the k-th line lies about k³ from its attractor; 3 balances u ~ r^0.6 at clamped edges (2·0.6·3 ≈ 4)
LOGARITHMIC = 8.0  #: lengths from an attractor beyond which sizes grow with the distance


@dataclass(frozen=True)
class Attractor:
    """A place on an axis where lines crowd."""

    position_mm: float
    length_mm: float  #: scale of the problem around it: one line more every length, far away
    weight: float = 1.0  #: 1 where the stress is singular and matters; less where it matters less


def graded_lines(stops: Sequence[float], attractors: Sequence[Attractor], level: int) -> FloatArray:
    """Lines (n + 1,) from the first to the last stop, increasing, that crowd at the attractors [mm]; stops are lines.

    Every interval between stops has `level` times as many elements as at level 1, whose lines stay. An attractor at a
    counts C(x) = w·sign(x − a)·(|x − a|/L)^(1/3) elements from itself to x, and beyond `LOGARITHMIC` lengths only their
    logarithm more. Counts of all add up; lines lie where their sum is a whole number of steps.

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


def _steps(lengths: FloatArray) -> FloatArray:
    """Elements from an attractor to so many lengths away: the cube root, continued smoothly by a logarithm."""
    near = np.cbrt(np.minimum(lengths, LOGARITHMIC))
    return near + np.cbrt(LOGARITHMIC) / 3 * np.log(np.maximum(lengths, LOGARITHMIC) / LOGARITHMIC)
