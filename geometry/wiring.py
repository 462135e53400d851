"""The crossing of the crossbar that reads each pillar.

Upper electrodes of array row i lie on row wires, lower ones of array column j on column wires, one each or as the
layout says: in the paper's unit U1 on row wire 2i, U2 on 2i+1; L1 on column wire 2j, L2 on 2j+1. Of each unit's four
crossings (U2, L2) is empty, the others hold one pillar each. A board sends the populated crossings row-major: along row
wire 0 by rising column wire, then along row wire 1, and so on; each is a channel.
"""

from collections.abc import Iterator
from functools import cache

import numpy as np
from numpy.typing import NDArray

from geometry.layout import SONG2018, Layout

MAX_SEARCHED = 10  #: electrodes of the smaller level for which the fewest wires are looked for


def unit_crossings(layout: Layout) -> NDArray[np.intp]:
    """Number of the pillar at each crossing of a unit's wires, -1 where there is none, shape (row, column wires).

    >>> unit_crossings(SONG2018).tolist()
    [[0, 1], [2, -1]]
    """
    own = np.full((max(layout.row_wires) + 1, max(layout.column_wires) + 1), -1)
    for number, crossing in enumerate(layout.pillar_crossings):
        own[crossing] = number
    return own


def wires(rows: int, cols: int, layout: Layout) -> tuple[int, int]:
    """Number of row wires and of column wires of an array.

    >>> wires(6, 6, SONG2018)
    (12, 12)
    """
    row, column = unit_crossings(layout).shape
    return rows * row, cols * column


def pillar_at(rows: int, cols: int, layout: Layout) -> NDArray[np.intp]:
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
    return np.argwhere(pillar_at(rows, cols, layout) >= 0)


def pillar_of_crossing(rows: int, cols: int, layout: Layout = SONG2018) -> NDArray[np.intp]:
    """Place of every sent crossing in a flattened (rows, cols, n_pillars) array; a permutation.

    >>> pillar_of_crossing(1, 2).tolist()  # z and x of both units along U1's wire, then y of both along U2's
    [0, 1, 3, 4, 2, 5]
    """
    places = pillar_at(rows, cols, layout)
    return places[places >= 0]


def crossing_of_pillar(rows: int, cols: int, layout: Layout = SONG2018) -> NDArray[np.intp]:
    """Place of every pillar among the sent crossings, shape (rows, cols, n_pillars).

    >>> sent = np.array([[10, 11, 20, 21, 12, 22]])  # of units 1 and 2: z and x, then y of both
    >>> sent.take(crossing_of_pillar(1, 2), axis=-1).tolist()
    [[[[10, 11, 12], [20, 21, 22]]]]
    """
    return np.argsort(pillar_of_crossing(rows, cols, layout)).reshape(rows, cols, -1)


def pillars_of_wires(rows: int, cols: int, layout: Layout = SONG2018) -> list[NDArray[np.intp]]:
    """Places in a flattened (rows, cols, n_pillars) array of the pillars on each row wire, then on each column wire.

    >>> [each.tolist() for each in pillars_of_wires(1, 2)]
    [[0, 1, 3, 4], [2, 5], [0, 2], [1], [3, 5], [4]]
    """
    board = pillar_at(rows, cols, layout)
    return [wire[wire >= 0] for wire in (*board, *board.T)]


@cache
def fewest_wires(layout: Layout) -> tuple[tuple[tuple[str, ...], ...], tuple[tuple[str, ...], ...]]:
    """Electrodes by the row and by the column wires of a unit, as few of both together as any sharing allows.

    By search over all ways to share the wires of one level; those of the other level then follow as the colours of a
    graph. Four electrodes a level take a millisecond, ten a second.

    >>> from geometry.layout import LAYOUTS
    >>> [len(level) for level in fewest_wires(LAYOUTS["six-pillar"])]
    [3, 2]
    """
    pairs = [(one.top, one.foot) for one in layout.pillars]
    upper, lower = ([one.name for one in level] for level in (layout.upper, layout.lower))
    swapped = len(lower) < len(upper)
    if swapped:
        pairs, upper, lower = [(foot, top) for top, foot in pairs], lower, upper
    best: tuple[list[list[str]], list[list[str]]] = [[name] for name in upper], [[name] for name in lower]
    for shared in _partitions(upper):
        if len(shared) + -(-len(pairs) // len(shared)) >= sum(
            map(len, best)
        ):  # more pillars than crossings, or no gain
            continue
        of = {name: number for number, names in enumerate(shared) for name in names}
        crossed = [(of[top], foot) for top, foot in pairs]
        if len({*crossed}) < len(pairs):
            continue
        met = {name: {row for row, foot in crossed if foot == name} for name in lower}
        room = sum(map(len, best)) - len(shared) - 1
        if found := _coloured(lower, met, [], room):
            best = shared, found
    one, other = (tuple(map(tuple, level)) for level in (best[::-1] if swapped else best))
    return one, other


def _partitions(names: list[str]) -> Iterator[list[list[str]]]:
    """All ways to put names into groups."""
    if not names:
        yield []
        return
    for rest in _partitions(names[:-1]):
        for number in range(len(rest)):
            yield [[*group, names[-1]] if number == k else group for k, group in enumerate(rest)]
        yield [*rest, [names[-1]]]


def _coloured(names: list[str], met: dict[str, set[int]], groups: list[list[str]], most: int) -> list[list[str]] | None:
    """Names in at most so many groups within which no two meet the same; the fewest, None if there are none."""
    if len(groups) > most:
        return None
    if not names:
        return groups
    best, (name, *rest) = None, names
    for number in range(len(groups) + 1):
        group = groups[number] if number < len(groups) else []
        if any(met[name] & met[one] for one in group):
            continue
        tried = [*groups[:number], [*group, name], *groups[number + 1 :]]
        if found := _coloured(rest, met, tried, most):
            best, most = found, len(found) - 1
    return best


def explained(layout: Layout) -> str:
    """In words how many wires and channels a unit has, and how few wires would do."""
    n_row, n_column = unit_crossings(layout).shape
    said = f"Wires of a unit: {n_row} in rows, {n_column} in columns; {len(layout.pillars)} channels."
    fewest = fewest_wires(layout) if min(len(layout.upper), len(layout.lower)) <= MAX_SEARCHED else None
    if fewest is None or sum(map(len, fewest)) == n_row + n_column:
        return said
    shared = [" and ".join(names) for level in fewest for names in level if len(names) > 1]
    return f"{said} {len(fewest[0])} and {len(fewest[1])} would do: {', '.join(shared)} can share a wire."
