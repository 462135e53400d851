"""Frozen answers: what a row holds to, and that a file gives back what was put into it."""

from dataclasses import replace

import numpy as np
import pytest

from studies.gates.__main__ import read, write
from studies.gates.rows import Row, in_own_process, verdict

ROW = Row(what="patch", estimate=1e-3, seconds=1.0, said="right", values={"patch": np.array([0.0, 0.0, -1.0])})


@pytest.mark.parametrize(
    ("now", "begins"),
    [
        (replace(ROW, values={"patch": np.array([0.0, 0.0, -1.0019])}), "holds"),
        (replace(ROW, values={"patch": np.array([0.0, 0.0, -1.0021])}), "no: moved"),
        (replace(ROW, values={}), "no: moved"),
        (replace(ROW, at_least=1.1e-3), "no: stated too little"),
        (replace(ROW, said="refused: why"), "no: 'right' has become"),
    ],
)
def test_a_row_moves_within_both_estimates_and_states_its_distance_to_the_truth(now: Row, begins: str):
    assert verdict(ROW, now).startswith(begins)
    wrong = replace(ROW, at_least=1.0)
    assert not verdict(wrong, replace(ROW, values={"patch": np.array([9.0, 0.0, 0.0])})).startswith("no")


def test_the_truth_may_be_uncertain():
    row = ROW.held_to({"patch": [0.0, 0.0, -1.002]}, 1.5e-3)
    assert row.error == pytest.approx(0.002 / 1.002)
    assert not row.is_wrong
    assert ROW.held_to({"patch": [0.0, 0.0, -1.003]}, {"patch": 1.5e-3}).is_wrong


def test_a_file_gives_back_its_rows(tmp_path):
    many = replace(ROW, what="array", values={"a": np.arange(90.0).reshape(5, 6, 3), "b": np.ones(2)}, estimate=np.inf)
    write(tmp_path / "kept.json", {"some": 1}, {"some": {"patch": ROW, "array": many}})
    about, found = read(tmp_path / "kept.json")
    assert about == {"some": 1}
    assert found["some"]["array"].estimate is None
    for row in (ROW, many):
        assert verdict(row, replace(found["some"][row.what], estimate=row.estimate)) == "holds"


def test_an_answer_that_fails_is_a_row():
    assert (
        in_own_process("none", lambda: 1 // 0)[0].said == "WRONG: ZeroDivisionError: integer division or modulo by zero"
    )
