"""`tripillar sweep` and `optimize`: gone on with, searched, failed, interrupted."""

import json
import signal
import subprocess
import time

import psutil
import pytest

from geometry.design_file import read_design
from tests.house import House
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
    made = House(tmp_path)
    (tmp_path / "pads.toml").write_text(SWEEP.format(settings="", more=""))
    return made


def test_a_sweep_goes_on_and_computes_only_what_is_missing(house):
    """One row is lost, one torn."""
    done = house.result("sweep", "pads.toml", "--workers", "1", "-q")
    wrong = sum(sample.design is None for sample in samples_of(read_sweep(house.folder / "pads.toml")))
    assert 0 < wrong < 3  # pads wider than the pitch
    assert (done["designs"], done["judged_now"], done["failed"]) == (6, 6, {"not a design": wrong})
    errors = [row["error_n"] for row in done["best"]]
    assert errors == sorted(errors)
    assert len(errors) == 6 - wrong
    for name in ("pads.parquet", "pads-pareto.png", "pads-parallel.png"):
        assert (house.folder / "out" / name).stat().st_size > 0
    lost, torn, *_ = sorted((house.folder / "out" / "pads-rows").glob("*.json"))
    lost.unlink()
    torn.write_text(torn.read_text()[:50])
    again = house.result("sweep", "pads.toml", "--workers", "1", "-q")
    assert again["judged_now"] == 2
    assert [row["error_n"] for row in again["best"]] == pytest.approx(errors, rel=1e-9)
    shown = house.tripillar("sweep", "pads.toml", "--best", "2")
    assert shown.returncode == 0, shown.stderr
    assert f"The 2 designs of least error [N] of {6 - wrong}; {wrong} failed" in shown.stdout
    assert shown.stderr.splitlines()[-1] == "out/pads-parallel.png"


def test_the_best_design_is_found_within_bounds_and_the_search_resumes(house):
    bounds = "[bounds]\nrange_n = { least = 400.0 }"
    (house.folder / "search.toml").write_text(SWEEP.format(settings="seed = 5", more=bounds))
    first = house.result("sweep", "search.toml", "--optimize", "--trials", "3", "--workers", "1", "-q")
    assert (first["trials"], first["tried_now"]) == (3, 3)
    more = house.result("sweep", "search.toml", "--optimize", "--trials", "5", "--workers", "1", "-q")
    assert (more["trials"], more["tried_now"]) == (5, 2)
    assert more["best"]["range_n"] >= 400
    assert more["best"]["error_n"] <= first["best"]["error_n"]
    best = read_design(house.folder / "out" / "search-best.toml")
    assert best.pad.size_mm == more["best"]["pad.size_mm"]
    rows = [json.loads(path.read_text()) for path in (house.folder / "out" / "search-rows").glob("*.json")]
    inside = [row["metrics"]["error_n"] for row in rows if row["metrics"].get("range_n", 0) >= 400]
    assert more["best"]["error_n"] == min(inside)


def test_designs_that_all_fail_say_why(house):
    """All pads are wider than the pitch: a sweep is a table of failures, a search finds nothing."""
    (house.folder / "wide.toml").write_text(
        SWEEP.format(settings="", more="").replace("low = 8.0\nhigh = 17.0", "low = 16.0\nhigh = 17.0")
    )
    swept = house.tripillar("sweep", "wide.toml", "--workers", "1", "-q")
    assert swept.returncode == 0, swept.stderr
    assert "6 failed, such as: not a design: pad size_mm=16" in swept.stderr
    searched = house.tripillar("sweep", "wide.toml", "--optimize", "--trials", "3", "--workers", "1", "-q")
    assert searched.returncode == 2
    assert "all 3 designs of wide.toml failed, such as: not a design: pad size_mm=16" in searched.stderr
    assert len(searched.stderr.splitlines()) == 1


def test_ctrl_c_keeps_the_rows_and_leaves_no_worker(house):
    command = house.command("sweep", "pads.toml", "--workers", "1", "-q")
    house.environment["TRIPILLAR_CACHE"] = str(house.folder / "cache")  # a cached design is judged too soon
    with subprocess.Popen(
        command, cwd=house.folder, env=house.environment, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # some shells ignore it
    ) as process:  # fmt: skip
        while not list((house.folder / "out" / "pads-rows").glob("*.json")):
            assert process.poll() is None
            time.sleep(0.02)
        workers = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=60)[1]
    words = "tripillar: stopped; the rows in out/pads-rows are kept: give the same command again to go on."
    assert (said.splitlines(), process.returncode) == ([words], 130)
    assert not psutil.wait_procs(workers, timeout=60)[1]
