"""The command line as a person uses it: real processes, a small sensor, real files."""

import signal
import subprocess
import sys
import time

import netCDF4
import numpy as np
import pytest
import xarray as xr

from dataset import read_samples
from hardware import Info
from hardware.boards.virtual_board import recording_from_resistances
from tests.house import SMALL, House

POKE = ["dataset", "--protocol", "contact", "--samples", "9", "--out", "x.nc"]


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """The whole pipeline, run once on two units."""
    house = House(tmp_path_factory.mktemp("house"))
    house.outcome = house.result("run", "--design", "small.toml", "--quiet")
    return house


def test_the_pipeline_beats_the_paper_and_the_marks(house):
    """On every studied protocol our net is below the paper's error, eq. 8 and least squares."""
    assert {comparison["protocol"] for comparison in house.outcome["comparisons"]} == {
        "contact-fz", "contact-fx", "independent-fz", "independent-fx",
    }  # fmt: skip
    for comparison in house.outcome["comparisons"]:
        errors = {entry["decoupler"]: entry["errors"]["rel_err"] for entry in comparison["entries"]}
        ours = errors.pop("skip net from the response (ours)")
        assert ours < comparison["paper_rel_err"]
        assert ours < errors["least squares on √R"]
        assert ours < errors["eq. 8, each pillar alone"]


def test_every_file_named_exists(house):
    files = [house.folder / path for stage in house.outcome["stages"] for path in stage["files"]]
    assert len(files) > 20
    assert all(path.stat().st_size > 0 for path in files)


def test_a_second_run_reuses_everything_and_says_so(house):
    again = house.result("run", "--design", "small.toml", "--quiet")
    assert [s["name"] for s in again["stages"] if not s["reused"]] == ["table"]
    assert again["comparisons"] == house.outcome["comparisons"]
    shown = house.tripillar("run", "--design", "small.toml", "--quiet")
    assert shown.stdout.count("reused, nothing changed") == 6


def test_a_dataset_changed_by_hand_is_made_again(house):
    path = house.folder / "out/data/contact-fz-test.nc"
    with netCDF4.Dataset(path, "a") as opened:
        opened["resistance_ohm"][3, 0, 0, 0] = np.nan
    again = house.result("run", "--design", "small.toml", "--quiet")
    assert [s["name"] for s in again["stages"] if not s["reused"]] == ["datasets", "table"]
    assert again["comparisons"] == house.outcome["comparisons"]


def test_a_bare_command_prints_its_help(house):
    done = house.tripillar()
    assert (done.returncode, done.stderr) == (0, "")
    assert "Usage" in done.stdout


def test_another_resistivity_solves_nothing(house):
    (house.folder / "ohms.toml").write_text("resistivity_ohm_mm = 8000\n" + SMALL)
    again = house.result("run", "--design", "ohms.toml", "--out", "ohms", "--until", "dataset", "--quiet")
    assert {s["name"]: s["reused"] for s in again["stages"]} == {
        "CAD": False, "response": True, "unit": True, "datasets": False,
    }  # fmt: skip
    ours, theirs = (read_samples(house.folder / out / "data/contact-fz-test.nc") for out in ("out", "ohms"))
    assert np.allclose(theirs.resistance_ohm, 2 * ours.resistance_ohm, rtol=1e-12)


def test_a_damaged_cad_file_is_drawn_again(house):
    broken = house.folder / "out/cad/unit.stl"
    whole = broken.read_bytes()
    broken.write_bytes(whole[:100])
    outcome = house.result("run", "--design", "small.toml", "--quiet", "--until", "dataset")
    assert not outcome["stages"][0]["reused"]
    assert broken.read_bytes() == whole


def test_dataset_train_evaluate_one_by_one(house):
    made = house.result(
        "dataset", "--protocol", "three-axis", "--samples", "300", "--seed", "5", "--cap", "0.3", "--noise", "0.001",
        "--bits", "12", "--out", "three.nc", "--design", "small.toml", "--quiet",
    )  # fmt: skip
    assert made["samples"] == 300
    trained = house.result(
        "train", "--data", "three.nc", "--component", "all", "--net", "skip", "--hidden", "8", "--trainer", "varpro",
        "--seed", "1", "--out", "all.safetensors", "--quiet",
    )  # fmt: skip
    assert set(trained["training_errors"]) == {"fx", "fy", "fz"}
    errors = house.result("evaluate", "--model", "all.safetensors", "--data", "three.nc")
    contract = ("rel_err", "rmse_n", "full_scale_pct")
    assert {name: {kind: one[kind] for kind in contract} for name, one in errors.items()} == trained["training_errors"]
    assert errors["fz"]["ratio"] < 1.15  # of the limit: what the project promises
    assert set(errors["fz"]["baselines"]) == {"eq. 8, each pillar alone", "least squares on √R"}
    assert "fz" in house.tripillar("evaluate", "--model", "all.safetensors", "--data", "three.nc").stdout


def test_crossval_and_fine_tune(house):
    """The first 20 pairs of a sensor whose pillars differ by 20 % bring a model that misses by far back to it."""
    for name, *more in (("nominal", "--seed", "1"), ("own", "--seed", "2", "--gain-spread", "0.2", "--specimen", "7")):
        house.result(
            "dataset", "--protocol", "independent-fz", "--samples", "80", "--noise", "0.001", *more,
            "--out", f"{name}.nc", "--design", "small.toml", "--quiet",
        )  # fmt: skip
    asked = ["--data", "nominal.nc", "--component", "fz", "--hidden", "4", "--quiet"]
    tested = house.result("crossval", *asked, "--folds", "4", "--seed", "3")
    assert len(tested["folds"]) == 4
    mean = sum(fold["rel_err"] for fold in tested["folds"]) / 4
    assert tested["mean_rel_err"] == pytest.approx(mean)
    assert tested["feature"] == "inverse"
    house.result("train", *asked, "--out", "nominal.safetensors")
    tuning = ["--model", "nominal.safetensors", "--data", "own.nc", "--pairs", "20", "--out", "own.safetensors"]
    tuned = house.result("fine-tune", *tuning, "--quiet")
    assert tuned["pairs"] == 20
    before, after = (
        house.result("evaluate", "--model", f"{name}.safetensors", "--data", "own.nc")["fz"]["rmse_n"]
        for name in ("nominal", "own")
    )
    assert after < before / 10
    assert "folds=60 must be from 2 to 40" in house.tripillar("crossval", *asked, "--folds", "60").stderr
    refused = house.tripillar("fine-tune", *tuning[:4], "--pairs", "0", "--out", "x.safetensors")
    assert (refused.returncode, "--pairs 0 must be at least 1" in refused.stderr) == (2, True)


def test_response_and_mesh_and_design_and_cad(house):
    solved = house.result("response", "--out", "response.nc", "--design", "small.toml", "--quiet")
    assert solved["reused"]
    with xr.open_dataset(house.folder / "response.nc") as opened:
        assert opened["influence_mm_per_n"].dims == (
            "row", "col", "electrode", "axis", "load_row", "load_col", "load_axis",
        )  # fmt: skip
        assert list(opened["load_axis"].values) == ["x", "y", "z"]
    assert not house.result("mesh", "--design", "small.toml", "--quiet")["reused"]
    assert house.result("mesh", "--design", "small.toml", "--quiet")["reused"]
    printed = house.tripillar("design").stdout
    assert house.tripillar("design", "--out", "paper.toml").returncode == 0
    assert (house.folder / "paper.toml").read_text() == printed
    drawn = house.result("cad", "--out", "drawn", "--design", "small.toml")
    assert (house.folder / "drawn/mould_lid.stl").is_file()
    assert len(drawn["files"]) == 20


def test_replay_gives_the_forces_behind_recorded_frames(house):
    """Frames made from a dataset's resistances: forces as the model gives them, but for the converter's steps."""
    data = read_samples(house.folder / "out/data/contact-fz-test.nc")
    info = Info(rows=1, cols=2, bits=16)
    (house.folder / "press.frames").write_bytes(recording_from_resistances(data.resistance_ohm, info))
    model = "out/models/contact-fz-skip17-inverse.safetensors"
    replayed = house.result("replay", "press.frames", "--model", model)
    assert (replayed["frames"], replayed["saturated_frames"], replayed["axes"]) == (200, 0, ["z"])
    found, known = np.array(replayed["force_n"])[..., 0], data.force_n[..., 2]
    assert np.abs(found - known).max() < 0.02 * known.max()  # 16 bits and the model's own error, well below 1 %
    assert house.tripillar("replay", "press.frames", "--model", model, "--out", "forces.nc").returncode == 0
    with xr.open_dataset(house.folder / "forces.nc") as opened:
        assert np.array_equal(opened["force_n"].values[..., 0], found)


def test_a_dataset_of_a_real_specimen(house):
    flags = ["--noise", "0.001", "--gain-spread", "0.2", "--offset", "20", "--dead-pillar", "0,1,y", "--dead-col", "1"]
    for specimen in ("1", "2"):
        house.result(
            "dataset", "--protocol", "contact-fz", "--samples", "10", "--out", f"specimen-{specimen}.nc", "--design",
            "small.toml", "--quiet", "--specimen", specimen, *flags, "--dead-pillar", "0,0,z",
        )  # fmt: skip
    first, second = (read_samples(house.folder / f"specimen-{specimen}.nc") for specimen in ("1", "2"))
    assert first.dead.tolist() == second.dead.tolist() == [[[True, True, False], [False, False, True]]]  # z, x, y
    assert np.array_equal(first.force_n, second.force_n)
    assert (first.resistance_ohm != second.resistance_ohm)[:, ~first.dead].all()
    assert first.noise == 0.001


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[unit]\nspam = 1\n", "unknown key 'spam' in [unit]; known are span_mm"),
        ("[array]\npitch_mm = 9\n", "pitch_mm=9 is smaller than the unit"),
        ("[pillar_material]\npoisson = 0.5\n", "poisson=0.5 must be from 0 to below 0.5"),
        ("[unit\n", "not valid TOML"),
    ],
)
def test_a_bad_design_is_one_line(house, tmp_path, text, says):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    assert says in house.refusal("response", "--design", str(path), "--out", "never.nc")
    assert says in house.refusal("run", "--design", str(path), "--out", "never")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["frobnicate"], "No such command 'frobnicate'"),
        (["train"], "Missing option"),
        (["dataset", "--protocol", "poke", "--samples", "3", "--out", "x.nc"], "--protocol poke must be one of"),
        (["dataset", "--protocol", "contact", "--samples", "many", "--out", "x.nc"], "--samples"),
        (["dataset", "--protocol", "contact", "--samples", "0", "--out", "x.nc"], "samples=0 must be"),
        (["dataset", "--protocol", "contact", "--samples", "9", "--cap", "2", "--out", "x.nc"], "cap=2 must be"),
        ([*POKE, "--gain-spread", "1"], "gain_spread=1 must be from 0 to below 1"),
        ([*POKE, "--offset=-3"], "offset_ohm=-3 must be"),
        ([*POKE, "--specimen=-1"], "specimen=-1 must be"),
        ([*POKE, "--dead-pillar", "0;3;z"], "'0;3;z' is no place of a pillar: write row,col,pillar"),
        ([*POKE, "--dead-pillar", "0,3,w"], "(0, 3, 'w')"),
        ([*POKE, "--dead-pillar", "0,6,z"], "an array of 6 × 6 units has no pillar 0,6,z"),
        ([*POKE, "--dead-row", "12"], "has no row wire 12: its row wires are 0 to 11"),
        ([*POKE, "--dead-col=-1"], "dead_cols=(-1,) must hold numbers of wires from 0 on"),
        (["evaluate", "--model", "nowhere.safetensors", "--data", "out/data/contact-fz-test.nc"], "no such file"),
        (
            ["evaluate", "--model", "out/models/contact-fz-skip17-inverse.safetensors", "--data", "nowhere.nc"],
            "no such file",
        ),
        (["evaluate", "--model", "small.toml", "--data", "out/data/contact-fz-test.nc"], "no safetensors file"),
        (["train", "--data", "small.toml", "--component", "fz", "--out", "x.safetensors"], "truncated or not NetCDF"),
        (["replay", "small.toml", "--model", "out/models/contact-fz-skip17-inverse.safetensors"], "small.toml"),
        (["run", "--design", "nowhere.toml"], "nowhere.toml"),
        (["view", "--save", "picture.txt"], "must end in .png"),
        (["view", "--save", "picture.png", "--pressure", "nan"], "--pressure nan must be above 0"),
        (["design", "--out", "out"], "out is a folder"),
        (["evaluate", "--model", "out/models/contact-fz-skip17-inverse.safetensors", "--data", "out"], "out: a folder"),
    ],
    ids=lambda value: "-".join(value[:3]) if isinstance(value, list) else None,
)
def test_a_mistake_is_one_line_and_writes_nothing(house, words, says):
    assert says in house.refusal(*words)


def test_data_of_another_design_are_refused(house):
    (house.folder / "wide.toml").write_text(SMALL + "pitch_mm = 17\n")
    done = house.tripillar(
        "dataset", "--protocol", "contact-fz", "--samples", "20", "--out", "wide.nc", "--design", "wide.toml", "-q"
    )
    assert done.returncode == 0, done.stderr
    line = house.refusal("evaluate", "--model", "out/models/contact-fz-skip17-inverse.safetensors", "--data", "wide.nc")
    assert "array.pitch_mm: model 15, data 17" in line


def test_a_truncated_dataset_is_refused(house, tmp_path):
    whole = (house.folder / "out/data/contact-fz-test.nc").read_bytes()
    cut = tmp_path / "cut.nc"
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    line = house.refusal("train", "--data", str(cut), "--component", "fz", "--out", "never.safetensors")
    assert "truncated or not NetCDF" in line


def test_a_nan_in_the_resistances_is_named(house, tmp_path):
    copy = tmp_path / "nan.nc"
    copy.write_bytes((house.folder / "out/data/contact-fz-test.nc").read_bytes())
    with netCDF4.Dataset(copy, "a") as opened:
        opened["resistance_ohm"][7, 0, 1, 0] = np.nan
    line = house.refusal("train", "--data", str(copy), "--component", "fz", "--out", "never.safetensors")
    assert "resistance_ohm is nan at sample 7, row 0, col 1, pillar z" in line


def test_ctrl_c_while_a_dataset_is_written_leaves_nothing(house):
    """The interrupt comes when the half-written file is seen; exit code 130, no file of either name, no hang."""
    folder = house.folder / "stopped"
    words = ["--protocol", "contact-fz", "--samples", "500000", "--out", "stopped/big.nc", "--design", "small.toml"]
    command = [sys.executable, "-m", "tripillar", "dataset", *words, "--quiet"]
    with subprocess.Popen(command, cwd=house.folder, env=house.environment, stderr=subprocess.PIPE) as process:
        while process.poll() is None and not list(folder.glob(".big*")):
            time.sleep(0.002)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
    assert process.returncode == 130
    assert list(folder.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_one_line(house):
    line = house.refusal("design", "--out", "small.toml/under/a/file.toml")
    assert "small.toml" in line
