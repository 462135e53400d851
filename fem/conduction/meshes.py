"""Hexahedra of a unit's pillars, crowding where the current density is singular.

Every pillar is cut in the middle of its height, and about each electrode lie the halves that end there: at most an
upright and an oblique one, between −w/2 and w/2 across. Their union is a plane figure, swept across. It is cut into
quadrilaterals along lines that end at the electrode's edges and in the crotch. Round pillars have the same figure in
every plane along their leans, smaller toward their sides; of their square ends nodes inside count as electrodes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations, pairwise

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre
from skfem import MeshHex
from skfem.refdom import RefHex

from common.errors import DesignError
from fem.kernel.elements import Basis, hexahedra
from fem.kernel.field import same_places
from fem.kernel.reference import IntArray
from fem.kernel.scalar import Scalar
from geometry.design import Unit
from geometry.layout import FloatArray, electrode_centres, leans_both_ways, pillar_ends, pillar_sections, pillar_widths
from geometry.prism import unit_prisms

RATIO = 0.15  #: of the sizes of neighbouring elements toward a singular edge
INNER = 0.7  #: of a strained pillar's width, its inner element
ROUND_ACROSS = 6  #: elements across a round pillar: halves of a polygon, enlarged to the circle's area
LONGEST = 1.0  #: of an element along a pillar, in widths of the pillar
AXES_AGREE = 1e-9  #: of the body's size: how far apart elements that meet may see a node they share


class Hexahedra(Scalar):
    """A body that conducts between terminals, each of some nodes; `pairs` of terminals are at the ends of pillars."""

    def __init__(
        self,
        basis: Basis,
        terminals: Sequence[IntArray],
        pairs: Sequence[tuple[int, int]] = ((0, 1),),
        constraint: sp.csr_matrix | None = None,
    ) -> None:
        super().__init__(basis, constraint)
        self.pairs = pairs
        #: unknowns on each terminal, (n_unknowns, n_terminals)
        self.on_terminals = np.stack([np.ravel(self.constraint[own].sum(axis=0)) > 0.5 for own in terminals], axis=1)


def joined(parts: Sequence[FloatArray], order: int) -> Basis:
    """Hexahedra of corners (m, 2, 2, 2, 3), of either orientation; those of one part share common faces.

    A `ValueError` says that axes of elements that meet differ: from order 3 on their edges' nodes would not.
    """
    points: list[FloatArray] = []
    corners: list[IntArray] = []
    for part in parts:
        places = part[:, *RefHex.p.astype(int)].reshape(-1, 3)
        first, number = same_places(places)
        corners.append(number.reshape(-1, 8).T + sum(each.shape[1] for each in points))
        points.append(places[first].T)
    basis = Basis(MeshHex(*(np.ascontiguousarray(np.hstack(each)) for each in (points, corners))), hexahedra(order)[0])
    seen = basis.mapping.F(basis.elem.doflocs.T) - basis.doflocs[:, basis.element_dofs.T]
    if np.abs(seen).max() > AXES_AGREE * np.ptp(basis.doflocs):
        raise ValueError("elements that meet differ in their axes: state the corners of all of them in one order")
    return basis


@dataclass(frozen=True, eq=False, kw_only=True)
class Joint:
    """Pillars that meet at an electrode. X runs along the oblique one's lean, Y across, t away from the electrode."""

    upright: bool  #: whether there is an upright one
    run_mm: float  #: by which the oblique one leans in all; 0 where there is none
    axes: FloatArray  #: X, Y and t as rows, (3, 3)
    width_mm: float  #: of both
    polygon: float  #: of round ones, corners of the polygon that is meshed, in terms of the radius; 1 of square ones
    at_mm: FloatArray  #: middle of the electrode in the unit's frame, (3,)
    electrode_mm: float  #: side of the electrode
    height_mm: float  #: of the unit


def unit_hexahedra(
    unit: Unit, order: int, levels: int, strained: bool = False, round_across: int = ROUND_ACROSS
) -> Hexahedra:
    """The pillars of a unit in its own frame; terminals are its electrodes, the upper ones first.

    `levels` are of refinement toward electrodes' edges and crotches, by `RATIO` each. `strained` cuts the pillars
    across, too: strain near the edge of a pad varies as much there as in the figure. A `DesignError` says that pillars
    touch that share no electrode, or several oblique ones or of several sections share one: no swept figures then.

    Where a pillar is cut the lines of one half may cross those of the other: the values there follow one polynomial of
    the elements' order, which suits both.
    """
    layout, joints = unit.layout, _joints(unit, round_across)
    parts = [joint.at_mm + _swept(joint, levels, strained, round_across) @ joint.axes for joint in joints]
    basis = joined(parts, order)
    nodes, part = basis.doflocs.T, np.empty(basis.N, dtype=np.int64)
    part[basis.element_dofs] = np.repeat(np.arange(len(parts)), [len(each) for each in parts])

    def within(
        own: Sequence[int], middle: FloatArray, half_mm: FloatArray, joint: Joint
    ) -> tuple[IntArray, FloatArray]:
        """Nodes of some parts in a horizontal rectangle, and where in it, −1..1 along x and y."""
        reach = joint.polygon * np.append(half_mm, 0.0) + 1e-6 * joint.width_mm
        found = np.flatnonzero(np.isin(part, own) & (np.abs(nodes - middle) <= reach).all(axis=1))
        return found, np.clip((nodes[found] - middle)[:, :2] / (joint.polygon * half_mm), -1.0, 1.0)

    e = np.full(2, unit.electrode_mm / 2)
    terminals = [within([k], joint.at_mm, e, joint)[0] for k, joint in enumerate(joints)]
    cuts = zip(layout.pillar_terminals, pillar_ends(unit).mean(axis=1), pillar_sections(unit) / 2, strict=True)
    constraint = _constraint(basis, [within(own, at, half, joints[own[0]]) for own, at, half in cuts])
    return Hexahedra(basis, terminals, layout.pillar_terminals, constraint)


def _constraint(basis: Basis, cuts: list[tuple[IntArray, FloatArray]]) -> sp.csr_matrix:
    """Nodes (n,) on every cut, at places (n, 2), take one polynomial of (order + 1)² values; all others are free.

    Where round pillars have shrunk to a line the nodes that it takes in are one.
    """
    n, elem, nodes_mm = basis.N, basis.elem, basis.doflocs.T
    one = np.arange(n)
    shrunk = np.unique(basis.element_dofs[:, (np.diff(np.sort(basis.mesh.t, axis=0), axis=0) == 0).any(axis=0)])
    if len(shrunk):
        first, number = same_places(nodes_mm[shrunk])
        one[shrunk] = shrunk[first[number]]
    free = np.setdiff1d(np.arange(n), np.concatenate([nodes for nodes, _ in cuts]))
    unknown, column = np.unique(one[free], return_inverse=True)
    columns = [sp.csr_matrix((np.ones(len(free)), (free, column)), shape=(n, len(unknown)))]
    for nodes, places in cuts:
        along = legendre.legvander(places, elem.maxdeg) @ elem.to_legendre  # (n, 2, order + 1)
        along[np.abs(along) < 1e-12] = 0.0
        values = np.einsum("ni,nj->nij", along[:, 0], along[:, 1]).reshape(len(nodes), -1)
        row, column = np.indices(values.shape)
        entries = values.ravel(), (nodes[row.ravel()], column.ravel())
        columns.append(sp.csr_matrix(entries, shape=(n, values.shape[1])))
    return sp.hstack(columns, format="csr")


def _joints(unit: Unit, round_across: int) -> list[Joint]:
    """What lies about each electrode; refusals as of `unit_hexahedra`."""
    layout, ends, centres, joints = unit.layout, pillar_ends(unit)[..., :2], electrode_centres(unit), []
    if (turned := leans_both_ways(unit)).any():
        names = [name for name, is_turned in zip(layout.pillar_names, turned, strict=True) if is_turned]
        raise DesignError(
            f"conduction takes pillars that lean along x or along y, {', '.join(names)} along both: take eq. 1."
        )
    leans, pairs, widths = ends[:, 1] - ends[:, 0], layout.pillar_terminals, pillar_widths(unit)
    for number, name in enumerate(layout.terminals):
        own = [k for k, pair in enumerate(pairs) if number in pair]
        uprights, obliques = ([k for k in own if leans[k].any() == lean] for lean in (False, True))
        if len(obliques) > 1:
            raise DesignError(
                f"conduction takes one oblique pillar at an electrode, {name} has {len(obliques)}: take eq. 1."
            )
        sections = {(widths[k], layout.pillars[k].section) for k in own}
        if len(sections) > 1:
            raise DesignError(f"conduction takes pillars of one section at an electrode, {name} has two: take eq. 1.")
        ((width, section),) = sections
        is_round = section == "round"
        if not (is_round or section == "square"):
            raise DesignError(f"conduction takes square and round pillars, at {name} they are {section}: take eq. 1.")
        if is_round and unit.electrode_mm < width * (1 - 1e-6):
            raise DesignError(
                f"conduction takes round pillars on electrodes at least as wide: raise electrode_mm from "
                f"{unit.electrode_mm:g} to {width:g}, or take eq. 1."
            )
        away = -1.0 if number < len(layout.upper) else 1.0  # along z; upper electrodes come first
        lean = away * leans[obliques].sum(axis=0)
        axes = np.zeros((3, 3))
        axes[:, [int(lean[1] != 0), int(lean[1] == 0), 2]] = np.diag([-1.0 if lean.sum() < 0 else 1.0, 1.0, away])
        polygon = 1.0
        if is_round:  # of twice as many sides as elements across, and the circle's area
            polygon = math.sqrt(math.pi / (round_across * math.sin(math.pi / round_across)))
        joints.append(
            Joint(
                upright=bool(uprights),
                run_mm=float(np.abs(lean).max()),
                axes=axes,
                width_mm=width,
                polygon=polygon,
                at_mm=centres[number],
                electrode_mm=unit.electrode_mm,
                height_mm=unit.height_mm,
            )
        )
    # an oblique pillar must part from an upright one above the middle of its height, and touch no other
    least_mm, prisms = max(widths) + float(pillar_sections(unit).max()), unit_prisms(unit)
    close = min((one.run_mm for one in joints if one.upright and one.run_mm), default=np.inf) <= least_mm
    for (one, a), (two, b) in combinations(zip(prisms, pairs, strict=True), 2):
        close |= not {*a} & {*b} and one.cuts(two, 0.0)
    if close:
        raise DesignError(
            f"conduction takes units whose oblique pillars do not touch: span_mm={unit.span_mm:g} must be above "
            f"{least_mm:.4g} for pillar_width_mm={max(widths):g}; widen the span, thin the pillars or take "
            "eq. 1."
        )
    return joints


def _swept(joint: Joint, levels: int, strained: bool, round_across: int) -> FloatArray:
    """A joint's figure swept across: corners by X, Y and t, (n, 2, 2, 2, 3)."""
    half, e = joint.polygon * joint.width_mm / 2, joint.polygon * joint.electrode_mm / 2
    if joint.polygon > 1:
        across = half * np.sin(np.linspace(-np.pi / 2, np.pi / 2, round_across + 1))
    else:
        across = _across(half, e, max(levels - 2, 0), strained)
    if not joint.run_mm:
        columns, end = _across(half, e, levels, strained), joint.height_mm / 2
        depth = _between(0.0, end, half, levels if e < half * (1 - 1e-6) else 0, longest=LONGEST * 2 * half)
        quads = _cells(np.broadcast_to(columns, (len(depth), len(columns))), depth)
    else:
        quads = _figure(joint, levels, half, e)
    corners = np.empty((len(quads), len(across) - 1, 2, 2, 2, 3))
    corners[..., 0], corners[..., 2] = quads[:, None, :, None, :, 0], quads[:, None, :, None, :, 1]
    corners[..., 1] = np.column_stack([across[:-1], across[1:]])[None, :, None, :, None]
    if joint.polygon > 1:
        corners = _rounded(corners, joint, half)
    return corners.reshape(-1, 2, 2, 2, 3)


def _rounded(corners: FloatArray, joint: Joint, half: float) -> FloatArray:
    """The same corners of a figure swept across round pillars: at Y it is smaller by the half chord over half."""
    X, Y, t = np.moveaxis(corners, -1, 0)
    size = np.sqrt(np.maximum(1 - (Y / half) ** 2, 0.0))
    run, h, depth, moved = joint.run_mm, joint.height_mm, t, size * X
    if run:
        is_oblique = np.ones(len(corners), dtype=bool)
        if joint.upright:
            crotch, end = half * (h + math.hypot(run, h)) / run, h / 2
            depth = np.where(t <= crotch, size * t, end - (end - t) * (end - size * crotch) / (end - crotch))
            middle = corners.mean(axis=(1, 2, 3, 4))
            is_oblique = (middle[:, 0] > half) & (middle[:, 2] > crotch)
        leaning = run / h * depth + size * (X - run / h * t)
        moved = np.where(is_oblique[:, None, None, None, None], leaning, moved)
    return np.stack([moved, Y, depth], axis=-1)


def _across(half: float, electrode: float, levels: int, strained: bool) -> FloatArray:
    """Lines from −w/2 to w/2, crowding at the electrode's edges where it ends inside."""
    if electrode >= half * (1 - 1e-6):
        return half * (np.array([-1.0, -INNER, INNER, 1.0]) if strained else np.array([-1.0, 1.0]))
    inner = _between(0.0, electrode, half, at_end=levels)
    right = np.concatenate([inner, _between(electrode, half, half, at_start=levels)[1:]])
    return np.concatenate([-right[:0:-1], right])


def _between(
    start: float, end: float, scale: float, at_start: int = 0, at_end: int = 0, longest: float = np.inf
) -> FloatArray:
    """Lines from start to end, `scale` times powers of `RATIO` away from ends that ask for levels."""
    length = end - start
    lines = [0.0, length]
    room = length * (0.5 if at_start and at_end else 0.9)
    for levels, place in ((at_start, lambda d: d), (at_end, lambda d: length - d)):
        steps = scale * RATIO ** np.arange(levels + 1.0)
        lines += [place(step) for step in steps if levels and step < room]
    if at_start and at_end and scale >= length / 2:
        lines.append(length / 2)
    filled = [np.zeros(1)]
    for low, high in pairwise(np.unique(lines)):
        count = max(1, int(np.ceil((high - low) / longest - 1e-9)))
        filled.append(np.linspace(low, high, count + 1)[1:])
    return start + np.concatenate(filled)


def _figure(joint: Joint, levels: int, half: float, e: float) -> FloatArray:
    """Quadrilaterals of the pillars at an electrode, (n, 2, 2, 2): corners by X and t, then X and t."""
    run, h, w = joint.run_mm, joint.height_mm, 2 * half
    a, b, c = run / h, w * np.hypot(run, h) / h / 2, w / 2
    is_rimmed = e < b * (1 - 1e-6)
    rimmed = levels if is_rimmed else 0
    lines = partial(_between, scale=w / 2)
    down = partial(lines, longest=LONGEST * w)
    if not joint.upright:
        columns = _across(b, e, levels, False) if is_rimmed else lines(-b, b, at_end=levels)
        depth = down(0.0, h / 2, at_start=levels)
        return _cells(a * depth[:, None] + columns, depth)

    first, crotch = (b - c) / a, (b + c) / a  # depths at which the oblique pillar leaves the upright one's sides
    right = e if rimmed else c  # where the line to the crotch starts
    depth = np.concatenate([lines(0.0, first, at_start=rimmed), down(first, crotch, at_end=levels)[1:]])
    left_of = np.where(depth <= first, -b + a * depth, -c)
    right_of = right + (c - right) * depth / crotch
    # the line from the electrode's left edge keeps its share of the width below
    columns = lines(-e if rimmed else -b, right, at_start=rimmed, at_end=levels)
    if rimmed:
        columns = np.concatenate([lines(-b, -e, at_end=levels), columns[1:]])
    columns = (columns - columns[0]) / np.ptp(columns)
    oblique_columns = lines(0.0, 2 * b, at_start=levels) / (2 * b)
    uprights = left_of[:, None] + (right_of - left_of)[:, None] * columns
    obliques = right_of[:, None] + (b + a * depth - right_of)[:, None] * oblique_columns
    below = down(crotch, h / 2, at_start=levels)
    return np.concatenate([
        _cells(uprights, depth),
        _cells(obliques, depth),
        _cells(np.broadcast_to(-c + 2 * c * columns, (len(below), len(columns))), below),
        _cells(-b + a * below[:, None] + 2 * b * oblique_columns, below),
    ])  # fmt: skip


def _cells(x: FloatArray, t: FloatArray) -> FloatArray:
    """Quadrilaterals between lines x (n_t, n_x) at depths t (n_t,)."""
    at = np.stack([x, np.broadcast_to(t[:, None], x.shape)], axis=-1)
    cells = np.stack([np.stack([at[:-1, :-1], at[1:, :-1]], 2), np.stack([at[:-1, 1:], at[1:, 1:]], 2)], 2)
    return cells.reshape(-1, 2, 2, 2)
