"""One contract for data files: NetCDF, zarr and CSV give back what was written, or refuse in one line."""

import gc
import json
import pickle
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import netCDF4
import numpy as np
import pyarrow.parquet as pq
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from dataset import OPEN_OHM, DatasetSettings, Samples, in_memory, read_samples, simulate
from dataset.leaves import LEAF
from dataset.stored import is_current
from dataset.table import TABLES, columns_of, write_table
from dataset.variables import LABELS, VARIABLES
from geometry import DesignError, FileFormatError, TriPillarError, design_from_toml
from geometry.design import Unit
from geometry.design_file import read_design, write_design
from geometry.layout import LAYOUTS
from tests.house import House

FORMS = ("nc", "zarr", "csv")
LABELLED = ("nc", "zarr")  #: forms that hold attributes and names of axes


@pytest.fixture(scope="module")
def data(response) -> Samples:
    return simulate(response, DatasetSettings(protocol="contact", samples=5, seed=3, noise=0.001, bits=16))


@pytest.fixture(scope="module")
def many(response) -> Samples:
    """More than a leaf, and no whole number of them."""
    return simulate(response, DatasetSettings(protocol="three-axis", samples=LEAF + 300, noise=1e-3, bits=12))


@pytest.fixture(scope="module")
def leaves(many, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("leaves") / "many.zarr"
    many.write(path)
    return path


@pytest.fixture
def copy(leaves, tmp_path) -> Path:
    return Path(shutil.copytree(leaves, tmp_path / "copy.zarr"))


def write(samples: Samples, path: Path) -> Path:
    write_table(samples, path) if path.suffix == ".csv" else samples.write(path)
    return path


def by_others(samples: Samples, path: Path, change) -> Path:
    """A file of the changed content as another program writes it, without our hashes."""
    content = samples.to_xarray()
    content.attrs.pop("content_hash")
    content = change(content)
    if path.suffix == ".nc":
        content.to_netcdf(path)
    else:
        content.to_zarr(path, zarr_format=2, consolidated=True)
    return path


def refusal(path: Path) -> str:
    """What reading a file is refused with: one line that begins with its name."""
    with pytest.raises(TriPillarError) as caught:
        read_samples(path)[:]
    assert isinstance(caught.value, FileFormatError | DesignError)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


@pytest.mark.parametrize("form", FORMS)
def test_a_file_gives_back_every_bit_and_what_made_it(data, tmp_path, form):
    """Negative forces, too: of a pad that is dragged to −x, or pulled. Written again, it is the same file."""
    data = replace(data, force_n=-data.force_n)
    path = write(data, tmp_path / f"a.{form}")
    samples, few = read_samples(path), read_samples(path, labels_only=True)
    for name in data.arrays() if form in LABELLED else LABELS:
        assert np.array_equal(getattr(samples[:], name), getattr(data, name))
    assert few[:].arrays().keys() == set(LABELS)
    assert (len(samples), samples.shape, samples.dtype) == (5, (2, 3), np.float64)
    assert few.content_hash == samples.content_hash
    assert not samples.dead.any()
    known = (samples.design, samples.noise, samples.bits, samples.made_from.get("recipe"))
    assert known == ((data.design, 1e-3, 16, data.made_from["recipe"]) if form in LABELLED else (None, 0.0, None, None))
    if form == "nc":
        samples.write(tmp_path / "again.nc")
        assert (tmp_path / "again.nc").read_bytes() == path.read_bytes()
    assert np.array_equal(pickle.loads(pickle.dumps(samples))[3].force_n, data[3].force_n)  # in another process
    for text in (repr(samples), samples._repr_html_()):
        assert "5 samples of 2 × 3 units" in text
        assert "axis [N]: z" in text


@pytest.mark.parametrize("form", FORMS)
def test_a_file_names_the_pillars_of_its_layout(any_response, tmp_path, form):
    """Without a design, too, by their names alone, in whatever order; other names and numbers of them are refused."""
    made = simulate(any_response, DatasetSettings(protocol="three-axis", samples=3, noise=1e-3))
    layout, bare = made.layout, replace(made, design=None)
    assert made.displacement_mm.shape[-2:] == (len(layout.upper), 3)
    path = write(bare, tmp_path / f"a.{form}")
    back = read_samples(path)[:]
    assert back.layout == layout == any_response.design.unit.layout
    assert np.array_equal(back.resistance_ohm, made.resistance_ohm)
    if form in LABELLED:
        assert np.array_equal(back.displacement_mm, made.displacement_mm)
        assert list(back.to_xarray().pillar) == list(layout.pillar_names)
        other = by_others(bare, tmp_path / f"b.{form}", lambda d: d.isel(pillar=slice(None, None, -1)))
        assert np.array_equal(read_samples(other)[:].resistance_ohm, made.resistance_ohm)
        more = by_others(bare, tmp_path / f"c.{form}", lambda d: d.rename(pillar="p").drop_vars("p").rename(p="pillar"))
        if layout == Unit().layout or (form == "nc" and len(layout.pillars) == 1):
            assert np.array_equal(read_samples(more)[:].resistance_ohm, made.resistance_ohm)
        else:
            assert f"is of size {len(layout.pillars)}, expected ['z', 'x', 'y']" in refusal(more)


def test_netcdf_keeps_the_contract(data, response, tmp_path):
    """Read with the NetCDF library alone: names, dims, types, coordinates and attributes are what others see."""
    contract = {
        "traction_mpa": (("axis",), "MPa"),
        "force_n": (("axis",), "N"),
        "displacement_mm": (("electrode", "axis"), "mm"),
        "length_mm": (("pillar",), "mm"),
        "resistance_ohm": (("pillar",), "ohm"),
    }
    with netCDF4.Dataset(write(data, tmp_path / "a.nc")) as file:
        assert set(file.variables) == {*contract, "axis", "pillar", "electrode"}
        for name, (dims, units) in contract.items():
            expected = (("sample", "row", "col", *dims), np.float64, units)
            assert (file[name].dimensions, file[name].dtype, file[name].units) == expected
            assert np.array_equal(file[name][:], getattr(data, name))  # to the last bit
        labels = {name: list(file[name][:]) for name in ("axis", "pillar", "electrode")}
        assert labels == {"axis": ["x", "y", "z"], "pillar": ["z", "x", "y"], "electrode": ["U1", "U2"]}
        assert design_from_toml(file.design) == data.design
        assert (file.protocol, file.seed, file.noise, file.bits) == ("contact", 3, 0.001, 16)
        assert (file.mesh_hash, file.residual) == (response.mesh_hash, response.residual)
        assert {"cap", "samples", "redrawn", "recipe", "response_hash"} <= set(file.ncattrs())
    exact = DatasetSettings(protocol="contact", samples=1, seed=2**63 - 1)  # the largest seed fits, None is left out
    with netCDF4.Dataset(write(simulate(response, exact), tmp_path / "b.nc")) as file:
        assert ("bits" in file.ncattrs(), file.seed) == (False, 2**63 - 1)


@pytest.mark.parametrize("form", LABELLED)
@pytest.mark.parametrize(
    "dead", [{"dead_pillars": ((0, 0, "z"), (1, 2, "y")), "dead_rows": (3,)}, {"dead_rows": (0, 1), "dead_cols": (5,)}]
)
def test_what_later_stages_need_of_the_sensor_comes_back(response, tmp_path, dead, form):
    """One or several of each: NetCDF hands a list of one over as a scalar. Also where samples were read otherwise."""
    sensor = {"noise": 0.01, "bits": 12, "gain_spread": 0.1, "offset_ohm": 20.0, "specimen": 9, **dead}
    made = simulate(response, DatasetSettings(protocol="contact", samples=4, **sensor))
    back = read_samples(write(made, tmp_path / f"a.{form}"))
    assert (back.noise, back.bits, type(back.bits)) == (0.01, 12, int)
    assert np.array_equal(back.dead, (back[:].resistance_ohm == OPEN_OHM).all(axis=0))
    assert [back.made_from[name] for name in ("gain_spread", "offset_ohm", "specimen")] == [0.1, 20.0, 9]
    other = replace(made, noise=0.02, bits=None, dead=~back.dead)
    back = read_samples(write(other, tmp_path / f"b.{form}"))
    assert (back.noise, back.bits) == (0.02, None)
    assert np.array_equal(back.dead, other.dead)


#: an attribute that makes no sense is passed over, and takes no other with it: the arrays are the contract
SENSELESS = [
    {"noise": "low"}, {"noise": [0.1, 0.2]}, {"bits": 99}, {"bits": "twelve"}, {"design": "a 6 × 6 array"},
    {"dead_pillars": ["0,0,w", "5,0,z"], "dead_rows": 0.5, "dead_cols": "first"},
]  # fmt: skip
OTHERS = {
    "other dims": lambda d: d.transpose("pillar", "axis", "electrode", "col", "row", "sample"),
    "other labels": lambda d: d.sel(axis=["z", "x", "y"], pillar=["x", "y", "z"], electrode=["U2", "U1"]),
    "needed only": lambda d: d[["force_n", "resistance_ohm"]].drop_attrs(),
    "more": lambda d: d.assign(extra=("row", [1.0, 2.0])).assign_coords(sample=np.arange(5) + 100),
    "unnamed": lambda d: xr.Dataset({name: (list("abcd"), d[name].values) for name in LABELS}),
    "big-endian": lambda d: d.assign({name: d[name].astype(">f8") for name in LABELS}),
    "float32": lambda d: d.assign({name: d[name].astype("float32") for name in LABELS}),
    **{str(attributes): lambda d, given=attributes: d.assign_attrs(given) for attributes in SENSELESS},
}


@pytest.mark.parametrize("form", LABELLED)
@pytest.mark.parametrize("change", OTHERS)
def test_files_of_others_are_read_by_their_labels(data, tmp_path, change, form):
    """In whatever order and type of numbers."""
    content, back = (
        OTHERS[change](data.to_xarray()),
        read_samples(by_others(data, tmp_path / f"a.{form}", OTHERS[change])),
    )
    for name in LABELS:
        assert np.array_equal(getattr(back[:], name), getattr(data, name).astype("f4" if change == "float32" else "f8"))
        assert getattr(back[:], name).dtype == np.float64
    assert not back.dead.any()
    stated, missing = {"noise": 0.001, "bits": 16, "design": data.design}, {"noise": 0.0, "bits": None, "design": None}
    kept = {name for name in stated if content.attrs.get(name) == data.to_xarray().attrs[name]}
    assert {name: getattr(back, name) for name in stated} == {n: (stated if n in kept else missing)[n] for n in stated}


def test_zarr_is_read_lazily_and_whatever_its_chunks(data, many, leaves, tmp_path):
    """Its hash is computed from the numbers where none is stated."""
    lazy = read_samples(leaves).to_xarray()
    assert all(lazy[name].dims == VARIABLES[name].dims for name in many.arrays())
    assert lazy["force_n"].chunks[0] == (LEAF, 300)
    assert np.array_equal(lazy["resistance_ohm"].sel(pillar="x")[:3], many.resistance_ohm[:3, ..., 1])
    mixed = data.labels().to_xarray().drop_attrs()
    encoding = {name: {"chunks": (2, 1, 2, 3) if name == "force_n" else (3, 2, 3, 2)} for name in mixed.data_vars}
    mixed.to_zarr(tmp_path / "a.zarr", encoding=encoding, zarr_format=2, consolidated=True)
    stored = read_samples(tmp_path / "a.zarr")
    assert np.array_equal(stored[:].resistance_ohm, data.resistance_ohm)
    assert read_samples(write(data, tmp_path / "b.zarr")).content_hash == stored.content_hash


def test_tables_are_for_other_programs_and_theirs_are_read_by_their_columns(data, tmp_path):
    """In any order, others between them; a semicolon goes with a decimal comma. Of whatever file, also of float32."""
    data.only("length_mm").write(tmp_path / "a.zarr", dtype="float32")
    single = read_samples(tmp_path / "a.zarr")
    assert (single.dtype, single[:].displacement_mm) == (np.float32, None)
    assert np.array_equal(single[:].length_mm, data.length_mm.astype(np.float32))
    assert single.content_hash != data.content_hash
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "pyarrow", None)
        assert "pip install 'tripillar[sweep]'" in House(tmp_path).refusal(
            "export", "a.zarr", "-o", "own.parquet", "-q"
        )
    told = House(tmp_path).result("export", "a.zarr", "-o", "own.csv", "-q")
    assert told == {"file": "own.csv", "samples": 5, "columns": 54}
    names, *lines = (tmp_path / "own.csv").read_text().splitlines()
    assert names.split(",") == columns_of(["force_n", "length_mm", "resistance_ohm"], 2, 3, data.layout)
    numbers = np.loadtxt(lines, delimiter=",", dtype=np.float32)
    assert np.array_equal(numbers[:, names.split(",").index("force_1_2_z_n")], data.force_n[:, 1, 2, 2].astype("f4"))
    assert read_design(tmp_path / "own.toml") == data.design
    noted = "# of batch 7\n" + (tmp_path / "own.toml").read_text(encoding="utf-8")
    (tmp_path / "own.toml").write_text(noted, encoding="utf-8")
    told = House(tmp_path).result("export", "a.zarr", "-o", "own.parquet", "-q")
    assert (tmp_path / "own.toml").read_text(encoding="utf-8") == noted
    with pytest.raises(FileFormatError, match=r"own.parquet: of tables CSV alone is read: write it as .csv"):
        read_samples(tmp_path / "own.parquet")
    table = pq.read_table(tmp_path / "own.parquet")
    assert table.column_names == names.split(",")
    assert np.array_equal(np.stack([column.to_numpy() for column in table.columns], axis=1), numbers)
    write_design(replace(data.design, resistivity_ohm_mm=1.0), tmp_path / "own.toml")
    assert "own.toml is another design" in House(tmp_path).refusal("export", "a.zarr", "-o", "own.csv")
    rows = [line.split(",") for line in write(data, tmp_path / "own.csv").read_text().splitlines()]
    rows = [["my number", *reversed(rows[0])], *([str(number), *reversed(row)] for number, row in enumerate(rows[1:]))]
    rows = [[*row, ""] for row in rows]
    for separator, decimal in ((",", "."), (";", ","), ("\t", "."), ("\t", ","), (";", ".")):
        text = [separator.join(cell.replace(".", decimal) for cell in row) for row in rows]
        text = "\n".join(["Prüfung", "", *text, separator * (len(rows[0]) - 1)])
        (tmp_path / "other.csv").write_text("\ufeff" + text, encoding="utf-8")
        back = read_samples(tmp_path / "other.csv")
        assert all(np.array_equal(getattr(back, name), getattr(data, name)) for name in LABELS)
    with pytest.raises(FileFormatError, match=r"end the name in \.csv"):
        write_table(data, tmp_path / "a.xlsx")
    with pytest.raises(DesignError, match=r"end .* in \.zarr"):
        data.write(tmp_path / "a.nc", dtype="float32")


@pytest.mark.parametrize("ending", TABLES)
def test_a_table_that_is_stopped_leaves_nothing_behind(data, tmp_path, ending):
    """No file, and no writer that fails once it is forgotten."""

    def stopped(samples):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_table(data, tmp_path / f"a{ending}", stopped)
    gc.collect()
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("resistance_ohm", -5.0, "pillar x; it must be finite, 1e-09 to 1e+15 ohm"),
        ("force_n", np.nan, "axis y; it must be finite, -1e+06 to 1e+06 N"),
    ],
)
def test_senseless_values_are_named_with_their_place(data, tmp_path, name, value, said, form):
    values = getattr(data, name).copy()
    values[3, 1, 2, 1] = value
    path = write(replace(data, **{name: values}), tmp_path / f"a.{form}")
    expected = f"{name} is {value} at sample 3, row 1, col 2, {said}: remove that sample or measure it again."
    assert refusal(path) == f"{path}: {expected}"


BROKEN = [
    (lambda d: d.drop_vars("force_n"), ["has no variable 'force_n'", "give a file made by 'tripillar dataset'"]),
    (lambda d: d.drop_vars("axis").isel(axis=[0, 1]), ["dimension 'axis' is of size 2, expected ['x', 'y', 'z']"]),
    (lambda d: d.rename(pillar="channel"), ["'resistance_ohm' has the dims ('sample', 'row', 'col', 'channel')"]),
    (lambda d: d.assign_coords(pillar=["z", "x", "x"]), ["'pillar' is ['z', 'x', 'x'], expected ['z', 'x', 'y']"]),
    (lambda d: d.assign(force_n=d.force_n.astype(str)), ["force_n is of type", "expected numbers"]),
    (lambda d: d.isel(row=[0]), ["holds 1 × 3 units, its attribute 'design' says 2 × 3"]),
]


@pytest.mark.parametrize("form", LABELLED)
@pytest.mark.parametrize(("change", "said"), BROKEN)
def test_a_file_that_breaks_the_contract_is_refused_with_the_reason(data, tmp_path, change, said, form):
    message = refusal(by_others(data, tmp_path / f"a.{form}", change))
    assert all(words in message for words in said), message


def test_what_is_no_file_of_its_form_is_refused(data, tmp_path):
    """Missing, cut, empty, a file for a folder: never a traceback of a library's."""
    for form in FORMS:
        assert "no such file" in refusal(tmp_path / f"none.{form}") or form == "zarr"
    path = write(data, tmp_path / "a.nc")
    content = path.read_bytes()
    for share in (0.0, 0.1, 0.9):
        path.write_bytes(content[: int(share * len(content))])
        assert "truncated or not NetCDF" in refusal(path)
    (tmp_path / "file.zarr").write_text("no directory")
    refusal(tmp_path / "file.zarr")
    names = ",".join(columns_of(LABELS, 1, 1, data.layout))
    for text, said in (
        ("a,b\n1,2\n", "has no column force_0_0_x_n: name columns force_0_0_x_n and resistance_0_0_z_ohm"),
        (f"{names}\n1,2,3,4,5,x\n", "give numbers alone, a row a sample"),
        (f"{names}\n" + "1,5,2,3,4,5,6,7\n" * 3, "rows have more values than the header has columns"),
        (f"{names}\n1,2,3,4,5,\n", "resistance_ohm is nan at sample 0, row 0, col 0, pillar y"),
    ):
        (tmp_path / "a.csv").write_text(text)
        assert said in refusal(tmp_path / "a.csv")


def test_a_table_of_one_axis_needs_no_other_pillars(tmp_path):
    """Those that are not in it are open circuits, which no component of that axis takes."""
    (tmp_path / "x.csv").write_text("force_0_0_x_n,resistance_0_0_x_ohm\n1,9000\n2,8000\n")
    data = read_samples(tmp_path / "x.csv")
    assert data.force_n[:, 0, 0].tolist() == [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    assert data.resistance_ohm[:, 0, 0].tolist() == [[1e9, 9000.0, 1e9], [1e9, 8000.0, 1e9]]


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-9])


def coded(folder: Path, header: str, change: str) -> None:
    """State another codec of the axes' names."""
    plain = json.loads((folder / "axis/.zarray").read_text())
    (folder / "axis" / header).write_text(json.dumps(plain)[:-1] + f", {change}}}")


#: a codec of zarr's unpickles; only known ones of numbers and texts are read, however their names are spelled
CODECS = [
    (".zarray", '"filters": [{"id": "pick\\u006ce", "name": "zlib"}], "dtype": "|O"'),
    ("zarr.json", '"codecs": ["bytes", {"name": "numcodecs.pickle"}]'),
    ("zarr.json", '"codecs": [{"name": "sharding_indexed", "configuration": {"codecs": ["own"]}}]'),
]
FIRST, LAST = "resistance_ohm/0.0.0.0", "resistance_ohm/1.0.0.0"  #: leaves
DAMAGED = {
    "leaf truncated": (lambda folder: cut(folder / LAST), "cannot be read"),
    "leaf missing": (lambda folder: (folder / LAST).unlink(), "samples 8192 to 8491 does not match the hash"),
    "leaf swapped": (lambda folder: shutil.copy(folder / FIRST, folder / LAST), "does not match the hash"),
    "group": (lambda folder: cut(folder / ".zgroup"), ""),
    "attributes": (lambda folder: cut(folder / ".zattrs"), ""),
    "array": (lambda folder: cut(folder / "force_n/.zarray"), ""),
    "labels": (lambda folder: cut(folder / "axis/0"), ""),
    "pickle": (lambda folder: coded(folder, *CODECS[0]), "which is no codec of numbers"),
    "pickle of zarr 3": (lambda folder: coded(folder, *CODECS[1]), "which is no codec of numbers"),
    "unknown in a shard": (lambda folder: coded(folder, *CODECS[2]), "which is no codec of numbers"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_directory_is_refused_and_nothing_in_it_is_run(copy, monkeypatch, name):
    """A leaf only when it is read."""
    change, said = DAMAGED[name]
    change(copy)
    monkeypatch.setattr(pickle, "loads", lambda *_: pytest.fail("unpickled"))
    if name.startswith("leaf"):
        read_samples(copy)[:LEAF]
    assert said in refusal(copy)


@pytest.fixture(scope="module")
def small(response, tmp_path_factory):
    """A directory of few samples, and what is read of it."""
    asked = DatasetSettings(protocol="contact", samples=3, noise=1e-3, bits=12, dead_pillars=((1, 2, "y"),))
    path = tmp_path_factory.mktemp("small") / "small.zarr"
    simulate(response, asked).only("length_mm").write(path)
    return path, read_samples(path)


@given(place=st.integers(0, 2**20), bit=st.integers(0, 7))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_a_flipped_bit_is_refused_in_one_line_or_changes_nothing(small, place, bit):
    """Wherever it is: in numbers, labels, headers, attributes, hashes."""
    path, before = small
    files = sorted(file for file in path.rglob("*") if file.is_file())
    place, number = divmod(place, len(files))
    content = files[number].read_bytes()
    byte = place % len(content)
    files[number].write_bytes(content[:byte] + bytes([content[byte] ^ 1 << bit]) + content[byte + 1 :])
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
        files[number].write_bytes(content)
    assert "\n" not in told


def test_a_changed_copy_that_carries_the_hash_is_read_with_a_word(data, tmp_path, caplog):
    """Nothing is said while it states the truth; the hash is of forces and resistances, our last line is of all."""
    content = data.to_xarray().assign_attrs(seed=99).drop_vars("length_mm")
    content.to_netcdf(tmp_path / "copy.nc", encoding={name: {"zlib": True} for name in content.data_vars})
    assert np.array_equal(read_samples(tmp_path / "copy.nc").force_n, data.force_n)
    assert not caplog.messages
    changed = {"part": content.isel(sample=slice(3)), "single": content.astype("float32")}
    changed["joined"] = xr.concat([content, content], "sample")
    for number, (name, own) in enumerate(changed.items(), start=1):
        own.to_netcdf(tmp_path / f"{name}.nc")
        back = read_samples(tmp_path / f"{name}.nc")
        assert np.array_equal(back.force_n, own.force_n.values)
        assert (len(caplog.messages), back.design, "recipe" in back.made_from) == (number, data.design, False)
        assert "no longer those of its attribute 'content_hash'" in caplog.messages[-1]
    path, noise = write(data, tmp_path / "a.nc"), np.float64(0.001).tobytes()
    whole = path.read_bytes()
    assert whole.count(noise) == 1
    path.write_bytes(whole.replace(noise, np.float64(0.002).tobytes()))
    assert "damaged, its content does not match the hash it states" in refusal(path)


@pytest.mark.parametrize("form", LABELLED)
def test_a_file_is_replaced_whole_and_current_while_recipe_and_content_are(data, tmp_path, form):
    """A failed write leaves the old file and no litter; what is no data set is never replaced."""
    path, recipe = write(data, tmp_path / f"a.{form}"), data.made_from["recipe"]
    assert is_current(path, recipe)
    assert not is_current(path, "0123456789abcdef")
    assert not is_current(tmp_path / f"none.{form}", recipe)
    with pytest.raises(TypeError):
        replace(data, made_from={"note": object()}).write(path)
    assert np.array_equal(read_samples(path)[:].force_n, data.force_n)
    if form == "nc":
        with netCDF4.Dataset(path, "a") as opened:
            opened["resistance_ohm"][1, 0, 0, 0] = 1.5e4  # by hand
    else:
        (path / "resistance_ohm/0.0.0.0").unlink()
    assert not is_current(path, recipe)
    data[:3].write(path)
    assert len(read_samples(path)) == 3
    assert list(tmp_path.iterdir()) == [path]
    (tmp_path / "mine.zarr").mkdir()
    (tmp_path / "mine.zarr/thesis.txt").write_text("years of work")
    with pytest.raises(FileFormatError, match="something else"):
        data.write(tmp_path / "mine.zarr")


def test_any_choice_from_disk_is_that_from_memory_which_may_be_too_small_for_all(many, leaves, tmp_path, monkeypatch):
    """Over leaves' borders, out of order, twice, none, by a mask, from the end; in blocks, all in order.

    Faults are counted over all leaves of what is read.
    """
    stored = read_samples(leaves, labels_only=True)
    mask = np.zeros(len(many), dtype=bool)
    mask[LEAF - 2 : LEAF + 2] = True
    for which in (slice(LEAF - 5, LEAF + 5), slice(None, None, -997), [LEAF + 1, 3, 3, -1], slice(0, 0), mask, -2):
        for samples in (stored[which], many[which]):
            assert np.array_equal(samples.force_n, many.force_n[which].reshape(samples.force_n.shape))
            assert np.array_equal(samples.resistance_ohm, many.resistance_ohm[which].reshape(samples.force_n.shape))
            assert "recipe" not in samples.made_from  # it is that of all samples
            assert samples.design == many.design
        assert stored[which].length_mm is None
    for samples in (many, stored):
        with pytest.raises(IndexError, match=f"no sample {len(many)}: there are {len(many)}"):
            samples[len(many)]
        for size in (1000, 2 * LEAF):
            assert np.array_equal(np.concatenate([block.force_n for block in samples.blocks(size)]), many.force_n)
    assert isinstance(in_memory(stored), Samples)
    moved = many.displacement_mm.copy()
    moved[LEAF + 7, 1, 0, 1, 2] = np.nan
    path = write(replace(many, displacement_mm=moved), tmp_path / "a.zarr")
    assert "displacement_mm is nan at sample 8199, row 1, col 0, electrode U2, axis z" in refusal(path)
    assert len(read_samples(path, labels_only=True)[:]) == len(many)
    monkeypatch.setattr("common.bounded.MEMORY_SHARE", 0.0)
    with pytest.raises(ValueError, match=r"8492 samples take 0.0 GB of memory here, .* give fewer"):
        in_memory(stored)


@pytest.mark.parametrize(
    ("name", "shape", "said"),
    [
        ("force_n", (5, 2, 3), r"force_n has shape \(5, 2, 3\), expected \(n_samples, rows, cols, 3\)"),
        ("displacement_mm", (5, 2, 3, 3), r"displacement_mm has shape .*, expected \(5, 2, 3, 2, 3\)"),
        ("dead", (2, 3), r"dead has shape \(2, 3\), expected \(2, 3, 3\)"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(data, name, shape, said):
    with pytest.raises(ValueError, match=said):
        replace(data, **{name: np.ones(shape)})


@pytest.mark.parametrize("form", ["short names", "counts", "three dims", "one pillar", "labelled"])
def test_one_reading_and_one_force_a_unit_are_data_of_the_layout_single(form, tmp_path):
    """Counts of 0 stand for half a count; forces along x and y are 0."""
    generator, path = np.random.default_rng(0), tmp_path / ("a.csv" if form in ("short names", "counts") else "a.nc")
    ohms, newtons = generator.uniform(1e3, 2e3, (4, 2, 3)), generator.uniform(0.0, 9.0, (4, 2, 3))
    ohms = np.round(ohms - 1e3) * (ohms > 1.2e3) if form == "counts" else ohms
    if path.suffix == ".csv":
        names = [f"{kind}_{row}_{col}" for kind in "rf" for row, col in np.ndindex(2, 3)]
        rows = np.hstack([ohms.reshape(4, -1), newtons.reshape(4, -1)])
        np.savetxt(path, rows, "%.17g", ",", header=",".join(names), comments="")
    else:
        dims, last = ("sample", "row", "col"), {"force_n": "axis", "resistance_ohm": "pillar"}
        given = {"force_n": newtons, "resistance_ohm": ohms}
        if form == "three dims":
            found = xr.Dataset({name: (dims, values) for name, values in given.items()})
        else:
            found = xr.Dataset({name: ((*dims, last[name]), values[..., None]) for name, values in given.items()})
        found = found.assign_coords(axis=["z"], pillar=["z"]) if form == "labelled" else found
        found.to_netcdf(path)
    back = read_samples(path)
    assert back.layout == LAYOUTS["single"]
    assert np.array_equal(back.force_n[..., 2], newtons)
    assert not back.force_n[..., :2].any()
    assert np.array_equal(back.resistance_ohm[..., 0], np.where(ohms == 0, 0.5, ohms))
