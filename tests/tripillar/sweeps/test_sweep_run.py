"""Sweeps and searches: rows are the same whoever makes them, none is lost, and what is missing alone is made."""

import tomllib
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure
from PIL import Image

import tripillar as tp
from common.pool import WorkerLost, open_pool
from common.storage.journal import Journal
from fem.array.closed_forms import layer_response
from geometry.design_file import design_from_toml, read_design
from geometry.layout import LAYOUTS
from tests.house import House
from tripillar.sweeps import judge, run
from tripillar.sweeps.optimize import START, search
from tripillar.sweeps.rows import Row
from tripillar.sweeps.run import judge_all, kept_rows
from tripillar.sweeps.sampling import samples_of
from tripillar.sweeps.sweep_file import read_sweep, sweep_from_dict
from tripillar.sweeps.trade_offs import best_tables, draw_pareto

GRID = sweep_from_dict(
    {
        "design": {"array": {"rows": 1, "cols": 2}},
        "sweep": {"sampling": "grid", "tolerance": 5e-2},
        "vary": [
            {"key": "pad.size_mm", "values": [9.0, 12.0, 16.0]},  # the last is larger than the pitch
            {"key": "resistivity_ohm_mm", "values": [3000.0, 4000.0]},
        ],
    }
)
FILE = """
sweep = {{ samples = {samples}, seed = 5 }}
design.array = {{ rows = 1, cols = 2 }}
vary = [{{ key = "pad.size_mm", low = {low}, high = 17.0 }}, {{ key = "unit.height_mm", low = 8.0, high = 12.0 }}]
bounds.range_n = {{ least = 400.0 }}
"""


MIXED = """
sweep = { sampling = "grid", tolerance = 5e-2, bits = 12 }
design.array = { rows = 2, cols = 2 }
vary = [{ key = "layout", values = ["song2018", "six-pillar"] }, { key = "pad.size_mm", values = [11.0, 12.0] }]
bounds = { rate_hz = { least = 900.0 } }
"""


@pytest.fixture
def house(tmp_path, monkeypatch):
    """Sweep files in a folder; designs are judged in this process, by a closed form of their response."""
    monkeypatch.setattr("common.pool.open_pool", lambda *_: open_pool(tasks=1))
    monkeypatch.setattr(judge, "array_response", lambda design, _: (layer_response(design), None, True))
    for name, low, samples in (("pads", 8.0, 4), ("wide", 16.0, 3)):
        (tmp_path / f"{name}.toml").write_text(FILE.format(low=low, samples=samples))
    return House(tmp_path)


def test_a_sweep_goes_on_and_a_search_finds_its_best(house):
    """One row is lost, one torn; what the search tried first is not judged again as more is asked for."""
    done = house.result("sweep", "pads.toml", "-q")
    assert (done["designs"], done["judged_now"], len(done["best"]) > 0) == (4, 4, True)
    errors = [row["error_n"] for row in done["best"]]
    assert errors == sorted(errors)
    assert all(row["range_n"] >= 400 for row in done["best"])
    table = pq.read_table(house.folder / "out/pads.parquet")
    assert sorted(filter(None, table["error_n"].to_pylist()))[: len(errors)] == errors
    assert table.schema.field("error_n").metadata[b"units"] == b"N"
    lost, torn, *_ = sorted((house.folder / "out/pads-rows").glob("*.json"))
    lost.unlink()
    torn.write_text(torn.read_text()[:50])
    again = house.result("sweep", "pads.toml", "-q")
    assert (again["judged_now"], [row["error_n"] for row in again["best"]]) == (2, errors)

    first = house.result("sweep", "pads.toml", "--optimize", "-q")
    rows = Journal(house.folder / "out/pads-rows")
    tried = set(rows.keys())
    more = house.result("sweep", "pads.toml", "--optimize", "--trials", "5", "-q")
    assert (first["trials"], more["trials"], len(set(rows.keys()) - tried)) == (4, 5, 1)
    assert more["best"]["error_n"] <= first["best"]["error_n"]
    assert read_design(house.folder / "out/pads-best.toml").pad.size_mm == more["best"]["pad.size_mm"]
    shown = house.tripillar("sweep", "pads.toml", "--optimize", "--best", "2", "-q").stdout
    assert shown.startswith("The 2 designs of least error")


@pytest.mark.filterwarnings("ignore:.*failed, such as")
def test_a_sweep_gives_the_best_first_and_the_others_as_they_were_drawn(house, monkeypatch):
    """No row is compared with all others: of 100,000 that would take 20 minutes."""
    monkeypatch.setattr(Row, "__eq__", lambda *_: pytest.fail("compared"))
    rows = tp.sweep(house.folder / "pads.toml", out=house.folder / "out")
    drawn = samples_of(read_sweep(house.folder / "pads.toml"))
    best = sorted(
        (row for row in rows if (row.metrics.get("range_n") or 0.0) >= 400.0), key=lambda row: row.metrics["error_n"]
    )
    assert rows[: len(best)] == best
    others = [sample.cache_key for sample in drawn if sample.cache_key not in {row.cache_key for row in best}]
    assert [row.cache_key for row in rows[len(best) :]] == others


def test_designs_that_all_fail_say_why(house):
    """All pads are wider than the pitch: a sweep is a table of failures, a search finds nothing."""
    for words, code, said in (((), 0, "3 failed"), (("--optimize",), 2, "all 3 designs of wide.toml failed")):
        done = house.tripillar("sweep", "wide.toml", "-q", *words)
        assert (done.returncode, f"{said}, such as: not a design: pad size_mm=16" in done.stderr) == (code, True)


def test_rows_survive_their_files_and_failed_ones_can_be_tried_again(tmp_path, house):
    samples, journal = samples_of(GRID), Journal(tmp_path / "rows")
    with open_pool(tasks=1) as pool:
        rows = judge_all(samples, GRID.judging, pool, journal)
    assert kept_rows(samples, journal) == rows
    assert [row.reason.split(":")[0] for row in rows.values() if row.failed] == ["not a design"] * 2
    assert len(kept_rows(samples, journal, retry=True)) == 4
    path = journal.folder / f"{samples[0].cache_key}.json"
    whole = path.read_text()
    for torn in ("", whole[:-20], "[]", '{"recipe": "ab"}', whole.replace("error_n", "errör_n")):
        path.write_text(torn)
        assert kept_rows(samples[:1], journal) == {}


def test_touches_are_judged_where_a_force_is_given(monkeypatch, house):
    monkeypatch.setattr(judge, "touch_limits", lambda design, force_n, errors: (force_n, errors.noise))
    row = judge.row_of(samples_of(GRID)[0], replace(GRID.judging, touch_n=20.0))
    assert (row.metric("touch_net_pct"), row.metric("touch_place_mm")) == (20.0, GRID.judging.noise)
    assert "touch_net_pct" not in judge.row_of(samples_of(GRID)[0], GRID.judging).metrics


def test_the_best_designs_stand_beside_each_other_and_equal_ranges_make_no_panel(tmp_path):
    """Five to a table; ranges that differ by rounding are one, so that the picture is of channels alone."""
    metrics = [{"error_n": 1.0 + k, "range_n": 509.0 + 1e-9 * k, "area_cm2": 9.0, "channels": 12 + k} for k in range(7)]
    rows = [
        Row(cache_key=str(k), values={"pad.size_mm": 9.0 + k, "resistivity_ohm_mm": 4e3}, design="x", metrics=each)
        for k, each in enumerate(metrics)
    ]
    tables = best_tables(rows, GRID, 8)
    assert [[str(column.header) for column in table.columns[1:]] for table in tables] == [list("12345"), list("67")]
    assert list(tables[1].columns[1].cells)[:3] == ["14", "4000", "6"]
    draw_pareto(rows, GRID, tmp_path / "pareto.png")
    with Image.open(tmp_path / "pareto.png") as picture:
        assert picture.width == 960  # 8 inches: one panel


def test_channels_are_whole_numbers_and_layouts_stand_in_the_legend(tmp_path, monkeypatch):
    """A colour bar would rank names."""
    drawn, save = [], Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda self, *at, **how: drawn.append(self) or save(self, *at, **how))
    sweep = sweep_from_dict(tomllib.loads(MIXED))
    rows = [
        Row(
            cache_key=f"{layout}{k}", values={"layout": layout, "pad.size_mm": 11.0 + k}, design="x",
            metrics={"error_n": n + 0.1 * k, "range_n": 500.0 * n, "area_cm2": 9.0, "channels": 10 + n, "rate_hz": 1e3},
        )
        for n, layout in enumerate(("song2018", "six-pillar"), 1) for k in (0, 1)
    ]  # fmt: skip
    draw_pareto(rows, sweep, tmp_path / "pareto.png")
    (figure,), of_range, of_channels = drawn, *drawn[0].axes
    assert {text.get_text() for text in figure.legends[0].get_texts()} >= {"song2018", "six-pillar"}
    assert [tick for tick in of_channels.get_xticks() if tick % 1] == []
    assert of_range.get_xlabel().startswith(sweep.metrics["range_n"].label)


def test_a_design_that_ends_its_worker_is_a_row(tmp_path, monkeypatch):
    def failing(sample, judging):
        raise WorkerLost("ended by SIGSEGV")

    monkeypatch.setattr(run, "row_of", failing)
    with open_pool(tasks=1) as pool:
        rows = judge_all(samples_of(GRID)[:2], GRID.judging, pool, Journal(tmp_path))
    assert [row.reason for row in rows.values()] == ["WorkerLost: ended by SIGSEGV"] * 2


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


def test_layouts_and_numbers_mix_in_one_sweep(tmp_path, monkeypatch):
    """More pillars err less; 24 channels take 1298 µs a scan. Columns are those of the pillars of both layouts."""
    monkeypatch.setattr("common.pool.open_pool", lambda *_: open_pool(tasks=1))
    (tmp_path / "mix.toml").write_text(MIXED)
    done = House(tmp_path).result("sweep", "mix.toml", "-q")
    assert (done["designs"], done["failed"]) == (4, {})
    rows = pq.read_table(tmp_path / "out/mix.parquet").to_pylist()
    three, six = ([row for row in rows if row["layout"] == name] for name in ("song2018", "six-pillar"))
    assert [row["layout"] for row in done["best"]] == ["song2018"] * 2
    assert all(more["error_n"] < fewer["error_n"] for fewer, more in zip(three, six, strict=True))
    assert {(row["channels"], row["wires"], row["rate_hz"]) for row in six} == {(24, 14, 770)}
    assert all((row["crosstalk_x3_1"] is None, row["crosstalk_x_1"] is None) == (True, False) for row in three)
    assert all(row["crosstalk_x3_1"] > 0 for row in six)
    assert design_from_toml(six[0]["design"]).unit.layout == LAYOUTS["six-pillar"]
