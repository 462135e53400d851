"""Sweep files and what they ask for: keys, shares, samples; nonsense is refused in one line."""

from dataclasses import asdict

import numpy as np
import pytest

from geometry.design import SensorDesign
from geometry.errors import DesignError
from tripillar.sweep.sampling import points_of, row_key, sample_at, samples_of
from tripillar.sweep.sweep_file import Bound, Judging, sweep_from_dict
from tripillar.sweep.variables import KEYS, Variable, value_of, with_values

PITCH = {"key": "array.pitch_mm", "low": 13.0, "high": 20.0}
PAD = {"key": "pad.size_mm", "of": "array.pitch_mm", "low": 0.5, "high": 1.0}
ROWS = {"key": ["array.rows", "array.cols"], "low": 2, "high": 4}


def sweep(*vary, **settings):
    return sweep_from_dict({"vary": list(vary), "sweep": settings})


def test_every_number_of_a_design_can_be_varied():
    table = asdict(SensorDesign())
    assert {type(value_of(table, key)) for key in KEYS} == {int, float}
    assert len(KEYS) == 15
    for key in KEYS:
        changed = with_values(table, [Variable(key=(key,), low=1.0, high=3.0)], [2.0])
        assert value_of(changed, key) == 2
        assert sum(value_of(changed, other) != value_of(table, other) for other in KEYS) <= 1


def test_shares_follow_the_key_they_are_of_and_whole_numbers_stay_whole():
    asked = sweep(PAD, PITCH, ROWS)  # the share comes before what it is of
    sample = sample_at(asked, [0.5, 20.0, 2.6])
    assert sample.values == {"pad.size_mm": 10.0, "array.pitch_mm": 20.0, "array.rows": 3.0}
    assert (sample.design.array.rows, sample.design.array.cols) == (3, 3)


def test_a_longer_sobol_sweep_keeps_the_designs_of_a_shorter_one():
    few, many = (points_of(sweep(PITCH, PAD, samples=n, seed=3)) for n in (6, 16))
    assert many[:6] == few
    assert points_of(sweep(PITCH, PAD, samples=6, seed=4)) != few


@pytest.mark.parametrize("sampling", ["sobol", "latin-hypercube"])
def test_samples_fill_the_range_evenly(sampling):
    """Both put one of 16 points into each sixteenth of every axis; Sobol's are so by its first 4 bits."""
    asked = sweep(PITCH, PAD | {"log": True}, sampling=sampling, samples=16)
    pitch, pad = np.array(points_of(asked)).T
    assert sorted(((pitch - 13) / 7 * 16).astype(int)) == list(range(16))
    assert sorted((np.log(pad / 0.5) / np.log(2) * 16).astype(int)) == list(range(16))


def test_a_grid_is_the_product_of_its_values():
    pitches = {"key": "array.pitch_mm", "values": [13.0, 16.5, 20.0]}
    asked = sweep(pitches, {"key": "array.rows", "values": [2, 3]}, sampling="grid")
    assert points_of(asked) == [(p, r) for p in (13.0, 16.5, 20.0) for r in (2, 3)]


def test_designs_that_rounding_makes_equal_are_judged_once():
    rows = [sample.values["array.rows"] for sample in samples_of(sweep(ROWS, samples=32))]
    assert sorted(rows) == [2.0, 3.0, 4.0]


def test_numbers_that_make_no_design_give_a_sample_with_the_reason():
    sample = sample_at(sweep(PITCH), [5.0])
    assert sample.design is None
    assert "pitch_mm=5 is smaller than the unit" in sample.reason


def test_a_row_is_known_by_its_design_and_how_it_is_judged():
    same = row_key(SensorDesign(), Judging())
    assert same == row_key(SensorDesign(), Judging())
    others = {"noise": 2e-3, "bits": 12, "tolerance": 2e-2, "cap": 0.2, "touch_n": 20.0}
    other = [Judging(**{name: value}) for name, value in others.items()]
    found = {row_key(SensorDesign(), judging) for judging in other}
    found.add(row_key(SensorDesign(resistivity_ohm_mm=3000.0), Judging()))
    assert len(found | {same}) == 7


def test_excess_is_relative_to_the_bound():
    assert Bound(least=10.0).excess(5.0) == 0.5
    assert Bound(most=10.0).excess(15.0) == 0.5
    assert Bound(least=1.0, most=2.0).excess(1.5) == 0.0
    assert Bound(most=1.0).excess(None) == float("inf")


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({}, "nothing is varied"),
        ({"vary": {}}, "array of tables"),
        ({"vary": [{"key": "pitch"}]}, "unknown key 'pitch'; known are resistivity_ohm_mm"),
        ({"vary": [PITCH | {"colour": 1}]}, r"unknown key 'colour' in \[\[vary\]\] 1"),
        ({"vary": [PITCH | {"low": 30.0}]}, "low must be below high"),
        ({"vary": [PITCH | {"low": float("nan")}]}, "finite"),
        ({"vary": [PITCH | {"log": "yes"}]}, "true or false"),
        ({"vary": [PITCH | {"values": [1.0]}]}, "either values, or low and high"),
        ({"vary": [PITCH | {"low": -1.0, "log": True}]}, "above 0"),
        ({"vary": [PITCH], "sweep": {"sampling": "grid"}}, "a grid needs values"),
        ({"vary": [PITCH, PITCH]}, "varied twice"),
        ({"vary": [PITCH | {"of": "array.pitch_mm"}]}, "share of itself"),
        ({"vary": [PAD, {"key": "unit.span_mm", "of": "pad.size_mm", "low": 0.1, "high": 1}]}, "itself a share"),
        ({"vary": [PITCH], "sweep": {"samples": 0}}, "samples=0"),
        ({"vary": [PITCH], "sweep": {"noise": 0.0}}, "leave no error"),
        ({"vary": [PITCH], "sweep": {"sampling": "random"}}, "choose sobol"),
        ({"vary": [PITCH], "sweep": {"least": "cost"}}, "no metric 'cost'; known are error_n"),
        ({"vary": [PITCH], "sweep": {"least": "touch_net_pct"}}, r"needs touch_n, .* write touch_n = 20.0"),
        ({"vary": [PITCH], "bounds": {"touch_place_mm": {"most": 1.0}}}, "touch_place_mm needs touch_n"),
        ({"vary": [PITCH], "sweep": {"touch_n": -1.0}}, "touch_n=-1 must be 0 or more"),
        ({"vary": [PITCH], "bounds": {"range_n": 5}}, "must be written"),
        ({"vary": [PITCH], "bounds": {"range_n": {"least": 2, "most": 1}}}, "above most"),
        ({"vary": [PITCH], "design": {"pad": {"size_mm": 99.0}}}, "pads may touch"),
    ],
)
def test_nonsense_is_refused_in_one_line(table, message):
    with pytest.raises(DesignError, match=message) as refused:
        sweep_from_dict(table, "mine.toml")
    assert str(refused.value).startswith("mine.toml: ")
    assert "\n" not in str(refused.value)
