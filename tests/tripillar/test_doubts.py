"""Commands that are given wrong samples: one line, exit code 2 and no file, unless --force."""

import json

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


@pytest.fixture
def folder(house):
    return house.folder


@pytest.fixture
def command(house):
    """Run a command in that folder; its exit code, stdout and stderr."""

    def run(*words):
        done = house.tripillar(*map(str, words))
        return done.returncode, done.stdout, done.stderr

    return run


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


def constant(data):
    data["resistance_ohm"][:] = data["resistance_ohm"].values[:1]


def unloaded(data):
    data["force_n"] *= 0


@pytest.mark.parametrize("change", [shuffle, in_kilohm, constant, unloaded])
@pytest.mark.parametrize(
    "words",
    [
        ("identify", "--design", "design.toml"),
        ("train", "--component", "all"),
        ("train", "--component", "all", "--net", "plain", "--feature", "root"),
    ],
    ids=["identify", "train", "train a plain net"],
)
def test_nothing_is_written_of_what_looks_wrong(folder, command, tmp_path, change, words):
    wrong = changed(folder, f"{change.__name__}.nc", change)
    out = tmp_path / "o.safetensors"
    code, said, complaint = command(*words, "--data", wrong, "--out", out, "-q")
    assert (code, said) == (2, "")
    assert complaint.startswith(f"tripillar: {wrong}: ")
    assert complaint.endswith(". Nothing was done; --force goes on all the same.\n")
    assert complaint.count("\n") == 1
    assert not out.exists()


def test_force_writes_and_the_model_remembers(folder, command, tmp_path):
    wrong, out = changed(folder, "forced.nc", shuffle), tmp_path / "o.safetensors"
    tuning = ("identify", "--data", wrong, "--out", out)
    code, _, warning = command(*tuning, "--force", "-q")
    assert code == 0
    assert warning.startswith(f"warning: {wrong}: the readings fit the forces far better in another order")
    assert "another order" in read_model(out).made_from["forced"]
    _, _, said = command("evaluate", "--model", out, "--data", "train.nc", "-q")
    assert f"warning: {out} was made by force of doubtful samples: the readings fit" in said


def test_right_pairs_are_taken_without_a_word(command, tmp_path):
    out = tmp_path / "o.safetensors"
    for pairs in (1, 2, 40):
        tuning = ("identify", "--data", "pairs.nc", "--pairs", pairs, "--out", out)
        code, _, said = command(*tuning, "-q")
        assert (code, said) == (0, f"{out}\n")
    assert "forced" not in read_model(out).made_from


def test_more_pairs_than_there_are_is_a_mistake(command, tmp_path):
    tuning = ("identify", "--data", "pairs.nc", "--out", tmp_path / "o.safetensors")
    code, _, said = command(*tuning, "--pairs", "1000")
    assert (code, said) == (2, "tripillar: --pairs 1000 must be at most 40: there are no more.\n")


@pytest.mark.parametrize("words", [("train", "--out", "fz.safetensors"), ("evaluate", "--folds", "2")], ids=str)
def test_a_component_that_others_disturb_is_named(command, words, monkeypatch):
    """It is no mistake: the net is trained, and the line says what to do."""
    monkeypatch.setattr("decoupler.evaluation.crossval.in_parallel", one_after_another)
    code, _, said = command(*words, "--data", "train.nc", "--component", "fz", "--hidden", "2", "-q")
    assert code == 0
    assert "train.nc: forces along x and y act as well and move the same pillars" in said
    assert "use the component 'all'" in said


def test_a_test_on_training_samples_is_named(command, tmp_path):
    asked = ("evaluate", "--model", "model.safetensors", "--json", "-q", "--data")
    code, found, said = command(*asked, "train.nc")
    assert code == 0
    assert json.loads(found)
    assert (
        said == "warning: train.nc: model.safetensors was trained on these samples: its errors on others are larger\n"
    )
    assert command(*asked, "pairs.nc")[2] == ""
    out = tmp_path / "own.safetensors"
    command("identify", "--data", "pairs.nc", "--pairs", "7", "--out", out)
    assert "was trained on these samples" in command("evaluate", "--model", out, "--data", "pairs.nc")[2]


def test_a_test_on_wrong_samples_is_named(folder, command):
    wrong = changed(folder, "kilohm.nc", in_kilohm)
    code, _, said = command("evaluate", "--model", "model.safetensors", "--data", wrong, "-q")
    assert (code, "times the design's: give them in Ω" in said) == (0, True)


def test_samples_given_twice_are_counted_out_loud(folder, command, tmp_path):
    def repeat(data):
        for name in ("force_n", "resistance_ohm"):
            data[name][20:] = data[name].values[:20]

    twice = changed(folder, "twice.nc", repeat)
    tuning = ("identify", "--data", twice, "--out", tmp_path / "o.safetensors")
    code, _, said = command(*tuning, "-q")
    assert (code, f"{twice}: 20 of 40 samples repeat an earlier one and count once" in said) == (0, True)
