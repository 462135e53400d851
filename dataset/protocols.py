"""Load protocols: random tractions on every pad, the way the paper loads its sensor and ways it does not.

Each protocol is a function of a random generator, a number of samples, a design and the ranges of its loads, and gives
tractions of shape (n_samples, n_units, 3) [MPa] along x, y, z; z is negative when pushing down.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator

from common.errors import DesignError
from dataset.loads import PAPERS, Loads, Range, preload_of
from geometry.design import SensorDesign
from geometry.layout import AXES, FloatArray, unit_centres

MAX_INDENTERS = 3
LIGHT_N = 10.0  #: largest force of a light touch, the paper's smallest range
MAX_TOUCHED = 3  #: pads; as often as one or any other number, none is touched
#: standard deviation of an indenter's bell, in pitches: what pads a pitch apart resolve; with the paper's pitch
INDENTER_WIDTH, PAPERS_PITCH_MM = (1.0, 2.0), 15.0

Draw = Callable[[Generator, int, SensorDesign, Loads], FloatArray]
Listed = tuple[tuple[tuple[float, ...], ...], ...]  #: tractions as settings hold them
#: the same of (n, n_units) sizes alone, by a range [MPa] and the largest force of a light touch [N]
Sizes = Callable[[Generator, int, SensorDesign, Range, float], FloatArray]


@dataclass(frozen=True)
class Protocol:
    """A named way to load the array."""

    words: str  #: `summary`, with names in the place of the ranges
    axes: tuple[str, ...]  #: axes along which pads are loaded
    tractions: Draw
    is_light: bool = False  #: whether no pad takes more than `LIGHT_N`

    @property
    def summary(self) -> str:
        """One line for people, with the paper's loads."""
        return self.said()

    def draw(self, generator: Generator, n: int, design: SensorDesign, loads: Loads = PAPERS) -> FloatArray:
        """Random tractions (n, n_units, 3) [MPa] within these ranges."""
        return self.tractions(generator, n, design, loads)

    def said(self, loads: Loads = PAPERS, design: SensorDesign | None = None) -> str:
        """One line for people, with these loads."""
        ranges = {"pressure": loads.normal_mpa, "shear": loads.tangential_mpa}
        values = {name: f"{low:.3g}-{high:.3g} MPa" for name, (low, high) in ranges.items()}
        values |= {f"light_{name}": f"{preload_of(one):.3g} MPa" for name, one in ranges.items()}
        most_mpa = loads.normal_mpa if "z" in self.axes else loads.tangential_mpa
        touch_n = LIGHT_N if design is None else _light_n(loads, most_mpa, design)
        return self.words.format(**values, touch=f"{touch_n:.3g} N")


def _light_n(loads: Loads, range_mpa: Range, design: SensorDesign) -> float:
    """Largest force of a light touch [N]; less than the paper's where a design bears less than the paper's loads."""
    return LIGHT_N if loads == PAPERS else min(LIGHT_N, range_mpa[1] * design.pad.size_mm**2)


def _along(axis: str, sizes: Sizes) -> Draw:
    """Loads of these sizes along one axis, z or x."""

    def tractions(generator: Generator, n: int, design: SensorDesign, loads: Loads) -> FloatArray:
        range_mpa, sign = (loads.normal_mpa, -1.0) if axis == "z" else (loads.tangential_mpa, 1.0)
        size_mpa = sizes(generator, n, design, range_mpa, _light_n(loads, range_mpa, design))
        traction = np.zeros((n, design.n_units, 3))
        traction[..., AXES.index(axis)] = sign * size_mpa
        return traction

    return tractions


def _in_cone(sizes: Sizes) -> Draw:
    """Pressures of these sizes, each with a shear within the friction cone."""

    def tractions(generator: Generator, n: int, design: SensorDesign, loads: Loads) -> FloatArray:
        range_mpa = loads.normal_mpa
        pressure = sizes(generator, n, design, range_mpa, _light_n(loads, range_mpa, design))
        shear = _in_disc(generator, pressure.shape) * (loads.friction * pressure)[..., None]
        return np.concatenate([shear, -pressure[..., None]], axis=-1)

    return tractions


def _contact(generator: Generator, n: int, design: SensorDesign, loads: Loads) -> FloatArray:
    pressure = _indenters(generator, n, design, loads.normal_mpa)
    drag = _in_disc(generator, (n, MAX_INDENTERS)) * loads.friction
    shear = pressure.transpose(0, 2, 1) @ drag  # summed over indenters
    return np.concatenate([shear, -preload_of(loads.normal_mpa) - pressure.sum(axis=1)[..., None]], axis=-1)


def _even(generator: Generator, n: int, design: SensorDesign, range_mpa: Range, light_n: float) -> FloatArray:
    return generator.uniform(*range_mpa, (n, design.n_units))


def _pressed(generator: Generator, n: int, design: SensorDesign, range_mpa: Range, light_n: float) -> FloatArray:
    return preload_of(range_mpa) + _indenters(generator, n, design, range_mpa).sum(axis=1)


def _touched(generator: Generator, n: int, design: SensorDesign, range_mpa: Range, light_n: float) -> FloatArray:
    """0 to `light_n` on none to `MAX_TOUCHED` pads of each sample."""
    number = generator.integers(0, MAX_TOUCHED + 1, (n, 1))
    rank = generator.random((n, design.n_units)).argsort(axis=1)
    return (rank < number) * generator.uniform(0.0, light_n, rank.shape) / design.pad.size_mm**2


def _indenters(generator: Generator, n: int, design: SensorDesign, peak_mpa: Range) -> FloatArray:
    """Tractions that one to three round indenters add to each pad's preload, (n, MAX_INDENTERS, n_units) [MPa].

    An indenter adds (peak − preload)·exp(−r²/2w²), w one to two pitches, at distance r of its centre, which lies
    anywhere over the array. Where several meet, they are weakened together so that no pad passes the largest peak.
    Indenters that a sample does not have add 0.
    """
    preload_mpa, (x, y, _) = preload_of(peak_mpa), design.slab_mm
    centre = generator.uniform(-0.5, 0.5, (n, MAX_INDENTERS, 1, 2)) * (x, y)
    narrow, wide = (share * design.array.pitch_mm for share in INDENTER_WIDTH)
    width = generator.uniform(narrow, wide, (n, MAX_INDENTERS, 1))
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
    "independent-fz": Protocol("every pad its own pressure, {pressure}", ("z",), _along("z", _even)),
    "independent-fx": Protocol("every pad its own shear along x, {shear}", ("x",), _along("x", _even)),
    "contact-fz": Protocol(
        "1-3 indenters press up to {pressure}, {light_pressure} elsewhere", ("z",), _along("z", _pressed)
    ),
    "contact-fx": Protocol(
        "1-3 indenters drag along x up to {shear}, {light_shear} elsewhere", ("x",), _along("x", _pressed)
    ),
    "contact": Protocol("1-3 indenters press and drag within a friction cone", ALL, _contact),
    "three-axis": Protocol("every pad {pressure} and its own shear within a friction cone", ALL, _in_cone(_even)),
    "light-fz": Protocol("nothing, or 0-{touch} of pressure on 1-3 pads", ("z",), _along("z", _touched), True),
    "light-fx": Protocol("nothing, or 0-{touch} of shear along x on 1-3 pads", ("x",), _along("x", _touched), True),
    "light": Protocol("nothing, or 0-{touch} on 1-3 pads, shear within a friction cone", ALL, _in_cone(_touched), True),
}
TABLE = "table"  #: takes its loads from those given: see `listed`
INDENT = "indent"  #: loads the top by contact, not pads: see `dataset.indentation`
#: one line for people about every kind of loads
SUMMARIES = {name: protocol.summary for name, protocol in PROTOCOLS.items()} | {
    TABLE: "loads of a table, drawn at random",
    INDENT: "a sphere, cylinder or flat punch is pressed in, and mostly dragged, with friction",
}


def scaled_indenters(protocol: str, design: SensorDesign) -> list[Any]:
    """What hashes of samples hold beside their settings: the indenters' width where it is not the paper's."""
    is_scaled = protocol.startswith("contact") and design.array.pitch_mm != PAPERS_PITCH_MM
    return ["indenters", INDENTER_WIDTH] if is_scaled else []


def forces(traction_mpa: FloatArray, design: SensorDesign) -> FloatArray:
    """Force on each pad (..., 3) [N] of its traction (..., 3) [MPa]; Fz positive in compression."""
    return traction_mpa * (design.pad.size_mm**2 * np.array([1.0, 1.0, -1.0]))


def listed(traction_mpa: Listed) -> Protocol:
    """The protocol that draws from tractions (m, n_units, 3) [MPa], all alike."""
    rows = np.array(traction_mpa)
    axes = tuple(axis for number, axis in enumerate(AXES) if rows[..., number].any())

    def tractions(generator: Generator, n: int, design: SensorDesign, loads: Loads) -> FloatArray:
        return rows[generator.integers(0, len(rows), n)]

    return Protocol(f"{len(rows)} loads of a table, drawn at random", axes, tractions)


def pad_protocol(name: str) -> Protocol:
    """The protocol of that name, refused if it does not load pads."""
    if name == INDENT:
        raise DesignError(
            f"protocol='{INDENT}' presses shapes on linear rubber; finite strain and twins take loads on pads alone: "
            f"choose one of {', '.join(PROTOCOLS)}."
        )
    return PROTOCOLS[name]
