"""Commands that are given wrong samples: one line, exit code 2 and no file, unless --force."""

import numpy as np
import pytest
import xarray as xr

from decoupler.model.model_file import read_model
from geometry.storage.netcdf import write_netcdf
from tests.house import House
from tests.studies.one_process import one_after_another

DESIGN = 'extends = "paper"\n[array]\nrows = 2\ncols = 2\n'


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """A sensor of four units, a model of it, and 40 pairs of one specimen."""
    house = House(tmp_path_factory.mktemp("doubts"))
    (house.folder / "design.toml").write_text(DESIGN)
    made = ("dataset", "--design", "design.toml", "--protocol", "three-axis", "--noise", "0.001", "-q")
    house.result(*made, "--samples", "80", "--seed", "1", "--out", "train.nc")
    specimen = ("--gain-spread", "0.1", "--offset", "100")
    house.result(*made, "--samples", "40", "--seed", "2", *specimen, "--out", "pairs.nc")
    trained = ("--component", "all", "--hidden", "4", "--out", "model.safetensors", "-q")
    house.result("train", "--data", "train.nc", *trained)
    return house


def changed(folder, name, change):
    """The pairs with a mistake in them, as another program might write them."""
    with xr.open_dataset(folder / "pairs.nc", engine="netcdf4") as opened:
        data = opened.load()
    data.attrs.pop("content_hash")
    change(data)
    write_netcdf(data, folder / name)
    return name


def shuffle(data):
    data["resistance_ohm"][:] = data["resistance_ohm"].values[np.random.default_rng(0).permutation(40)]


def in_kilohm(data):
    data["resistance_ohm"] /= 1000


def unloaded(data):
    data["force_n"] *= 0


def repeat(data):
    for name in ("force_n", "resistance_ohm"):
        data[name][20:] = data[name].values[:20]


@pytest.mark.parametrize("change", [shuffle, in_kilohm, unloaded])
@pytest.mark.parametrize(
    "words",
    [("identify", "--design", "design.toml"), ("train", "--net", "plain", "--feature", "root", "--component", "all")],
)
def test_nothing_is_written_of_what_looks_wrong(house, change, words):
    wrong = changed(house.folder, f"{change.__name__}.nc", change)
    line = house.refusal(*words, "--data", wrong, "--out", "o.safetensors", "-q")
    assert line.startswith(f"tripillar: {wrong}: ")
    assert line.endswith(". Nothing was done; --force goes on all the same.")


def test_force_writes_and_the_model_remembers(house):
    wrong = changed(house.folder, "forced.nc", shuffle)
    told = house.tripillar("identify", "--data", wrong, "--out", "forced.safetensors", "--force", "-q")
    warning = f"warning: {wrong}: the readings fit the forces worse than if nothing linked them"
    assert (told.returncode, told.stderr.startswith(warning)) == (0, True)
    assert "nothing linked them" in read_model(house.folder / "forced.safetensors").made_from["forced"]
    tested = house.tripillar("evaluate", "--model", "forced.safetensors", "--data", "train.nc", "-q")
    assert "warning: forced.safetensors was made by force of doubtful samples: the readings fit" in tested.stderr


@pytest.mark.parametrize("pairs", [1, 40])
def test_right_pairs_are_taken_without_a_word(house, pairs):
    told = house.tripillar("identify", "--data", "pairs.nc", "--pairs", str(pairs), "--out", "o.safetensors", "-q")
    assert (told.returncode, told.stderr) == (0, "o.safetensors\n")
    assert "forced" not in read_model(house.folder / "o.safetensors").made_from


def test_what_costs_accuracy_or_misleads_is_a_line_and_no_mistake(house, monkeypatch):
    """Forces left out that act, samples given twice, tests on training samples and on wrong ones."""
    monkeypatch.setattr("decoupler.evaluation.crossval.in_parallel", one_after_another)
    wrong, twice = (changed(house.folder, f"{change.__name__}.nc", change) for change in (in_kilohm, repeat))
    own = ("identify", "--data", "pairs.nc", "--pairs", "7", "--out", "own.safetensors")
    assert house.tripillar(*own).returncode == 0
    alone = ("--data", "train.nc", "--component", "fz", "--hidden", "2")
    disturbed = "train.nc: forces along x and y act as well and move the same pillars"
    seen = "was trained on these samples: its errors on others are larger"
    tested = ("evaluate", "--model", "model.safetensors", "--data")
    for words, said in (
        (("train", *alone, "--out", "fz.safetensors"), disturbed),
        (("evaluate", *alone, "--folds", "2"), disturbed),
        (("identify", "--data", twice, "--out", "o.safetensors"), "20 of 40 samples repeat an earlier one"),
        ((*tested, "train.nc"), f"warning: train.nc: model.safetensors {seen}\n"),
        (("evaluate", "--model", "own.safetensors", "--data", "pairs.nc"), seen),
        ((*tested, wrong), "times the design's: give them in Ω"),
    ):
        done = house.tripillar(*words, "-q")
        assert (done.returncode, said in done.stderr) == (0, True), done.stderr
    assert house.tripillar(*tested, "pairs.nc", "-q").stderr == ""
