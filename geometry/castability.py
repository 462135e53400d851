"""What a design asks of its mould and of rubber, in closed form: walls, heels that stay under, how steep wedges are.

`mould.py` draws the parts; nothing is drawn here, so that a sweep may ask it of every design.
"""

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from common.errors import DesignError
from geometry.design import SensorDesign, Unit
from geometry.layout import FloatArray, pillar_ends, pillar_sections, pillar_vectors, pillar_widths
from geometry.prism import Prism, unit_prisms
from geometry.shares import pillar_shares

SLICES = 40  #: of a unit, in which its pillars are measured


@dataclass(frozen=True, kw_only=True)
class Castability:
    """How well a sensor can be cast in its mould."""

    wall_mm: float  #: smallest wall between the troughs of two pillars, or of rubber from a pillar to the slab's side
    undercut_mm: float  #: how far a pillar's heel juts out under the wall of its trough; rubber bends past some 0.5 mm
    demould_deg: float | None  #: least angle between a slanted face and the vertical; None where no pillar leans


def castability(design: SensorDesign) -> Castability:
    """Measures of a design's mould; `DesignError` if it has none, as one pillar lies above another.

    From above a trough is its pillar's outline, as a wedge of the lid reaches down to all that leans. Pillars that meet
    at an electrode, or at the two ends of an upright one, are one body there and have no wall between them.

    >>> castability(SensorDesign())
    Castability(wall_mm=1.08..., undercut_mm=0.41..., demould_deg=45.0)
    """
    unit, pitch_mm = design.unit.body, design.array.pitch_mm
    outlines, names = _outlines(unit), unit.layout.pillar_names
    walls = [pitch_mm / 2 - float((np.abs(pillar_ends(unit)[..., :2]) + pillar_sections(unit)[:, None] / 2).max())]
    for one, other in combinations(range(len(names)), 2):
        if _is_joined(unit, one, other):
            continue
        walls.append(_gap(outlines[one], outlines[other]))
        if not walls[-1] > 0:
            raise DesignError(
                f"pillars {names[one]} and {names[other]} lie one above the other: no lid lifts off the lower one."
            )
    rows, cols = design.array.rows > 1, design.array.cols > 1
    for right, up in [(1, 0)] * cols + [(0, 1)] * rows + [(1, 1), (-1, 1)] * (rows and cols):
        moved = outlines + pitch_mm * np.array([right, up])
        walls += [_gap(one, other) for one in outlines for other in moved]
    widths, h = pillar_widths(unit), unit.height_mm
    runs = np.linalg.norm(pillar_vectors(unit)[:, :2], axis=1)
    upright = {pillar.foot: w for pillar, w, run in zip(unit.layout.pillars, widths, runs, strict=True) if not run}
    heels = [
        w * math.hypot(run, h) / h / 2 - _reach(upright[pillar.foot], w, straight)
        for pillar, straight, w, run in zip(unit.layout.pillars, unit_prisms(unit), widths, runs, strict=True)
        if run and pillar.foot in upright
    ]
    leaning = runs[runs > 0]
    angle = math.degrees(math.atan(float(leaning.min()) / h)) if len(leaning) else None
    return Castability(wall_mm=min(walls), undercut_mm=max(0.0, *heels) if heels else 0.0, demould_deg=angle)


def conductive_mm3(design: SensorDesign) -> float:
    """Volume of all pillars, counted once where they overlap [mm³].

    >>> round(conductive_mm3(SensorDesign()) / 36, 3)  # w²(h + 2l) − w²·h·(w·l/h)/s of a unit
    141.823
    """
    unit, side_mm = design.unit, design.unit.footprint_mm
    ends_mm, levels_mm = np.array([-side_mm / 2, side_mm / 2]), np.linspace(0.0, unit.height_mm, SLICES + 1)
    filled = float(pillar_shares(unit, ends_mm, ends_mm, levels_mm).mean())
    return design.n_units * filled * side_mm**2 * unit.height_mm


def _outlines(unit: Unit) -> FloatArray:
    """Rectangles that pillars are from above, or that hold them: corners (n_pillars, 4, 2) in the unit's frame [mm]."""
    found = []
    for straight in unit_prisms(unit):
        ends = straight.own(np.array([straight.base_mm, straight.top_mm])[:, :2])
        half = np.array(straight.section_mm) / 2
        (x0, y0), (x1, y1) = ends.min(axis=0) - half, ends.max(axis=0) + half
        found.append(straight.placed(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])))
    return np.array(found)


def _gap(one: FloatArray, other: FloatArray) -> float:
    """Distance of two convex outlines, corners (n, 2) each; 0 if they overlap."""
    apart, distances = [], []
    for a, b in ((one, other), (other, one)):
        ends = np.roll(a, -1, axis=0)
        along = (ends - a) / np.linalg.norm(ends - a, axis=1, keepdims=True)
        out = ((b[:, None] - a) * np.column_stack([along[:, 1], -along[:, 0]])).sum(axis=2)  # anticlockwise
        apart.append(out.min(axis=0).max())
        share = (((b[:, None] - a) * along).sum(axis=2) / np.linalg.norm(ends - a, axis=1)).clip(0.0, 1.0)[..., None]
        distances.append(np.linalg.norm(b[:, None] - (a * (1 - share) + ends * share), axis=2).min())
    return float(min(distances)) if max(apart) > 0 else 0.0


def _reach(upright_mm: float, width_mm: float, straight: Prism) -> float:
    """How far an upright pillar lies behind the foot of one that leans, where that is least: at its sides' edges.

    Behind a square that the other leans across, its corner lies furthest.
    """
    if straight.is_round or not straight.axis_mm[:2].all():
        return upright_mm / 2
    back, across = -straight.turn[0], straight.turn[1] * width_mm / 2
    return float(min(((upright_mm / 2 - np.sign(back) * at) / np.abs(back)).min() for at in (across, -across)))


def _is_joined(unit: Unit, one: int, other: int) -> bool:
    """Whether two pillars meet wherever an end of one lies on or above an end of the other, and that is somewhere."""
    layout, ends = unit.layout, pillar_ends(unit)[..., :2]
    pairs = layout.pillar_terminals
    upright = {pair for pair, end in zip(pairs, ends, strict=True) if (end[0] == end[1]).all()}
    places = dict(zip(np.ravel(pairs).tolist(), ends[:, ::-1].reshape(-1, 2).tolist(), strict=True))
    met = [(a, b) for a in pairs[one] for b in pairs[other] if places[a] == places[b]]
    return bool(met) and all(a == b or {(a, b), (b, a)} & upright for a, b in met)
