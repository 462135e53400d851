"""The harness of all benchmarks: runs in processes of their own, and tables that say what was measured."""

import json
from dataclasses import replace
from functools import partial

import pytest

from decoupler import NetworkConfig
from studies.bench import inference
from studies.bench.harness import (
    Record,
    Settings,
    draw_records,
    fastest_by_family,
    named,
    ratio_table,
    record_table,
    run_contenders,
    write_records,
)  # fmt: skip
from studies.bench.solving import CONTENDERS, LOADED, WORST
from tests.decoupler.synthetic_sensor import response, sensor

BLOCK = "block-normal-0.49"
MODULE = "studies.bench.solving"


def made_up(family: str, seconds: float, error: float, **more) -> Record:
    steps, errors = {"solve": seconds}, {LOADED: error, WORST: error}
    return Record(
        case="scene", contender=family, family=family, setting=1.0, seconds=seconds, steps=steps, errors=errors,
        size=10, peak_mib=100.0, **more,
    )  # fmt: skip


def test_tables_picture_and_json_hold_what_was_measured(tmp_path):
    found = [
        made_up("TriPillar", 2.0, 0.004),
        made_up("peer", 9.0, 0.0005),
        made_up("peer", 30.0, 0.008),
        Record(case="scene", contender="peer", family="peer", setting=2.0, failure="over 20 s"),
        made_up("traced", 8.0, 0.001, trace=[(0.5, 1.0), (1.0, 0.01), (8.0, 0.001)], notes={"stopped by": "goal"}),
    ]
    columns = {
        f"{goal:.1%}": partial(Record.seconds_to, judged=WORST, error=goal) for goal in (0.01, 0.004, 7e-4, 1e-4)
    }
    assert fastest_by_family(found, columns["1.0%"]) == {"TriPillar": 2.0, "peer": 9.0, "traced": 1.0}
    ratios = ratio_table("scene", found, columns, "TriPillar", "peer")
    assert [list(column.cells) for column in ratios.columns] == [
        ["TriPillar", "peer", "traced"],
        ["2 s, 1× / 0.22×", "9 s, 4.5× / 1×", "1 s, 0.5× / 0.11×"],
        ["2 s, 1× / 0.22×", "9 s, 4.5× / 1×", "8 s, 4× / 0.89×"],
        ["–", "9 s, – / 1×", "> 8 s, – / > 0.89×"],
        ["–", "–", "> 8 s, – / –"],
    ]
    (alone,) = (list(column.cells) for column in ratio_table("scene", found, columns, "TriPillar").columns[1:2])
    assert alone == ["2 s", "9 s, 4.5×", "1 s, 0.5×"]
    table = record_table("scene", found)
    assert table.row_count == 5
    assert [column.header for column in table.columns][2:4] == [LOADED, WORST]
    assert list(table.columns[-1].cells)[-1] == "goal"
    write_records(found, {"threads": 2}, tmp_path / "a.json")
    rows = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))["measurements"]
    assert (rows[0]["seconds"], rows[3]["seconds"], rows[3]["failure"]) == (2.0, None, "over 20 s")
    draw_records("scene", found, (LOADED, WORST), tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_a_run_in_a_process_of_its_own(capsys):
    chosen = named(CONTENDERS, "half-space, closed form")
    absent = replace(chosen, name="nobody", missing=lambda: "not there")
    found = run_contenders(MODULE, BLOCK, BLOCK, [absent, chosen], Settings(runs=1, threads=1))
    assert capsys.readouterr().err.splitlines()[0] == "nobody: skipped, not there"
    assert [one.failure for one in found] == [""]
    assert 0.2 < found[0].errors[WORST] < 2.0  # a half-space is far softer than a 10 mm layer
    assert found[0].peak_mib > 10


def test_what_is_accurate_enough_is_not_refined_further_and_what_fails_or_takes_too_long_says_so():
    settings = Settings(runs=1, threads=1, enough=0.5, by_processor=True)
    (found,) = run_contenders(MODULE, BLOCK, BLOCK, CONTENDERS[:1], settings)
    assert found.setting == CONTENDERS[0].settings[0]
    assert found.errors[WORST] < settings.enough
    assert found.seconds > 0
    (broken,) = run_contenders(MODULE, "none", "none", CONTENDERS[:1], settings)
    assert "none" in broken.failure
    hasty = run_contenders(MODULE, BLOCK, BLOCK, CONTENDERS[:1], replace(settings, patience_s=0.01))
    assert [one.failure for one in hasty] == ["over 0.01 s"]  # nor is anything finer tried
    with pytest.raises(KeyError, match="no contender 'x'; there are TriPillar"):
        named(CONTENDERS, "x")


def test_nets_are_measured_by_errors_and_times(monkeypatch):
    """On a small array; no time is asserted."""
    monkeypatch.setattr(inference, "WARM_UP_S", 0.0)
    monkeypatch.setattr(inference, "REPEATS", {1: 2, inference.MANY: 1})
    samples = {"train": (60, 1), "test": (20, 2)}
    network = NetworkConfig(hidden=2, feature="inverse")
    found = inference.trained_and_timed(response(sensor(2, 2)), "three-axis", "all", network, samples)
    assert set(found.errors) == {f"{name} [% of full scale]" for name in ("fx", "fy", "fz")}
    assert all(error < 1.0 for error in found.errors.values())  # it starts from the response of these very data
    assert min(*found.steps.values(), *found.notes.values()) > 0
