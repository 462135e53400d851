"""The study of hard scenes tells right from refused from wrong, and its closed forms are met."""

import json

import numpy as np
import pytest
import typer

from fem.linear.factors import SolverError
from studies.edge_cases import __main__ as command
from studies.edge_cases.__main__ import all_trials
from studies.edge_cases.scenes import flat_cells, flattened, signed_volumes
from studies.edge_cases.training import other_response, training_trials
from studies.edge_cases.trials import Outcome, Trial, tried


def outcome(error: float) -> Outcome:
    return Outcome(residual=0.0, error=error, allowed=1e-3, against="a twin")


def verdict(run) -> str:
    return tried(Trial(name="trial", value="1", run=run)).verdict


def test_errors_beyond_what_is_allowed_are_wrong():
    assert verdict(lambda: outcome(1e-3)) == "right"
    assert verdict(lambda: outcome(1.01e-3)) == "WRONG"
    assert verdict(lambda: outcome(np.nan)) == "WRONG"


def test_a_refusal_is_not_wrong_but_a_crash_is():
    def refuse() -> Outcome:
        raise SolverError("the moduli differ too widely")

    assert verdict(refuse) == "refused: the moduli differ too widely"
    assert verdict(lambda: outcome(1 / 0)) == "WRONG: ZeroDivisionError: division by zero"


@pytest.mark.parametrize("form", ["TH", "P2"])
def test_nearly_flat_cells_still_hold_a_linear_field(form):
    found = flat_cells(0.1, form, 0.3)
    assert found.error <= found.allowed
    assert found.residual <= 1e-9


def test_nodes_are_pushed_until_cells_are_nearly_flat_but_not_inside_out():
    mesh, smallest_deg = flattened(0.5)
    assert 0.5 <= smallest_deg < 0.51
    flat, before = signed_volumes(mesh.p, mesh.t), signed_volumes(flattened(30.0)[0].p, mesh.t)
    assert (flat * before > 0).all()
    assert np.abs(flat).sum() == pytest.approx(1.0)  # the unit cube is still filled


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("poisson", "ν = 0, whole top"),
        ("slender", "0.1 × 0.1 × 10 pressed"),
        ("slender", "1 × 1 × 100 dragged"),
        ("zero load", "skipped"),
        ("zero load", "computed"),
    ],
)
def test_cheap_trials_are_right(name, value):
    chosen = [trial for trial in all_trials() if (trial.name, trial.value) == (name, value)]
    assert [tried(trial).verdict for trial in chosen] == ["right"]


def test_trials_are_told_apart_by_name_and_value():
    labels = [(trial.name, trial.value) for trial in all_trials()]
    assert len(set(labels)) == len(labels)


@pytest.mark.parametrize(("error", "status"), [(1e-4, 0), (1e-2, 1)])
def test_a_wrong_answer_is_the_exit_status(tmp_path, monkeypatch, capsys, error, status):
    monkeypatch.setattr(command, "all_trials", lambda: [Trial(name="one", value="1", run=lambda: outcome(error))])
    app = typer.Typer()
    app.command()(command.judge_all)
    with pytest.raises(SystemExit) as ended:
        app(["--out", str(tmp_path), "--only", "one"])
    assert ended.value.code == status
    stored = json.loads((tmp_path / "edge-cases.json").read_text(encoding="utf-8"))
    assert [entry["verdict"] for entry in stored] == ["WRONG" if status else "right"]
    assert "a twin" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("constant input", "varpro skip"),
        ("duplicated input", "lm plain"),
        ("float32", "lm skip"),
        ("saturated start", "varpro plain"),
        ("slope at the end", "varpro skip"),
        ("10 samples", "varpro skip, stated"),
        ("dead column wire", "joint, from the response"),
        ("one pair", "gains ± 20 %"),
    ],
)
def test_cheap_trainings_are_right(name, value):
    chosen = [trial for trial in training_trials() if (trial.name, trial.value) == (f"training, {name}", value)]
    assert [tried(trial).verdict for trial in chosen] == ["right"]


@pytest.mark.parametrize("value", ["nan Ω", "inf Ω", "0 Ω", "-1 Ω"])
def test_what_is_no_resistance_is_refused(value):
    chosen = [trial for trial in training_trials() if (trial.name, trial.value) == ("training, no resistance", value)]
    assert [tried(trial).verdict.split(":")[0] for trial in chosen] == ["refused"]


def test_a_response_of_another_sensor_is_refused_before_it_does_harm():
    assert tried(Trial(name="one", value="8 mm", run=lambda: other_response(8.0))).verdict.startswith("refused")
