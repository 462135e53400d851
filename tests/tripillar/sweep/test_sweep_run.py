"""The work of a sweep: whichever worker does it rows are the same, none is lost with one, no stage is made twice."""

from dataclasses import replace

import numpy as np
import pytest

from dataset.measurement import ReadingError
from decoupler.touch.limits import touch_limits
from fem import ResponseSettings, solve_response
from geometry.design import Array, Material, Pad, SensorDesign
from geometry.errors import DesignError
from geometry.pool import WorkerLost, open_pool
from geometry.storage.journal import Journal
from tripillar.sweep import run
from tripillar.sweep.judge import metrics_of, row_of
from tripillar.sweep.rows import Row, write_parquet
from tripillar.sweep.run import judge_all, kept_rows, shared_stages
from tripillar.sweep.sampling import Sample, row_key, samples_of
from tripillar.sweep.sweep_file import sweep_from_dict

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


def test_touches_are_judged_where_a_force_is_given(monkeypatch):
    monkeypatch.setattr("decoupler.touch.limits.TOUCHES", 4)
    design = SensorDesign(array=Array(rows=1, cols=2))
    judging = replace(SWEEP.judging, touch_n=20.0)
    row = row_of(sample(design), judging)
    errors = ReadingError(noise=judging.noise, bits=judging.bits)
    assert (row.metric("touch_net_pct"), row.metric("touch_place_mm")) == touch_limits(design, 20.0, errors)
    assert "touch_net_pct" not in row_of(sample(design), SWEEP.judging).metrics


def test_a_row_survives_its_file_and_a_torn_one_is_made_again(tmp_path):
    journal = Journal(tmp_path)
    row = Row(
        cache_key="ab", values={"pad.size_mm": 9.0}, design="x", metrics={"error_n": 1.5}, sensitivity_per_n=[[[1.0]]]
    )
    journal.keep("ab", vars(row))
    one = Sample(cache_key="ab", values={}, design=None)
    assert kept_rows([one], journal) == {"ab": row}
    whole = (tmp_path / "ab.json").read_text()
    for torn in ("", whole[:-20], "[]", '{"recipe": "ab"}', whole.replace('"ab"', '"cd"')):
        (tmp_path / "ab.json").write_text(torn)
        assert kept_rows([one], journal) == {}


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
    assert table["sensitivity_per_n"].to_pylist() == [[[[1.0] * 3]], None]


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

    def __init__(self, stages):
        self.stages, self.made, self.given, self.order = stages, set(), [], np.random.default_rng(1)

    def done(self, make, tasks, judging):
        in_work = {}
        while True:
            while len(in_work) < 8 and (sample := next(tasks, None)) is not None:
                own = self.stages(sample, judging) - self.made
                assert own.isdisjoint(set().union(*(stages for _, stages in in_work.values())))
                self.given.append(sample.cache_key)
                in_work[sample.cache_key] = sample, own
            if not in_work:
                return
            sample, own = in_work.pop(list(in_work)[self.order.integers(len(in_work))])
            self.made |= own
            yield sample, Row(cache_key=sample.cache_key, values={}, design="x")


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
    monkeypatch.setattr(Journal, "keep", lambda *_: None)
    samples = [Sample(cache_key=str(number), values={}, design=None) for number in range(3000)]
    workers = Shuffled(stages)
    rows = judge_all(samples, SWEEP.judging, workers, Journal(tmp_path))
    assert sorted(workers.given, key=int) == sorted(looked_at, key=int) == [sample.cache_key for sample in samples]
    assert set(rows) == set(looked_at)


def test_a_design_that_ends_its_worker_or_fails_unforeseen_is_a_row(tmp_path, monkeypatch):
    def lost(sample, judging):
        raise WorkerLost("its worker ended by SIGSEGV, the last of 4")

    monkeypatch.setattr(run, "row_of", lost)
    samples = samples_of(SWEEP)[:2]
    with open_pool(tasks=1) as pool:
        rows = judge_all(samples, SWEEP.judging, pool, Journal(tmp_path))
    assert {row.reason for row in rows.values()} == {"WorkerLost: its worker ended by SIGSEGV, the last of 4"}
    assert kept_rows(samples, Journal(tmp_path)) == rows
    assert kept_rows(samples, Journal(tmp_path), retry=True) == {}


def test_a_process_judges_as_this_one_does_and_no_stage_is_made_twice(tmp_path):
    samples = samples_of(SWEEP)
    with open_pool(2, log=tmp_path / "log") as pool:
        rows = judge_all(samples, SWEEP.judging, pool, Journal(tmp_path / "rows"))
    assert kept_rows(samples, Journal(tmp_path / "rows")) == rows
    failed = [row.reason.split(":")[0] for row in rows.values() if row.failed]
    assert failed == ["not a design"] * 2
    solved = [row for row in rows.values() if "seconds_condense" in row.metrics]
    assert len(solved) <= 2  # one a pad: the other resistivity waits for the response
    for one in samples:
        (texts, metrics), (expected, anew) = known(rows[one.cache_key]), known(row_of(one, SWEEP.judging))
        assert texts == expected
        assert metrics == pytest.approx(anew, rel=1e-6)  # sums in another order, through condition numbers of up to 1e4
