"""Vertical planes in which a body mirrors itself, and the even and odd parts into which they split displacements.

Only the part of the body on one side of each plane is solved. A load that is neither even nor odd is split into both,
each of which is a problem of that part with its own conditions on the planes.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from fem.scene.scene import Rectangle
from geometry.layout import FloatArray

Parity = tuple[int, int]  #: in x and y: 1 even, −1 odd, 0 where there is no plane


@dataclass(frozen=True, kw_only=True)
class Mirror:
    """A middle plane of the body; what lies beyond it, above its position, is solved."""

    axis: int  #: of the plane's normal: 0 for x, 1 for y
    position_mm: float  #: where the plane cuts that axis
    parities: tuple[int, ...]  #: 1 if the loads have an even part, which equals its mirror image; −1 for an odd one


def parities(mirrors: tuple[Mirror, ...]) -> list[Parity]:
    """Of every part into which the loads are split."""
    along_x, along_y = ({mirror.axis: mirror.parities for mirror in mirrors}.get(axis, (0,)) for axis in (0, 1))
    return [(x, y) for x in along_x for y in along_y]


def sign(component: int, axis: int, parity: Parity) -> int:
    """Of a displacement's component in the image across a plane, relative to the component itself."""
    return -parity[axis] if component == axis else parity[axis]


def images(mirrors: tuple[Mirror, ...], parity: Parity) -> list[tuple[tuple[Mirror, ...], FloatArray]]:
    """Images of the solved part, itself included: the planes it is flipped in, and the signs of x, y and z there."""
    found = []
    for flips in product(*[(False, True)] * len(mirrors)):
        flipped = tuple(mirror for mirror, flip in zip(mirrors, flips, strict=True) if flip)
        signs = np.ones(3)
        for mirror in flipped:
            signs *= [sign(component, mirror.axis, parity) for component in range(3)]
        found.append((flipped, signs))
    return found


def flipped_rectangle(rectangle: Rectangle, flipped: tuple[Mirror, ...]) -> FloatArray:
    """The mirror image of a rectangle, shape (4,)."""
    image = np.array(rectangle)
    for mirror in flipped:
        low, high = image[mirror.axis], image[mirror.axis + 2]
        image[[mirror.axis, mirror.axis + 2]] = 2 * mirror.position_mm - np.array([high, low])
    return image


def flipped_points(points_mm: FloatArray, flipped: tuple[Mirror, ...]) -> FloatArray:
    """The mirror image of points, shape (..., 3)."""
    image = np.array(points_mm)
    for mirror in flipped:
        image[..., mirror.axis] = 2 * mirror.position_mm - image[..., mirror.axis]
    return image
