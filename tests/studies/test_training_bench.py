"""The training race on a tiny network: every contender learns, and the tables say what was measured. Times are free."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import xarray as xr
from torch.func import functional_call, jacrev

from dataset.samples import COORDINATES, VARIABLES
from decoupler.model.settings import NetworkConfig
from decoupler.training.trainer import LIGHT
from geometry.storage.netcdf import write_netcdf
from studies.bench.training import peers
from studies.bench.training.contenders import CONTENDERS, KNOWN, LM, VARPRO
from studies.bench.training.dense import dense_jacobian, step_difference
from studies.bench.training.problem import Problem, Scaled
from studies.bench.training.race import Case, Run, race, warm_up
from studies.bench.training.race_chart import draw_race
from studies.bench.training.table import ratio_table, time_table
from studies.bench.training.trace import Ended, Trace
from tests.decoupler.synthetic_sensor import labelled, response, sensor

SENSOR = sensor(2, 2)
DATA = labelled(SENSOR, "x", n_samples=60, seed=0)


@pytest.fixture(params=["skip", "plain"])
def problem(request) -> Problem:
    network = NetworkConfig(hidden=3, net=request.param)
    return Problem(data=DATA, component="fx", network=network, response=response(SENSOR))


@pytest.mark.parametrize("one", CONTENDERS, ids=lambda one: one.name)
def test_every_contender_lowers_the_error(one, problem):
    if one.missing():
        pytest.skip(one.missing())
    warm_up(one, problem)
    trace = Trace(0.0, 1.0)  # enough for the slowest, on a busy machine too
    decoupler, reason = one.train(problem, trace)
    iterations, seconds, mse = np.array(trace.points).T
    assert iterations[0] == 0
    assert (np.diff(iterations) >= 0).all()
    assert (np.diff(seconds) >= 0).all()
    assert mse[-1] < 0.5 * Scaled(problem).mse()  # of the random start, which VarPro's first point has left behind
    assert reason
    # the network handed back is the one whose error was recorded last
    errors = (decoupler.forces(DATA.resistance_ohm) - DATA.force_n[..., :1]).reshape(len(DATA.force_n), -1)
    found = np.mean((errors / decoupler.output_scaling.half_range) ** 2)
    if one.name == KNOWN:  # what it recorded counts the light samples that it adds, too
        assert found <= (1.0 + LIGHT) * mse[-1] * (1.0 + 1e-6)
    else:
        assert found == pytest.approx(mse[-1], rel=1e-6)


def test_all_start_from_the_same_error(problem):
    starts = []
    for one in CONTENDERS:
        if (
            one.name not in (VARPRO, KNOWN) and not one.missing()
        ):  # VarPro solves for the output weights before it looks
            trace = Trace(0.0, 0.0)
            one.train(problem, trace)
            starts.append(trace.points[0][2])
    assert starts == pytest.approx([Scaled(problem).mse()] * len(starts), rel=1e-12)


def test_structured_step_is_the_dense_one(problem):
    assert step_difference(problem) < 1e-8  # rounding times the damped matrix's condition number


def test_dense_jacobian_is_that_of_automatic_differentiation(problem):
    scaled = Scaled(problem.first(5))
    weights = {name: weight.detach() for name, weight in scaled.model.named_parameters()}
    blocks = jacrev(lambda given: functional_call(scaled.model, given, scaled.x))(weights)
    exact = torch.cat([blocks[name].reshape(scaled.t.numel(), -1) for name in weights], dim=1)
    assert dense_jacobian(scaled.model, scaled.x.numpy()) == pytest.approx(exact.numpy(), abs=1e-13)


def test_trace_ends_a_training():
    trace = Trace(1e-3, 60.0)
    trace.record(0, 1.0)
    trace.record(2, 1e-2)
    with pytest.raises(Ended, match="goal"):
        trace.record(3, 1e-3)
    assert trace.seconds_to(0.1) == trace.points[1][1]
    assert trace.seconds_to(1e-4) is None
    with pytest.raises(Ended, match="time"):
        Trace(1e-3, 0.0).record(0, 1.0)


def test_what_is_not_installed_is_said(monkeypatch):
    monkeypatch.setattr(peers, "find_spec", lambda name: None if name == "torchmetrics" else name)
    assert peers.torch_lm_missing().startswith("torchmetrics not installed")
    monkeypatch.setattr(peers, "find_spec", lambda name: name)
    assert peers.torch_lm_missing() == ""


def test_a_race_in_processes_of_their_own(tmp_path):
    for split, data in (("train", DATA), ("test", labelled(SENSOR, "x", n_samples=20, seed=1))):
        variables = {name: (VARIABLES[name][0], getattr(data, name)) for name in ("force_n", "resistance_ohm")}
        write_netcdf(xr.Dataset(variables, coords=COORDINATES), tmp_path / f"{split}.nc")
    case = Case(
        name="tiny",
        train=str(tmp_path / "train.nc"),
        test=str(tmp_path / "test.nc"),
        component="fx",
        net="skip",
        hidden=3,
        patience_s=0.3,
    )
    lines: list[str] = []
    chosen = next(one for one in CONTENDERS if one.name == LM)
    (run,) = race(case, [replace(chosen, name="nobody", missing=lambda: "not there"), chosen], lines.append)
    assert lines[0] == "nobody: skipped, not there"
    assert run.failure == ""
    assert run.iterations > 0
    assert run.mse is not None
    assert run.mse < 1e-2
    assert run.rel_err is not None
    assert run.rel_err < 0.2
    assert run.peak_mib is not None
    assert run.peak_mib > 10
    (broken,) = race(replace(case, train=str(tmp_path / "none.nc")), [chosen])
    assert "none.nc" in broken.failure


def made_up(name: str, seconds: float, to_goal: float | None, reason: str = "goal") -> Run:
    return Run(
        contender=name,
        ours=name in (LM, VARPRO),
        reason=reason,
        iterations=4,
        seconds_per_iteration=seconds,
        seconds_to={"1e-3": to_goal, "1e-4": None, "1e-5": None},
        mse=1e-3,
        rel_err=None,
        peak_mib=300.0,
        training_mib=20.0,
        trace=[(0, 0.001, 1.0), (4, 8.0, 1e-3)],
    )


def test_tables_and_picture_hold_what_was_measured(tmp_path):
    runs = [
        made_up(VARPRO, 0.2, 0.5),
        made_up(LM, 0.1, 1.0),
        made_up("peer", 2.0, None, reason="time"),
        Run(contender="broken", ours=False, failure="out of memory"),
    ]
    table = time_table("case", runs, 1e-12)
    assert table.row_count == 4
    assert list(table.columns[3].cells) == ["0.50", "1.00", "–", ""]
    ratios = ratio_table("case", runs)
    assert list(ratios.columns[1].cells) == ["2× / 1×", "1× / 0.5×", "20× / 10×"]
    assert list(ratios.columns[2].cells) == ["0.5× / 1×", "1× / 2×", "> 8× / > 16×"]
    draw_race("case", runs, tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
