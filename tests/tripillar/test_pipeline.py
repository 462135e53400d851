"""The whole way on a small sensor: the pipeline, its stages one by one, real files."""

import netCDF4
import numpy as np
import pytest
import xarray as xr

from dataset import read_samples
from fem.array.solving import ResponseSettings
from hardware import Info
from tests.hardware.boards import recording_from_resistances
from tests.house import SMALL, House
from tests.studies.one_process import one_after_another

RUN = ("run", "--design", "small.toml", "--quiet")
MODEL = "out/models/contact-fz-skip17-inverse.safetensors"


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """All that the whole pipeline makes for two units, of fewer samples than the paper's."""
    house = House(tmp_path_factory.mktemp("house"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tripillar.pipeline.run.SPLITS", {"train": (400, 1), "test": (100, 2)})
        patch.setattr("tripillar.pipeline.run.SETTINGS", {"soft": ResponseSettings(tolerance=2e-2)})
        house.outcome = house.result(*RUN)
        yield house


def made_anew(outcome):
    return [stage["name"] for stage in outcome["stages"] if not stage["reused"]]


def test_the_pipeline_beats_the_paper_and_the_marks(house):
    """On every studied protocol our net is below the paper's error, eq. 8 and least squares; its files are there."""
    assert {comparison["protocol"] for comparison in house.outcome["comparisons"]} == {
        "contact-fz", "contact-fx", "independent-fz", "independent-fx",
    }  # fmt: skip
    for comparison in house.outcome["comparisons"]:
        errors = {entry["decoupler"]: entry["errors"]["rel_err"] for entry in comparison["entries"]}
        ours = errors.pop("skip net from the response (ours)")
        assert ours < comparison["paper_rel_err"]
        assert ours < errors["least squares on √R"]
        assert ours < errors["eq. 8, each pillar alone"]
    files = [house.folder / path for stage in house.outcome["stages"] for path in stage["files"]]
    assert len(files) > 20
    assert all(path.stat().st_size > 0 for path in files)


def test_a_second_run_makes_only_what_was_changed_by_hand_and_says_so(house):
    shown = house.tripillar(*RUN)
    assert shown.stdout.count("reused, nothing changed") == 6
    broken = house.folder / "out/cad/unit.stl"
    whole = broken.read_bytes()
    broken.write_bytes(whole[:100])
    with netCDF4.Dataset(house.folder / "out/data/contact-fz-test.nc", "a") as opened:
        opened["resistance_ohm"][3, 0, 0, 0] = np.nan
    again = house.result(*RUN)
    assert made_anew(again) == ["CAD", "datasets", "table"]
    assert again["comparisons"] == house.outcome["comparisons"]
    assert broken.read_bytes() == whole


def test_another_resistivity_solves_nothing(house):
    (house.folder / "ohms.toml").write_text("resistivity_ohm_mm = 8000\n" + SMALL)
    again = house.result("run", "--design", "ohms.toml", "--out", "ohms", "--until", "dataset", "--quiet")
    assert made_anew(again) == ["CAD", "datasets"]
    ours, theirs = (read_samples(house.folder / out / "data/contact-fz-test.nc") for out in ("out", "ohms"))
    assert np.allclose(theirs.resistance_ohm, 2 * ours.resistance_ohm, rtol=1e-12)


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


def test_cross_validation_has_the_mean_of_its_folds(house, monkeypatch):
    monkeypatch.setattr("decoupler.evaluation.crossval.in_parallel", one_after_another)
    asked = ["--data", "out/data/contact-fz-test.nc", "--component", "fz", "--hidden", "4", "--quiet"]
    tested = house.result("evaluate", *asked, "--folds", "4", "--seed", "3")
    assert len(tested["folds"]) == 4
    assert tested["mean_rel_err"] == pytest.approx(sum(fold["rel_err"] for fold in tested["folds"]) / 4)


def test_response_and_mesh_and_design_and_cad(house):
    assert house.result("response", "--out", "response.nc", "--design", "small.toml", "--quiet")["reused"]
    with xr.open_dataset(house.folder / "response.nc") as opened:
        assert opened["influence_mm_per_n"].dims == (
            "row", "col", "electrode", "axis", "load_row", "load_col", "load_axis",
        )  # fmt: skip
        assert list(opened["load_axis"].values) == ["x", "y", "z"]
    meshing = ("cad", "--mesh", "--design", "small.toml", "--out", "solids", "--quiet")
    first, second = (house.result(*meshing) for _ in range(2))
    assert (second["mesh"]["reused"], len(first["files"])) == (True, 21)
    printed = house.tripillar("design").stdout
    assert house.tripillar("design", "--out", "paper.toml").returncode == 0
    assert (house.folder / "paper.toml").read_text() == printed


def test_replay_gives_the_forces_behind_recorded_frames(house):
    """Frames made from a dataset's resistances: forces as the model gives them, but for the converter's steps."""
    data = read_samples(house.folder / "out/data/contact-fz-test.nc")
    info = Info(rows=1, cols=2, bits=16)
    (house.folder / "press.frames").write_bytes(recording_from_resistances(data.resistance_ohm, info))
    replayed = house.result("replay", "press.frames", "--model", MODEL)
    assert (replayed["frames"], replayed["saturated_frames"], replayed["axes"]) == (100, 0, ["z"])
    found, known = np.array(replayed["force_n"])[..., 0], data.force_n[..., 2]
    assert np.abs(found - known).max() < 0.02 * known.max()  # 16 bits and the model's own error, well below 1 %
    assert house.tripillar("replay", "press.frames", "--model", MODEL, "--out", "forces.nc").returncode == 0
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
