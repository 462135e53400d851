"""Load protocols: random tractions on every pad, the way the paper loads its sensor and ways it does not.

Each protocol is a function of a random generator, a number of samples and a design, and gives tractions of
shape (n_samples, n_units, 3) [MPa] along x, y, z; z is negative when pushing down. Ranges are the paper's:
1-5 MPa normal, 0.2-1 MPa tangential.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from common.errors import DesignError
from geometry.design import SensorDesign
from geometry.layout import FloatArray, unit_centres

NORMAL_MPA = (1.0, 5.0)  #: range of a pad's pressure, and of an indenter's peak
TANGENTIAL_MPA = (0.2, 1.0)  #: the same for shear
NORMAL_PRELOAD_MPA = 0.5  #: light pressure on pads that no indenter touches: a tenth of the largest
TANGENTIAL_PRELOAD_MPA = 0.1  #: the same for shear
FRICTION = TANGENTIAL_MPA[1] / NORMAL_MPA[1]  #: largest ratio of shear to pressure where both act on a pad
MAX_INDENTERS = 3
LIGHT_N = 10.0  #: largest force of a light touch, the paper's smallest range
MAX_TOUCHED = 3  #: pads; as often as one or any other number, none is touched
INDENTER_WIDTH_MM = (15.0, 30.0)  #: standard deviation of an indenter's bell: what pads a pitch apart resolve

Range = tuple[float, float]
Draw = Callable[[Generator, int, SensorDesign], FloatArray]
#: the same of (n, n_units) sizes alone, by a range and a preload [MPa]
Sizes = Callable[[Generator, int, SensorDesign, Range, float], FloatArray]


@dataclass(frozen=True)
class Protocol:
    """A named way to load the array."""

    summary: str  #: one line for people
    axes: tuple[str, ...]  #: axes along which pads are loaded
    draw: Draw
    is_light: bool = False  #: whether no pad takes more than `LIGHT_N`


def _along(axis: str, sizes: Sizes) -> Draw:
    """Loads of these sizes along one axis, z or x."""

    def draw(generator: Generator, n: int, design: SensorDesign) -> FloatArray:
        traction = np.zeros((n, design.n_units, 3))
        if axis == "z":
            traction[..., 2] = -sizes(generator, n, design, NORMAL_MPA, NORMAL_PRELOAD_MPA)
        else:
            traction[..., 0] = sizes(generator, n, design, TANGENTIAL_MPA, TANGENTIAL_PRELOAD_MPA)
        return traction

    return draw


def _in_cone(sizes: Sizes) -> Draw:
    """Pressures of these sizes, each with a shear within the friction cone."""

    def draw(generator: Generator, n: int, design: SensorDesign) -> FloatArray:
        pressure = sizes(generator, n, design, NORMAL_MPA, NORMAL_PRELOAD_MPA)
        shear = _in_disc(generator, pressure.shape) * (FRICTION * pressure)[..., None]
        return np.concatenate([shear, -pressure[..., None]], axis=-1)

    return draw


def _contact(generator: Generator, n: int, design: SensorDesign) -> FloatArray:
    pressure = _indenters(generator, n, design, NORMAL_MPA, NORMAL_PRELOAD_MPA)
    drag = _in_disc(generator, (n, MAX_INDENTERS)) * FRICTION
    shear = pressure.transpose(0, 2, 1) @ drag  # summed over indenters
    return np.concatenate([shear, -NORMAL_PRELOAD_MPA - pressure.sum(axis=1)[..., None]], axis=-1)


def _even(generator: Generator, n: int, design: SensorDesign, range_mpa: Range, preload_mpa: float) -> FloatArray:
    return generator.uniform(*range_mpa, (n, design.n_units))


def _pressed(generator: Generator, n: int, design: SensorDesign, range_mpa: Range, preload_mpa: float) -> FloatArray:
    return preload_mpa + _indenters(generator, n, design, range_mpa, preload_mpa).sum(axis=1)


def _touched(generator: Generator, n: int, design: SensorDesign, range_mpa: Range, preload_mpa: float) -> FloatArray:
    """0 to `LIGHT_N` on none to `MAX_TOUCHED` pads of each sample."""
    number = generator.integers(0, MAX_TOUCHED + 1, (n, 1))
    rank = generator.random((n, design.n_units)).argsort(axis=1)
    return (rank < number) * generator.uniform(0.0, LIGHT_N, rank.shape) / design.pad.size_mm**2


def _indenters(generator: Generator, n: int, design: SensorDesign, peak_mpa: Range, preload_mpa: float) -> FloatArray:
    """Tractions that one to three round indenters add to each pad's preload, (n, MAX_INDENTERS, n_units) [MPa].

    An indenter adds (peak − preload)·exp(−r²/2w²) at distance r of its centre, which lies anywhere over the
    array. Where several meet, they are weakened together so that no pad passes the largest peak. Indenters
    that a sample does not have add 0.
    """
    x, y, _ = design.slab_mm
    centre = generator.uniform(-0.5, 0.5, (n, MAX_INDENTERS, 1, 2)) * (x, y)
    width = generator.uniform(*INDENTER_WIDTH_MM, (n, MAX_INDENTERS, 1))
    strength = generator.uniform(*peak_mpa, (n, MAX_INDENTERS, 1)) - preload_mpa
    number = generator.integers(1, MAX_INDENTERS + 1, (n, 1, 1))
    present = np.arange(MAX_INDENTERS)[:, None] < number
    dx, dy = (unit_centres(design)[:, axis] - centre[..., axis] for axis in (0, 1))  # each (n, indenters, units)
    squared = dx * dx + dy * dy
    traction = present * strength * np.exp(-squared / (2 * width**2))
    limit = peak_mpa[1] - preload_mpa
    most = np.maximum(traction.sum(axis=1).max(axis=1), limit)
    return traction * (limit / most)[:, None, None]


def _in_disc(generator: Generator, shape: tuple[int, int]) -> FloatArray:
    """Points spread evenly over the unit disc, shape (*shape, 2)."""
    radius = np.sqrt(generator.uniform(0.0, 1.0, shape))
    angle = generator.uniform(0.0, 2 * np.pi, shape)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


ALL = ("x", "y", "z")
PROTOCOLS = {
    "independent-fz": Protocol("every pad its own pressure, 1-5 MPa", ("z",), _along("z", _even)),
    "independent-fx": Protocol("every pad its own shear along x, 0.2-1 MPa", ("x",), _along("x", _even)),
    "contact-fz": Protocol("1-3 indenters press up to 1-5 MPa, 0.5 MPa elsewhere", ("z",), _along("z", _pressed)),
    "contact-fx": Protocol(
        "1-3 indenters drag along x up to 0.2-1 MPa, 0.1 MPa elsewhere", ("x",), _along("x", _pressed)
    ),
    "contact": Protocol("1-3 indenters press and drag within a friction cone", ALL, _contact),
    "three-axis": Protocol("every pad 1-5 MPa and its own shear within a friction cone", ALL, _in_cone(_even)),
    "light-fz": Protocol("nothing, or 0-10 N of pressure on 1-3 pads", ("z",), _along("z", _touched), True),
    "light-fx": Protocol("nothing, or 0-10 N of shear along x on 1-3 pads", ("x",), _along("x", _touched), True),
    "light": Protocol("nothing, or 0-10 N on 1-3 pads, shear within a friction cone", ALL, _in_cone(_touched), True),
}
INDENT = "indent"  #: loads the top by contact, not pads: see `dataset.indentation`
#: one line for people about every kind of loads
SUMMARIES = {name: protocol.summary for name, protocol in PROTOCOLS.items()} | {
    INDENT: "a sphere, cylinder or flat punch is pressed in, and mostly dragged, with friction"
}


def forces(traction_mpa: FloatArray, design: SensorDesign) -> FloatArray:
    """Force on each pad (..., 3) [N] of its traction (..., 3) [MPa]; Fz positive in compression."""
    return traction_mpa * (design.pad.size_mm**2 * np.array([1.0, 1.0, -1.0]))


def pad_protocol(name: str) -> Protocol:
    """The protocol of that name, refused if it does not load pads."""
    if name == INDENT:
        raise DesignError(
            f"protocol='{INDENT}' presses shapes on linear rubber; finite strain and twins take loads on pads alone: "
            f"choose one of {', '.join(PROTOCOLS)}."
        )
    return PROTOCOLS[name]
