"""Files: written whole or not at all, given back to the last bit, refused in one line where they are damaged."""

import json
import os
import re
import signal
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

from common.storage.cache import kept, kept_value, read_arrays, read_value, write_arrays, write_value
from common.storage.files import digest, replacing, uninterrupted
from common.storage.netcdf import Content, Named, labelled, read_netcdf, write_netcdf
from common.storage.seal import BLANK, KEY, LAST_LINE, MARK, opened_json, require_intact, sealed, sealed_json
from geometry import Array, FileFormatError, Material, SensorDesign
from geometry.mesh import TetMesh, read_mesh, write_mesh

RNG = np.random.default_rng(0)
ARRAYS = {"a": RNG.normal(size=(2, 3)), "steps": np.array(["one", "two"])}
WANTED = {"load": ("row", "col"), "reply": ("row", "col", "axis")}
DATA = Content(
    data_vars={
        "load": Named(("row", "col"), RNG.normal(size=(2, 3)), {"units": "N"}),
        "reply": Named(("row", "col", "axis"), RNG.normal(size=(2, 3, 2))),
    },
    coords={**labelled({"axis": ["x", "y"]}), "time_s": Named(("row",), np.arange(2.0), {"units": "s"})},
    attrs={"design": "# ν and Ω are no ASCII\n", "seed": 3},
)
MESH = TetMesh(RNG.normal(size=(5, 3)), np.array([[0, 1, 2, 3], [1, 2, 3, 4]]), np.array([0, 1]), "0123456789abcdef")


def read_data(path):
    return read_netcdf(path, WANTED, made_by="tripillar made-up")


#: writer, reader, what is compared
KINDS = {
    "npz": (lambda path: write_arrays(ARRAYS, path), read_arrays, lambda found: digest(*map(repr, found.values()))),
    "nc": (lambda path: write_netcdf(DATA, path), read_data, lambda found: found.to_xarray().to_dict()),
    "vtu": (lambda path: write_mesh(MESH, path), read_mesh, lambda found: (found.content_hash, found.cache_key)),
}
GIVEN = {"npz": ARRAYS, "nc": DATA, "vtu": MESH}


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_comes_back_to_the_last_bit_and_is_refused_where_it_is_damaged(tmp_path, kind, capfd):
    """Before its library reads it, some of which crash."""
    write, read, compared = KINDS[kind]
    path = tmp_path / f"a.{kind}"
    with pytest.raises(FileFormatError, match=r"a\.\w+: (no|.*No) such file"):
        read(path)
    write(path)
    assert compared(read(path)) == compared(GIVEN[kind])
    assert list(tmp_path.iterdir()) == [path]
    whole = path.read_bytes()
    half = len(whole) // 2
    flipped = whole[:half] + bytes([whole[half] ^ 1]) + whole[half + 1 :]
    foreign = (b"", b"hello\n" * 100, b"\x89HDF\r\n\x1a\n", b"PK\3\4 no zip", b"<?xml version='1.0'?>")
    for content in (*foreign, *(whole[: int(share * len(whole))] for share in (0.01, 0.5, 0.99)), flipped):
        path.write_bytes(content)
        with pytest.raises(FileFormatError, match=rf"^{path}: ") as caught:
            read(path)
        assert "\n" not in str(caught.value)
    write(path)  # no library keeps it open
    assert capfd.readouterr().out == ""


def test_missing_variables_and_wrong_dims_are_named_and_others_transposed(tmp_path):
    path = tmp_path / "a.nc"
    for data, says in (
        (DATA.to_xarray().drop_vars("reply"), r"has no variable 'reply', only \['load'\]"),
        (DATA.to_xarray().expand_dims(sample=1), r"'load' has the dims .*, expected \('row', 'col'\)"),
    ):
        data.to_netcdf(path)
        with pytest.raises(FileFormatError, match=rf"{says}: give a file made by 'tripillar made-up'\.$"):
            read_data(path)
    DATA.to_xarray().transpose("axis", "col", "row").to_netcdf(path)
    assert read_data(path).to_xarray().drop_attrs(deep=True).identical(DATA.to_xarray().drop_attrs(deep=True))
    write_netcdf(DATA, path)
    with xr.open_dataset(path, decode_times=False) as opened:
        assert opened.identical(DATA.to_xarray())


def test_what_other_programs_pack_is_unpacked_as_xarray_does(tmp_path):
    """Scaled integers, missing numbers, texts of single characters."""
    values = np.array([[1.0, np.nan, 2.5], [0.0, -1.5, 3.0]])
    packed = {"dtype": "i2", "scale_factor": 0.5, "add_offset": 1.0, "_FillValue": -99}
    letters = xr.DataArray(np.array([b"x", b"y"]), dims="axis")
    data = DATA.to_xarray().assign(load=(("row", "col"), values)).assign_coords(axis=letters)
    data.to_netcdf(tmp_path / "a.nc", encoding={"load": packed})
    found = read_data(tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc", decode_times=False) as opened:
        assert np.array_equal(found.data_vars["load"].values, opened["load"].values, equal_nan=True)
    assert np.array_equal(found.data_vars["load"].values, values, equal_nan=True)
    assert list(found.coords["axis"].values) == ["x", "y"]


@pytest.mark.parametrize("last", [LAST_LINE, b""], ids=["last line", "header"])
def test_every_flipped_bit_is_refused_but_in_the_mark_itself(tmp_path, last):
    """A file whose mark is damaged states no hash, and is refused where one is required; its content is whole."""
    path = tmp_path / "a"
    path.write_bytes(b"".join(sealed(b"x" * 10_000 if last else BLANK + b"x" * 10_000, last)))
    require_intact(path, "mend it", required=True)
    whole = path.read_bytes()
    at = whole.index(MARK)
    for place in [0, 5000, len(whole) - 1, *range(at, at + len(BLANK))]:
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        in_mark = at <= place < at + len(MARK)
        with pytest.raises(FileFormatError, match="states no hash.*mend it" if in_mark else "does not match.*mend it"):
            require_intact(path, "mend it", required=True)
        if in_mark:
            require_intact(path, "mend it")


def test_json_is_hashed_as_what_it_holds_not_as_it_is_laid_out():
    plain = {"b": [0.1, None, float("nan")], "a": {"ü": 1}}
    text = sealed_json(plain)
    assert str(opened_json(text)) == str(plain)
    again = json.dumps(dict(reversed(json.loads(text).items())), indent=2, ensure_ascii=False)
    assert opened_json(again)["a"] == {"ü": 1}
    assert KEY not in opened_json(text)
    for damaged in (text.replace("0.1", "0.2"), "[1]", '{"a": ', "[" * 100_000):
        with pytest.raises(ValueError, match=r"."):
            opened_json(damaged)


@dataclass(frozen=True)
class Answer:
    number: float
    cache_key: str


class Cache:
    """Asks for one answer and counts how often it is made."""

    made = 0

    def ask(self, cache_key="k", needed=False):
        def make():
            self.made += 1
            return Answer(float(self.made), cache_key)

        def read(path):
            found = read_arrays(path)
            return Answer(float(found["number"]), str(found["cache_key"]))

        return kept("answer.npz", cache_key, make, read, lambda one, path: write_arrays(vars(one), path), needed)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[:-100]), True),
        (lambda path: path.write_bytes(b"".join(sealed(b"PK\3\4 no zip, but sealed", LAST_LINE))), True),
        (lambda path: write_arrays({"number": 1.0}, path), True),  # of an earlier version
        (lambda path: write_arrays({"number": 1.0, "cache_key": "elsewhere"}, path), False),
        (lambda path: path.unlink(), False),
    ],
)
def test_an_answer_is_made_once_for_each_key_and_anew_where_it_is_damaged_foreign_or_older(caplog, damage, said):
    cache = Cache()
    first, path, reused = cache.ask()
    assert (path.name, reused) == ("answer-k.npz", False)
    assert cache.ask() == (first, path, True)
    assert not cache.ask("other")[2]
    assert not caplog.records
    damage(path)
    again, _, reused = cache.ask()
    assert (again.number, reused) == (3.0, False)
    assert [line.partition(" is ")[2] for line in caplog.messages] == (
        ["damaged or of an earlier version: it is made anew."] if said else []
    )
    assert cache.ask() == (again, path, True)


@dataclass(frozen=True, eq=False, kw_only=True)
class Many:
    values: NDArray[np.float32]
    answers: dict[tuple[int, ...], Answer]
    pairs: tuple[tuple[float, Mapping[str, NDArray[Any]]], ...]
    pair: tuple[int, bool] = (1, True)
    extra: Answer | None = None
    name: str = "ü"
    left_out: list[str] = field(default_factory=list)


def test_dataclasses_come_back_from_the_cache_bit_by_bit_or_are_refused(tmp_path, caplog):
    """Arrays of any type, nested dataclasses, tuples and dicts of them, None, and numbers of NumPy; damaged ones are
    made anew with a word."""
    grids = ((0.1 + 0.2, {"a": np.arange(3, dtype=np.int8)}), (float("nan"), {}))
    many = Many(
        values=np.float32([[1.5, -0.0]]),
        answers={(): Answer(np.float64(0.1), "k"), (1, 2): Answer(3, "")},
        pairs=grids,
        extra=Answer(float("inf"), "x"),
        left_out=["of another place"],
    )
    found, path, reused = kept_value(Many, "many.npz", "k", lambda: many, left_out=["known"])
    assert (found is many, reused) == (True, False)
    found, _, reused = kept_value(Many, "many.npz", "k", lambda: many, left_out=["known"])
    assert reused
    assert found.values.dtype == np.float32
    assert np.signbit(found.values[0, 1])
    assert {key: vars(one) for key, one in found.answers.items()} == {
        key: vars(one) for key, one in many.answers.items()
    }
    assert [repr(each) for each in found.pairs] == [repr(each) for each in grids]
    assert (found.pair, found.extra, found.name) == ((1, True), many.extra, "ü")
    assert found.left_out == ["known"]
    for value, hint in ((many, Answer), ({"a": 1}, dict[str, str]), ((1, 2), tuple[int]), (None, Answer)):
        write_value(value, tmp_path / "value.npz", "left_out")
        with pytest.raises(FileFormatError, match="no value of this program"):
            read_value(hint, tmp_path / "value.npz")
    path.write_bytes(path.read_bytes()[:-9])
    assert not kept_value(Many, "many.npz", "k", lambda: many, left_out=[])[2]
    assert len(caplog.records) == 1


def test_a_cache_that_cannot_be_written_loses_nothing_unless_the_file_is_needed(caplog, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write anywhere
    found, path, _ = Cache().ask()
    assert (found.number, path.exists()) == (1.0, False)
    assert [message[:27] for message in caplog.messages] == ["not kept for the next time:"]
    with pytest.raises(OSError, match="may not be written to"):
        Cache().ask(needed=True)


def test_readers_see_the_old_file_until_the_new_one_is_whole(tmp_path):
    """A write that fails half way leaves it, and no litter."""
    path = tmp_path / "a" / "b" / "data.txt"  # missing folders are made
    for old, text in ((None, "old"), ("old", "new")):
        with replacing(path) as temporary:
            temporary.write_text(text)
            assert (path.read_text() if path.exists() else None) == old
            assert temporary.parent.parent == path.parent  # a rename across file systems would be a copy
            assert temporary.name == path.name
        assert path.read_text() == text
        (plain := tmp_path / "plain").touch()
        assert path.stat().st_mode == plain.stat().st_mode  # as `open` gives
    with pytest.raises(RuntimeError, match="half way"), replacing(path) as temporary:  # noqa: PT012, both are the point
        temporary.write_text("ne")
        raise RuntimeError("half way")
    assert path.read_text() == "new"
    assert list(path.parent.iterdir()) == [path]


def test_digest_changes_with_every_field_and_value_but_not_with_their_order_and_memory():
    """Pinned: a change of the first one makes every cache and every recorded key worthless."""
    assert digest("mesh", 1, 2.5, None, {"b": 1, "a": 2}) == "4f0c2e2586d962e9"
    assert digest(SensorDesign()) == "09b42a3e829e3dac" == digest(SensorDesign(array=Array(pitch_mm=15)))
    array = np.arange(6.0)
    table, one_bit = array.reshape(2, 3), np.where(array == 3, np.nextafter(3.0, 4.0), array)
    different = [
        *(SensorDesign(), SensorDesign(pillar_material=Material(young_mpa=6.2)), SensorDesign(array=Array(rows=5))),
        *(array, one_bit, table, table.T, array.reshape(3, 2), array.astype(np.float32), array.view(np.int64)),
    ]
    assert len({digest(each) for each in different}) == len(different)
    assert digest(np.asfortranarray(table)) == digest(table)
    assert digest("ab", "c") != digest("a", "bc")  # parts do not run together


def test_an_interrupt_waits_for_the_block_and_then_comes():
    came, taker = [], lambda *_: came.append("came")
    before = signal.signal(signal.SIGINT, taker)
    try:
        with uninterrupted():
            assert signal.getsignal(signal.SIGINT).before is taker  # as who ends what hangs asks
            signal.raise_signal(signal.SIGINT)
            came.append("finished")
        assert came == ["finished", "came"]
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_folder_in_the_place_of_a_file_of_the_cache_is_named(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("TRIPILLAR_CACHE", str(tmp_path))
    (tmp_path / "answer-1.npz").mkdir()
    asked = ("answer.npz", "1", lambda: {"x": np.ones(1)}, read_arrays, write_arrays)
    assert kept(*asked)[0] == {"x": np.ones(1)}
    said = r"answer-1\.npz: a folder in the place of a file of the cache: delete it"
    assert re.search(said, caplog.text)
    with pytest.raises(FileFormatError, match=said):
        kept(*asked, needed=True)
