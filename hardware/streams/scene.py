"""The picture that viewers draw of a scan: pads in colours, forces as arrows, in metres, on the touched surface."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.layout import FloatArray
from hardware.readout.forces import Forces
from hardware.readout.wrench import SIGNS, on_all_axes

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
    channels = np.stack([np.interp(shares, places, each) for each in np.transpose(HOT)], axis=1)
    return channels.round().astype(np.uint8)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Pads and arrows of one scan; n pads, c contacts."""

    pad_m: float  #: side of a pad
    places_m: FloatArray  #: (n, 3): the pads' centres, which are the arrows' tips
    pad_colours: NDArray[np.uint8]  #: (n, 3): by Fz, or by shear where the model gives no Fz
    arrows_m: FloatArray  #: (n, 3): forces on the sensor
    net_arrow_m: FloatArray  #: (1, 3), or (0, 3) where nothing presses: net force; a newton is 1/√n of one on a pad
    net_tip_m: FloatArray  #: of the same shape: centre of pressure
    contact_centres_m: FloatArray  #: (c, 3): of flat ellipsoids where a decoder of touch finds contacts
    contact_halves_m: FloatArray  #: (c, 3): their half axes


def scene_of(scan: Forces) -> Scene:
    """The picture of one scan of a sensor whose pads' places are known."""
    sensor = scan.description
    pad_m, places_m = 1e-3 * sensor.pad_mm, 1e-3 * sensor.position_mm.reshape(-1, 3)
    vectors = on_all_axes(scan.force_n, sensor.axes, unknown=0.0).reshape(-1, 3)
    shown = vectors[:, 2] if "z" in sensor.axes else np.linalg.norm(vectors[:, :2], axis=1)
    vectors *= SIGNS
    per_newton_m = LONGEST * pad_m / sensor.full_scale_n
    net = [] if np.isnan(scan.wrench.centre_mm).any() else [np.nan_to_num(scan.wrench.vector_n)]
    tips = [np.append(1e-3 * scan.wrench.centre_mm, 0.0)] * len(net)
    flat_m, contacts = PAD_HEIGHT * pad_m, scan.contacts or ()
    return Scene(
        pad_m=pad_m,
        places_m=places_m,
        pad_colours=colours(np.abs(shown) / sensor.full_scale_n),
        arrows_m=vectors * per_newton_m,
        net_arrow_m=np.reshape(net, (-1, 3)) * per_newton_m / math.sqrt(len(vectors)),
        net_tip_m=np.reshape(tips, (-1, 3)),
        contact_centres_m=np.reshape([[*1e-3 * each.centre_mm, 0.0] for each in contacts], (-1, 3)),
        contact_halves_m=np.reshape([[*1e-3 * each.half_mm, flat_m] for each in contacts], (-1, 3)),
    )


def turns_from_x(vectors: FloatArray) -> FloatArray:
    """Unit quaternions x, y, z, w that turn the x axis onto vectors, (n, 3) -> (n, 4).

    >>> turns_from_x(np.array([[2.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])).tolist()
    [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]]
    """
    length = np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
    x, y, z = (vectors / length).T
    quaternions = np.stack([np.zeros_like(x), -z, y, 1.0 + x], axis=1)  # half way between the x axis and the vector
    quaternions[1.0 + x < 1e-9] = [0.0, 0.0, 1.0, 0.0]  # straight back
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True) + 0.0
