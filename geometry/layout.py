"""Layout of a unit as data, and the places of a design's units, electrodes, pillars and pads as plain arrays (mm).

A layout names electrodes and the pillars between them; this file and `wiring.py` alone know one by heart, the paper's.
Units run k = i·cols + j over rows i (along y) and columns j (along x); electrodes and pillars in the layout's order.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from geometry.errors import DesignError

if TYPE_CHECKING:
    from geometry.design import SensorDesign, Unit

FloatArray = NDArray[np.float64]

AXES = ("x", "y", "z")  #: displacement, traction and force components


@dataclass(frozen=True)
class Electrode:
    """A square on a unit's top or base."""

    name: str
    place: tuple[float, float]  #: of its middle along x and y from the unit's middle, in half spans


@dataclass(frozen=True)
class Pillar:
    """A straight pillar between two electrodes."""

    name: str
    foot: str  #: name of the lower electrode
    top: str  #: name of the upper one


@dataclass(frozen=True)
class Layout:
    """Electrodes of a unit and the pillars between them; `DesignError` if they make no unit."""

    upper: tuple[Electrode, ...]
    lower: tuple[Electrode, ...]
    pillars: tuple[Pillar, ...]

    def __post_init__(self) -> None:
        once: list[tuple[str, list[Any]]] = [
            ("electrodes are named", list(self.terminals)),
            ("upper electrodes lie at", [one.place for one in self.upper]),
            ("lower electrodes lie at", [one.place for one in self.lower]),
            ("pillars are named", list(self.pillar_names)),
            ("pillars join", [(one.foot, one.top) for one in self.pillars]),
        ]
        for kind, given in once:
            for twice in {each for each in given if given.count(each) > 1}:
                raise DesignError(f"two {kind} {twice}: give each its own.")
        feet, tops = ({one.name: one.place for one in level} for level in (self.lower, self.upper))
        for one in self.pillars:
            if one.foot not in feet or one.top not in tops:
                raise DesignError(
                    f"pillar {one.name} joins {one.foot} and {one.top}: it must stand on one of {', '.join(feet)} and "
                    f"end at one of {', '.join(tops)}."
                )
            if all(a != b for a, b in zip(feet[one.foot], tops[one.top], strict=True)):
                raise DesignError(f"pillar {one.name} leans along x and along y: it may lean along one of them.")
        idle = {*self.terminals} - {name for one in self.pillars for name in (one.foot, one.top)}
        if idle or not self.pillars:
            raise DesignError(f"no pillar joins {', '.join(sorted(idle)) or 'electrodes'}: each needs one.")

    @cached_property
    def upper_names(self) -> tuple[str, ...]:
        return tuple(one.name for one in self.upper)

    @cached_property
    def terminals(self) -> tuple[str, ...]:
        """Names of all electrodes, the upper ones first."""
        return tuple(one.name for one in (*self.upper, *self.lower))

    @cached_property
    def pillar_names(self) -> tuple[str, ...]:
        return tuple(one.name for one in self.pillars)

    @cached_property
    def pillar_terminals(self) -> tuple[tuple[int, int], ...]:
        """Numbers, among `terminals`, of the electrodes at the top and at the foot of each pillar."""
        return tuple((self.terminals.index(one.top), self.terminals.index(one.foot)) for one in self.pillars)

    @cached_property
    def pillar_top(self) -> tuple[int, ...]:
        """Number of the upper electrode at the top of each pillar."""
        return tuple(top for top, _ in self.pillar_terminals)

    def sensing(self, axis: str) -> tuple[int, ...]:
        """Numbers of the pillars that answer a force along x, y or z: those that lean along it, upright ones for z.

        All pillars where none does.

        >>> LAYOUTS["six-pillar"].sensing("x")
        (1, 5)
        """
        places = {one.name: one.place for one in (*self.upper, *self.lower)}
        leans = [tuple(a != b for a, b in zip(places[one.foot], places[one.top], strict=True)) for one in self.pillars]
        found = [not any(lean) if axis == "z" else lean[AXES.index(axis)] for lean in leans]
        return tuple(number for number, answers in enumerate(found) if answers or not any(found))


_UPPER = {"U1": (-1.0, -1.0), "U2": (-1.0, 1.0), "U3": (1.0, 1.0), "U4": (1.0, -1.0)}
_LOWER = {"L1": (-1.0, -1.0), "L2": (1.0, -1.0), "L3": (-1.0, 1.0), "L4": (1.0, 1.0)}


def _on_corners(pillars: str) -> Layout:
    """Layout of electrodes on a square's corners by the names, feet and tops of its pillars."""
    joined = [one.split() for one in pillars.split(",")]
    upper, lower = ({each[at] for each in joined} for at in (2, 1))
    return Layout(
        upper=tuple(Electrode(name, place) for name, place in _UPPER.items() if name in upper),
        lower=tuple(Electrode(name, place) for name, place in _LOWER.items() if name in lower),
        pillars=tuple(Pillar(*each) for each in joined),
    )


#: the paper's unit: electrodes "2", "7", "3" and "5", pillars "1", "4" and "6", named after the force that each senses
SONG2018 = _on_corners("z L1 U1, x L2 U1, y L1 U2")
#: layouts by name; rank of what their pillars tell of a rigid plate's six motions: 3, 6, 6 and 3
LAYOUTS = {
    "song2018": SONG2018,
    "six-pillar": _on_corners("z L1 U1, x L2 U1, y L1 U2, z2 L3 U2, z3 L4 U3, x3 L3 U3"),
    "eight-pillar": _on_corners("z1 L1 U1, x1 L2 U1, z2 L3 U2, y2 L1 U2, z3 L4 U3, x3 L3 U3, z4 L2 U4, y4 L4 U4"),
    "upright-four": _on_corners("z1 L1 U1, z2 L3 U2, z3 L4 U3, z4 L2 U4"),
}
ELECTRODES = SONG2018.upper_names  #: upper electrodes of the paper's unit
PILLARS = SONG2018.pillar_names  #: its pillars
PILLAR_TOP = SONG2018.pillar_top  #: number of the upper electrode at the top of each


def unit_centres(design: "SensorDesign") -> FloatArray:
    """Centre of every unit on the base plane, shape (n_units, 2) [mm]."""
    rows, cols, pitch_mm = design.array.rows, design.array.cols, design.array.pitch_mm
    x = (np.arange(cols) - (cols - 1) / 2) * pitch_mm
    y = (np.arange(rows) - (rows - 1) / 2) * pitch_mm
    return np.stack([np.tile(x, rows), np.repeat(y, cols)], axis=1)


def electrode_centres(unit: "Unit") -> FloatArray:
    """Centres of all electrodes in the unit's frame, the upper ones first, shape (n_electrodes, 3) [mm]."""
    levels, s = ((unit.layout.upper, unit.height_mm), (unit.layout.lower, 0.0)), unit.span_mm / 2
    return np.array([(s * one.place[0], s * one.place[1], z) for level, z in levels for one in level])


def upper_electrodes(unit: "Unit") -> FloatArray:
    """Centres of the upper electrodes in the unit's frame, shape (n_upper, 3) [mm]."""
    return electrode_centres(unit)[: len(unit.layout.upper)]


def pillar_ends(unit: "Unit") -> FloatArray:
    """Bottom and top of the pillars in the unit's frame, shape (n_pillars, 2, 3) [mm]."""
    tops, feet = np.array(unit.layout.pillar_terminals).T
    return np.stack([electrode_centres(unit)[feet], electrode_centres(unit)[tops]], axis=1)


def rest_lengths(unit: "Unit") -> FloatArray:
    """Undeformed length of the pillars, shape (n_pillars,) [mm]; 10, 10√2, 10√2 for the paper's."""
    bottom, top = pillar_ends(unit).transpose(1, 0, 2)
    return np.linalg.norm(top - bottom, axis=1)


def pillar_volumes(unit: "Unit") -> FloatArray:
    """Volume of the pillars, V = S·l exactly, shape (n_pillars,) [mm³]."""
    return unit.pillar_width_mm**2 * rest_lengths(unit)


def pillar_sections(unit: "Unit") -> FloatArray:
    """Extent along x and y of the pillars' horizontal sections, shape (n_pillars, 2) [mm].

    Perpendicular to its axis a pillar is w × w; along its tilt the horizontal section is wider, w·l/h.

    >>> from geometry.design import Unit
    >>> pillar_sections(Unit()).round(3).tolist()
    [[2.0, 2.0], [2.828, 2.0], [2.0, 2.828]]
    """
    w, h = unit.pillar_width_mm, unit.height_mm
    runs = (pillar_ends(unit)[:, 1] - pillar_ends(unit)[:, 0])[:, :2].tolist()
    return np.array([[w * math.hypot(run, h) / h if run else w for run in both] for both in runs])


def footprint(unit: "Unit") -> float:
    """Side of the smallest centred square that holds the unit's pillars and electrodes [mm]."""
    pillars = np.abs(pillar_ends(unit)[..., :2]) + pillar_sections(unit)[:, None] / 2
    electrodes = np.abs(pillar_ends(unit)[..., :2]) + unit.electrode_mm / 2
    return 2 * float(max(pillars.max(), electrodes.max()))


def min_span(unit: "Unit") -> float:
    """Span at which ends of two pillars, or two electrodes, meet, for sections as they are now [mm]."""
    ends, sections, found = pillar_ends(unit)[..., :2] / unit.span_mm, pillar_sections(unit), [0.0]
    for one, other in combinations(range(len(ends)), 2):
        for apart in np.abs(ends[one] - ends[other]):
            for room in ((sections[one] + sections[other]) / 2, np.full(2, unit.electrode_mm)):
                found += [float((room[apart > 0] / apart[apart > 0]).min())] if apart.any() else []
    return max(found)


def pillar_shares(unit: "Unit", x_mm: FloatArray, y_mm: FloatArray, z_mm: FloatArray) -> FloatArray:
    """Share of each box between lines (nx + 1,), (ny + 1,), (nz + 1,) of the unit's frame that its pillars fill.

    Shape (nx, ny, nz). By 8 Gauss points along z of every box: exact where no pillar's face crosses its uprights.

    >>> from geometry.design import Unit
    >>> around_z = np.array([-6.0, -4.0]), np.array([-6.0, -4.0])
    >>> round(float(pillar_shares(Unit(), *around_z, np.array([4.0, 6.0]))[0, 0, 0]), 9)
    1.0
    """
    points, weights = np.polynomial.legendre.leggauss(8)
    z = (z_mm[:-1] + z_mm[1:])[:, None] / 2 + np.diff(z_mm)[:, None] / 2 * points
    ends = pillar_ends(unit)[:, :, :2]
    middle = ends[:, 0, None, None] + (z / unit.height_mm)[..., None] * (ends[:, 1] - ends[:, 0])[:, None, None]
    half = pillar_sections(unit)[:, None, None] / 2
    sections = np.stack([middle - half, middle + half])  # (2, n_pillars, nz, 8, 2): low and high corners of each

    def filled(pillars: tuple[int, ...]) -> FloatArray:
        """Area of the boxes that all of some pillars cover, its mean along z."""
        low, high = sections[0, pillars].max(axis=0), sections[1, pillars].min(axis=0)
        low, high = (np.moveaxis(ends, -1, 0) for ends in (low, high))
        along = (
            np.maximum(np.minimum(line[1:, None, None], top) - np.maximum(line[:-1, None, None], bottom), 0.0)
            for line, bottom, top in zip((x_mm, y_mm), low, high, strict=True)
        )
        return np.einsum("xzq,yzq,q->xyz", *along, weights / 2)

    # of the union: what one pillar covers less what two do, and so on, as far as any are in one place
    whole, sign = np.zeros((len(x_mm) - 1, len(y_mm) - 1, len(z_mm) - 1)), 1.0
    groups: list[tuple[int, ...]] = [(k,) for k in range(len(ends))]
    while groups:
        areas = {group: filled(group) for group in groups}
        for area in areas.values():
            whole += sign * area
        groups = [(*group, k) for group, area in areas.items() if area.any() for k in range(group[-1] + 1, len(ends))]
        sign = -sign
    return whole / (np.diff(x_mm)[:, None, None] * np.diff(y_mm)[:, None])


def electrode_squares(design: "SensorDesign") -> FloatArray:
    """Upper electrodes as rectangles of the top face, shape (n_units·n_upper, 4): x0, y0, x1, y1 [mm]."""
    centres = unit_centres(design)[:, None, :] + upper_electrodes(design.unit)[None, :, :2]
    return _squares(centres.reshape(-1, 2), design.unit.electrode_mm)


def pad_squares(design: "SensorDesign") -> FloatArray:
    """Contact pads as rectangles of the top face, shape (n_units, 4): x0, y0, x1, y1 [mm]."""
    offset = np.array([design.pad.offset_x_mm, design.pad.offset_y_mm])
    return _squares(unit_centres(design) + offset, design.pad.size_mm)


def _squares(centres: FloatArray, side_mm: float) -> FloatArray:
    return np.hstack([centres - side_mm / 2, centres + side_mm / 2])
