"""Sweeps and searches: rows are the same whoever makes them, none is lost, and what is missing alone is made."""

import signal
import subprocess
import time
from dataclasses import replace

import numpy as np
import psutil
import pytest

from dataset.measurement import ReadingError
from decoupler.touch.limits import touch_limits
from geometry.design import Array, Material, Pad, SensorDesign
from geometry.design_file import read_design
from geometry.errors import DesignError
from geometry.pool import WorkerLost, open_pool
from geometry.storage.journal import Journal
from tests.house import House
from tripillar.sweep import run
from tripillar.sweep.judge import row_of
from tripillar.sweep.optimize import START, search
from tripillar.sweep.rows import Row, write_parquet
from tripillar.sweep.run import different_first, judge_all, kept_rows, shared_stages
from tripillar.sweep.sampling import Sample, row_key, samples_of
from tripillar.sweep.sweep_file import sweep_from_dict

GRID = sweep_from_dict(
    {
        "design": {"array": {"rows": 1, "cols": 2}},
        "sweep": {"sampling": "grid", "tolerance": 2e-2},
        "vary": [
            {"key": "pad.size_mm", "values": [9.0, 12.0, 16.0]},  # the last is larger than the pitch
            {"key": "resistivity_ohm_mm", "values": [3000.0, 4000.0]},
        ],
    }
)
FILE = """
[sweep]
samples = {samples}
seed = 5
tolerance = 2e-2
[design.array]
rows = 1
cols = 2
[[vary]]
key = "pad.size_mm"
low = {low}
high = 17.0
[[vary]]
key = "unit.height_mm"
low = 8.0
high = 12.0
[bounds]
range_n = {{ least = 400.0 }}
"""


def sample(design):
    return Sample(cache_key=row_key(design, GRID.judging), values={}, design=design)


@pytest.fixture
def house(tmp_path, monkeypatch):
    """Sweep files in a folder; commands that run in this process judge in it, too."""
    monkeypatch.setattr("geometry.pool.open_pool", lambda *_: open_pool(tasks=1))
    for name, low, samples in (("pads", 8.0, 4), ("more", 8.0, 6), ("wide", 16.0, 3)):
        (tmp_path / f"{name}.toml").write_text(FILE.format(low=low, samples=samples))
    return House(tmp_path)


def test_a_sweep_goes_on_and_a_search_finds_its_best(house):
    """One row is lost, one torn; what the search tried first is not judged again as more is asked for."""
    done = house.result("sweep", "pads.toml", "-q")
    wrong = done["failed"].get("not a design", 0)  # pads wider than the pitch
    assert (done["designs"], done["judged_now"], len(done["best"]) > 0) == (4, 4, True)
    errors = [row["error_n"] for row in done["best"]]
    assert errors == sorted(errors)
    assert all(row["range_n"] >= 400 for row in done["best"])
    lost, torn, *_ = sorted((house.folder / "out/pads-rows").glob("*.json"))
    lost.unlink()
    torn.write_text(torn.read_text()[:50])
    shown = house.tripillar("sweep", "pads.toml", "--best", "1")
    assert f"The 1 designs of least error [N] of {4 - wrong}" in shown.stdout
    assert shown.stderr.splitlines()[-1].startswith(("out/pads-pareto.png", f"{wrong} failed, such as: not a design"))
    again = house.result("sweep", "pads.toml", "-q")
    assert (again["judged_now"], [row["error_n"] for row in again["best"]]) == (0, pytest.approx(errors, rel=1e-9))

    first = house.result("sweep", "pads.toml", "--optimize", "-q")
    rows = Journal(house.folder / "out/pads-rows")
    tried = set(rows.keys())
    more = house.result("sweep", "pads.toml", "--optimize", "--trials", "5", "-q")
    assert (first["trials"], more["trials"], len(set(rows.keys()) - tried)) == (4, 5, 1)
    assert more["best"]["error_n"] <= first["best"]["error_n"]
    assert read_design(house.folder / "out/pads-best.toml").pad.size_mm == more["best"]["pad.size_mm"]


def test_designs_that_all_fail_say_why(house):
    """All pads are wider than the pitch: a sweep is a table of failures, a search finds nothing."""
    swept = house.tripillar("sweep", "wide.toml", "-q")
    assert swept.returncode == 0, swept.stderr
    assert "3 failed, such as: not a design: pad size_mm=16" in swept.stderr
    searched = house.tripillar("sweep", "wide.toml", "--optimize", "-q")
    assert searched.returncode == 2
    assert "all 3 designs of wide.toml failed, such as: not a design: pad size_mm=16" in searched.stderr
    assert len(searched.stderr.splitlines()) == 1


def test_ctrl_c_keeps_the_rows_and_leaves_no_worker(house):
    house.environment["TRIPILLAR_CACHE"] = str(house.folder / "cache")
    with subprocess.Popen(
        house.command("sweep", "more.toml", "--workers", "1", "-q"), cwd=house.folder, env=house.environment,
        stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # some shells ignore it
    ) as process:  # fmt: skip
        while not list((house.folder / "out/more-rows").glob("*.json")):
            assert process.poll() is None
            time.sleep(0.02)
        workers = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=60)[1]
    words = "tripillar: stopped; the rows in out/more-rows are kept: give the same command again to go on."
    assert (said.splitlines(), process.returncode) == ([words], 130)
    assert not psutil.wait_procs(workers, timeout=60)[1]


def test_a_process_judges_as_this_one_does_and_rows_survive_their_files(tmp_path):
    samples, journal = samples_of(GRID), Journal(tmp_path / "rows")
    with open_pool(2) as pool:
        rows = judge_all(samples, GRID.judging, pool, journal)
    assert kept_rows(samples, journal) == rows
    assert [row.reason.split(":")[0] for row in rows.values() if row.failed] == ["not a design"] * 2
    assert len(kept_rows(samples, journal, retry=True)) == 4
    for one in samples[:3:2]:
        there, here = rows[one.cache_key], row_of(one, GRID.judging)
        assert replace(there, metrics={}) == replace(here, metrics={})
        for name, value in here.metrics.items():
            if value is not None and not name.startswith("seconds"):  # sums in another order, condition up to 1e4
                assert there.metrics[name] == pytest.approx(value, rel=1e-6)
    key = samples[0].cache_key
    whole = (journal.folder / f"{key}.json").read_text()
    for torn in ("", whole[:-20], "[]", '{"recipe": "ab"}', whole.replace("error_n", "errör_n")):
        (journal.folder / f"{key}.json").write_text(torn)
        assert kept_rows(samples[:1], journal) == {}


def test_tables_hold_every_metric_and_the_failed_ones(tmp_path):
    import pyarrow.parquet as pq

    good = Row(cache_key="a", values={"array.cols": 2.0}, design="x", metrics={"error_n": 1.5})
    bad = Row(cache_key="b", values={"array.cols": 3.0}, design=None, reason="DesignError: no")
    write_parquet([good, bad], tmp_path / "rows.parquet")
    table = pq.read_table(tmp_path / "rows.parquet")
    assert table["error_n"].to_pylist() == [1.5, None]
    assert table["reason"].to_pylist() == ["", "DesignError: no"]
    assert table.schema.field("error_n").metadata[b"units"] == b"N"


def test_touches_are_judged_where_a_force_is_given(monkeypatch):
    monkeypatch.setattr("decoupler.touch.limits.TOUCHES", 4)
    design, judging = SensorDesign(array=Array(rows=1, cols=2)), replace(GRID.judging, touch_n=20.0)
    row, errors = row_of(sample(design), judging), ReadingError(noise=judging.noise, bits=judging.bits)
    assert (row.metric("touch_net_pct"), row.metric("touch_place_mm")) == touch_limits(design, 20.0, errors)
    assert "touch_net_pct" not in row_of(sample(design), GRID.judging).metrics


def test_designs_that_share_a_stage_come_one_after_the_others():
    """The pad is not in the mesh of a two-rubber cell, rows and columns are not in a cell, resistivity in neither."""
    soft = SensorDesign(matrix_material=Material(young_mpa=2.0), array=Array(rows=4, cols=4))

    def stages(**changes):
        return shared_stages(sample(replace(soft, **changes)), GRID.judging)

    def shared(**changes):
        return {name.split()[0] for name in stages() & stages(**changes)}

    assert shared(resistivity_ohm_mm=1.0) == {"mesh", "cell", "response"}
    assert shared(array=Array(rows=4, cols=7)) == {"mesh", "cell"}
    assert shared(pad=Pad(size_mm=10.0)) == shared(matrix_material=Material(young_mpa=3.0)) == {"mesh"}
    assert shared(array=Array(rows=4, cols=4, pitch_mm=16.0)) == set()
    ordered = different_first([one for one in samples_of(GRID) if one.design], GRID.judging)
    assert [one.values["pad.size_mm"] for one in ordered] == [9.0, 12.0, 9.0, 12.0]


def test_arrays_of_another_size_take_the_cell_from_the_cache(monkeypatch):
    first = row_of(sample(SensorDesign(array=Array(rows=3, cols=3))), GRID.judging)
    assert first.metrics["seconds_condense"] > 0
    monkeypatch.setattr("fem.array.substructured.cells_of_stage", None)  # nobody condenses again
    larger = row_of(sample(SensorDesign(array=Array(rows=3, cols=5))), GRID.judging)
    assert larger.metrics["seconds_condense"] == 0
    assert larger.metrics["error_estimate"] == first.metrics["error_estimate"]


@pytest.mark.parametrize("error", [WorkerLost("its worker ended by SIGSEGV, the last of 4"), DesignError("no mesh")])
def test_a_design_that_ends_its_worker_or_fails_is_a_row(tmp_path, monkeypatch, error):
    def failing(sample, judging):
        raise error

    monkeypatch.setattr(run, "row_of", failing)
    samples = samples_of(GRID)[:2]
    with open_pool(tasks=1) as pool:
        rows = judge_all(samples, GRID.judging, pool, Journal(tmp_path))
    assert {row.reason for row in rows.values()} == {f"{type(error).__name__}: {error}"}
    assert all("pitch_mm" in row.design for row in rows.values())


def test_a_search_leans_on_what_it_found_and_is_the_same_again(tmp_path, monkeypatch):
    """Its last trials are nearer to the optimum than its first; half of the rows are lost, and made as they were."""
    asked = sweep_from_dict({"sweep": {"samples": 40}, "vary": [{"key": "array.pitch_mm", "low": 13.0, "high": 20.0}]})
    made = []

    def instant(sample, judging):
        made.append(sample.values["array.pitch_mm"])
        metrics = {"error_n": abs(made[-1] - 15.0)}
        return Row(cache_key=sample.cache_key, values=sample.values, design="x", metrics=metrics)

    monkeypatch.setattr(run, "row_of", instant)
    with open_pool(tasks=1) as pool:
        rows = search(asked, pool, Journal(tmp_path))
        first = made.copy()
        off_mm = np.abs(np.array(first) - 15.0)
        assert off_mm[-10:].mean() < 0.6 * off_mm[:START].mean()
        for path in sorted(tmp_path.glob("*.json"))[::2]:
            path.unlink()
        again = search(asked, pool, Journal(tmp_path))
    assert {row.cache_key: row for row in again} == {row.cache_key: row for row in rows}
    assert (len(first), len(made), set(made[40:]) < set(first)) == (40, 60, True)
