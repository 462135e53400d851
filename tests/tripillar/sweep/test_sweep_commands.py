"""`tripillar sweep` and `optimize`: killed and resumed as real processes, searched, failed."""

import json
import shutil
import signal
import subprocess
import time

import psutil
import pytest
from optuna.distributions import FloatDistribution

from geometry.design_file import read_design
from tests.house import House
from tripillar.sweep.optimize import finished, open_study
from tripillar.sweep.sampling import samples_of
from tripillar.sweep.sweep_file import read_sweep

SWEEP = """
[sweep]
samples = 6
tolerance = 2e-2
{settings}
[design.array]
rows = 1
cols = 2
[[vary]]
key = "pad.size_mm"
low = 8.0
high = 17.0
[[vary]]
key = "unit.height_mm"
low = 8.0
high = 12.0
{more}
"""


@pytest.fixture
def house(tmp_path):
    made = House(tmp_path, cache=tmp_path / "cache")  # a cached design is judged too soon to be interrupted
    (tmp_path / "pads.toml").write_text(SWEEP.format(settings="", more=""))
    return made


def ended_by(number, house, n_rows):
    """Send a sweep a signal once it has made so many rows; its exit code, its last words, and the rows that it left.

    It is stopped while it is looked at, lest it ends meanwhile; where it was quicker, it begins anew.
    """
    command = house.command("sweep", "pads.toml", "--workers", "1", "-q")
    rows = house.folder / "out" / "pads-rows"
    for _ in range(5):
        with subprocess.Popen(
            command, cwd=house.folder, env=house.environment, stderr=subprocess.PIPE, text=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # some shells ignore it
        ) as process:  # fmt: skip
            while len(list(rows.glob("[!.]*.json"))) < n_rows and process.poll() is None:
                time.sleep(0.02)
            process.send_signal(signal.SIGSTOP)
            workers = [] if process.poll() is not None else psutil.Process(process.pid).children(recursive=True)
            is_at_work = n_rows <= len(list(rows.glob("[!.]*.json"))) < 6
            process.send_signal(number if is_at_work else signal.SIGKILL)
            process.send_signal(signal.SIGCONT)
            said = process.communicate(timeout=60)[1]
        assert not psutil.wait_procs(workers, timeout=60)[1]
        if is_at_work:
            return process.returncode, said, sorted(rows.glob("[!.]*.json"))
        shutil.rmtree(house.folder / "cache")
        shutil.rmtree(house.folder / "out")
    raise AssertionError("the sweep is never seen at work")


def test_a_killed_sweep_goes_on_and_computes_only_what_is_missing(house):
    """Killed without warning after two rows; then one of them is torn as no kill can tear it."""
    _, _, kept = ended_by(signal.SIGKILL, house, n_rows=3)
    kept[0].write_text(kept[0].read_text()[:50])
    done = house.result("sweep", "pads.toml", "--workers", "1", "-q")
    assert done["judged_now"] == 6 - len(kept) + 1
    wrong = sum(sample.design is None for sample in samples_of(read_sweep(house.folder / "pads.toml")))
    assert 0 < wrong < 3  # pads wider than the pitch
    assert (done["designs"], done["failed"]) == (6, {"not a design": wrong})
    errors = [row["error_n"] for row in done["best"]]
    assert errors == sorted(errors)
    assert len(errors) == 6 - wrong
    for name in ("pads.parquet", "pads.nc", "pads-pareto.png", "pads-parallel.png"):
        assert (house.folder / "out" / name).stat().st_size > 0
    again = house.tripillar("sweep", "pads.toml", "--best", "2")
    assert again.returncode == 0, again.stderr
    assert f"The 2 designs of least error [N] of {6 - wrong}; {wrong} failed" in again.stdout
    assert again.stderr.splitlines()[-1] == "out/pads-parallel.png"


def test_the_best_design_is_found_within_bounds_and_the_search_resumes(house):
    bounds = "[bounds]\nrange_n = { least = 400.0 }"
    (house.folder / "search.toml").write_text(SWEEP.format(settings="seed = 5", more=bounds))
    first = house.result("optimize", "search.toml", "--trials", "3", "--workers", "1", "-q")
    assert (first["trials"], first["tried_now"]) == (3, 3)
    with (house.folder / "out" / "search-trials.log").open("ab") as journal:
        journal.write(b'{"op_code": 5, "wor')  # torn by a power cut
    more = house.result("optimize", "search.toml", "--trials", "5", "--workers", "1", "-q")
    assert (more["trials"], more["tried_now"]) == (5, 2)
    assert more["best"]["range_n"] >= 400
    assert more["best"]["error_n"] <= first["best"]["error_n"]
    best = read_design(house.folder / "out" / "search-best.toml")
    assert best.pad.size_mm == more["best"]["pad.size_mm"]
    rows = [json.loads(path.read_text()) for path in (house.folder / "out" / "search-rows").glob("*.json")]
    inside = [row["figures"]["error_n"] for row in rows if row["figures"].get("range_n", 0) >= 400]
    assert more["best"]["error_n"] == min(inside)


def test_designs_that_all_fail_say_why(house):
    """All pads are wider than the pitch: a sweep is a table of failures, a search finds nothing."""
    (house.folder / "wide.toml").write_text(
        SWEEP.format(settings="", more="").replace("low = 8.0\nhigh = 17.0", "low = 16.0\nhigh = 17.0")
    )
    swept = house.tripillar("sweep", "wide.toml", "--workers", "1", "-q")
    assert swept.returncode == 0, swept.stderr
    assert "6 failed, such as: not a design: pad size_mm=16" in swept.stderr
    searched = house.tripillar("optimize", "wide.toml", "--trials", "3", "--workers", "1", "-q")
    assert searched.returncode == 2
    assert "all 3 designs of wide.toml failed, such as: not a design: pad size_mm=16" in searched.stderr
    assert len(searched.stderr.splitlines()) == 1


def test_two_searches_at_once_share_their_trials(house):
    """Neither ends the trials of the other, which it finds begun."""
    asked = read_sweep(house.folder / "pads.toml")
    journal = house.folder / "trials.log"
    space = {variable.name: FloatDistribution(0.0, 1.0) for variable in asked.variables}
    one = open_study(asked, journal)
    trial = one.ask(space)
    other = open_study(asked, journal)
    one.tell(trial, 1.0)
    assert len(finished(other, asked)) == 1


def test_ctrl_c_keeps_the_rows_and_leaves_no_worker(house):
    code, said, _ = ended_by(signal.SIGINT, house, n_rows=1)
    assert code == 130
    words = "tripillar: stopped; the rows in out/pads-rows are kept: give the same command again to go on."
    assert said.splitlines() == [words]
