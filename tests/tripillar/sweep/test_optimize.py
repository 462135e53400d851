"""The search for the best design, with designs that need no time."""

import pytest
from rich.console import Console

from geometry.pool import open_pool
from geometry.storage.journal import Journal
from tripillar.sweep import optimize, run
from tripillar.sweep.rows import Row
from tripillar.sweep.sweep_file import sweep_from_dict
from tripillar.sweep.trade_offs import best_table

VARY = {"vary": [{"key": ["array.rows", "array.cols"], "low": 1, "high": 2}]}


def instant(sample, judging):
    """A design is the better the fewer rows it has."""
    metrics = {"error_n": sample.values["array.rows"]}
    return Row(cache_key=sample.cache_key, values=sample.values, design="x", metrics=metrics)


@pytest.fixture
def search(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "row_of", instant)

    def searched(samples, progress=lambda row: None):
        asked = sweep_from_dict({"sweep": {"samples": samples, "seed": 3}, **VARY})
        with open_pool(tasks=1) as pool:
            return asked, optimize.search(
                asked, pool, Journal(tmp_path / "rows"), Journal(tmp_path / "trials"), progress
            )

    return searched


def test_a_design_that_is_tried_again_is_listed_once(search):
    """Whole numbers from 1 to 2 make two designs, however often the search tries them."""
    tried = []
    asked, rows = search(12, tried.append)
    assert len(tried) == 12
    assert sorted(row.values["array.rows"] for row in rows) == [1.0, 2.0]
    console = Console(width=120)
    with console.capture() as shown:
        console.print(best_table(rows, asked, 5))
    assert "The 2 designs of least error [N] of 2; 0 failed" in shown.get()
    assert sum(line.startswith("│") for line in shown.get().splitlines()) == 2
    assert "rows,columns" in "".join(line.split("┃")[1].strip() for line in shown.get().splitlines() if "┃" in line)


def test_a_search_goes_on_with_its_trials_even_where_a_row_is_lost(search, tmp_path):
    search(4)
    for path in (tmp_path / "rows").iterdir():
        path.unlink()
    more = []
    asked, _ = search(7, more.append)
    assert len(more) == 3
    assert len(optimize.tried(asked, Journal(tmp_path / "trials"))) == 7
    assert optimize.tried(sweep_from_dict({"sweep": {"seed": 4}, **VARY}), Journal(tmp_path / "trials")) == []
