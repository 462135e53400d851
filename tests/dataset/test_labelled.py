"""The dataset file: its contract, whoever wrote it, and every way to break it refused in one line."""

from dataclasses import replace
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr

from dataset import (
    OPEN_OHM,
    DatasetSettings,
    Imperfections,
    SampleError,
    Samples,
    read_samples,
    simulate,
)
from dataset.stored import is_current
from geometry import DesignError, FileFormatError, TriPillarError, design_from_toml
from geometry.storage.netcdf import write_netcdf


@pytest.fixture(scope="module")
def data(response) -> Samples:
    return simulate(response, DatasetSettings(protocol="contact", samples=5, seed=3, noise=0.001, bits=16))


@pytest.fixture
def path(data, tmp_path) -> Path:
    data.write(tmp_path / "data.nc")
    return tmp_path / "data.nc"


def rewritten(path: Path, change) -> Path:
    """The file with a change made to its content on purpose, as another program might write it."""
    with xr.open_dataset(path, engine="netcdf4") as opened:
        content = opened.load()
    content.attrs.pop("content_hash", None)
    write_netcdf(change(content), path)
    return path


def refusal(path: Path) -> str:
    with pytest.raises(TriPillarError) as caught:
        read_samples(path)
    assert isinstance(caught.value, FileFormatError | DesignError)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


def test_file_keeps_the_contract(path, data, response):
    """Read with the NetCDF library alone: names, dims, types, coordinates and attributes are what others see."""
    grid = ("sample", "row", "col")
    contract = {
        "traction_mpa": ((*grid, "axis"), "MPa"),
        "force_n": ((*grid, "axis"), "N"),
        "displacement_mm": ((*grid, "electrode", "axis"), "mm"),
        "length_mm": ((*grid, "pillar"), "mm"),
        "resistance_ohm": ((*grid, "pillar"), "ohm"),
    }
    with netCDF4.Dataset(path) as file:
        assert {name: size.size for name, size in file.dimensions.items()} == {
            "sample": 5, "row": 2, "col": 3, "axis": 3, "electrode": 2, "pillar": 3,
        }  # fmt: skip
        assert set(file.variables) == {*contract, "axis", "pillar", "electrode"}
        for name, (dims, units) in contract.items():
            assert (file[name].dimensions, file[name].dtype, file[name].units) == (dims, np.float64, units)
            assert np.array_equal(file[name][:], getattr(data, name))  # to the last bit
        assert list(file["axis"][:]) == ["x", "y", "z"]
        assert list(file["pillar"][:]) == ["z", "x", "y"]
        assert list(file["electrode"][:]) == ["U1", "U2"]
        assert design_from_toml(file.design) == data.design
        assert (file.protocol, file.seed, file.noise, file.bits) == ("contact", 3, 0.001, 16)
        assert (file.mesh_hash, file.residual) == (response.mesh_hash, response.residual)
        assert {"cap", "samples", "redrawn", "recipe", "response_hash"} <= set(file.ncattrs())


def test_exact_dataset_leaves_the_converter_out_and_the_largest_seed_fits_the_file(response, tmp_path):
    """None is no attribute of a NetCDF file."""
    simulate(response, DatasetSettings(protocol="contact", samples=1, seed=2**63 - 1)).write(tmp_path / "a.nc")
    with netCDF4.Dataset(tmp_path / "a.nc") as file:
        assert "bits" not in file.ncattrs()
        assert file.seed == 2**63 - 1


DEAD = [
    {"dead_pillars": ((1, 2, "y"),)},
    {"dead_pillars": ((0, 0, "z"), (1, 2, "y")), "dead_rows": (3,)},
    {"dead_rows": (0, 1), "dead_cols": (5,)},
]


@pytest.mark.parametrize("dead", DEAD, ids=["one pillar", "pillars and a wire", "wires"])
def test_what_later_stages_need_of_the_sensor_comes_back(response, tmp_path, dead):
    """One or several of each: NetCDF hands a list of one over as a scalar."""
    settings = DatasetSettings(
        protocol="contact", samples=4, noise=0.01, bits=12, gain_spread=0.1, offset_ohm=20.0, specimen=9, **dead
    )
    simulate(response, settings).write(tmp_path / "a.nc")
    labelled = read_samples(tmp_path / "a.nc")
    assert (labelled.noise, labelled.bits) == (0.01, 12)
    assert type(labelled.bits) is int
    assert np.array_equal(labelled.dead, Imperfections(**dead).dead_mask(2, 3))
    assert np.array_equal(labelled.dead, (labelled.resistance_ohm == OPEN_OHM).all(axis=0))
    with netCDF4.Dataset(tmp_path / "a.nc") as file:
        assert (file.gain_spread, file.offset_ohm, file.specimen) == (0.1, 20.0, 9)


@pytest.mark.parametrize(
    "attributes",
    [
        {"noise": "low"}, {"noise": -1.0}, {"noise": np.nan}, {"noise": [0.1, 0.2]},
        {"bits": 99}, {"bits": "twelve"}, {"bits": [12, 12]},
        {"dead_pillars": "all"}, {"dead_pillars": ["0,0,z", "5,0,z"]}, {"dead_pillars": "0,0,w"}, {"dead_pillars": 3},
        {"dead_rows": 4}, {"dead_rows": -1}, {"dead_rows": [0, 99]}, {"dead_rows": 0.5}, {"dead_rows": ""},
        {"dead_cols": "first"}, {"dead_cols": 6},
    ],
    ids=str,
)  # fmt: skip
def test_attributes_of_others_that_make_no_sense_are_passed_over(path, attributes):
    """And they take no other attribute with them."""
    labelled = read_samples(rewritten(path, lambda d: d.assign_attrs(attributes)))
    assert labelled.noise == (0.0 if "noise" in attributes else 0.001)
    assert labelled.bits == (None if "bits" in attributes else 16)
    assert not labelled.dead.any()


def test_content_hash_is_of_forces_and_resistances_alone(path, data):
    before = read_samples(path).content_hash
    assert read_samples(rewritten(path, lambda d: d.assign_attrs(seed=99))).content_hash == before
    assert read_samples(rewritten(path, lambda d: d.drop_vars("length_mm"))).content_hash == before
    changed = rewritten(path, lambda d: d.assign(force_n=d.force_n + 1e-9))
    assert read_samples(changed).content_hash != before


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.transpose("pillar", "axis", "electrode", "col", "row", "sample"),
        lambda d: d.sel(axis=["z", "x", "y"], pillar=["x", "y", "z"], electrode=["U2", "U1"]),
        lambda d: d[["force_n", "resistance_ohm"]],
        lambda d: d.assign(extra=("row", [1.0, 2.0])),
        lambda d: d.assign_coords(sample=np.arange(5) + 100),
        lambda d: d.drop_vars(["axis", "pillar"]),
        lambda d: xr.Dataset({name: (list("abcd"), d[name].values) for name in ("force_n", "resistance_ohm")}),
        lambda d: d.drop_attrs(deep=False),
    ],
    ids=["other-dims", "other-labels", "needed-only", "more", "numbered", "unlabelled", "unnamed", "no-sensor"],
)
def test_files_of_others_are_read_by_their_labels(path, data, change):
    labelled = read_samples(rewritten(path, change))
    assert np.array_equal(labelled.resistance_ohm, data.resistance_ohm)
    assert np.array_equal(labelled.force_n, data.force_n)
    assert labelled.dead.shape == (2, 3, 3)
    assert not labelled.dead.any()
    if "noise" not in labelled.made_from:
        assert (labelled.design, labelled.noise, labelled.bits) == (None, 0.0, None)


@pytest.mark.parametrize("dtype", [np.float32, np.int32, ">f8"])
def test_other_types_of_numbers_become_float64(path, data, dtype):
    change = {name: (lambda v: v.astype(dtype)) for name in ("force_n", "resistance_ohm")}
    labelled = read_samples(rewritten(path, lambda d: d.assign({n: f(d[n]) for n, f in change.items()})))
    assert labelled.force_n.dtype == labelled.resistance_ohm.dtype == np.float64
    assert np.array_equal(labelled.resistance_ohm, data.resistance_ohm.astype(dtype))


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        *(("resistance_ohm", value, "pillar x; it must be finite, 1e-09 to 1e+15 ohm")
          for value in (np.nan, np.inf, -5.0, 0.0, 1e300, 1e-300)),
        *(("force_n", value, "axis y; it must be finite, -1e+06 to 1e+06 N") for value in (np.nan, -np.inf, 1e300)),
    ],
)  # fmt: skip
def test_senseless_values_are_named_with_their_place(path, data, name, value, said):
    values = getattr(data, name).copy()
    values[3, 1, 2, 1] = value
    replace(data, **{name: values}).write(path)
    expected = f"{name} is {value} at sample 3, row 1, col 2, {said}: remove that sample or measure it again."
    assert refusal(path) == f"{path}: {expected}"


def test_negative_forces_are_taken(path, data):
    """A pad that is dragged to −x, or pulled."""
    replace(data, force_n=-data.force_n).write(path)
    assert np.array_equal(read_samples(path).force_n, -data.force_n)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.drop_vars("force_n"), ["has no variable 'force_n'", "give a file made by 'tripillar dataset'"]),
        (lambda d: d.drop_vars("resistance_ohm"), ["has no variable 'resistance_ohm'"]),
        (lambda d: d.drop_vars("axis").isel(axis=[0, 1]), ["dimension 'axis' is of size 2, expected ['x', 'y', 'z']"]),
        (lambda d: d.rename(pillar="channel"), ["'resistance_ohm' has the dims ('sample', 'row', 'col', 'channel')"]),
        (lambda d: d.assign_coords(pillar=["z", "x", "w"]), ["'pillar' is ['z', 'x', 'w'], expected ['z', 'x', 'y']"]),
        (lambda d: d.assign_coords(pillar=["z", "x", "x"]), ["'pillar' is ['z', 'x', 'x'], expected ['z', 'x', 'y']"]),
        (lambda d: d.isel(pillar=[0, 1]), ["'pillar' is ['z', 'x'], expected ['z', 'x', 'y']"]),
        (lambda d: d.assign_coords(pillar=[0, 1, 2]), ["'pillar' is ['0', '1', '2'], expected ['z', 'x', 'y']"]),
        (lambda d: d.assign(force_n=d.force_n.astype(str)), ["force_n is of type", "expected numbers"]),
        (lambda d: d.isel(sample=[]), ["is empty, expected at least one sample"]),
        (lambda d: d.isel(row=[0]), ["holds 1 × 3 units, its attribute 'design' says 2 × 3"]),
    ],
)
def test_a_file_that_breaks_the_contract_is_refused_with_the_reason(path, change, said):
    message = refusal(rewritten(path, change))
    assert all(words in message for words in said), message


def test_a_missing_or_truncated_file_is_refused(path, tmp_path):
    content = path.read_bytes()
    for share in (0.0, 0.1, 0.5, 0.9):
        path.write_bytes(content[: int(share * len(content))])
        assert "truncated or not NetCDF" in refusal(path)
    assert "no such file" in refusal(tmp_path / "none.nc")


@pytest.mark.parametrize("design", ["a 6 × 6 array", "", "# by hand", "[sensor]\npitch = 15\n", 5])
def test_a_design_in_other_words_is_not_known(path, design):
    """Whoever made the file may describe the sensor in another way; the arrays are the contract."""
    assert read_samples(rewritten(path, lambda d: d.assign_attrs(design=design))).design is None


def test_a_copy_by_another_program_is_accepted_while_it_states_the_truth(path, data, tmp_path):
    """Compressed, without its last line, the attributes carried along; a changed sample must not carry the hash."""
    with xr.open_dataset(path, engine="netcdf4") as opened:
        content = opened.load()
    packed = {name: {"zlib": True} for name in content.data_vars}
    content.to_netcdf(tmp_path / "copy.nc", encoding=packed)
    assert np.array_equal(read_samples(tmp_path / "copy.nc").force_n, data.force_n)
    content.isel(sample=slice(3)).to_netcdf(tmp_path / "part.nc")
    assert "do not match its attribute 'content_hash': drop the attribute if you" in refusal(tmp_path / "part.nc")


def test_an_attribute_changed_behind_our_back_is_refused(path):
    """One bit of the stated noise: no reader could tell, but for the hash of the whole file."""
    noise = np.float64(0.001).tobytes()
    content = path.read_bytes()
    assert content.count(noise) == 1
    path.write_bytes(content.replace(noise, np.float64(0.002).tobytes()))
    assert "damaged, its content does not match the hash it states" in refusal(path)


def test_a_file_is_current_while_recipe_and_content_are(path, data, tmp_path):
    recipe = data.made_from["recipe"]
    assert is_current(path, recipe)
    assert not is_current(path, "0123456789abcdef")
    assert not is_current(tmp_path / "none.nc", recipe)
    (tmp_path / "text.nc").write_text("hello\n" * 100)
    assert not is_current(tmp_path / "text.nc", recipe)
    write_netcdf(xr.Dataset({"a": ("x", [1.0])}), tmp_path / "plain.nc")
    assert not is_current(tmp_path / "plain.nc", recipe)
    with netCDF4.Dataset(path, "a") as opened:
        opened["resistance_ohm"][1, 0, 0, 0] = 1.5e4  # by hand
    assert not is_current(path, recipe)


def test_failed_write_leaves_the_old_file_and_no_litter(path, data):
    before = path.read_bytes()
    with pytest.raises(TypeError, match="Invalid value for attr"):
        replace(data, made_from={"note": object()}).write(path)
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_a_file_gives_back_all_that_was_simulated(path, data):
    """And with `labels_only` what training needs of it; written again, it is the same file."""
    samples = read_samples(path)
    for name in data.arrays():
        assert np.array_equal(getattr(samples, name), getattr(data, name))
        assert getattr(samples, name).dtype == np.float64
    assert samples.design == data.design
    assert samples.made_from["protocol"] == "contact"
    samples.write(path.with_name("again.nc"))
    assert path.with_name("again.nc").read_bytes() == path.read_bytes()
    few = read_samples(path, labels_only=True)
    assert (few.traction_mpa, few.displacement_mm, few.length_mm) == (None, None, None)
    assert few.content_hash == samples.content_hash


def test_samples_are_chosen_as_in_an_array(data):
    some = data[[3, 1]]
    assert (len(data), len(some), len(data[:2]), len(data[-1])) == (5, 2, 2, 1)
    for name in data.arrays():
        assert np.array_equal(getattr(some, name), getattr(data, name)[[3, 1]])
    assert some.design == data.design
    assert some.content_hash != data.content_hash
    assert "recipe" not in some.made_from  # it is that of all samples
    with pytest.raises(IndexError, match="no sample 5: there are 5"):
        data[5]


def test_a_file_states_noise_converter_and_dead_pillars_of_samples_made_otherwise(data, tmp_path):
    """Also where they differ from what the samples were simulated with."""
    dead = np.zeros((2, 3, 3), dtype=bool)
    dead[1, 2, 0] = dead[0, 0, 1] = True
    for samples in (data, replace(data, made_from={}, design=None).labels()):
        replace(samples, noise=0.02, bits=None, dead=dead).write(tmp_path / "a.nc")
        back = read_samples(tmp_path / "a.nc")
        assert (back.noise, back.bits, back.design) == (0.02, None, samples.design)
        assert np.array_equal(back.dead, dead)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"force_n": np.ones((5, 2, 3))}, r"force_n has shape \(5, 2, 3\), expected \(n_samples, rows, cols, 3\)"),
        (
            {"resistance_ohm": np.ones((5, 2, 2, 3))},
            r"resistance_ohm has .* expected \(5, 2, 3, 3\)",
        ),
        ({"displacement_mm": np.ones((5, 2, 3, 3))}, r"displacement_mm has shape .*, expected \(5, 2, 3, 2, 3\)"),
        ({"dead": np.zeros((2, 3), dtype=bool)}, r"dead has shape \(2, 3\), expected \(2, 3, 3\)"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(data, changed, said):
    with pytest.raises(SampleError, match=said):
        replace(data, **changed)


def test_loads_of_others_are_read_or_refused_by_name(path, data):
    values = data.displacement_mm.copy()
    values[2, 1, 0, 1, 2] = np.nan
    replace(data, displacement_mm=values).write(path)
    assert "displacement_mm is nan at sample 2, row 1, col 0, electrode U2, axis z" in refusal(path)
    assert len(read_samples(path, labels_only=True)) == 5
