"""Vertical planes in which a body mirrors itself, and the even and odd parts into which they split displacements.

Only the part of the body above each plane's position is solved. A load that is neither even nor odd is split into both,
each of which is a problem of that part with its own conditions on the planes.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from geometry.layout import FloatArray

Parity = tuple[int, int]  #: in x and y: 1 even, −1 odd, 0 where there is no plane


@dataclass(frozen=True, kw_only=True)
class Mirror:
    """A middle plane of the body."""

    axis: int  #: of the plane's normal: 0 for x, 1 for y
    position_mm: float  #: where the plane cuts that axis
    parities: tuple[int, ...]  #: 1 if the loads have an even part, which equals its mirror image; −1 for an odd one


#: the planes x = 0 and y = 0
QUARTER = tuple(Mirror(axis=axis, position_mm=0.0, parities=(1, -1)) for axis in (0, 1))


def parities(mirrors: tuple[Mirror, ...]) -> list[Parity]:
    """Every parity that the loads have a part of."""
    along_x, along_y = ({mirror.axis: mirror.parities for mirror in mirrors}.get(axis, (0,)) for axis in (0, 1))
    return [(x, y) for x in along_x for y in along_y]


def sign(component: int, axis: int, parity: Parity) -> int:
    """Sign of a displacement's component in the image across a plane, relative to the component itself."""
    return -parity[axis] if component == axis else parity[axis]


def vanishing_components(axis: int, parity: Parity) -> NDArray[np.bool_]:
    """Which components vanish on a plane, shape (3,): the normal one of even displacements, the others of odd ones."""
    return np.array([sign(component, axis, parity) == -1 for component in range(3)])


def images(mirrors: tuple[Mirror, ...], parity: Parity) -> list[tuple[tuple[Mirror, ...], FloatArray]]:
    """Images of the solved part, itself first: the planes it is flipped in, and the signs of x, y and z there."""
    found = []
    for flips in product(*[(False, True)] * len(mirrors)):
        flipped = tuple(mirror for mirror, flip in zip(mirrors, flips, strict=True) if flip)
        signs = [np.prod([sign(component, mirror.axis, parity) for mirror in flipped]) for component in range(3)]
        found.append((flipped, np.array(signs, dtype=np.float64)))
    return found


def flipped_rectangles(rectangles: FloatArray, flipped: tuple[Mirror, ...]) -> FloatArray:
    """Mirror images of rectangles x0, y0, x1, y1, shape (..., 4)."""
    image = np.array(rectangles, dtype=np.float64)
    for mirror in flipped:
        ends = [mirror.axis, mirror.axis + 2]
        image[..., ends] = 2 * mirror.position_mm - image[..., ends[::-1]]
    return image


def flipped_points(points_mm: FloatArray, flipped: tuple[Mirror, ...]) -> FloatArray:
    """Mirror images of points, shape (..., 3)."""
    image = np.array(points_mm)
    for mirror in flipped:
        image[..., mirror.axis] = 2 * mirror.position_mm - image[..., mirror.axis]
    return image


def folded_point(point_mm: FloatArray, mirrors: tuple[Mirror, ...], parity: Parity) -> tuple[FloatArray, FloatArray]:
    """A point's place in the solved part, shape (3,), and the signs that its displacement takes from there."""
    beyond = tuple(mirror for mirror in mirrors if point_mm[mirror.axis] < mirror.position_mm)
    signs = next(signs for flipped, signs in images(mirrors, parity) if flipped == beyond)
    return flipped_points(point_mm, beyond), signs
