"""Tables for other programs and the card: read back by pyarrow, pandas, numpy and a YAML parser."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from dataset import DatasetSettings, read_samples, simulate
from dataset.card import card_text
from dataset.table import columns_of, write_table
from dataset.variables import VARIABLES
from geometry.design_file import design_from_toml
from geometry.errors import DesignError, FileFormatError, MissingPackageError
from tests.house import House

LABELS = {"axis": "xyz", "pillar": "zxy", "electrode": ["U1", "U2"]}
pa = pytest.importorskip("pyarrow")


@pytest.fixture(scope="module")
def data(response):
    return simulate(response, DatasetSettings(protocol="three-axis", samples=40, seed=3, noise=1e-3, bits=12))


@pytest.fixture(scope="module")
def stored(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("table") / "data.zarr"
    data.only("length_mm").write(path, dtype="float32")
    return read_samples(path)


def test_tables_give_back_every_bit_and_parquet_what_it_means(data, stored, tmp_path, monkeypatch):
    """A column a number: of each kind one is looked up by its name, and all by what their fields say; in blocks."""
    monkeypatch.setattr("dataset.table.ROWS_AT_ONCE", 16)
    for samples, dtype in ((data, "double"), (stored, "float")):
        counts = []
        write_table(samples, tmp_path / "a.parquet", counts.append)
        table = pa.parquet.read_table(tmp_path / "a.parquet")
        assert sum(counts) == len(table) == len(samples)
        assert {str(field.type) for field in table.schema} == {dtype}
        whole = samples[:]
        assert np.array_equal(table["force_1_2_z_n"], whole.force_n[:, 1, 2, 2])
        assert np.array_equal(table["resistance_0_1_x_ohm"], whole.resistance_ohm[:, 0, 1, 1])
        told = json.loads(table.schema.metadata[b"tripillar"])
        assert told["content_hash"] == samples.content_hash
        assert design_from_toml(told["design"], "it") == data.design
        assert list(columns_of(samples)) == table.column_names
        for name in table.column_names:
            said = {key.decode(): value.decode() for key, value in table.schema.field(name).metadata.items()}
            assert said == columns_of(samples)[name]
            dims = VARIABLES[said["variable"]].dims[1:]
            place = (slice(None), *(LABELS.get(dim, "0123").index(said[dim]) for dim in dims))
            assert np.array_equal(table[name], getattr(whole, said["variable"])[place])
        write_table(samples, tmp_path / "a.csv")
        names, *lines = (tmp_path / "a.csv").read_text().splitlines()
        assert names.split(",") == table.column_names
        numbers = np.loadtxt(lines, delimiter=",").astype(samples.dtype)
        assert np.array_equal(numbers, np.stack([table[name] for name in table.column_names], axis=1))
    assert columns_of(data)["displacement_0_0_u2_y_mm"]["units"] == "mm"
    assert pa.parquet.read_table(tmp_path / "a.parquet").to_pandas()["force_0_0_z_n"].gt(0).all()


def test_other_forms_and_a_missing_package_are_refused_and_leave_nothing(data, tmp_path, monkeypatch):
    with pytest.raises(FileFormatError, match=r"end the name in \.parquet or \.csv"):
        write_table(data, tmp_path / "a.xlsx")
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'tripillar\[parquet\]'"):
        write_table(data, tmp_path / "a.parquet")
    assert not list(tmp_path.iterdir())


def test_what_is_held_is_told_in_a_terminal_in_a_notebook_and_on_the_card(data, stored):
    """The same of samples in memory and on disk; the card's head is YAML."""
    told = stored.described()
    assert told["resistance_ohm"].startswith("sample, row, col, pillar [ohm]: as measured")
    assert (told["noise"], told["seed"]) == ("0.001", "3")
    assert told.items() <= data.described().items()
    for text in (repr(stored), stored._repr_html_(), card_text(stored, stored.path)):
        assert "40 samples of 2 × 3 units, three-axis" in text
        assert all(name in text for name in told)
    assert "axis [N]: z &gt; 0 is compression" in data._repr_html_()
    assert "design" in replace(data, design=None).described()
    _, head, body = card_text(stored, stored.path, "cc-by-4.0").split("---\n", 2)
    assert yaml.safe_load(head)["license"] == "cc-by-4.0"
    assert yaml.safe_load(head)["configs"] == [{"config_name": "default", "data_files": "data.parquet"}]
    assert all(words in body for words in (stored.content_hash, "pitch_mm = 15.0", data.made_from["recipe"]))
    with pytest.raises(DesignError, match="must be an identifier such as cc-by"):
        card_text(stored, stored.path, "my own\nlicense: other")


def test_the_command_writes_as_the_name_ends_and_refuses_what_does_not_go_together(data, stored, tmp_path):
    house = House(tmp_path)
    data.write(tmp_path / "data.nc")
    told = house.result("export", "data.nc", "-o", "data.parquet", "-q")
    assert told == {"file": "data.parquet", "samples": 40, "columns": len(columns_of(data))}
    assert house.result("export", str(stored.path), "-o", "own.csv", "-q")["columns"] == 54
    house.result("export", "data.nc", "--license", "mit", "-q", "-o", "card.md")
    assert "license: mit\n" in (tmp_path / "card.md").read_text(encoding="utf-8")
    (tmp_path / "m.safetensors").touch()
    for words, says in {
        (): "give a data set, a recording or --model FILE, one of them",
        ("--model", "m.safetensors"): "m.csv must be a file that ends in .onnx or .h",
        ("data.nc", "--license", "mit"): "is written into the card",
        ("data.nc", "--license", "A B", "-o", "c.md"): "must be an identifier",
    }.items():
        words = words if "-o" in words else (*words, "-o", "m.csv")
        assert says in house.refusal("export", *words)
