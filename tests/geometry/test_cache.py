"""The cache: an answer is made once; damaged, foreign and older files are made anew, a full disk loses nothing."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from geometry import FileFormatError
from geometry.storage.cache import kept, read_arrays, write_arrays
from geometry.storage.seal import LAST_LINE, sealed


@dataclass(frozen=True)
class Answer:
    number: float
    cache_key: str


class Cache:
    """Asks for one answer and counts how often it is made."""

    def __init__(self) -> None:
        self.made = 0

    def ask(self, cache_key: str = "k", needed: bool = False) -> tuple[Answer, Path, bool]:
        def make() -> Answer:
            self.made += 1
            return Answer(float(self.made), cache_key)

        return kept("answer.npz", cache_key, make, self.read, lambda one, path: write_arrays(vars(one), path), needed)

    def read(self, path: Path) -> Answer:
        found = read_arrays(path)
        return Answer(float(found["number"]), str(found["cache_key"]))


def test_an_answer_is_made_once_for_each_key(caplog):
    cache = Cache()
    first, path, reused = cache.ask()
    assert (path.name, reused) == ("answer-k.npz", False)
    assert cache.ask() == (first, path, True)
    assert not cache.ask("other")[2]
    assert list(path.parent.glob(".*")) == []
    assert not caplog.records


def written(content: bytes):
    return lambda path: path.write_bytes(content)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[:-100]), True),
        (lambda path: path.write_bytes(path.read_bytes().replace(b"number", b"numbes")), True),
        (written(b""), True),
        (written(b"PK\3\4 no zip"), True),
        (written(b"".join(sealed(b"PK\3\4 no zip, but sealed", LAST_LINE))), True),
        (lambda path: write_arrays({"number": 1.0}, path), True),  # of an earlier version
        (lambda path: write_arrays({"number": 1.0, "cache_key": "elsewhere"}, path), False),
        (lambda path: path.unlink(), False),
    ],
)
def test_what_is_damaged_foreign_or_older_is_made_anew(caplog, damage, said):
    cache = Cache()
    _, path, _ = cache.ask()
    damage(path)
    again, _, reused = cache.ask()
    assert (again.number, reused) == (2.0, False)
    assert [line.partition(" is ")[2] for line in caplog.messages] == (
        ["damaged or of an earlier version: it is made anew."] if said else []
    )
    assert cache.ask() == (again, path, True)


def test_a_cache_that_cannot_be_written_loses_nothing_unless_the_file_is_needed(caplog, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write anywhere
    found, path, _ = Cache().ask()
    assert found.number == 1.0
    assert not path.exists()
    assert [message[:27] for message in caplog.messages] == ["not kept for the next time:"]
    with pytest.raises(OSError, match="may not be written to"):
        Cache().ask(needed=True)


def test_arrays_come_back_to_the_last_bit_and_no_other_file_passes_for_them(tmp_path):
    arrays = {"a": np.random.default_rng(0).normal(size=(2, 3)), "steps": np.array(["one", "two"])}
    write_arrays(arrays, tmp_path / "a.npz")
    found = read_arrays(tmp_path / "a.npz")
    assert all((found[name] == arrays[name]).all() for name in arrays)
    assert found["a"].dtype == np.float64
    with pytest.raises(FileFormatError, match=r"none\.npz"):
        read_arrays(tmp_path / "none.npz")
