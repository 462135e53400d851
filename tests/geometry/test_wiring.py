"""Every pillar has a crossing of its own, in the order that docs/frames.md gives."""

import re
from pathlib import Path

import numpy as np
import pytest

from geometry.layout import PILLARS
from geometry.wiring import crossing_of_pillar, crossings, crossings_from_pillars, pillar_of_crossing

SIZES = [(1, 1), (1, 2), (2, 1), (3, 5), (6, 6)]
PAGE = Path(__file__).parents[2] / "docs" / "frames.md"

# The 1 × 2 array by hand: row wires 0 (U1) and 1 (U2), column wires 0 and 1 (L1 and L2 of unit 0), 2 and 3.
ONE_BY_TWO = [
    # row wire, column wire, array row, array column, pillar
    (0, 0, 0, 0, "z"),
    (0, 1, 0, 0, "x"),
    (0, 2, 0, 1, "z"),
    (0, 3, 0, 1, "x"),
    (1, 0, 0, 0, "y"),
    (1, 2, 0, 1, "y"),
]


def test_order_of_a_1_by_2_array_is_the_hand_written_one():
    assert crossings(1, 2).tolist() == [[r, c] for r, c, *_ in ONE_BY_TWO]
    pillars = crossing_of_pillar(1, 2)
    for place, (*_, row, col, pillar) in enumerate(ONE_BY_TWO):
        assert pillars[row, col, PILLARS.index(pillar)] == place


def test_page_lists_the_same_order():
    listed = re.findall(r"^\| (\d) \| (\d) \| (\d) \| (\d) \| (\d) \| ([xyz]) \|$", PAGE.read_text(), re.MULTILINE)
    assert [(*map(int, line[1:5]), line[5]) for line in listed] == ONE_BY_TWO


@pytest.mark.parametrize(("rows", "cols"), SIZES)
def test_every_pillar_has_a_crossing_of_its_own_where_its_electrodes_wires_cross(rows, cols):
    """Sent row-major, never (U2, L2); the design's table read the other way gives the place of each pillar."""
    wires = crossings(rows, cols)
    assert len({tuple(pair) for pair in wires}) == len(wires) == 3 * rows * cols
    assert sorted(pillar_of_crossing(rows, cols)) == list(range(3 * rows * cols))
    row_wire, column_wire = wires.T
    assert (np.diff(row_wire * 2 * cols + column_wire) > 0).all()
    assert (row_wire.max(), column_wire.max()) == (2 * rows - 1, 2 * cols - 1)
    assert not ((row_wire % 2 == 1) & (column_wire % 2 == 1)).any()
    place = {tuple(pair): k for k, pair in enumerate(wires.tolist())}
    pillars = crossing_of_pillar(rows, cols)
    for i, j in np.ndindex(rows, cols):
        U1, U2, L1, L2 = 2 * i, 2 * i + 1, 2 * j, 2 * j + 1
        assert pillars[i, j].tolist() == [place[U1, L1], place[U1, L2], place[U2, L1]]
    values = np.random.default_rng(0).random((4, rows, cols, 3))
    sent = crossings_from_pillars(values)
    assert sent.shape == (4, 3 * rows * cols)
    assert (sent.take(pillars, axis=-1) == values).all()


def test_wrong_shapes_are_refused_by_name():
    with pytest.raises(ValueError, match=r"shape \(4, 108\), expected \(..., rows, cols, 3\)"):
        crossings_from_pillars(np.zeros((4, 108)))
