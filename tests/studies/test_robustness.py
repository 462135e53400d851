"""The robustness study on a small array: its limits, its twins, what it writes, and its table of truths."""

import json
from dataclasses import replace

import numpy as np
import pytest

from dataset import Imperfections
from decoupler.data.columns import component_named, force_columns
from decoupler.inverse.limits import bayes, cramer_rao
from decoupler.inverse.sensor_model import SensorModel
from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, SensorDesign
from geometry.layout import PILLARS
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


def chosen(found, **labels) -> list[study.ErrorRow]:
    return [row for row in found if all(getattr(row, name) == value for name, value in labels.items())]


def test_every_case_has_a_row_for_every_net_and_force(found):
    cases = len(study.NOISES) + len(study.BITS) + 2 * len(study.dead_cases(2, 2))
    assert len(found) == cases * len(study.NETS) * 3
    assert len({(row.part, row.case, row.net, row.force) for row in found}) == len(found)


def test_nets_are_near_the_limit(found):
    """300 samples leave 12 inputs of a linear layer 2 % above it, and 100 test samples know an error to 4 %."""
    ratios = [row.ratio for row in chosen(found, part="noise", net="inverse")]
    assert min(ratios) > 0.8
    assert max(ratios) < 1.15


def test_a_dead_pillar_hurts_its_own_force_most_and_its_own_unit(found):
    for pillar, force in {"z": "fz", "x": "fx", "y": "fy"}.items():
        rows = chosen(found, part=f"dead {pillar} pillar", net="inverse")
        own, others = ({row.force: row.error_pct for row in rows if row.case.startswith(c)} for c in ("its", "others"))
        assert own[force] > 3 * others[force]
    for fault, pillars in {"dead row wire": "zx", "dead column wire": "zy"}.items():
        lost = np.argwhere(study.dead_cases(6, 6)[fault].dead_mask(6, 6))  # those that hang on the wire
        assert {PILLARS[pillar] for _, _, pillar in lost} == set(pillars)
        assert set(lost[:, 0 if "row" in fault else 1]) == {3}
        assert len(lost) == 12


def test_limits_of_units_add_up_to_those_of_the_array(sensor):
    data = sensor.measured(Imperfections(noise=0.01), "test")
    parts = component_named("all")
    usual_n = sensor.loads["train"].force_n
    by_unit = study.unit_bayes(sensor.response, data, usual_n)
    forward, forces = SensorModel.of(sensor.response, parts), force_columns(data.force_n, parts)
    whole = bayes(forward, forces, 0.01, None, None, force_columns(usual_n, parts))
    np.testing.assert_allclose((by_unit**2).mean(), (whole**2).mean(), rtol=1e-12)  # the same sums in another order
    assert (by_unit**2).mean() < (cramer_rao(forward, forces, 0.01, None) ** 2).mean()


def test_few_usual_loads_lower_the_limit_as_said(sensor):
    """m samples of p forces that no reading tells apart: their spread about each other falls by √(1 − p/m)."""
    parts, m = component_named("all"), 40
    forward = SensorModel.of(sensor.response, parts)
    many = force_columns(sensor.loads["train"].force_n, parts)
    readable = np.ones(forward.n_pillars, dtype=bool)
    readable[2] = False
    limits = [bayes(forward, many[:1], 1e-6, None, readable, usual).max() for usual in (many, many[:m])]
    expected = np.sqrt((1 - many.shape[1] / m) / (1 - many.shape[1] / len(many)))
    assert limits[1] / limits[0] == pytest.approx(expected, rel=0.3)  # three deviations of √(1/(2·28))


def test_table_json_and_pictures_are_written(found, tmp_path):
    write(found, tmp_path)
    stored = json.loads((tmp_path / "robustness.json").read_text(encoding="utf-8"))
    assert len(stored["rows"]) == len(found)
    assert stored["rows"][0]["ratio"] == pytest.approx(found[0].ratio)
    pictures = sorted(path.name for path in tmp_path.glob("*.png"))
    assert pictures == [f"robustness-{name}.png" for name in ("readings",)]
    row = study.ErrorRow(part="noise", case="noise 1%", net="inverse", force="fx", error_pct=1.2, limit_pct=1.0)
    assert row.cells["above 1.15"] == "yes"  # the bar of the net that is to meet it
    assert replace(row, net="root").cells["above 1.15"] == ""


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


def test_a_part_of_the_table_of_truths_replaces_its_own_rows_alone(tmp_path):
    rows = [row(truth, pairs) for truth in ("all", "spread") for pairs in (0, 10)]
    old = identified.merged([], rows)
    assert [(one["truth"], one["pairs"]) for one in old] == [("spread", 0), ("spread", 10), ("all", 0), ("all", 10)]
    new = identified.merged(old, [row("all", 0, error=9.0)])
    assert [one["error_pct"][0] for one in new] == [1.0, 1.0, 9.0]
    draw_pairs(new, tmp_path / "pairs.png")
    assert (tmp_path / "pairs.png").stat().st_size > 1000


def row(truth: str, pairs: int, error: float = 1.0) -> identified.PairRow:
    return identified.PairRow(
        truth=truth, protocol="contact", size="3 × 3", pairs=pairs, error_pct=(error, 1.0, 1.0),
        limit_pct=(1.0, 1.0, 1.0), within_68=(0.7, 0.7, 0.7), within_95=(0.9, 0.9, 0.9), seconds=1.0,
    )  # fmt: skip
