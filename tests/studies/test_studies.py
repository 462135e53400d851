"""Every study is found by its name, and says what may be asked of it; all report in one form."""

import json
import sys

import pytest

from common.errors import DesignError
from studies.__main__ import STUDIES, run_study
from studies.bench.processes import timed
from studies.tables import report


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_says_what_it_does_and_takes(name, capsys):
    assert run_study([name, "--help"]) == 0
    said = capsys.readouterr().out
    assert f"studies {name}" in said
    with pytest.raises(DesignError, match=r"--nonsense|is missing"):
        run_study([name, "--nonsense", "1"])


def test_a_study_that_is_none_is_refused_with_all_names():
    with pytest.raises(DesignError, match=r"no study 'gates': choose arrays, .*draw-touch"):
        run_study(["gates"])


def test_tables_and_json_hold_what_was_measured(tmp_path, capsys):
    rows = [{"way": "ours", "seconds": 2.0, "x / y": [1.0, 2.0]}, {"way": "theirs", "failure": "over 20 s"}]
    report({"run time": rows}, tmp_path / "a.json", {"threads": 2, "nan": float("nan")})
    shown = capsys.readouterr().out
    assert "over 20 s" in shown
    assert "1 / 2" in shown
    stored = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert (stored["about"]["threads"], stored["about"]["nan"]) == (2, None)
    assert stored["tables"] == {"run time": rows}


def test_programs_are_timed_alone_with_an_empty_cache():
    code = "import os, sys; print(os.environ['OMP_NUM_THREADS'], os.listdir(os.environ['TRIPILLAR_CACHE']))"
    said, seconds = timed(sys.executable, "-c", code, threads=2)
    assert said == "2 []\n"
    assert seconds > 0
