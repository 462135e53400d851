"""How the mouse turns, moves and brings nearer what a camera sees, z upright."""

import math
from typing import Any

import numpy as np

from geometry.layout import FloatArray

STEEPEST_DEG = 89.0  #: straight from above there is no upright
NEAREST, FARTHEST = 0.1, 5.0  #: of the distance from which all is seen


class Gestures:
    """A camera of VTK that is turned about what it looks at.

    Parameters
    ----------
    camera
        Placed so that all is seen; how near it comes and how far it is moved is bounded by that.
    """

    def __init__(self, camera: Any) -> None:
        self._camera = camera
        self._middle = np.array(camera.GetFocalPoint())
        self._distance = float(np.linalg.norm(np.array(camera.GetPosition()) - self._middle))

    def turn(self, right_deg: float, up_deg: float) -> None:
        """Turn what is seen to the right and up."""
        focus, (r, azimuth, elevation) = self._focus, self._spherical()
        steepest = math.radians(STEEPEST_DEG)
        elevation = min(max(elevation - math.radians(up_deg), -steepest), steepest)
        self._place(focus, r, azimuth - math.radians(right_deg), elevation)

    def approach(self, factor: float) -> None:
        """Come nearer by a factor above 1."""
        r, azimuth, elevation = self._spherical()
        r = min(max(r / factor, NEAREST * self._distance), FARTHEST * self._distance)
        self._place(self._focus, r, azimuth, elevation)

    def move(self, right: float, up: float) -> None:
        """Move what is seen, by fractions of the picture's height."""
        r, azimuth, elevation = self._spherical()
        inward = self._focus - np.array(self._camera.GetPosition())
        across = np.cross(inward, (0.0, 0.0, 1.0))
        across /= np.linalg.norm(across)
        upward = np.cross(across, inward / r)
        height = 2.0 * r * math.tan(math.radians(self._camera.GetViewAngle() / 2))
        focus = self._focus - height * (right * across + up * upward)
        away = np.clip(focus - self._middle, -self._distance, self._distance)
        self._place(self._middle + away, r, azimuth, elevation)

    @property
    def _focus(self) -> FloatArray:
        return np.array(self._camera.GetFocalPoint())

    def _spherical(self) -> tuple[float, float, float]:
        """Distance, azimuth and elevation of the camera from what it looks at."""
        x, y, z = np.array(self._camera.GetPosition()) - self._focus
        return math.hypot(x, y, z), math.atan2(y, x), math.atan2(z, math.hypot(x, y))

    def _place(self, focus: FloatArray, r: float, azimuth: float, elevation: float) -> None:
        flat = r * math.cos(elevation)
        away = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), r * math.sin(elevation)])
        self._camera.SetFocalPoint(*focus)
        self._camera.SetPosition(*(focus + away))
        self._camera.SetViewUp(0.0, 0.0, 1.0)
