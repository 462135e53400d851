"""Layouts as tables and as text: back as they were, and refused in one line."""

from dataclasses import replace

import pytest

from geometry import DesignError
from geometry.layout import LAYOUTS, SONG2018, Electrode
from geometry.layout_file import layout_from_tables, layout_from_text, layout_tables, layout_text
from tests.fem.scenes import BESIDE

OWN = replace(SONG2018, upper=(SONG2018.upper[0], Electrode("U2", (-1.0, 0.5))))


@pytest.mark.parametrize("layout", [*LAYOUTS.values(), OWN, BESIDE])
def test_a_layout_comes_back_from_its_tables_and_its_text(layout):
    assert layout_from_tables(layout_tables(layout)) == layout_from_text(layout_text(layout)) == layout
    assert ("layout" in layout_tables(layout)) == (layout in LAYOUTS.values())
    assert layout_text(layout).isascii()
    assert "\n" not in layout_text(layout)


def test_what_states_no_layout_is_the_papers():
    assert layout_from_tables({}) == layout_from_text("") == SONG2018


TABLES = layout_tables(OWN)
ELECTRODE, PILLAR = TABLES["electrode"], TABLES["pillar"]


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ({"layout": "seven"}, "layout = 'seven': give one of song2018, six-pillar"),
        ({"layout": "song2018", **TABLES}, r"layout = 'song2018' and \[\[electrode\]\]: give one of"),
        (TABLES | {"electrode": 3}, "'electrode' must be an array of tables"),
        (TABLES | {"electrode": [*ELECTRODE, {"name": "U3"}]}, r"the key 'place' is missing in \[\[electrode\]\] 5"),
        (
            TABLES | {"electrode": [ELECTRODE[0] | {"place": [1]}]},
            r"1: place=\[1\] must be 2 finite numbers; its middle along x and y",
        ),
        (TABLES | {"electrode": [ELECTRODE[0] | {"level": "top"}]}, "1: level = 'top' must be one of upper, lower"),
        (
            TABLES | {"electrode": [ELECTRODE[0] | {"name": "U 1"}]},
            "'U 1' is no name: give up to 8",
        ),
        (TABLES | {"pillar": [*PILLAR, PILLAR[0] | {"to": "U9", "name": "q"}]}, "pillar q joins L1 and U9"),
        (TABLES | {"pillar": [PILLAR[0] | {"size": 2}]}, r"unknown key 'size' in \[\[pillar\]\] 1"),
    ],
)
def test_bad_layouts_are_refused_in_one_line(tables, said):
    with pytest.raises(DesignError, match=said) as refusal:
        layout_from_tables(tables)
    assert "\n" not in str(refusal.value)


def test_a_text_that_is_no_layout_is_refused():
    for text in ("six pillar", '{"electrode": [', "{" + '"a":{' * 20000):
        with pytest.raises(DesignError):
            layout_from_text(text)
