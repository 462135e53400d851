"""Sweep files and what they ask for: keys, shares, samples; nonsense is refused in one line."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from common.errors import DesignError
from geometry.design import SensorDesign, Unit
from geometry.design_file import design_to_toml
from geometry.layout import LAYOUTS, Layout
from tests.docs.terminal import ROOT
from tripillar.sweeps.sampling import points_of, row_key, sample_at, samples_of
from tripillar.sweeps.sweep_file import Bound, Judging, read_sweep, sweep_from_dict
from tripillar.sweeps.variables import KEYS, Variable, value_of, with_values

PITCH = {"key": "array.pitch_mm", "low": 13.0, "high": 20.0}
PAD = {"key": "pad.size_mm", "of": "array.pitch_mm", "low": 0.5, "high": 1.0}
ROWS = {"key": ["array.rows", "array.cols"], "low": 2, "high": 4}
YOUNG = {"key": "matrix_material.young_mpa", "low": 0.5, "high": 1.0}
TURNED = tuple(replace(one, name=name) for one, name in zip(LAYOUTS["upright-four"].pillars, "abcd", strict=True))


def sweep(*vary, **settings):
    return sweep_from_dict({"vary": list(vary), "sweep": settings})


def test_every_number_of_a_design_can_be_varied():
    table = asdict(SensorDesign())
    assert len(KEYS) == 15
    for key in KEYS:
        changed = with_values(table, [Variable(key=(key,), low=1.0, high=3.0)], [2.0])
        assert value_of(changed, key) == 2
        assert sum(value_of(changed, other) != value_of(table, other) for other in KEYS) <= 1


def test_shares_follow_the_key_they_are_of_and_whole_numbers_stay_whole_and_are_judged_once():
    sample = sample_at(sweep(PAD, PITCH, ROWS), [0.5, 20.0, 2.6])  # the share comes before what it is of
    assert sample.values == {"pad.size_mm": 10.0, "array.pitch_mm": 20.0, "array.rows": 3.0}
    assert (sample.design.array.rows, sample.design.array.cols) == (3, 3)
    rows = [sample.values["array.rows"] for sample in samples_of(sweep(ROWS, samples=32))]
    assert sorted(rows) == [2.0, 3.0, 4.0]
    sample = sample_at(sweep(PITCH), [5.0])
    assert (sample.design, "pitch_mm=5 is smaller than the unit" in sample.reason) == (None, True)


def test_texts_change_a_design_by_name_and_by_file(tmp_path):
    """A layout of one's own is read beside the sweep file; the columns are those of all layouts' pillars."""
    own = Layout(upper=LAYOUTS["upright-four"].upper, lower=LAYOUTS["upright-four"].lower, pillars=TURNED)
    (tmp_path / "own.toml").write_text(design_to_toml(SensorDesign(unit=Unit(layout=own))))
    layouts = {"key": "layout", "values": ["own.toml", "six-pillar", "song2018"]}
    kinds, rubbers = {"key": "pad.kind", "values": ["soft", "stiff"]}, ["ecoflex-00-50", "dragon-skin-30"]
    given = {"design": {"layout": "eight-pillar"}, "sweep": {"sampling": "grid"}}
    asked = sweep_from_dict(
        given | {"vary": [layouts, kinds, {"key": "matrix_material", "values": rubbers}]}, folder=tmp_path
    )
    designs = [sample.design for sample in samples_of(asked)]
    assert [each.unit.layout for each in designs[::4]] == [own, LAYOUTS["six-pillar"], LAYOUTS["song2018"]]
    assert [(each.pad.kind, each.matrix_material.young_mpa) for each in designs[:4]] == [
        (kind, young) for kind in ("soft", "stiff") for young in (0.087, 0.922)
    ]
    assert {"sensitivity_a_pct_per_n", "sensitivity_z3_pct_per_n", "sensitivity_y_pct_per_n"} < {*asked.metrics}
    assert [*samples_of(asked)[0].values.values()] == ["own.toml", "soft", rubbers[0]]
    pitches = {"key": "array.pitch_mm", "values": [15.0]}
    assert samples_of(sweep_from_dict(given | {"vary": [pitches]}))[0].design.unit.layout == LAYOUTS["eight-pillar"]


@pytest.mark.parametrize("sampling", ["sobol", "latin-hypercube"])
def test_samples_fill_the_range_evenly_by_their_seed(sampling):
    """Both put one of 16 points into each sixteenth of every axis; a longer Sobol sweep keeps a shorter one's."""
    found = [points_of(sweep(PITCH, PAD | {"log": True}, sampling=sampling, samples=16, seed=s)) for s in (3, 3, 4)]
    pitch, pad = np.array(found[0]).T
    assert sorted(((pitch - 13) / 7 * 16).astype(int)) == list(range(16))
    assert sorted((np.log(pad / 0.5) / np.log(2) * 16).astype(int)) == list(range(16))
    assert found[0] == found[1] != found[2]
    fewer = points_of(sweep(PITCH, PAD | {"log": True}, sampling=sampling, samples=6, seed=3))
    assert (fewer == found[0][:6]) == (sampling == "sobol")


def test_a_grid_is_the_product_of_its_values():
    pitches = {"key": "array.pitch_mm", "values": [13.0, 16.5, 20.0]}
    asked = sweep(pitches, {"key": "array.rows", "values": [2, 3]}, sampling="grid")
    assert points_of(asked) == [(p, r) for p in (13.0, 16.5, 20.0) for r in (2, 3)]


def test_a_row_is_known_by_its_design_and_how_it_is_judged_and_excess_is_relative():
    others = {"noise": 2e-3, "bits": 12, "tolerance": 2e-2, "cap": 0.2, "touch_n": 20.0}
    found = {row_key(SensorDesign(), Judging(**{name: value})) for name, value in others.items()}
    found |= {row_key(SensorDesign(resistivity_ohm_mm=3000.0), Judging()), row_key(SensorDesign(), Judging())}
    assert len(found | {row_key(SensorDesign(), Judging())}) == 7
    assert (Bound(least=10.0).excess(5.0), Bound(most=10.0).excess(15.0)) == (0.5, 0.5)
    assert (Bound(least=1.0, most=2.0).excess(1.5), Bound(most=1.0).excess(None)) == (0.0, float("inf"))


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.toml")), ids=lambda path: path.stem)
def test_examples_are_sweeps_of_designs_that_mostly_can_be_built(path):
    asked = read_sweep(path)
    samples = samples_of(replace(asked, samples=16))
    assert sum(sample.design is not None for sample in samples) > 12, [sample.reason for sample in samples]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"vary": [{"key": "pitch"}]}, "unknown key 'pitch'; known are resistivity_ohm_mm"),
        ({"vary": [PITCH | {"colour": 1}]}, r"unknown key 'colour' in \[\[vary\]\] 1"),
        ({"vary": [PITCH | {"low": float("nan")}]}, "finite"),
        ({"vary": [PITCH | {"values": [1.0]}]}, "either values, or low and high"),
        ({"vary": [PITCH | {"of": "array.pitch_mm"}]}, "share of itself"),
        ({"vary": [PITCH], "sweep": {"least": "cost"}}, "no metric 'cost'; known are error_n"),
        ({"vary": [PITCH], "bounds": {"touch_place_mm": {"most": 1.0}}}, "touch_place_mm needs touch_n"),
        ({"vary": [PITCH], "bounds": {"range_n": {"least": 2, "most": 1}}}, "above most"),
        (
            {"vary": [{"key": "layout", "values": ["hexagon"]}]},
            r"hexagon: no such file: give a file .* or one of song2018",
        ),
        ({"vary": [{"key": "layout", "values": [3]}]}, r"layout takes values = \[...\] of texts alone"),
        (
            {"vary": [{"key": "layout", "low": 1, "high": 2}]},
            r"unknown key 'low' in \[\[vary\]\] 1; known are key, values",
        ),
        ({"vary": [{"key": "pad.kind", "values": ["hard"]}]}, "'hard' is no kind of pad: give some of soft, stiff"),
        ({"vary": [{"key": "matrix_material", "values": ["gel"]}]}, "gel is neither"),
        ({"vary": [{"key": "matrix_material", "values": ["pdms-10-1"]}, YOUNG]}, "young_mpa is varied twice"),
        ({"vary": [PITCH], "design": {"pad": {"size_mm": 99.0}}}, "pads may touch"),
    ],
)
def test_nonsense_is_refused_in_one_line(table, message):
    with pytest.raises(DesignError, match=message) as refused:
        sweep_from_dict(table, "mine.toml")
    assert str(refused.value).startswith("mine.toml: ")
    assert "\n" not in str(refused.value)
