"""Layout of a unit as data, and the places of a design's units, electrodes, pillars and pads as plain arrays (mm).

A layout names electrodes and the pillars between them; this file alone knows some by heart, the paper's among them.
Units run k = i·cols + j over rows i (along y) and columns j (along x); electrodes and pillars in the layout's order.
"""

import math
import re
import reprlib
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from common.errors import DesignError
from common.quantity import OPTIONAL, Sound, quantity

if TYPE_CHECKING:
    from geometry.design import SensorDesign, Unit

FloatArray = NDArray[np.float64]

AXES = ("x", "y", "z")  #: displacement, traction and force components
TURNS = (0.2, 0.3)  #: of a pad by a shear force, by its shift over the height; two, as one may just cancel a shift


Pair = tuple[float, float]

#: of a pillar, perpendicular to its axis: corners anticlockwise, each opposite another, along its lean and across it in
#: half widths; a circle has none
SECTIONS: dict[str, tuple[Pair, ...]] = {
    "square": ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)),
    "round": (),
}
NAME = re.compile(r"[A-Za-z][A-Za-z0-9]{0,7}")  #: of an electrode, a wire or a pillar: it becomes part of names
PLACES = (-1e3, 1e3)  #: of an electrode, in half spans
MAX_PARTS = 64  #: electrodes and pillars of a unit: more are an array's


@dataclass(frozen=True)
class Electrode(Sound):
    """A square on a unit's top or base."""

    name: str
    place: tuple[float, float] = quantity(
        MISSING, "its middle along x and y from the unit's middle, in half spans", count=2, within=PLACES
    )
    #: name of a wire that it shares with others of the unit and level; without, it has one of its own
    wire: str | None = field(default=None, metadata=OPTIONAL)


@dataclass(frozen=True)
class Pillar(Sound):
    """A straight pillar between two electrodes."""

    name: str
    foot: str  #: name of the lower electrode
    top: str  #: name of the upper one
    section: str = quantity("square", "perpendicular to its axis", True, of=SECTIONS)
    width_mm: float | None = quantity(None, "side or diameter; without, it is the unit's", True, above_0=True)
    reference: bool = quantity(
        False, "stands beside the slab on these electrodes' wires: no load reaches it, drifts do", True
    )

    @property
    def is_round(self) -> bool:
        return self.section == "round"


@dataclass(frozen=True)
class Layout:
    """Electrodes of a unit and the pillars between them; `DesignError` if they make no unit."""

    upper: tuple[Electrode, ...]
    lower: tuple[Electrode, ...]
    pillars: tuple[Pillar, ...]

    def __post_init__(self) -> None:
        for kind, count in (("electrodes", len(self.upper) + len(self.lower)), ("pillars", len(self.pillars))):
            if count > MAX_PARTS:
                raise DesignError(f"a unit has more than {MAX_PARTS} {kind}: give fewer, and more rows or cols.")
        wires = [one.wire for one in (*self.upper, *self.lower) if one.wire is not None]
        ends = [end for one in self.pillars for end in (one.foot, one.top)]
        for name in (*self.terminals, *wires, *self.pillar_names, *ends):
            if not isinstance(name, str) or not NAME.fullmatch(name):
                raise DesignError(f"{reprlib.repr(name)} is no name: give up to 8 letters and digits, such as U1 or z.")
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
                lower, upper = (
                    ", ".join(names) or f"the {level} electrodes, of which there are none"
                    for names, level in ((feet, "lower"), (tops, "upper"))
                )
                raise DesignError(
                    f"pillar {one.name} joins {one.foot} and {one.top}: it must stand on one of {lower} and end at one "
                    f"of {upper}."
                )
        idle = {*self.terminals} - {name for one in self.pillars if not one.reference for name in (one.foot, one.top)}
        if idle or not self.pillars:
            raise DesignError(
                f"no pillar joins {', '.join(sorted(idle)) or 'electrodes'}: each needs one that is no reference."
            )
        self._require_crossings()

    def _require_crossings(self) -> None:
        """Refuse two pillars that are read at one crossing of wires."""
        for (one, at), (other, place) in combinations(zip(self.pillars, self.pillar_crossings, strict=True), 2):
            if at == place:
                ends = [pair for pair in ((one.foot, other.foot), (one.top, other.top)) if pair[0] != pair[1]]
                raise DesignError(
                    f"pillars {one.name} and {other.name} want one crossing of wires: give "
                    f"{' or '.join(' and '.join(pair) for pair in ends)} wires of their own."
                )

    @cached_property
    def loaded(self) -> tuple[int, ...]:
        """Numbers of the pillars that loads reach: all but references."""
        return tuple(number for number, one in enumerate(self.pillars) if not one.reference)

    @cached_property
    def body(self) -> "Layout":
        """The same without references: what is cast and bends."""
        if len(self.loaded) == len(self.pillars):
            return self
        return replace(self, pillars=tuple(self.pillars[number] for number in self.loaded))

    @cached_property
    def row_wires(self) -> tuple[int, ...]:
        """Number, among a unit's row wires, of each upper electrode's; wires count as electrodes first name them."""
        return _wires(self.upper)

    @cached_property
    def column_wires(self) -> tuple[int, ...]:
        """Number, among a unit's column wires, of each lower electrode's."""
        return _wires(self.lower)

    @cached_property
    def pillar_crossings(self) -> tuple[tuple[int, int], ...]:
        """Row and column wire, among the unit's, of each pillar."""
        n_upper = len(self.upper)
        return tuple((self.row_wires[top], self.column_wires[foot - n_upper]) for top, foot in self.pillar_terminals)

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

        All that loads reach where none does.

        >>> LAYOUTS["six-pillar"].sensing("x")
        (1, 5)
        """
        return self._sensing[AXES.index(axis)]

    @cached_property
    def _sensing(self) -> list[tuple[int, ...]]:
        """By axis; each scan that is decoded asks for it."""
        places = {one.name: one.place for one in (*self.upper, *self.lower)}
        leans = [tuple(a != b for a, b in zip(places[one.foot], places[one.top], strict=True)) for one in self.pillars]
        answers = [[*lean, not any(lean)] for lean in leans]
        found = [tuple(k for k in self.loaded if answers[k][axis]) for axis in range(len(AXES))]
        return [some or self.loaded for some in found]


def _wires(level: tuple[Electrode, ...]) -> tuple[int, ...]:
    names = [one.name if one.wire is None else f"wire {one.wire}" for one in level]
    found = list(dict.fromkeys(names))
    return tuple(found.index(name) for name in names)


_UPPER = {"U0": (0.0, 0.0), "U1": (-1.0, -1.0), "U2": (-1.0, 1.0), "U3": (1.0, 1.0), "U4": (1.0, -1.0)}
_LOWER = {"L0": (0.0, 0.0), "L1": (-1.0, -1.0), "L2": (1.0, -1.0), "L3": (-1.0, 1.0), "L4": (1.0, 1.0)}


def _on_corners(pillars: str) -> Layout:
    """Layout of electrodes on a square's corners, or its middle, by the names, feet and tops of its pillars."""
    joined = [one.split() for one in pillars.split(",")]
    upper, lower = ({each[at] for each in joined} for at in (2, 1))
    return Layout(
        upper=tuple(Electrode(name, place) for name, place in _UPPER.items() if name in upper),
        lower=tuple(Electrode(name, place) for name, place in _LOWER.items() if name in lower),
        pillars=tuple(Pillar(name, foot, top) for name, foot, top in joined),
    )


#: the paper's unit: electrodes "2", "7", "3" and "5", pillars "1", "4" and "6", named after the force that each senses
SONG2018 = _on_corners("z L1 U1, x L2 U1, y L1 U2")
#: layouts by name; rank of what their pillars tell of a rigid plate's six motions: 3, 6, 6, 3 and 1
LAYOUTS = {
    "song2018": SONG2018,
    "six-pillar": _on_corners("z L1 U1, x L2 U1, y L1 U2, z2 L3 U2, z3 L4 U3, x3 L3 U3"),
    "eight-pillar": _on_corners("z1 L1 U1, x1 L2 U1, z2 L3 U2, y2 L1 U2, z3 L4 U3, x3 L3 U3, z4 L2 U4, y4 L4 U4"),
    "upright-four": _on_corners("z1 L1 U1, z2 L3 U2, z3 L4 U3, z4 L2 U4"),
    "single": _on_corners("z L0 U0"),
}


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


def pillar_vectors(unit: "Unit") -> FloatArray:
    """From the bottom of each pillar to its top, undeformed, shape (n_pillars, 3) [mm]."""
    return pillar_ends(unit)[:, 1] - pillar_ends(unit)[:, 0]


def rest_lengths(unit: "Unit") -> FloatArray:
    """Undeformed length of the pillars, shape (n_pillars,) [mm]; 10, 10√2, 10√2 for the paper's."""
    return np.linalg.norm(pillar_vectors(unit), axis=1)


def pillar_widths(unit: "Unit") -> list[float]:
    """Side or diameter of each pillar, perpendicular to its axis [mm]."""
    return [unit.pillar_width_mm if one.width_mm is None else one.width_mm for one in unit.layout.pillars]


def pillar_areas(unit: "Unit") -> FloatArray:
    """Area S of each pillar's section, perpendicular to its axis, shape (n_pillars,) [mm²]: w², or π w²/4."""
    return np.array([polygon_area(one.section) / 4 for one in unit.layout.pillars]) * np.square(pillar_widths(unit))


def pillar_volumes(unit: "Unit") -> FloatArray:
    """Volume of the pillars, V = S·l exactly, shape (n_pillars,) [mm³]."""
    return pillar_areas(unit) * rest_lengths(unit)


def polygon_area(section: str) -> float:
    """Area of a section in half widths squared, by the shoelace formula.

    >>> polygon_area("square"), polygon_area("round")
    (4.0, 3.14159...)
    """
    if not SECTIONS[section]:
        return math.pi
    x, y = np.array(SECTIONS[section]).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def half_extents(section: str) -> Pair:
    """Half extents of a section along its pillar's lean and across it, in half widths."""
    x, y = np.abs(SECTIONS[section] or [(1.0, 1.0)]).max(axis=0).tolist()
    return x, y


def extents_around(section: str, widths_mm: FloatArray) -> FloatArray:
    """Extents (2,) along x and y of a section whose widths along the lean and across it are these vectors (2, 2)."""
    corners = np.reshape(SECTIONS[section], (-1, 2))
    return np.asarray(np.abs(corners @ widths_mm).max(axis=0) if len(corners) else np.linalg.norm(widths_mm, axis=0))


def leans_both_ways(unit: "Unit") -> NDArray[np.bool_]:
    """Whether each pillar leans along x and along y, shape (n_pillars,)."""
    return np.asarray((pillar_vectors(unit)[:, :2] != 0).all(axis=1))


def pillar_sections(unit: "Unit") -> FloatArray:
    """Extent along x and y of the pillars' horizontal sections, shape (n_pillars, 2) [mm].

    Perpendicular to its axis a pillar has its section of width w; along its tilt it is wider, w·l/h. Of one that leans
    along x and along y the rectangle around its section, which is turned along its tilt.

    >>> from geometry.design import Unit
    >>> pillar_sections(Unit()).round(3).tolist()
    [[2.0, 2.0], [2.828, 2.0], [2.0, 2.828]]
    """
    found, h = [], unit.height_mm
    leans = np.abs(pillar_vectors(unit)[:, :2]).tolist()
    for pillar, w, (x, y) in zip(unit.layout.pillars, pillar_widths(unit), leans, strict=True):
        run = math.hypot(x, y)
        along, x, y = (w * math.hypot(run, h) / h, x / run, y / run) if run else (w, 1.0, 0.0)
        found.append(extents_around(pillar.section, np.array([[along * x, along * y], [-w * y, w * x]])))
    return np.array(found)


def untold(unit: "Unit", axes: Sequence[str] = AXES, turns: Sequence[float] = TURNS) -> list[str]:
    """Axes among some along which the pillars cannot tell a force from those along the others.

    A force along x or y moves a pad along and turns it, as far as `turns` say; one along z presses it down. Lengths of
    pillars must change in ways of their own by each of the axes that are asked.
    """
    along, tops, h = pillar_vectors(unit.body), pillar_ends(unit.body)[:, 1, :2], unit.height_mm
    columns = [AXES.index(axis) for axis in axes]

    def rank(some: list[int]) -> int:
        turned = [np.hstack([along[:, :2] - turn * tops, along[:, 2:]])[:, some] / h for turn in turns]
        return max(int(np.linalg.matrix_rank(each)) for each in turned) if some else 0

    if (told := rank(columns)) == len(columns):
        return []
    return [AXES[each] for each in columns if rank([one for one in columns if one != each]) == told]


def require_told(unit: "Unit", axes: Sequence[str] = AXES) -> None:
    """Refuse a layout whose pillars cannot tell forces along some axes from those along the others; `DesignError`."""
    if said := untold(unit, axes):
        raise DesignError(
            f"pillars {', '.join(unit.layout.pillar_names)} do not tell forces along {' and '.join(said)} from others: "
            "ask for fewer components, or add pillars: one that leans along x, one along y and an upright one."
        )


def told_by_tilt(unit: "Unit", axes: Sequence[str] = AXES) -> str:
    """A line that says which forces the pillars tell by the tilt of pads alone, since none leans that way; or none.

    Errors 4 to 40 times as large as of the paper's pillars are Cramér and Rao's bounds for `upright-four`, 6 to 15 mm
    high, of 0.1 % of noise and 12 bits.

    >>> from geometry.design import Unit
    >>> told_by_tilt(Unit(layout=LAYOUTS["upright-four"]), ("x", "z")), told_by_tilt(Unit())
    ('no pillar leans along x: forces that way are told by tilt alone, with errors 4 to 40 times as large', '')
    """
    said = [axis for axis in untold(unit, axes, (0.0,)) if axis not in untold(unit, axes)]
    told = "forces that way are told by tilt alone, with errors 4 to 40 times as large"
    return f"no pillar leans along {' or '.join(said)}: {told}" if said else ""


def footprint(unit: "Unit") -> float:
    """Side of the smallest centred square that holds the unit's pillars and electrodes [mm]."""
    unit = unit.body
    pillars = np.abs(pillar_ends(unit)[..., :2]) + pillar_sections(unit)[:, None] / 2
    electrodes = np.abs(pillar_ends(unit)[..., :2]) + unit.electrode_mm / 2
    return 2 * float(max(pillars.max(), electrodes.max()))


def min_span(unit: "Unit") -> tuple[float, str]:
    """Span at which ends of two pillars, or two electrodes, meet, for sections as they are now [mm]; and which."""
    unit = unit.body
    ends, sections, found = pillar_ends(unit)[..., :2] / unit.span_mm, pillar_sections(unit), [(0.0, "")]
    for one, other in combinations(range(len(ends)), 2):
        a, b = (unit.layout.pillars[number] for number in (one, other))
        for apart, electrodes in zip(np.abs(ends[one] - ends[other]), ((a.foot, b.foot), (a.top, b.top)), strict=True):
            for room, met in (
                ((sections[one] + sections[other]) / 2, f"pillars {a.name} and {b.name}"),
                (np.full(2, unit.electrode_mm), f"electrodes {' and '.join(electrodes)}"),
            ):
                found += [(float((room[apart > 0] / apart[apart > 0]).min()), met)] if apart.any() else []
    return max(found, key=lambda each: each[0])


def crossing_pillars(unit: "Unit", samples: int = 65) -> tuple[str, str] | None:
    """Names of two pillars without a common electrode that meet, outside one that joins an electrode of each.

    Of round sections, and of those turned along a lean both ways, the rectangles along x and y around them count: some
    that nearly meet are refused.
    """
    unit = unit.body
    ends, sections, pairs = pillar_ends(unit)[..., :2], pillar_sections(unit), unit.layout.pillar_terminals
    share = np.linspace(0.0, 1.0, samples)[:, None]
    middle = ends[:, None, 0] + share * (ends[:, None, 1] - ends[:, None, 0])  # (n_pillars, samples, 2)
    low, high = middle - sections[:, None] / 2, middle + sections[:, None] / 2
    slack = 1e-9 * sections.max()
    for i, j in combinations(range(len(ends)), 2):
        if {*pairs[i]} & {*pairs[j]}:
            continue
        bottom, top = np.maximum(low[i], low[j]), np.minimum(high[i], high[j])
        met = (top - bottom > slack).all(axis=1)
        for k, pair in enumerate(pairs):
            if {*pair} & {*pairs[i]} and {*pair} & {*pairs[j]}:  # inside it both are one body with it anyway
                met &= ~((bottom >= low[k] - slack) & (top <= high[k] + slack)).all(axis=1)
        if met.any():
            return unit.layout.pillar_names[i], unit.layout.pillar_names[j]
    return None


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
