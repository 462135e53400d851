"""Every pillar has a crossing of its own, in the order that docs/frames.md gives."""

import re
from pathlib import Path

import numpy as np
import pytest

from geometry.layout import SONG2018
from geometry.wiring import crossing_of_pillar, crossings
from tests.fem.scenes import FOUR
from tests.geometry.closed_forms import crossings_from_pillars

PAGE = Path(__file__).parents[2] / "docs" / "frames.md"

# The 1 × 2 array by hand: row wires 0 (U1) and 1 (U2), column wires 0 and 1 (L1 and L2 of unit 0), 2 and 3.
ONE_BY_TWO = [
    # row wire, column wire, array row, array column, pillar
    (0, 0, 0, 0, "z"), (0, 1, 0, 0, "x"), (0, 2, 0, 1, "z"), (0, 3, 0, 1, "x"), (1, 0, 0, 0, "y"), (1, 2, 0, 1, "y"),
]  # fmt: skip


def test_order_of_a_1_by_2_array_is_the_hand_written_one_and_the_pages():
    assert crossings(1, 2).tolist() == [[r, c] for r, c, *_ in ONE_BY_TWO]
    for place, (*_, row, col, pillar) in enumerate(ONE_BY_TWO):
        assert crossing_of_pillar(1, 2)[row, col, SONG2018.pillar_names.index(pillar)] == place
    listed = re.findall(r"^\| (\d) \| (\d) \| (\d) \| (\d) \| (\d) \| ([xyz]) \|$", PAGE.read_text(), re.MULTILINE)
    assert [(*map(int, line[1:5]), line[5]) for line in listed] == ONE_BY_TWO


@pytest.mark.parametrize("layout", [SONG2018, FOUR], ids=["paper", "four pillars"])
def test_every_pillar_has_a_crossing_of_its_own_where_its_electrodes_wires_cross(layout):
    """Sent row-major; the layout read the other way gives the place of each pillar."""
    rows, cols = 3, 5
    wires, n = crossings(rows, cols, layout), len(layout.pillars) * rows * cols
    n_upper, n_lower = len(layout.upper), len(layout.lower)
    assert len(wires) == n
    row_wire, column_wire = wires.T
    assert (np.diff(row_wire * n_lower * cols + column_wire) > 0).all()

    place = {tuple(pair): k for k, pair in enumerate(wires.tolist())}
    pillars = crossing_of_pillar(rows, cols, layout)
    for i, j in np.ndindex(rows, cols):
        own = [place[n_upper * i + top, n_lower * j + foot - n_upper] for top, foot in layout.pillar_terminals]
        assert pillars[i, j].tolist() == own
    values = np.random.default_rng(0).random((4, rows, cols, len(layout.pillars)))
    assert (crossings_from_pillars(values, layout).take(pillars, axis=-1) == values).all()
