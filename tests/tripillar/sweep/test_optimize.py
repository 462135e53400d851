"""The search for the best design, with workers that need no time."""

import errno

import pytest
from rich.console import Console

from geometry.errors import NotWrittenError
from tripillar.sweep.optimize import open_study, search, written
from tripillar.sweep.rows import Row
from tripillar.sweep.sweep_file import sweep_from_dict
from tripillar.sweep.trade_offs import best_table


class Prompt:
    """Workers that know every row; a design is the better the fewer rows it has."""

    count = 2

    def __init__(self) -> None:
        self.given = []

    def give(self, sample, judging):
        self.given.append(sample)

    def row(self, wait_s):
        sample = self.given.pop()
        metrics = {"error_n": sample.values["array.rows"]}
        return Row(cache_key=sample.cache_key, values=sample.values, design="x", metrics=metrics)

    def state(self):
        return ""


def test_a_design_that_is_tried_again_is_listed_once(tmp_path):
    """Whole numbers from 1 to 2 make two designs, however often the search tries them."""
    asked = sweep_from_dict(
        {"sweep": {"samples": 12}, "vary": [{"key": ["array.rows", "array.cols"], "low": 1, "high": 2}]}
    )
    study = open_study(asked, tmp_path / "trials.log")
    tried = []
    rows = search(asked, study, Prompt(), tmp_path / "rows", tried.append)
    assert len(tried) == 12
    assert sorted(row.values["array.rows"] for row in rows) == [1.0, 2.0]
    console = Console(width=120)
    with console.capture() as shown:
        console.print(best_table(rows, asked, 5))
    assert "The 2 designs of least error [N] of 2; 0 failed" in shown.get()
    assert sum(line.startswith("│") for line in shown.get().splitlines()) == 2
    assert "rows,columns" in "".join(line.split("┃")[1].strip() for line in shown.get().splitlines() if "┃" in line)


def test_a_full_disk_is_said_of_the_journal(tmp_path):
    with pytest.raises(NotWrittenError, match=r"trials\.log: the disk is full"), written(tmp_path / "trials.log"):
        raise OSError(errno.ENOSPC, "No space left on device")
