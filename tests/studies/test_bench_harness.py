"""The harness of all benchmarks: runs in processes of their own, and tables that say what was measured."""

import json
from dataclasses import replace

from studies.bench.harness import Record, Settings, draw_records, goal_rows, named, run_contenders
from studies.bench.solving import CONTENDERS, LOADED, WORST
from studies.tables import report

BLOCK = "block-normal-0.49"
MODULE = "studies.bench.solving"


def made_up(family: str, seconds: float, error: float, **more) -> Record:
    errors = {LOADED: error, WORST: error}
    return Record(
        case="scene", contender=family, family=family, setting=1.0, seconds=seconds, errors=errors, size=10,
        peak_mib=100.0, **more,
    )  # fmt: skip


def test_tables_picture_and_json_hold_what_was_measured(tmp_path, capsys):
    found = [
        made_up("TriPillar", 2.0, 0.004),
        made_up("peer", 9.0, 0.0005),
        made_up("peer", 30.0, 0.008),
        Record(case="scene", contender="peer", family="peer", setting=2.0, failure="over 20 s"),
        made_up("traced", 8.0, 0.001, trace=[(0.5, 1.0), (1.0, 0.01), (8.0, 0.001)], notes={"stopped by": "goal"}),
    ]
    assert goal_rows(found, WORST, (0.01, 0.0007)) == [
        {"family": "TriPillar", "to 0.01 [s]": 2.0, "to 0.0007 [s]": None},
        {"family": "peer", "to 0.01 [s]": 9.0, "to 0.0007 [s]": 9.0},
        {"family": "traced", "to 0.01 [s]": 1.0, "to 0.0007 [s]": None},
    ]
    report({"run time [s]": [one.cells for one in found]}, tmp_path / "a.json", {"threads": 2, "nan": float("nan")})
    assert "over 20 s" in capsys.readouterr().out
    stored = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert stored["about"] == {"threads": 2, "nan": None}
    rows = stored["tables"]["run time [s]"]
    assert (rows[0]["seconds"], rows[3]["failure"], rows[4]["stopped by"]) == (2.0, "over 20 s", "goal")
    draw_records("scene", found, LOADED, tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_a_run_in_a_process_of_its_own(capsys):
    chosen = named(CONTENDERS, "half-space, closed form")
    absent = replace(chosen, name="nobody", missing=lambda: "not there")
    found = run_contenders(MODULE, BLOCK, BLOCK, [absent, chosen], Settings(runs=1, threads=1))
    assert capsys.readouterr().err.splitlines()[0] == "nobody: skipped, not there"
    assert [one.failure for one in found] == [""]
    assert 0.2 < found[0].errors[WORST] < 2.0  # a half-space is far softer than a 10 mm layer
    assert found[0].peak_mib > 10


def test_what_fails_or_takes_too_long_says_so_and_is_not_refined():
    settings = Settings(runs=1, threads=1, by_processor=True)
    (broken,) = run_contenders(MODULE, "none", "none", CONTENDERS[:1], settings)
    assert "none" in broken.failure
    hasty = run_contenders(MODULE, BLOCK, BLOCK, CONTENDERS[:1], replace(settings, patience_s=0.01))
    assert [one.failure for one in hasty] == ["over 0.01 s"]
