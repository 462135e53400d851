"""Layouts as tables and as text: back as they were, and refused in one line."""

import re
from dataclasses import replace

import pytest

from geometry import DesignError, design_from_toml
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


def table(pillars: str, electrodes: str = "U1 -1 -1, U2 -1 1, L1 -1 -1, L2 1 -1") -> str:
    """Electrodes by name and place and pillars by name, foot and top, with more keys after them, as a file has them."""
    levels = {"U": "upper", "L": "lower"}
    words = [each.split(None, 3) for each in electrodes.split(", ")]
    text = [f'{{name="{n}", level="{levels[n[0]]}", place=[{x}, {y}]{"".join(more)}}}' for n, x, y, *more in words]
    words = [each.split(None, 3) for each in pillars.split(", ")]
    joined = [f'{{name="{n}", from="{foot}", to="{top}"{"".join(more)}}}' for n, foot, top, *more in words]
    return f"electrode = [{', '.join(text)}]\npillar = [{', '.join(joined)}]\n"


PAPERS = "z L1 U1, x L2 U1, y L1 U2"
ONE = 'electrode = [{name="U", level="upper", place=[0, 0]}, {name="L", level="lower", place=[0, 0]}'
NINE = table(
    ", ".join(f"p{k} L{k} U{k}" for k in range(30)),
    ", ".join(f"{level}{k} {k // 3 / 5 - 0.9} {k % 3 / 5 - 0.9}" for level in "UL" for k in range(30)),
)
BAD = [
    ("layout = 'seven'", "layout = 'seven': give one of song2018, six-pillar, eight-pillar, upright-four, single"),
    ("layout = 'song2018'\n" + table(PAPERS), "layout = 'song2018' and [[electrode]]: give one of"),
    (table(PAPERS) + "[unit]\nlayout = 'song2018'\n", "unknown key 'layout' in [unit]"),
    ("electrode = 3\npillar = []\n", "'electrode' must be an array of tables"),
    ("electrode = []\npillar = []\n", "no pillar joins electrodes"),
    (f"{ONE}, {{name='V'}}]\n", "the key 'place' is missing in [[electrode]] 3"),
    (f"{ONE}, {{name='V', level='top', place=[1, 0]}}]\n", "3: level = 'top' must be one of upper, lower"),
    (
        f"{ONE}, {{name='V', level='upper', place=[1]}}]\n",
        "3: place=[1] must be 2 finite numbers; its middle along x and",
    ),
    (table("z L1 U1", "U1 nan 0, L1 0 0"), "place=[nan, 0] must be 2 finite numbers"),
    (table("z. L1 U1", "U1 0 0, L1 0 0"), "'z.' is no name: give up to 8 letters and digits"),
    (f"{ONE}]\npillar = [{{name=3, from='L', to='U'}}]\n", "3 is no name: give up to 8"),
    ("pillar = [{name='z', from=['L'], to='U'}]\n", "['L'] is no name"),
    ("pillar = [{name='z', from='L', to='U'}]\n", "end at one of the upper electrodes, of which there are none"),
    (table("z L1 U1, x L2 U9, y L1 U2"), "pillar x joins L2 and U9: it must stand on one of L1, L2"),
    (table("z L1 U1, x L2 U1"), "no pillar joins U2: each needs one that is no reference"),
    (table("z L1 U1, x L2 U1, y L1 U2 ,reference=true"), "no pillar joins U2: each needs one that is no reference"),
    (table(PAPERS + ", r L1 U1 ,reference=true"), "two pillars join ('L1', 'U1')"),
    (table(PAPERS + ", z L2 U2"), "two pillars are named z: give each its own"),
    (table(PAPERS, "U1 -1 -1, U2 -1 1, L1 -1 -1, L1 1 -1"), "two electrodes are named L1"),
    (table(PAPERS, "U1 -1 -1, U2 -1 1, L1 -1 -1, L2 -1 -1"), "two lower electrodes lie at (-1.0, -1.0)"),
    (
        table("z L1 U1, y L1 U2", "U1 -1 -1 ,wire='a', U2 -1 1 ,wire='a', L1 -1 -1"),
        "pillars z and y want one crossing of wires: give U1 and U2 wires of their own",
    ),
    (table(PAPERS + " ,length_mm=3"), "unknown key 'length_mm' in [[pillar]] 3; known are name, from, to"),
    (table(PAPERS + " ,section='oval'"), "[[pillar]] 3: section='oval' must be one of square, round"),
    *((table(f"z L1 U1 ,width_mm={w}, x L2 U1, y L1 U2"), f"width_mm={w} must be") for w in ("0", "-1", "nan", "'2'")),
    (table("z L1 U1 ,width_mm=20, x L2 U1, y L1 U2"), "lets pillars z and x of a unit merge: it must be above 11.41"),
    (NINE, "span_mm=10 lets pillars p1 and p2 of a unit merge: it must be above 20"),
    ("layout = 'six-pillar'\n[unit]\nspan_mm = 2.0\n", "in [unit]: span_mm=2 lets pillars z and x of a unit merge"),
    (table("z L1 U1", "U1 3 0, L1 3 0"), "pitch_mm=15 is smaller than the unit, whose pillars take 32 mm"),
]


@pytest.mark.parametrize(("text", "said"), BAD, ids=[said for _, said in BAD])
def test_a_bad_layout_is_one_line_that_names_file_and_place(text, said):
    with pytest.raises(DesignError, match=rf"^my\.toml: .*{re.escape(said)}") as refusal:
        design_from_toml(text, "my.toml")
    assert "\n" not in str(refusal.value)


def test_a_text_that_is_no_layout_is_refused():
    for text in ("six pillar", '{"electrode": [', "{" + '"a":{' * 20000):
        with pytest.raises(DesignError):
            layout_from_text(text)


def test_an_electrode_of_a_reference_alone_is_idle_in_the_layout_already():
    """A design, which asks again without the references, would hide it."""
    with pytest.raises(DesignError, match="no pillar joins U2"):
        replace(SONG2018, pillars=(*SONG2018.pillars[:2], replace(SONG2018.pillars[2], reference=True)))
