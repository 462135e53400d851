"""Where the reference puts its grid lines: geometric layers toward every edge at which the solution is singular."""

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from geometry.layout import FloatArray


def graded_line(layers: Mapping[float, int], ratio: float, widest_mm: float) -> FloatArray:
    """Lines through given positions, shrinking geometrically toward those that ask for layers.

    Parameters
    ----------
    layers : mapping
        Position [mm] → number of layers on either side of it; the lowest and highest bound the line.
    ratio : float
        Width of each layer's outer end over the next one's; about 0.15 suits functions of order 3 to 6
        (Schwab, *p- and hp-finite element methods*, 1998).
    widest_mm : float
        No element is wider [mm].

    Examples
    --------
    >>> graded_line({0.0: 0, 8.0: 2}, ratio=0.25, widest_mm=10.0)
    array([0. , 6. , 7.5, 8. ])
    """
    positions = sorted(layers)
    lines = [np.array(positions[:1])]
    for left, right in pairwise(positions):
        both = layers[left] > 0 and layers[right] > 0
        reach = (right - left) / (2 if both else 1)
        inner = [left + reach * ratio**k for k in range(layers[left], 0, -1)]
        inner += [left + reach] if both else []
        inner += [right - reach * ratio**k for k in range(1, layers[right] + 1)]
        ends = np.array([left, *inner, right])
        for a, b in pairwise(ends):
            lines.append(np.linspace(a, b, int(np.ceil((b - a) / widest_mm - 1e-9)) + 1)[1:])
    return np.concatenate(lines)
