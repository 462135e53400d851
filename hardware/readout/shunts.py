"""Shunts: what rubber that pillars share conducts between electrodes of a unit that no pillar joins."""

from itertools import combinations, product

import numpy as np

from geometry.layout import FloatArray, Layout
from geometry.wiring import unit_crossings


def shunts(layout: Layout) -> list[tuple[int, int]]:
    """Electrodes between which no pillar lies, by their numbers among `Layout.terminals`: two upper, two lower, others.

    >>> from geometry.layout import SONG2018
    >>> shunts(SONG2018)
    [(0, 1), (2, 3), (1, 3)]
    """
    layout = layout.body  # a reference lies beside what the rubber conducts
    n_upper, n = len(layout.upper), len(layout.terminals)
    levels = [*combinations(range(n_upper), 2)], [*combinations(range(n_upper, n), 2)]
    across = [pair for pair in product(range(n_upper), range(n_upper, n)) if pair not in layout.pillar_terminals]
    return [*levels[0], *levels[1], *across]


def shunts_between_wires(rows: int, cols: int, layout: Layout, siemens: tuple[float, ...]) -> FloatArray:
    """Conductances of all units' `shunts` between the wires of an array, (n_wires, n_wires) [S]; row wires first."""
    row_wire, column_wire = layout.row_wires, layout.column_wires
    n_row, n_column = unit_crossings(layout).shape
    row_units, column_units = n_row * np.arange(rows), rows * n_row + n_column * np.arange(cols)
    wires = [row_units + own for own in row_wire] + [column_units + own for own in column_wire]  # of each electrode
    G = np.zeros((rows * n_row + cols * n_column,) * 2)
    for (one, other), each in zip(shunts(layout), siemens, strict=True):
        if other < len(row_wire):  # of all units along a row
            G[wires[one], wires[other]] += cols * each
        elif one >= len(row_wire):
            G[wires[one], wires[other]] += rows * each
        else:
            G[np.ix_(wires[one], wires[other])] += each
    np.fill_diagonal(G, 0.0)  # electrodes on one wire
    return G + G.T
