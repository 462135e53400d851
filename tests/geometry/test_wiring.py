"""Every pillar has a crossing of its own, in the order that docs/frames.md gives."""

import re
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from geometry.errors import DesignError
from geometry.layout import LAYOUTS, SONG2018, Layout
from geometry.wiring import crossing_of_pillar, crossings, explained, fewest_wires
from geometry.wiring import wires as wires_of
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
    """A layout in which electrodes share wires, named by those that do, with a hyphen between."""
    of = {each: wire for wire in together for each in wire.split("-")}
    levels = [
        [replace(one, wire=of.get(one.name)) for one in level] for level in (LAYOUTS[name].upper, LAYOUTS[name].lower)
    ]
    return replace(LAYOUTS[name], upper=tuple(levels[0]), lower=tuple(levels[1]))


SHARED = shared("six-pillar", "L1-L4", "L2-L3")
EVERY = LAYOUTS | {"four pillars": FOUR, "shared": SHARED}


@pytest.mark.parametrize("layout", EVERY.values(), ids=list(EVERY))
def test_every_pillar_has_a_crossing_of_its_own_where_its_electrodes_wires_cross(layout):
    """Sent row-major; the layout read the other way gives the place of each pillar."""
    rows, cols = 3, 5
    wires, n = crossings(rows, cols, layout), len(layout.pillars) * rows * cols
    n_upper, (n_row, n_column) = len(layout.upper), wires_of(1, 1, layout)
    assert (len(wires), wires_of(rows, cols, layout)) == (n, (rows * n_row, cols * n_column))
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
        pairs, n_upper = np.array(layout.pillar_terminals), len(layout.upper)
        least = len(layout.terminals)
        lower = [np.array(shared) for shared in product(range(4), repeat=len(layout.lower))]
        for upper in (np.array(shared) for shared in product(range(n_upper), repeat=n_upper)):
            for columns in lower:
                used = len({*zip(upper[pairs[:, 0]].tolist(), columns[pairs[:, 1] - n_upper].tolist(), strict=True)})
                if used == len(pairs):
                    least = min(least, len({*upper.tolist()}) + len({*columns.tolist()}))
        found = fewest_wires(layout)
        assert least == expected == sum(map(len, found))
        shared(name, *("-".join(names) for level in found for names in level))  # each pillar has a crossing
    assert explained(LAYOUTS["six-pillar"]).endswith("3 and 2 would do: L1 and L4, L2 and L3 can share a wire.")
    assert explained(SHARED) == "Wires of a unit: 3 in rows, 2 in columns; 6 channels."
    with pytest.raises(DesignError, match="pillars z and x want one crossing of wires: give L1 and L2"):
        shared("six-pillar", "L1-L2")
