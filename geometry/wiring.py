"""The crossing of the crossbar that reads each pillar.

U1 of array row i lies on row wire 2i, U2 on 2i+1; L1 of array column j on column wire 2j, L2 on 2j+1. A
rows × cols array is thus a crossbar of 2·rows × 2·cols wires. Of each unit's four crossings (U2, L2) is
empty, the others hold one pillar each. A board sends the populated crossings row-major: along row wire 0 by
rising column wire, then along row wire 1, and so on.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.layout import PILLARS


def crossings(rows: int, cols: int) -> NDArray[np.intp]:
    """Row and column wire of every populated crossing in the order they are sent, shape (rows·cols·3, 2).

    >>> crossings(1, 1).tolist()
    [[0, 0], [0, 1], [1, 0]]
    """
    row_wire, column_wire = np.indices((2 * rows, 2 * cols))
    is_empty = (row_wire % 2 == 1) & (column_wire % 2 == 1)
    return np.argwhere(~is_empty)


def pillar_of_crossing(rows: int, cols: int) -> NDArray[np.intp]:
    """Place of every sent crossing in a flattened (rows, cols, 3) array of pillars z, x, y; a permutation.

    >>> pillar_of_crossing(1, 2).tolist()  # z and x of both units along U1's wire, then y of both along U2's
    [0, 1, 3, 4, 2, 5]
    """
    row_wire, column_wire = crossings(rows, cols).T
    unit = (row_wire // 2) * cols + column_wire // 2
    pillar = 2 * (row_wire % 2) + column_wire % 2  # (U1, L1), (U1, L2), (U2, L1): as PILLARS
    return unit * len(PILLARS) + pillar


def crossing_of_pillar(rows: int, cols: int) -> NDArray[np.intp]:
    """Place of every pillar z, x, y among the sent crossings, shape (rows, cols, 3).

    >>> sent = np.array([[10, 11, 20, 21, 12, 22]])  # of units 1 and 2: z and x, then y of both
    >>> sent.take(crossing_of_pillar(1, 2), axis=-1).tolist()
    [[[[10, 11, 12], [20, 21, 22]]]]
    """
    return np.argsort(pillar_of_crossing(rows, cols)).reshape(rows, cols, len(PILLARS))


def crossings_from_pillars(values: NDArray[Any]) -> NDArray[Any]:
    """Values of pillars z, x, y, shape (..., rows, cols, 3), rearranged as sent: (..., rows·cols·3)."""
    if values.ndim < 3 or values.shape[-1] != len(PILLARS):
        raise ValueError(f"values has shape {values.shape}, expected (..., rows, cols, 3): pillars last.")
    rows, cols = values.shape[-3:-1]
    return values.reshape(*values.shape[:-3], -1)[..., pillar_of_crossing(rows, cols)]
