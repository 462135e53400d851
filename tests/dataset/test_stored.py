"""Zarr directories: what is written is read back leaf by leaf, lazily, and damage is refused in one line."""

import json
import pickle
import shutil

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from dataset import DatasetSettings, in_memory, read_samples, simulate
from dataset.leaves import HASHES, LEAF
from dataset.samples import Samples
from dataset.stored import StoredSamples
from dataset.variables import VARIABLES
from geometry import DesignError, FileFormatError


@pytest.fixture(scope="module")
def data(response):
    """More than a leaf, and no whole number of them."""
    return simulate(response, DatasetSettings(protocol="three-axis", samples=LEAF + 300, noise=1e-3, bits=12))


@pytest.fixture(scope="module")
def written(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("stored") / "data.zarr"
    data.write(path)
    return path


@pytest.fixture
def copy(written, tmp_path):
    path = tmp_path / "copy.zarr"
    shutil.copytree(written, path)
    return path


def test_a_directory_gives_back_every_bit_and_what_made_it(data, written):
    stored = read_samples(written)
    assert isinstance(stored, StoredSamples)
    assert (len(stored), stored.shape, stored.dtype) == (LEAF + 300, (2, 3), np.float64)
    assert (stored.design, stored.noise, stored.bits) == (data.design, 1e-3, 12)
    assert stored.made_from["recipe"] == data.made_from["recipe"]
    whole = stored[:]
    for name in data.arrays():
        assert np.array_equal(getattr(whole, name), getattr(data, name))
    assert "recipe" not in whole.made_from  # as of a part of samples in memory
    assert np.array_equal(pickle.loads(pickle.dumps(stored))[5].force_n, data[5].force_n)  # in another process


def test_any_choice_is_that_of_the_samples_in_memory(data, written):
    """Over leaves' borders, out of order, twice, none, by a mask, from the end."""
    stored = read_samples(written, labels_only=True)
    mask = np.zeros(len(data), dtype=bool)
    mask[LEAF - 2 : LEAF + 2] = True
    for which in (slice(LEAF - 5, LEAF + 5), slice(None, None, -997), [LEAF + 1, 3, 3, -1], slice(0, 0), mask, -2):
        few = stored[which]
        assert np.array_equal(few.resistance_ohm, data[which].resistance_ohm)
        assert np.array_equal(few.force_n, data[which].force_n)
        assert few.length_mm is None
    with pytest.raises(IndexError, match=f"there are {len(data)}"):
        stored[len(data)]


@pytest.mark.parametrize("size", [1000, LEAF, 2 * LEAF])
def test_blocks_are_all_samples_in_order_from_memory_and_from_disk(data, written, size):
    for source in (data, read_samples(written, labels_only=True)):
        assert np.array_equal(np.concatenate([block.force_n for block in source.blocks(size)]), data.force_n)


def test_float32_is_the_nearest_number_and_keeps_its_own_hash(data, tmp_path):
    data.only("length_mm").write(tmp_path / "a.zarr", dtype="float32")
    stored = read_samples(tmp_path / "a.zarr")
    assert stored.dtype == np.float32
    assert np.array_equal(stored[:].length_mm, data.length_mm.astype(np.float32))
    assert stored[:].displacement_mm is None
    assert stored.content_hash != data.content_hash
    with pytest.raises(DesignError, match=r"end .* in \.zarr"):
        data.write(tmp_path / "a.nc", dtype="float32")


def test_xarray_reads_it_lazily_as_the_contract_says(data, written):
    lazy = read_samples(written).to_xarray()
    assert all(lazy[name].dims == VARIABLES[name].dims for name in data.arrays())
    assert lazy["force_n"].chunks[0] == (LEAF, 300)
    assert list(lazy["pillar"].values) == ["z", "x", "y"]
    some = lazy["resistance_ohm"].sel(pillar="x").isel(sample=slice(0, 3)).to_numpy()
    assert np.array_equal(some, data.resistance_ohm[:3, ..., 1])


def test_a_directory_made_by_xarray_is_read_whatever_its_chunks_and_order(data, tmp_path):
    """Dims transposed, axes in another order, no hashes: as NetCDF of others is."""
    mixed = data[:50].labels().to_xarray().drop_attrs().isel(pillar=[2, 0, 1]).transpose("axis", "pillar", ...)
    encoding = {name: {"chunks": (1, 2, 3, 7) if name == "force_n" else (3, 2, 3, 20)} for name in mixed.data_vars}
    mixed.transpose("axis", "pillar", "row", "col", "sample").to_zarr(
        tmp_path / "a.zarr", encoding=encoding, zarr_format=2, consolidated=True
    )
    stored = read_samples(tmp_path / "a.zarr")
    assert np.array_equal(stored[:].resistance_ohm, data.resistance_ohm[:50])
    assert stored.design is None
    again = tmp_path / "b.zarr"
    data[:50].labels().write(again)
    assert read_samples(again).content_hash == stored.content_hash  # stated, and computed from the numbers


def test_what_memory_cannot_hold_is_refused(written, monkeypatch):
    assert isinstance(in_memory(read_samples(written)), Samples)
    monkeypatch.setattr("dataset.stored.IN_MEMORY", 0.0)
    with pytest.raises(ValueError, match=r"8492 samples take 0.0 GB of memory here, .* give fewer"):
        in_memory(read_samples(written))


CHUNK = "resistance_ohm/1.0.0.0"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda path: (path / CHUNK).write_bytes((path / CHUNK).read_bytes()[:-9]), "cannot be read"),
        (lambda path: (path / CHUNK).unlink(), "samples 8192 to 8491 does not match the hash"),
        (lambda path: shutil.copy(path / "force_n/0.0.0.0", path / "force_n/1.0.0.0"), "does not match the hash"),
    ],
    ids=["truncated", "missing", "swapped"],
)
def test_a_damaged_leaf_is_refused_when_it_is_read(copy, change, told):
    change(copy)
    stored = read_samples(copy)
    stored[:LEAF]
    with pytest.raises(FileFormatError, match=told):
        stored[LEAF:]


def test_an_impossible_number_of_others_is_named_with_its_place(data, tmp_path):
    lazy = data.labels().to_xarray().drop_attrs()
    lazy["resistance_ohm"][LEAF + 7, 1, 2, 0] = np.nan
    lazy.to_zarr(tmp_path / "a.zarr", zarr_format=2, consolidated=True)
    with pytest.raises(FileFormatError, match="resistance_ohm is nan at sample 8199, row 1, col 2, pillar z"):
        read_samples(tmp_path / "a.zarr")[:]


def test_a_damaged_or_foreign_directory_is_refused_in_one_line(copy, data, tmp_path):
    """Missing, empty, a file, half a header, hashes of other leaves: never a traceback of zarr's."""
    (tmp_path / "file.zarr").write_text("no directory")
    (tmp_path / "empty.zarr").mkdir()
    places = ["none.zarr", "file.zarr", "empty.zarr"]
    for number, header in enumerate((".zgroup", ".zattrs", "force_n/.zarray", "force_n/.zattrs", "axis/0")):
        place = tmp_path / f"{number}.zarr"
        shutil.copytree(copy, place)
        (place / header).write_bytes((place / header).read_bytes()[:-6])
        places.append(place.name)
    xr.Dataset({"a": ("b", np.ones(3))}).to_zarr(tmp_path / "foreign.zarr", zarr_format=2, consolidated=True)
    for place in [*places, "foreign.zarr"]:
        with pytest.raises(FileFormatError, match=f"{place}[^\n]*: [^\n]*$"):
            read_samples(tmp_path / place)[:]
    text = (copy / "force_n/.zattrs").read_text()
    (copy / "force_n/.zattrs").write_text(text.replace(read_samples(copy)._hashes["force_n"][0], "0" * 16))
    with pytest.raises(FileFormatError, match="content_hash"):
        read_samples(copy)
    assert HASHES in text


@pytest.mark.parametrize(
    ("header", "change"),
    [
        (".zarray", '"filters": [{"id": "pickle"}], "dtype": "|O"'),
        (".zarray", '"filters": [{"id": "pick\\u006ce", "name": "zlib"}], "dtype": "|O"'),
        (".zarray", '"compressor": {"id": "json2"}'),
        ("zarr.json", '"codecs": ["bytes", {"name": "numcodecs.pickle"}]'),
        ("zarr.json", '"codecs": [{"name": "sharding_indexed", "configuration": {"codecs": ["own"]}}]'),
    ],
)
def test_a_codec_that_could_run_programs_is_not_read(copy, monkeypatch, header, change):
    """A codec of zarr's unpickles; only known ones of numbers and texts are read, however their names are spelled."""
    path = copy / "axis" / header
    plain = json.loads((copy / "axis/.zarray").read_text())
    path.write_text(json.dumps(plain)[:-1] + f", {change}}}")
    monkeypatch.setattr(pickle, "loads", lambda *_: pytest.fail("unpickled"))
    with pytest.raises(FileFormatError, match="which is no codec of numbers"):
        read_samples(copy)


@pytest.fixture(scope="module", params=["zarr", "nc"])
def small(request, response, tmp_path_factory):
    """A file of few samples, and what is read of it."""
    asked = DatasetSettings(protocol="contact", samples=3, noise=1e-3, bits=12, dead_pillars=((1, 2, "y"),))
    path = tmp_path_factory.mktemp("small") / f"small.{request.param}"
    simulate(response, asked).only("length_mm").write(path)
    return path, read_samples(path)


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        ("length_mm/.zarray", b'"zarr_format": 2', b'"zarr_format": 6', "headers are damaged"),
        ("length_mm/.zarray", b'"dtype"', b'"dtypf"', "headers are damaged"),
        (".zattrs", b'"seed": 0', b'"seed": 1', "do not match 'header_hash'"),
        ("force_n/.zattrs", b"leaf_hashes", b"leaf_hashew", None),
        ("electrode/0", b"U\x00\x00\x001\x00\x00\x00", b"U\x00\x00\x001\x00\x00\x01", "headers are damaged"),
    ],
)
def test_damage_that_no_json_or_codec_shows_is_refused(copy, name, old, new, said):
    """A variable is not left out without a word; of forces without hashes the numbers themselves are read."""
    content = (copy / name).read_bytes()
    assert old in content
    (copy / name).write_bytes(content.replace(old, new))
    if said is None:
        assert len(read_samples(copy)[:5]) == 5
        return
    with pytest.raises(FileFormatError, match=said):
        read_samples(copy)


@given(place=st.integers(0, 2**20), bit=st.integers(0, 7))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_a_flipped_bit_is_refused_in_one_line_or_changes_nothing(small, place, bit):
    """Wherever it is: in numbers, labels, headers, attributes, hashes."""
    path, before = small
    files = sorted(file for file in path.rglob("*") if file.is_file()) or [path]
    place, number = divmod(place, len(files))
    file = files[number]
    byte = place % file.stat().st_size
    content = file.read_bytes()
    file.write_bytes(content[:byte] + bytes([content[byte] ^ 1 << bit]) + content[byte + 1 :])
    told = ""
    try:
        after = read_samples(path)
        read = after[:]
    except FileFormatError as refused:
        told = str(refused)
    else:
        assert read.variables == before.variables
        assert all(np.array_equal(values, getattr(before[:], name)) for name, values in read.arrays().items())
        assert (after.design, after.noise, after.bits) == (before.design, before.noise, before.bits)
        assert np.array_equal(after.dead, before.dead)
        assert before.made_from.items() <= after.made_from.items()
    finally:
        file.write_bytes(content)
    assert "\n" not in told


def test_only_a_data_set_is_replaced(copy, data, tmp_path):
    (tmp_path / "mine.zarr").mkdir()
    (tmp_path / "mine.zarr/thesis.txt").write_text("years of work")
    with pytest.raises(FileFormatError, match="something else"):
        data[:5].write(tmp_path / "mine.zarr")
    data[:5].write(copy)
    assert len(read_samples(copy)) == 5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["copy.zarr", "mine.zarr"]
