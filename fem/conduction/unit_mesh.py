"""Hexahedra of a unit's three pillars, crowding where the current density is singular.

The upper half of the upright pillar and the pillar x lie between y = −w/2 and w/2 of their common electrode U1: their
union is a plane figure, swept along y. It is cut into quadrilaterals along lines that end at the electrodes' edges and
in the crotch. The lower half with the pillar y is its mirror image (x, y, z) -> (y, x, h − z).
"""

from functools import partial
from itertools import pairwise

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.conduction.hexahedra import Hexahedra, joined
from fem.discretization.elasticity import IntArray
from fem.discretization.lagrange import shape_functions
from geometry.design import Unit
from geometry.errors import DesignError
from geometry.layout import FloatArray, upper_electrodes

RATIO = 0.15  #: of the sizes of neighbouring elements toward a singular edge
INNER = 0.7  #: of a strained pillar's width, its inner element
LONGEST = 1.0  #: of an element along a pillar, in widths of the pillar


def unit_hexahedra(unit: Unit, order: int, levels: int, strained: bool = False) -> Hexahedra:
    """The pillars of a unit in its own frame; terminals are U1, U2, L1 and L2.

    Parameters
    ----------
    unit : Unit
    order : int
        Of the elements.
    levels : int
        Of refinement toward electrodes' edges and crotches, by `RATIO` each.
    strained : bool
        Cut the pillars across, too: strain near the edge of a pad varies as much there as in the figure.

    Raises
    ------
    DesignError
        If the pillars x and y touch each other: their union is then no swept figure.

    Notes
    -----
    Both halves meet in the middle of the upright pillar, where the lines of one cross those of the other: the values
    there follow one polynomial of the elements' order, which suits both.
    """
    s, h, w, ow = unit.span_mm, unit.height_mm, unit.pillar_width_mm, unit.oblique_width_mm
    if not s > w + ow:
        raise DesignError(
            f"conduction takes units whose oblique pillars do not touch: span_mm={s:g} must be above {w + ow:.4g} for "
            f"pillar_width_mm={w:g}; widen the span, thin the pillars or take eq. 1."
        )
    e, half = unit.electrode_mm / 2, w / 2
    quads, across = _figure(unit, levels), _across(half, e, max(levels - 2, 0), strained)
    corners = np.empty((len(quads), len(across) - 1, 2, 2, 2, 3))  # of X, Y, t
    corners[..., 0], corners[..., 2] = quads[:, None, :, None, :, 0], quads[:, None, :, None, :, 1]
    corners[..., 1] = np.column_stack([across[:-1], across[1:]])[None, :, None, :, None]
    slack = 1e-6 * w

    def on_end(places: FloatArray, x: float, z: float) -> NDArray[np.bool_]:
        return np.asarray((np.abs(places - (x, 0.0, z)) <= (e + slack, e + slack, slack)).all(axis=1))

    part = joined(corners.reshape(-1, 8, 3), order, [lambda at: on_end(at, 0.0, 0.0), lambda at: on_end(at, s, h)])
    n, (top, bottom), nodes = len(part.nodes_mm), part.terminals, part.nodes_mm
    middle = np.flatnonzero((np.abs(nodes[:, 2] - h / 2) < slack) & (nodes[:, 0] <= half + slack))
    corner = upper_electrodes(unit)[0, :2]
    upper, lower = np.array([*corner, h]), np.array([*corner, 0.0])
    return Hexahedra(
        order=order,
        corners_mm=np.concatenate([upper + part.corners_mm * (1, 1, -1), lower + part.corners_mm[..., [1, 0, 2]]]),
        nodes_mm=np.concatenate([upper + nodes * (1, 1, -1), lower + nodes[:, [1, 0, 2]]]),
        elements=np.concatenate([part.elements, part.elements + n]),
        terminals=(top, bottom + n, top + n, bottom),
        constraint=_constraint(order, nodes[middle, :2] / half, middle, n),
    )


def _constraint(order: int, places: FloatArray, middle: IntArray, n: int) -> sp.csr_matrix:
    """Both halves' values on the middle of the upright pillar from one polynomial of (order + 1)² values."""
    X, Y = (_lagrange(order, places[:, d]) for d in (0, 1))
    halves = [np.einsum("ni,nj->nij", *pair).reshape(len(middle), -1) for pair in ((X, Y), (Y, X))]
    free = np.setdiff1d(np.arange(n), middle)
    one = sp.csr_matrix((np.ones(len(free)), (free, np.arange(len(free)))), shape=(n, len(free)))
    held = [
        sp.csr_matrix((half.ravel(), (np.repeat(middle, half.shape[1]), np.tile(np.arange(half.shape[1]), len(half)))),
                      shape=(n, half.shape[1]))
        for half in halves
    ]  # fmt: skip
    return sp.bmat([[one, None, held[0]], [None, one, held[1]]], format="csr")


def _lagrange(order: int, x: FloatArray) -> FloatArray:
    values = shape_functions(order, np.clip(x, -1.0, 1.0))[0]
    values[np.abs(values) < 1e-12] = 0.0
    return values


def _across(half: float, electrode: float, levels: int, strained: bool) -> FloatArray:
    """Lines from −w/2 to w/2, crowding at the electrode's edges where it ends inside."""
    if electrode >= half * (1 - 1e-6):
        return half * (np.array([-1.0, -INNER, INNER, 1.0]) if strained else np.array([-1.0, 1.0]))
    inner = _between(0.0, electrode, half, at_end=levels)
    right = np.concatenate([inner, _between(electrode, half, half, at_start=levels)[1:]])
    return np.concatenate([-right[:0:-1], right])


def _between(
    start: float, end: float, reach: float, at_start: int = 0, at_end: int = 0, longest: float = np.inf
) -> FloatArray:
    """Lines from start to end, crowding by `RATIO` toward the ends that ask for levels.

    Lines are `reach` times powers of `RATIO` away from such an end, and no further apart than `longest`.
    """
    length = end - start
    lines = [0.0, length]
    room = length * (0.5 if at_start and at_end else 0.9)
    for levels, place in ((at_start, lambda d: d), (at_end, lambda d: length - d)):
        steps = reach * RATIO ** np.arange(levels + 1.0)
        lines += [place(step) for step in steps if levels and step < room]
    if at_start and at_end and reach >= length / 2:
        lines.append(length / 2)
    filled = [np.zeros(1)]
    for low, high in pairwise(np.unique(lines)):
        count = max(1, int(np.ceil((high - low) / longest - 1e-9)))
        filled.append(np.linspace(low, high, count + 1)[1:])
    return start + np.concatenate(filled)


def _figure(unit: Unit, levels: int) -> FloatArray:
    """Quadrilaterals of the plane figure, shape (n, 2, 2, 2): corners by X and depth t, then X and t [mm].

    X runs from the axis of the upright pillar toward the other end of the pillar x, t down from the top.
    """
    s, h, w = unit.span_mm, unit.height_mm, unit.pillar_width_mm
    a, b, c, e = s / h, unit.oblique_width_mm / 2, w / 2, unit.electrode_mm / 2
    first, crotch = (b - c) / a, (b + c) / a  # depths at which the pillar x leaves the upright one's sides
    rimmed = levels if e < b * (1 - 1e-6) else 0
    right = e if rimmed else c  # where the line to the crotch starts
    lines = partial(_between, reach=w / 2)
    down = partial(lines, longest=LONGEST * w)

    depth = np.concatenate([lines(0.0, first, at_start=rimmed), down(first, crotch, at_end=levels)[1:]])
    left_of = np.where(depth <= first, -b + a * depth, -c)
    right_of = right + (c - right) * depth / crotch
    # the line from the electrode's left edge keeps its share of the width below
    columns = lines(-e if rimmed else -b, right, at_start=rimmed, at_end=levels)
    if rimmed:
        columns = np.concatenate([lines(-b, -e, at_end=levels), columns[1:]])
    columns = (columns - columns[0]) / np.ptp(columns)
    upright = left_of[:, None] + (right_of - left_of)[:, None] * columns
    oblique_columns = _oblique_columns(b, e, w / 2, levels, rimmed)
    oblique = right_of[:, None] + (b + a * depth - right_of)[:, None] * oblique_columns
    quads = [_cells(upright, depth), _cells(oblique, depth)]

    below = down(crotch, h / 2, at_start=levels)
    quads.append(_cells(np.broadcast_to(-c + 2 * c * columns, (len(below), len(columns))), below))
    below = down(crotch, h, at_start=levels, at_end=rimmed)
    quads.append(_cells(-b + a * below[:, None] + 2 * b * oblique_columns, below))
    return np.concatenate(quads)


def _oblique_columns(b: float, e: float, reach: float, levels: int, rimmed: int) -> FloatArray:
    """Lines across the pillar x as shares of its width: at the edges of its lower electrode, and toward the crotch."""
    if not rimmed:
        return _between(0.0, 2 * b, reach, at_start=levels) / (2 * b)
    lines = [
        _between(0.0, b - e, reach, at_start=levels, at_end=levels),
        _between(b - e, b + e, reach, at_start=levels, at_end=levels),
        _between(b + e, 2 * b, reach, at_start=levels),
    ]
    return np.concatenate([lines[0], lines[1][1:], lines[2][1:]]) / (2 * b)


def _cells(x: FloatArray, t: FloatArray) -> FloatArray:
    """Quadrilaterals between lines x (n_t, n_x) at depths t (n_t,)."""
    at = np.stack([x, np.broadcast_to(t[:, None], x.shape)], axis=-1)
    cells = np.stack([np.stack([at[:-1, :-1], at[1:, :-1]], 2), np.stack([at[:-1, 1:], at[1:, 1:]], 2)], 2)
    return cells.reshape(-1, 2, 2, 2)
