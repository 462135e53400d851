"""Hexahedra of a unit's pillars, crowding where the current density is singular.

Every pillar is cut in the middle of its height, and about each electrode lie the halves that end there: at most an
upright and an oblique one, between −w/2 and w/2 across. Their union is a plane figure, swept across. It is cut into
quadrilaterals along lines that end at the electrode's edges and in the crotch. Round pillars have the same figure in
every plane along their leans, smaller toward their sides; of their square ends nodes inside count as electrodes.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from itertools import combinations, pairwise, product

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from common.errors import DesignError
from fem.boxes.boxes import cube_functions, cube_slopes, gauss_points, lobatto_points, shape_functions
from fem.field import IntArray, same_places
from geometry.design import Unit
from geometry.layout import FloatArray, electrode_centres, leans_both_ways, pillar_ends, pillar_sections, pillar_widths
from geometry.prism import unit_prisms

RATIO = 0.15  #: of the sizes of neighbouring elements toward a singular edge
INNER = 0.7  #: of a strained pillar's width, its inner element
ROUND_ACROSS = 6  #: elements across a round pillar: halves of a polygon, enlarged to the circle's area
LONGEST = 1.0  #: of an element along a pillar, in widths of the pillar

Where = Callable[[FloatArray], NDArray[np.bool_]]  #: points (n, 3) to booleans
Tie = list[tuple[IntArray, FloatArray]]  #: nodes (n,) on either side of a cut, and their places (n, 2) in the section


@dataclass(frozen=True, eq=False, kw_only=True)
class Hexahedra:
    """Trilinear hexahedra with Lagrange functions of an order along each edge; corners and nodes run z fastest."""

    order: int
    corners_mm: FloatArray  #: (n_elements, 8, 3)
    nodes_mm: FloatArray  #: (n_nodes, 3)
    elements: IntArray  #: (n_elements, (order + 1)³): nodes of each
    terminals: tuple[IntArray, ...]  #: nodes on each terminal
    constraint: sp.csr_matrix  #: (n_nodes, n_unknowns): values of the nodes from the unknowns
    pairs: tuple[tuple[int, int], ...] = ((0, 1),)  #: terminals at both ends of each pillar

    @cached_property
    def _gauss(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        x, w = gauss_points(self.order + 1)
        points = np.array(list(product(x, x, x)))
        jacobian = np.einsum("dqn,enx->eqxd", cube_slopes(1, points), self.corners_mm)  # ∂x/∂ξ
        gradient = np.linalg.inv(jacobian).swapaxes(-1, -2) @ cube_slopes(self.order, points).swapaxes(0, 1)
        weights = np.einsum("a,b,c->abc", w, w, w).ravel() * np.abs(np.linalg.det(jacobian))
        places = cube_functions(1, points) @ self.corners_mm
        return places.reshape(-1, 3), weights.ravel(), gradient.reshape(-1, *gradient.shape[-2:])

    @property
    def points_mm(self) -> FloatArray:
        """Gauss points of all elements, one after the other, (n_points, 3)."""
        return self._gauss[0]

    @property
    def weight_mm3(self) -> FloatArray:
        """Volume of each of `points_mm`, (n_points,)."""
        return self._gauss[1]

    @property
    def gradient(self) -> FloatArray:
        """Gradients of the element's functions at `points_mm`, (n_points, 3, (order + 1)³) [1/mm]."""
        return self._gauss[2]


def joined(corners_mm: FloatArray, order: int, on_terminals: Sequence[Where]) -> Hexahedra:
    """Hexahedra of corners (n_elements, 8, 3), conforming, either orientation, that share the nodes of common faces.

    `on_terminals` takes points (n, 3) to booleans: those on each terminal.
    """
    x = lobatto_points(order)
    places = (cube_functions(1, np.array(list(product(x, x, x)))) @ corners_mm).reshape(-1, 3)
    first, numbers = same_places(places)
    nodes = places[first]
    return Hexahedra(
        order=order,
        corners_mm=corners_mm,
        nodes_mm=nodes,
        elements=numbers.reshape(len(corners_mm), -1),
        terminals=tuple(np.flatnonzero(on(nodes)) for on in on_terminals),
        constraint=sp.eye(len(nodes), format="csr"),
    )


@dataclass(frozen=True, kw_only=True)
class Joint:
    """Pillars that meet at an electrode. X runs along the oblique one's lean, Y across, t away from the electrode."""

    upright: int | None  #: numbers of the pillars
    oblique: int | None
    axis: int = 0  #: along which the oblique one leans
    sign: float = 1.0  #: its lean away from the electrode
    width_mm: float = 2.0  #: of both
    is_round: bool = False  #: both
    polygon: float = 1.0  #: corners of the polygon that is meshed, in terms of the radius

    @property
    def half_mm(self) -> float:
        """Half of the width across, as meshed."""
        return self.width_mm / 2 * self.polygon

    def turned(self, local: FloatArray) -> FloatArray:
        """Values (..., 2) along X and Y along x and y."""
        return np.stack([self.sign * local[..., 0], local[..., 1]][:: 1 - 2 * self.axis], axis=-1)


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
    h, layout = unit.height_mm, unit.layout
    corners: list[FloatArray] = []
    nodes: list[FloatArray] = []
    elements, terminals, n = [], [], 0
    ties: dict[int, Tie] = {}
    # X runs toward the oblique pillar's other end
    swept = cache(partial(_swept, unit, order, levels, strained, round_across))
    for number, (at, joint) in enumerate(zip(electrode_centres(unit), _joints(unit, round_across), strict=True)):
        run = 0.0 if joint.oblique is None else float(np.ptp(pillar_ends(unit)[joint.oblique, :, joint.axis]))
        half, slack = joint.half_mm, 1e-6 * joint.width_mm
        part = swept(joint.upright is not None, run, joint.width_mm, joint.is_round)
        X, Y, t = part.nodes_mm.T
        up = 1.0 if number >= len(layout.upper) else -1.0
        for local, placed in ((part.corners_mm, corners), (part.nodes_mm, nodes)):
            placed.append(at + np.concatenate([joint.turned(local[..., :2]), up * local[..., 2:]], axis=-1))
        elements.append(part.elements + n)
        terminals.append(part.terminals[0] + n)
        halves = {} if joint.upright is None else {joint.upright: (0.0, half)}
        if joint.oblique is not None:
            along = pillar_sections(unit)[joint.oblique, joint.axis] / joint.width_mm  # of its width
            halves[joint.oblique] = (run / 2, along * half)
        for pillar, (middle, width) in halves.items():
            cut = np.flatnonzero((np.abs(t - h / 2) < slack) & (np.abs(X - middle) <= width + slack))
            place = joint.turned(np.column_stack([(X[cut] - middle) / width, Y[cut] / half]))
            ties.setdefault(pillar, []).append((cut + n, place))
        n += len(part.nodes_mm)
    return Hexahedra(
        order=order,
        corners_mm=np.concatenate(corners),
        nodes_mm=np.concatenate(nodes),
        elements=np.concatenate(elements),
        terminals=tuple(terminals),
        pairs=layout.pillar_terminals,
        constraint=_constraint(order, list(ties.values()), n),
    )


def _joints(unit: Unit, round_across: int) -> list[Joint]:
    """What lies about each electrode; refusals as of `unit_hexahedra`."""
    layout, ends, joints = unit.layout, pillar_ends(unit)[..., :2], []
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
        sections = {(widths[k], layout.pillars[k].is_round) for k in own}
        if len(sections) > 1:
            raise DesignError(f"conduction takes pillars of one section at an electrode, {name} has two: take eq. 1.")
        ((width, is_round),) = sections
        if is_round and unit.electrode_mm < width * (1 - 1e-6):
            raise DesignError(
                f"conduction takes round pillars on electrodes at least as wide: raise electrode_mm from "
                f"{unit.electrode_mm:g} to {width:g}, or take eq. 1."
            )
        made = partial(
            Joint,
            upright=uprights[0] if uprights else None,
            width_mm=width,
            is_round=is_round,
            polygon=_corner_ratio(round_across) if is_round else 1.0,
        )
        if not obliques:
            joints.append(made(oblique=None))
            continue
        lean = leans[obliques[0]] * (-1 if number == pairs[obliques[0]][0] else 1)
        axis = int(lean[1] != 0)
        joints.append(made(oblique=obliques[0], axis=axis, sign=float(np.sign(lean[axis]))))
    # an oblique pillar must part from an upright one above the middle of its height, and touch no other
    least_mm, prisms = max(widths) + float(pillar_sections(unit).max()), unit_prisms(unit)
    both = [np.abs(leans[one.oblique]).max() for one in joints if None not in (one.upright, one.oblique)]
    close = min(both, default=np.inf) <= least_mm
    for (one, a), (two, b) in combinations(zip(prisms, pairs, strict=True), 2):
        close |= not {*a} & {*b} and one.cuts(two, 0.0)
    if close:
        raise DesignError(
            f"conduction takes units whose oblique pillars do not touch: span_mm={unit.span_mm:g} must be above "
            f"{least_mm:.4g} for pillar_width_mm={max(widths):g}; widen the span, thin the pillars or take "
            "eq. 1."
        )
    return joints


def _corner_ratio(across: int) -> float:
    """Of a circle's radius, that of the corners of a polygon of twice as many sides and the same area."""
    return math.sqrt(math.pi / (across * math.sin(math.pi / across)))


def _swept(
    unit: Unit,
    order: int,
    levels: int,
    strained: bool,
    round_across: int,
    upright: bool,
    run: float,
    width_mm: float,
    is_round: bool,
) -> Hexahedra:
    """A joint's figure swept across, in X, Y and t; the terminal is its electrode."""
    h, half, e = unit.height_mm, width_mm / 2, unit.electrode_mm / 2
    if is_round:
        half, e = (_corner_ratio(round_across) * one for one in (half, e))
        across = half * np.sin(np.linspace(-np.pi / 2, np.pi / 2, round_across + 1))
    else:
        across = _across(half, e, max(levels - 2, 0), strained)
    if not run:
        columns = _across(half, e, levels, strained)
        depth = _between(0.0, h / 2, half, levels if e < half * (1 - 1e-6) else 0, longest=LONGEST * 2 * half)
        quads = _cells(np.broadcast_to(columns, (len(depth), len(columns))), depth)
    else:
        quads = _figure(unit, levels, upright, run, half, e)
    corners = np.empty((len(quads), len(across) - 1, 2, 2, 2, 3))  # of X, Y, t
    corners[..., 0], corners[..., 2] = quads[:, None, :, None, :, 0], quads[:, None, :, None, :, 1]
    corners[..., 1] = np.column_stack([across[:-1], across[1:]])[None, :, None, :, None]
    if is_round:
        corners = _rounded(corners, unit, upright, run, half)
    reach = np.array([e, e, 0.0]) + 2e-6 * half

    def on_electrode(points: FloatArray) -> NDArray[np.bool_]:
        return np.asarray((np.abs(points) <= reach).all(axis=1))

    return joined(corners.reshape(-1, 8, 3), order, [on_electrode])


def _rounded(corners: FloatArray, unit: Unit, upright: bool, run: float, half: float) -> FloatArray:
    """Corners (n, ..., 3) of a figure swept across round pillars: at Y it is smaller by the half chord over half."""
    X, Y, t = np.moveaxis(corners, -1, 0)
    size = np.sqrt(np.maximum(1 - (Y / half) ** 2, 0.0))
    lean, depth, moved = run / unit.height_mm, t, size * X
    is_oblique = np.full(X.shape, bool(run))
    if upright and run:
        crotch = half * (1 + math.hypot(run, unit.height_mm) / unit.height_mm) / lean
        end = unit.height_mm / 2
        depth = np.where(t <= crotch, size * t, end - (end - t) * (end - size * crotch) / (end - crotch))
        middles = (
            X.mean(axis=tuple(range(1, X.ndim)), keepdims=True),
            t.mean(axis=tuple(range(1, t.ndim)), keepdims=True),
        )
        is_oblique &= (middles[0] > half) & (middles[1] > crotch)
    moved = np.where(is_oblique, lean * depth + size * (X - lean * t), moved)
    return np.stack([moved, Y, depth], axis=-1)


def _constraint(order: int, ties: list[Tie], n: int) -> sp.csr_matrix:
    """Both sides' values on every cut from one polynomial of (order + 1)² values; all other nodes are free."""
    free = np.setdiff1d(np.arange(n), [node for tie in ties for nodes, _ in tie for node in nodes])
    columns = [sp.csr_matrix((np.ones(len(free)), (free, np.arange(len(free)))), shape=(n, len(free)))]
    for tie in ties:
        nodes, places = np.concatenate([nodes for nodes, _ in tie]), np.concatenate([place for _, place in tie])
        along = shape_functions(order, np.clip(places, -1.0, 1.0))[0]  # (n, 2, order + 1)
        along[np.abs(along) < 1e-12] = 0.0
        values = np.einsum("ni,nj->nij", along[:, 0], along[:, 1]).reshape(len(nodes), -1)
        row, column = np.indices(values.shape)
        entries = values.ravel(), (nodes[row.ravel()], column.ravel())
        columns.append(sp.csr_matrix(entries, shape=(n, values.shape[1])))
    return sp.hstack(columns, format="csr")


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


def _figure(unit: Unit, levels: int, upright: bool, run: float, half: float, e: float) -> FloatArray:
    """Quadrilaterals of the pillars at an electrode, (n, 2, 2, 2): corners by X and t, then X and t."""
    h, w = unit.height_mm, 2 * half
    a, b, c = run / h, w * np.hypot(run, h) / h / 2, w / 2
    is_rimmed = e < b * (1 - 1e-6)
    rimmed = levels if is_rimmed else 0
    lines = partial(_between, scale=w / 2)
    down = partial(lines, longest=LONGEST * w)
    if not upright:
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
