"""The picture that viewers draw of a frame: pads in colours, forces as arrows, in metres, on the touched surface."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.layout import AXES, FloatArray
from hardware.readout.description import SensorDescription
from hardware.readout.forces import Forces
from hardware.readout.wrench import SIGNS

HOT = ((13, 8, 135), (126, 3, 168), (204, 71, 120), (248, 149, 64), (240, 249, 33))  #: the colour map "plasma"
PAD_HEIGHT = 0.1  #: of a drawn pad, over its side
LONGEST = 3.0  #: arrow of the largest force in the model's training, over a pad's side
MIN_ARROW = 0.02  #: of the longest: shorter ones are not drawn
THICK = 0.08  #: diameter of an arrow's shaft, over a pad's side; that of the net force is twice as thick
ARROW_COLOUR, NET_COLOUR, CONTACT_COLOUR = (26, 204, 77), (255, 255, 255), (255, 140, 0)


def colours(shares: FloatArray) -> NDArray[np.uint8]:
    """Red, green and blue of shares of full scale, (n,) -> (n, 3).

    >>> colours(np.array([0.0, 0.5, 2.0])).tolist()
    [[13, 8, 135], [204, 71, 120], [240, 249, 33]]
    """
    places = np.linspace(0.0, 1.0, len(HOT))
    found = np.stack([np.interp(shares, places, each) for each in np.transpose(HOT)], axis=1)
    return found.round().astype(np.uint8)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Pads and arrows of one frame; n pads."""

    pad_colours: NDArray[np.uint8]  #: (n, 3): by Fz, or by shear where the model gives no Fz
    arrows_m: FloatArray  #: (n, 3): forces on the sensor; their tips are at the pads' centres
    net_arrow_m: FloatArray | None  #: (3,): net force; a newton is 1/√n of one on a pad
    net_tip_m: FloatArray | None  #: (3,): centre of pressure; None, as the arrow, where there is none
    contact_centres_m: FloatArray  #: (c, 3): of flat ellipsoids where a decoder of touch finds contacts
    contact_halves_m: FloatArray  #: (c, 3): their half axes


class Painter:
    """Draws frames of one sensor.

    Raises
    ------
    DesignError
        If nobody knows where the pads are.
    """

    def __init__(self, sensor: SensorDescription) -> None:
        sensor.require_positions()
        self.sensor = sensor
        self.pad_m = 1e-3 * sensor.pad_mm
        self.places_m = sensor.position_m.reshape(-1, 3)
        self.full_scale_n = max(float(np.abs(sensor.range_n).max()), 1.0)
        self._given = [AXES.index(axis) for axis in sensor.axes]

    def scene(self, scan: Forces) -> Scene:
        """The picture of one scan."""
        vectors = np.zeros((len(self.places_m), 3))
        vectors[:, self._given] = scan.force_n.reshape(len(vectors), -1)
        shown = vectors[:, 2] if "z" in self.sensor.axes else np.linalg.norm(vectors[:, :2], axis=1)
        vectors *= SIGNS
        per_newton_m = LONGEST * self.pad_m / self.full_scale_n
        net_arrow_m = net_tip_m = None
        if not np.isnan(scan.wrench.centre_mm).any():
            net_arrow_m = np.nan_to_num(scan.wrench.vector_n) * per_newton_m / math.sqrt(len(vectors))
            net_tip_m = np.append(1e-3 * scan.wrench.centre_mm, 0.0)
        found = scan.contacts or ()
        centres_m = np.zeros((len(found), 3))
        halves_m = np.full((len(found), 3), PAD_HEIGHT * self.pad_m)
        for place, contact in enumerate(found):
            centres_m[place, :2], halves_m[place, :2] = 1e-3 * contact.centre_mm, 1e-3 * contact.half_mm
        return Scene(
            pad_colours=colours(np.abs(shown) / self.full_scale_n),
            arrows_m=vectors * per_newton_m,
            net_arrow_m=net_arrow_m,
            net_tip_m=net_tip_m,
            contact_centres_m=centres_m,
            contact_halves_m=halves_m,
        )
