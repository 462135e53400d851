"""Every pillar has a crossing of its own, in the order that docs/frames.md gives."""

import re
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from common.errors import DesignError
from geometry.layout import LAYOUTS, SONG2018, Layout
from geometry.wiring import crossing_of_pillar, crossings, explained, fewest_wires, unit_crossings
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


def shared(name: str, *together: str) -> Layout:
    """A layout in which electrodes share wires: "L1 L2" that of L1."""
    wire = {each: group.split()[0] for group in together for each in group.split()}
    layout = LAYOUTS[name]
    upper, lower = (
        tuple(replace(one, wire=wire.get(one.name)) for one in level) for level in (layout.upper, layout.lower)
    )
    return replace(layout, upper=upper, lower=lower)


SHARED = shared("six-pillar", "L1 L4", "L2 L3")
EVERY = LAYOUTS | {"four pillars": FOUR, "shared": SHARED}


@pytest.mark.parametrize("layout", EVERY.values(), ids=list(EVERY))
def test_every_pillar_has_a_crossing_of_its_own_where_its_electrodes_wires_cross(layout):
    """Sent row-major; the layout read the other way gives the place of each pillar."""
    rows, cols = 3, 5
    wires, n = crossings(rows, cols, layout), len(layout.pillars) * rows * cols
    n_upper, (n_row, n_column) = len(layout.upper), unit_crossings(layout).shape
    assert len(wires) == n
    row_wire, column_wire = wires.T
    assert (np.diff(row_wire * n_column * cols + column_wire) > 0).all()

    place = {tuple(pair): k for k, pair in enumerate(wires.tolist())}
    pillars = crossing_of_pillar(rows, cols, layout)
    for i, j in np.ndindex(rows, cols):
        own = [
            place[n_row * i + layout.row_wires[top], n_column * j + layout.column_wires[foot - n_upper]]
            for top, foot in layout.pillar_terminals
        ]
        assert pillars[i, j].tolist() == own
    values = np.random.default_rng(0).random((4, rows, cols, len(layout.pillars)))
    assert (crossings_from_pillars(values, layout).take(pillars, axis=-1) == values).all()


def test_fewest_wires_are_those_of_a_search_of_all_sharings():
    """All maps of electrodes to wires, of both levels, that leave every pillar a crossing of its own."""
    for name, expected in {"song2018": 4, "six-pillar": 5, "eight-pillar": 6, "upright-four": 4}.items():
        layout = LAYOUTS[name]
        n_upper, n_lower, counts = len(layout.upper), len(layout.lower), set()
        for wires in product(range(max(n_upper, n_lower)), repeat=n_upper + n_lower):
            if len({(wires[top], wires[foot]) for top, foot in layout.pillar_terminals}) == len(layout.pillars):
                counts.add(len({*wires[:n_upper]}) + len({*wires[n_upper:]}))
        found = fewest_wires(layout)
        assert min(counts) == expected == sum(map(len, found))
        shared(name, *(" ".join(names) for level in found for names in level))  # each pillar has a crossing
    assert explained(LAYOUTS["six-pillar"]).endswith("3 and 2 would do: L1 and L4, L2 and L3 can share a wire.")
    assert explained(SHARED) == "Wires of a unit: 3 in rows, 2 in columns; 6 channels."
    with pytest.raises(DesignError, match="pillars z and x want one crossing of wires: give L1 and L2"):
        shared("six-pillar", "L1 L2")
