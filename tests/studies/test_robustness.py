"""The robustness study on a small array: its limits, its twins, what it writes, and its table of truths."""

import json
from dataclasses import asdict, replace

import pytest

from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, SensorDesign
from studies.robustness import identified, study
from studies.robustness.__main__ import write
from studies.robustness.noise_charts import draw_pairs
from studies.robustness.truths import TRUTHS, Truth
from tests.studies.one_process import one_after_another
from tripillar.pipeline.manufactured import as_made

SIZES = study.Sizes(train=300, test=100)


@pytest.fixture(scope="module")
def sensor():
    """2 × 2 units, their response in closed form."""
    design = replace(SensorDesign(), array=Array(rows=2, cols=2))
    return study.sensor_under_load(solve_response(design, ResponseSettings(method="layer")), SIZES)


@pytest.fixture(scope="module")
def found(sensor):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("studies.robustness.study.in_parallel", one_after_another)
        return study.study_sensors(sensor)


def test_nets_are_near_the_limit(found):
    """300 samples leave 12 inputs of a linear layer 2 % above it, and 100 test samples know an error to 4 %."""
    ratios = [row.ratio for row in found if (row.part, row.net) == ("noise", "inverse")]
    assert min(ratios) > 0.8
    assert max(ratios) < 1.15


def test_table_json_and_pictures_are_written(found, tmp_path):
    write(found, tmp_path)
    stored = json.loads((tmp_path / "robustness.json").read_text(encoding="utf-8"))
    assert len(stored["rows"]) == len(found)
    assert stored["rows"][0]["ratio"] == pytest.approx(found[0].ratio)
    assert [path.name for path in tmp_path.glob("*.png")] == ["robustness-readings.png"]
    rows = [identified.PairRow("all", "contact", "3 × 3", n, *[(1.0, 1.0, 1.0)] * 4, 1.0) for n in (0, 10)]
    draw_pairs([asdict(one) for one in rows], tmp_path / "pairs.png")
    assert (tmp_path / "pairs.png").stat().st_size > 1000


def test_ten_pairs_mend_what_manufacturing_spoils(monkeypatch):
    """A softer, higher 2 × 2 array under shifted pads."""
    small = replace(SensorDesign(), array=Array(rows=2, cols=2))
    spread = Truth(said="", intended=small, made=as_made(small))
    monkeypatch.setitem(TRUTHS, "spread", spread)
    monkeypatch.setattr(identified, "COUNTS", (10,))
    monkeypatch.setattr(identified, "TRAINED", 300)
    untuned, ten = identified.rows_of("spread", "three-axis")
    assert untuned.pairs == 0
    for before, after, limit in zip(untuned.error_pct, ten.error_pct, ten.limit_pct, strict=True):
        assert before > 10 * after
        assert after < 2 * limit
    assert min(ten.within_95) > 0.9
