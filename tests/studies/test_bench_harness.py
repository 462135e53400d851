"""The harness of all benchmarks: runs in processes of their own, and tables that say what was measured."""

import json
from dataclasses import replace

from studies.bench.harness import Record, Settings, goal_rows, named, run_contenders
from studies.bench.solving import CONTENDERS, LOADED, WORST
from studies.tables import report

BLOCK = "block-normal-0.49"
MODULE = "studies.bench.solving"


def made_up(family: str, seconds: float, error: float, **more) -> Record:
    measured = {"seconds": seconds, "errors": {LOADED: error, WORST: error}, "size": 10, "peak_mib": 100.0}
    return Record(case="scene", contender=family, family=family, setting=1.0, **measured, **more)


def test_tables_and_json_hold_what_was_measured(tmp_path, capsys):
    found = [
        made_up("TriPillar", 2.0, 0.004),
        made_up("peer", 9.0, 0.0005),
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
    assert stored["tables"]["run time [s]"][0]["seconds"] == 2.0


def test_runs_in_processes_of_their_own_say_what_failed_or_took_too_long(capsys):
    chosen, settings = named(CONTENDERS, "half-space, closed form"), Settings(runs=1, threads=1)
    absent = replace(chosen, name="nobody", missing=lambda: "not there")
    (found,) = run_contenders(MODULE, BLOCK, BLOCK, [absent, chosen], settings)
    assert capsys.readouterr().err.splitlines()[0] == "nobody: skipped, not there"
    assert found.failure == ""
    assert 0.2 < found.errors[WORST] < 2.0  # a half-space is far softer than a 10 mm layer
    (broken,) = run_contenders(MODULE, "none", "none", CONTENDERS[:1], settings)
    assert "none" in broken.failure
    (hasty,) = run_contenders(MODULE, BLOCK, BLOCK, CONTENDERS[:1], replace(settings, patience_s=0.01))
    assert hasty.failure == "over 0.01 s"
