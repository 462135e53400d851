"""The work of a sweep: whichever worker does it rows are the same, none is lost with one, no stage is made twice."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from distributed.scheduler import KilledWorker

from fem import ResponseSettings, solve_response
from geometry.design import Array, Material, Pad, SensorDesign
from geometry.errors import DesignError
from tripillar.sweep.judge import failed_row, metrics_of, row_of
from tripillar.sweep.rows import Row, read_row, to_xarray, write_parquet, write_row
from tripillar.sweep.run import judge_all, kept_rows, shared_stages
from tripillar.sweep.sampling import Sample, row_key, samples_of
from tripillar.sweep.sweep_file import sweep_from_dict
from tripillar.sweep.workers import KILLS, TRIES, ClusterWorkers, open_workers

ROOT = Path(__file__).parents[3]
SMALL = {"array": {"rows": 1, "cols": 2}}
SWEEP = sweep_from_dict(
    {
        "design": SMALL,
        "sweep": {"sampling": "grid", "tolerance": 2e-2},
        "vary": [
            {"key": "pad.size_mm", "values": [9.0, 12.0, 16.0]},  # the last is larger than the pitch
            {"key": "resistivity_ohm_mm", "values": [3000.0, 4000.0]},
        ],
    }
)


def sample(design):
    return Sample(cache_key=row_key(design, SWEEP.judging), values={}, design=design)


def known(row):
    """A row's texts, and its metrics without what they cost."""
    costs = ("seconds", "peak")
    metrics = {name: value for name, value in row.metrics.items() if value is not None and not name.startswith(costs)}
    return (row.cache_key, row.values, row.design, row.reason), metrics


def test_a_row_survives_its_file_and_a_torn_one_is_made_again(tmp_path):
    row = Row(
        cache_key="ab", values={"pad.size_mm": 9.0}, design="x", metrics={"error_n": 1.5}, sensitivity_per_n=[[[1.0]]]
    )
    write_row(row, tmp_path)
    assert read_row(tmp_path, "ab") == row
    whole = (tmp_path / "ab.json").read_text()
    for torn in ("", whole[:-20], "[]", '{"recipe": "ab"}', whole.replace('"ab"', '"cd"')):
        (tmp_path / "ab.json").write_text(torn)
        assert read_row(tmp_path, "ab") is None
    assert read_row(tmp_path, "ef") is None


def test_tables_hold_every_metric_and_the_failed_ones(tmp_path):
    import pyarrow.parquet as pq

    good = Row(
        cache_key="a", values={"array.cols": 2.0}, design="x", metrics={"error_n": 1.5}, sensitivity_per_n=[[[1.0] * 3]]
    )
    bad = Row(cache_key="b", values={"array.cols": 3.0}, design=None, reason="DesignError: no")
    write_parquet([good, bad], tmp_path / "rows.parquet")
    table = pq.read_table(tmp_path / "rows.parquet")
    assert table["error_n"].to_pylist() == [1.5, None]
    assert table["reason"].to_pylist() == ["", "DesignError: no"]
    assert table.schema.field("error_n").metadata[b"units"] == b"N"
    data = to_xarray([good, bad])
    assert data["sensitivity_per_n"].shape == (2, 1, 1, 3)
    assert data["error_n"].isnull().to_numpy().tolist() == [False, True]
    assert data["array_cols"].attrs["key"] == "array.cols"


def test_a_design_fails_as_a_row(monkeypatch):
    def broken(*_):
        raise DesignError("the mesher gave up")

    monkeypatch.setattr("tripillar.sweep.judge.array_response", broken)
    row = row_of(sample(SensorDesign()), SWEEP.judging)
    assert row.reason == "DesignError: the mesher gave up"
    assert row.metrics["seconds"] >= 0
    assert row.design is not None


def test_designs_know_the_stages_they_share():
    """The pad is not in the mesh of a two-rubber cell, rows and columns are not in a cell, resistivity in neither."""
    soft = SensorDesign(matrix_material=Material(young_mpa=2.0), array=Array(rows=4, cols=4))

    def stages(**changes):
        return shared_stages(sample(SensorDesign(**{**vars(soft), **changes})), SWEEP.judging)

    kinds = {name.split()[0] for name in stages()}
    assert kinds == {"mesh", "cell", "response"}

    def shared(**changes):
        return {name.split()[0] for name in stages() & stages(**changes)}

    assert shared(resistivity_ohm_mm=1.0) == kinds
    assert shared(array=Array(rows=4, cols=7)) == {"mesh", "cell"}
    assert shared(pad=Pad(size_mm=10.0)) == {"mesh"}
    assert shared(matrix_material=Material(young_mpa=3.0)) == {"mesh"}
    assert shared(array=Array(rows=4, cols=4, pitch_mm=16.0)) == set()


def test_arrays_of_another_size_take_the_cell_from_the_cache(monkeypatch):
    first = row_of(sample(SensorDesign(array=Array(rows=3, cols=3))), SWEEP.judging)
    assert first.metrics["seconds_condense"] > 0
    monkeypatch.setattr("fem.array.substructured.cells_of_stage", None)  # nobody condenses again
    larger = row_of(sample(SensorDesign(array=Array(rows=3, cols=5))), SWEEP.judging)
    assert larger.metrics["seconds_condense"] == 0
    assert larger.metrics["error_estimate"] == first.metrics["error_estimate"]
    monkeypatch.undo()
    fresh = solve_response(SensorDesign(array=Array(rows=3, cols=5)), ResponseSettings(tolerance=2e-2))
    anew = metrics_of(fresh, SWEEP.judging.noise, SWEEP.judging.bits, SWEEP.judging.cap)
    assert {name: larger.metrics[name] for name in anew} == pytest.approx(anew, rel=1e-9)


class Shuffled:
    """Eight workers that end their designs in any order, and watch that no two of them make the same stage."""

    count = 8

    def __init__(self, stages):
        self.stages, self.made, self.given, self.order = stages, set(), [], np.random.default_rng(1)
        self.in_work = {}

    def give(self, sample, judging):
        own = self.stages(sample, judging) - self.made
        assert own.isdisjoint(set().union(*self.in_work.values()))
        self.given.append(sample.cache_key)
        self.in_work[sample.cache_key] = own

    def row(self, wait_s):
        cache_key = list(self.in_work)[self.order.integers(len(self.in_work))]
        self.made |= self.in_work.pop(cache_key)
        return Row(cache_key=cache_key, values={}, design="x")

    def state(self):
        return ""


def test_thousands_of_designs_are_each_looked_at_once_and_no_stage_is_made_twice(tmp_path, monkeypatch):
    """Stages in threes, shared by up to 50 designs; all work of the sweep itself grows as their number."""
    looked_at = []

    def stages(one, judging):
        number = int(one.cache_key)
        return {f"mesh {number // 50}", f"cell {number // 10}", f"response {number % 700}"}

    def counted(one, judging):
        looked_at.append(one.cache_key)
        return stages(one, judging)

    monkeypatch.setattr("tripillar.sweep.run.shared_stages", counted)
    monkeypatch.setattr("tripillar.sweep.run.write_row", lambda row, folder: None)
    samples = [Sample(cache_key=str(number), values={}, design=None) for number in range(3000)]
    workers = Shuffled(stages)
    rows = judge_all(samples, SWEEP.judging, workers, tmp_path)
    assert sorted(workers.given, key=int) == sorted(looked_at, key=int) == [sample.cache_key for sample in samples]
    assert set(rows) == set(looked_at)


def test_two_workers_of_a_scheduler_and_one_is_killed(tmp_path, monkeypatch):
    """A real scheduler, real workers on loopback: the killed one's designs go to the other, and all rows are right.

    Dask gives a design up with the first worker that it loses.
    """
    monkeypatch.setattr("tripillar.sweep.workers.CONNECT_S", 60)
    samples = samples_of(SWEEP)
    file = tmp_path / "scheduler.json"
    environment = os.environ | {
        "PYTHONPATH": str(ROOT),
        "OMP_NUM_THREADS": "1",
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
        "TRIPILLAR_CACHE": str(tmp_path / "there"),
    }
    dask = [sys.executable, "-W", "ignore", "-m", "dask"]
    options = ["--scheduler-file", str(file), "--no-dashboard"]
    worker = [*dask, "worker", *options, "--nthreads", "1", "--no-nanny", "--local-directory", str(tmp_path)]
    with open(tmp_path / "log", "w") as log:
        processes = [
            subprocess.Popen(command, env=environment, stdout=log, stderr=log, cwd=tmp_path)
            for command in ([*dask, "scheduler", *options, "--host", "127.0.0.1", "--port", "0"], worker, worker)
        ]
        try:
            address = _address(file)
            with open_workers(None, address, tmp_path / "unused.log") as judges:
                until = time.monotonic() + 60
                while judges.count < 2 and time.monotonic() < until:
                    time.sleep(0.1)
                done = []

                def progress(row):
                    done.append(row)
                    if len(done) == 2:
                        processes[1].send_signal(signal.SIGKILL)

                rows = judge_all(samples, SWEEP.judging, judges, tmp_path / "rows", progress)
        finally:
            for process in processes:
                process.kill()
                process.wait()
    assert len(done) == len(samples) == len(rows) == 6
    assert kept_rows(samples, tmp_path / "rows") == rows
    failed = [row for row in rows.values() if row.failed]
    assert [row.reason.split(":")[0] for row in failed] == ["not a design"] * 2
    solved = [row for row in rows.values() if "seconds_condense" in row.metrics]
    assert len(solved) <= 2  # one a pad: the other resistivity waits for the response, whichever worker makes it
    for one in samples:  # by this process, from a cache of its own
        (texts, metrics), (expected, anew) = known(rows[one.cache_key]), known(row_of(one, SWEEP.judging))
        assert texts == expected
        assert metrics == pytest.approx(anew, rel=1e-6)  # sums in another order, through condition numbers of up to 1e4


class LostFuture:
    """A design whose workers all died."""

    def __init__(self):
        self.cancelled = lambda: False
        self.exception = lambda: KilledWorker("row_of-1", SimpleNamespace(address="tcp://127.0.0.1:1"), 3)

    def add_done_callback(self, put):
        put(self)


def test_a_design_that_ends_every_worker_of_a_scheduler_fails_in_the_end():
    """Dask gives it up after four workers each time."""
    submitted = []
    client = SimpleNamespace(submit=lambda *_, pure: submitted.append(LostFuture()) or submitted[-1])
    workers = ClusterWorkers(client, row_of, failed_row)
    workers.give(samples_of(SWEEP)[0], SWEEP.judging)
    row = workers.row(1.0)
    assert len(submitted) * TRIES == KILLS
    assert row.reason.startswith("KilledWorker: ")


def test_a_scheduler_that_is_not_there_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("tripillar.sweep.workers.CONNECT_S", 1)
    with pytest.raises(DesignError, match=r"no scheduler at tcp://127\.0\.0\.1:9"):
        open_workers(None, "tcp://127.0.0.1:9", tmp_path / "log").__enter__()


def _address(file):
    import json

    for _ in range(600):
        if file.exists() and file.read_text():
            return json.loads(file.read_text())["address"]
        time.sleep(0.1)
    raise AssertionError("the scheduler did not start")
