"""The crossing of the crossbar that reads each pillar.

Upper electrode m of array row i lies on a row wire, lower electrode n of array column j on a column wire: in the
paper's unit U1 on row wire 2i, U2 on 2i+1; L1 on column wire 2j, L2 on 2j+1. Of each unit's four crossings (U2, L2) is
empty, the others hold one pillar each. A board sends the populated crossings row-major: along row wire 0 by rising
column wire, then along row wire 1, and so on.
"""

import numpy as np
from numpy.typing import NDArray

from geometry.layout import SONG2018, Layout


def unit_wires(layout: Layout) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row wire of each upper electrode and column wire of each lower one, counted from 0 within their unit."""
    return np.arange(len(layout.upper)), np.arange(len(layout.lower))


def unit_crossings(layout: Layout) -> NDArray[np.intp]:
    """Number of the pillar at each crossing of a unit's wires, -1 where there is none, shape (row, column wires).

    >>> unit_crossings(SONG2018).tolist()
    [[0, 1], [2, -1]]
    """
    row_wire, column_wire = unit_wires(layout)
    own = np.full((row_wire.max() + 1, column_wire.max() + 1), -1)
    for number, (top, foot) in enumerate(layout.pillar_terminals):
        own[row_wire[top], column_wire[foot - len(row_wire)]] = number
    return own


def wires(rows: int, cols: int, layout: Layout) -> tuple[int, int]:
    """Number of row wires and of column wires of an array.

    >>> wires(6, 6, SONG2018)
    (12, 12)
    """
    row, column = unit_crossings(layout).shape
    return rows * row, cols * column


def _pillar_at(rows: int, cols: int, layout: Layout) -> NDArray[np.intp]:
    """Place in a flattened (rows, cols, n_pillars) array of the pillar of every crossing, -1 where there is none.

    Shape (row wires, column wires).
    """
    own = unit_crossings(layout)
    i, row, j, column = np.indices((rows, own.shape[0], cols, own.shape[1]))
    places = np.where(own[row, column] < 0, -1, (i * cols + j) * len(layout.pillars) + own[row, column])
    return places.reshape(rows * own.shape[0], cols * own.shape[1])


def crossings(rows: int, cols: int, layout: Layout = SONG2018) -> NDArray[np.intp]:
    """Row and column wire of every populated crossing in the order they are sent, shape (rows·cols·n_pillars, 2).

    >>> crossings(1, 1).tolist()
    [[0, 0], [0, 1], [1, 0]]
    """
    return np.argwhere(_pillar_at(rows, cols, layout) >= 0)


def pillar_of_crossing(rows: int, cols: int, layout: Layout = SONG2018) -> NDArray[np.intp]:
    """Place of every sent crossing in a flattened (rows, cols, n_pillars) array; a permutation.

    >>> pillar_of_crossing(1, 2).tolist()  # z and x of both units along U1's wire, then y of both along U2's
    [0, 1, 3, 4, 2, 5]
    """
    places = _pillar_at(rows, cols, layout)
    return places[places >= 0]


def crossing_of_pillar(rows: int, cols: int, layout: Layout = SONG2018) -> NDArray[np.intp]:
    """Place of every pillar among the sent crossings, shape (rows, cols, n_pillars).

    >>> sent = np.array([[10, 11, 20, 21, 12, 22]])  # of units 1 and 2: z and x, then y of both
    >>> sent.take(crossing_of_pillar(1, 2), axis=-1).tolist()
    [[[[10, 11, 12], [20, 21, 22]]]]
    """
    return np.argsort(pillar_of_crossing(rows, cols, layout)).reshape(rows, cols, -1)
