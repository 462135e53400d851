"""The study of edge cases tells right from refused from wrong, and its cheap trials come out right."""

import json
import sys
from unittest.mock import Mock

import numpy as np
import pytest

from fem.kernel.factor import SolverError
from studies.edge_cases import __main__ as command
from studies.edge_cases.scenes import scene_trials
from studies.edge_cases.trials import Judged, Trial, tried
from studies.program import run_alone

CHEAP = ("ν = 0, whole top", "0.1 × 0.1 × 10 pressed", "1 × 1 × 100 dragged", "skipped", "computed", "0.1°, ν = 0.4999")


def judged(error: float) -> Judged:
    return Judged(residual=0.0, error=error, allowed=1e-3, against="a twin")


def test_errors_beyond_what_is_allowed_are_wrong_and_refusals_are_not():
    refuse = Mock(side_effect=SolverError("the moduli differ too widely"))
    for verdict, run in (
        ("right", lambda: judged(1e-3)),
        ("WRONG", lambda: judged(np.nan)),
        ("WRONG: ZeroDivisionError: division by zero", lambda: judged(1 / 0)),
        ("refused: the moduli differ too widely", refuse),
    ):
        assert tried(Trial(name="trial", value="1", run=run)).verdict == verdict


def test_cheap_trials_come_out_as_they_should():
    """With the linear field on nearly flat cells, which quadratic elements hold exactly."""
    trials = [trial for trial in scene_trials() if trial.value in CHEAP]
    assert len(trials) == len(CHEAP)
    for trial in trials:
        assert tried(trial).verdict.split(":")[0] == "right", (trial.name, trial.value)


@pytest.mark.parametrize(("error", "status"), [(1e-4, 0), (1e-2, 1)])
def test_a_wrong_answer_is_the_exit_status(tmp_path, monkeypatch, capsys, error, status):
    monkeypatch.setattr(command, "scene_trials", lambda: [Trial(name="one", value="1", run=lambda: judged(error))])
    monkeypatch.setattr(sys, "argv", ["studies.edge_cases", "--out", str(tmp_path), "--only", "one"])
    monkeypatch.setattr("tripillar.terminal.interrupts.install", lambda: None)  # which is for a program of its own
    with pytest.raises(SystemExit) as ended:
        run_alone(command.judge_all)
    assert ended.value.code == status
    (stored,) = json.loads((tmp_path / "edge-cases.json").read_text(encoding="utf-8"))["tables"].values()
    assert [entry["verdict"] for entry in stored] == ["WRONG" if status else "right"]
    assert "a twin" in capsys.readouterr().out
