"""Design files: what is written comes back, what is unknown is named, no mistake takes more than a line."""

import re
import time
import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.storage.files import digest, stated
from geometry import (
    Array,
    DesignError,
    Electrics,
    Material,
    Pad,
    SensorDesign,
    Unit,
    design_from_toml,
    design_to_toml,
    read_design,
)
from geometry.design_file import read_tolerances, whole_design
from geometry.layout import LAYOUTS, Electrode, Layout, Pillar
from geometry.tolerances import usual_deviations
from tests.fem.scenes import round_of

materials = st.builds(Material, young_mpa=st.floats(1e-3, 1e3), poisson=st.floats(0.0, 0.5, exclude_max=True))
conductions = st.builds(Electrics, model=st.just("conduction"), elastoresistance_along=st.floats(-10.0, 10.0))


@st.composite
def designs(draw) -> SensorDesign:
    """Any design that is allowed: a thin pillar in a wide unit on a wider pitch, pads inside their share."""
    width_mm = draw(st.floats(0.1, 50.0))
    span_mm = 3 * width_mm * draw(st.floats(1.0, 2.0))
    height_mm = span_mm * draw(st.floats(0.5, 3.0))  # flatter units would merge their pillars
    unit = Unit(span_mm=span_mm, height_mm=height_mm, pillar_width_mm=width_mm, electrode_mm=0.9 * span_mm)
    pitch_mm = unit.footprint_mm * draw(st.floats(1.0, 3.0))
    share = draw(st.floats(0.1, 0.9))
    offsets = st.floats(-(1 - share) / 2.001, (1 - share) / 2.001).map(lambda part: part * pitch_mm)
    return SensorDesign(
        resistivity_ohm_mm=draw(st.floats(1e-3, 1e9)),
        unit=unit,
        array=Array(rows=draw(st.integers(1, 40)), cols=draw(st.integers(1, 40)), pitch_mm=pitch_mm),
        pad=Pad(size_mm=share * pitch_mm, offset_x_mm=draw(offsets), offset_y_mm=draw(offsets)),
        pillar_material=draw(materials),
        matrix_material=draw(materials),
        electrics=draw(st.just(Electrics()) | conductions),
    )


@settings(max_examples=30, deadline=None, derandomize=True, database=None)
@given(designs())
def test_every_design_comes_back_to_the_last_bit(design):
    text = design_to_toml(design)
    assert design_from_toml(text) == whole_design(text, "a file") == design


REFUSED = {
    "[array]\npitch_mm = '2'\n": "in [array]: pitch_mm='2' must be a finite number; centre-to-centre",
    "[unit]\nspam_mm = 3.0\n": "unknown key 'spam_mm' in [unit]; known are span_mm, height_mm, ",
    "[arrays]\nrows = 2\n": "unknown key 'arrays'; known are resistivity_ohm_mm, ",
    '"a\\nb" = 1\n': r"unknown key 'a\nb'; known are ",
    "[array]\npitch_mm = 5.0\n": "pitch_mm=5 is smaller than the unit",
    "unit = 3\n": "'unit' must be one table, written [unit], not 3",
    f"a = 1{'0' * 5000}": "not valid TOML: a number has thousands of digits: give fewer.",
    # no TOML: an open table, endless nesting
    **dict.fromkeys(["[unit", f"a = {'[' * 5000}{']' * 5000}"], "not valid TOML: "),
    # the parser takes 1.7 GB and minutes for this
    ".".join("a" * 20_000) + " = 1": "a key has more than 16 parts",
}


@pytest.mark.parametrize("text", REFUSED, ids=lambda text: text[:30])
def test_what_is_no_design_is_refused_in_one_line_that_names_file_and_place(text):
    begin = time.process_time()
    with pytest.raises(DesignError, match=rf"^my\.toml: .*{re.escape(REFUSED[text])}") as caught:
        design_from_toml(text, "my.toml")
    assert "\n" not in str(caught.value)
    assert time.process_time() - begin < 1


def test_a_file_that_was_cut_off_anywhere_is_refused(tmp_path):
    """At every line and within the last one; whole it gives the design back, with Windows' line ends and mark too."""
    whole = design_to_toml(SensorDesign())
    lines = whole.splitlines(keepends=True)
    kept = max(number for number, line in enumerate(lines) if "=" in line)
    for text in ["".join(lines[:number]) for number in range(kept + 1)] + [whole[:-40], whole.rstrip("\n")]:
        with pytest.raises(DesignError, match="cut off"):
            whole_design(text, "my.toml")
    path = tmp_path / "my.toml"
    path.write_bytes(b"\xef\xbb\xbf" + whole.replace("\n", "\r\n").encode())
    assert read_design(path) == SensorDesign()
    for content, says in ((b"\xff\xfe\x00\x80", "not a text file"), (b"# " + b"x" * 2_000_000, "larger than 2 MB")):
        path.write_bytes(content)
        with pytest.raises(DesignError, match=rf"my\.toml: {says}"):
            read_design(path)


def test_what_a_file_leaves_out_is_the_papers_if_it_says_so():
    assert whole_design('extends = "paper"\n[array]\nrows = 3\n', "my.toml") == SensorDesign(array=Array(rows=3))
    with pytest.raises(DesignError, match="extends = 'mine' is unknown"):
        whole_design("extends = 'mine'\n", "my.toml")


def test_later_tables_and_layouts_leave_older_files_and_hashes_alone():
    """Defaults do not count in hashes, and no layout is written of the paper's unit."""
    text = design_to_toml(SensorDesign())
    before = text[: text.index("[electrics]")] + text[text.index("[pillar_material]") :]
    assert whole_design(before, "an older file") == SensorDesign()
    assert "electrics" not in stated(SensorDesign())
    assert "layout" not in stated(SensorDesign())["unit"]
    assert not {"layout", "electrode", "pillar"} & {*tomllib.loads(text)}
    changed = [SensorDesign(electrics=Electrics(model="conduction"))]
    changed += [SensorDesign(unit=Unit(layout=layout)) for layout in (*OTHERS.values(), *ROUND.values())]
    assert len({*map(digest, [SensorDesign(), *changed])}) == 1 + len(changed)


ROUND = {f"{name}, round": round_of(layout) for name, layout in LAYOUTS.items()}
OWN = Layout(
    upper=(Electrode("Up", (0.0, 0.5), wire="a"), Electrode("V2", (1.2, 0.5))),
    lower=(Electrode("L1", (0.0, 0.5)), Electrode("L2", (1.2, 0.5), wire="b"), Electrode("L3", (0.0, -1.0), wire="b")),
    pillars=(Pillar("z", "L1", "Up", "round", 1.25), Pillar("z2", "L2", "V2", "square", 0.5), Pillar("y", "L3", "Up")),
)
OTHERS = {name: layout for name, layout in LAYOUTS.items() if name != "song2018"} | {"of your own": OWN}
EVERY = LAYOUTS | ROUND | OTHERS


@pytest.mark.parametrize("layout", EVERY.values(), ids=list(EVERY))
def test_layouts_come_back_whole_in_whatever_way_they_are_written(layout):
    """By name or as tables, written [[electrode]] or in lines, of units that would not suit the paper's pillars."""
    design = SensorDesign(unit=Unit(layout=layout, span_mm=9.0))
    text = design_to_toml(design)
    assert design_from_toml(text) == whole_design(text, "a file") == design
    assert ("layout = " in text) == (layout in OTHERS.values() and layout is not OWN)
    if layout is OWN:
        tables = tomllib.loads(text)
        named = "".join(
            f"\n[[{kind}]]\n" + "\n".join(f"{key} = {value!r}" for key, value in entry.items())
            for kind in ("electrode", "pillar")
            for entry in tables[kind]
        )
        assert design_from_toml(f"[unit]\nspan_mm = 9.0{named}") == design


def test_a_design_file_may_state_tolerances_of_its_own(tmp_path):
    """The table [tolerance] is checked with the design and is no part of it."""
    path, design = tmp_path / "sensor.toml", SensorDesign()
    text = design_to_toml(design)
    path.write_text(text + '[tolerance]\n"unit.height_mm" = 0.05\n"pad.size_mm" = 0\n', encoding="utf-8")
    assert read_design(path) == design
    assert read_tolerances(path) == usual_deviations(design) | {"unit.height_mm": 0.05, "pad.size_mm": 0.0}
    path.write_text(f'{text}[tolerance]\n"unit.depth_mm" = 0.05\n', encoding="utf-8")
    for read in (read_design, read_tolerances):
        with pytest.raises(DesignError, match=r"unknown key 'unit\.depth_mm'"):
            read(path)
