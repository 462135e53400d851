"""A layout from its name to decoded forces on the command line, and what is refused of another one's files."""

from pathlib import Path

import numpy as np
import pytest

import tripillar as tp
from common.errors import DesignError
from dataset import DatasetSettings, Samples, read_samples, simulate
from decoupler import read_model
from fem.array.closed_forms import layer_response
from geometry.design import Array, SensorDesign, Unit
from geometry.design_file import design_to_toml
from geometry.layout import LAYOUTS, Electrode, Layout, Pillar
from tests.house import SMALL, House
from tripillar.face.caller import Caller, called_by
from tripillar.sweeps.judge import metrics_of
from tripillar.viewer.page.sensing import inverse_forces

READ = ("--noise", "0.001", "--bits", "12")


@pytest.mark.long  # its parts are in tests/decoupler/test_sensor_model.py
@pytest.mark.parametrize("layout", ["six-pillar", "eight-pillar"])
def test_a_named_layout_goes_from_data_to_forces(tmp_path, layout):
    """Components are forces, whatever the pillars; models, exports and twins are of that layout."""
    house = House(tmp_path)
    (tmp_path / "small.toml").write_text(f'extends = "paper"\nlayout = "{layout}"\n[array]\nrows = 1\ncols = 2\n')

    def made(protocol: str, samples: int, out: str) -> Path:
        asked = ("--protocol", protocol, "--samples", str(samples), "--out", out, *READ)
        house.result("dataset", "--design", "small.toml", *asked)
        return tmp_path / out

    data = read_samples(made("three-axis", 300, "a.nc"))
    names = LAYOUTS[layout].pillar_names
    assert list(data.to_xarray().pillar) == list(names)
    assert data.displacement_mm.shape[-2] == len(LAYOUTS[layout].upper)
    house.result("train", "--data", "a.nc", "--component", "all", "--out", "all.safetensors")
    made("independent-fx", 100, "fx.nc")
    house.result("train", "--data", "fx.nc", "--component", "fx", "--out", "fx.safetensors")
    taken = read_model(tmp_path / "fx.safetensors").pillars
    assert {names[pillar][0] for pillar in taken} == {"x"}
    found = house.result("evaluate", "--model", "all.safetensors", "--data", str(made("three-axis", 100, "b.nc")))
    assert max(found[force]["ratio"] for force in ("fx", "fy", "fz")) < 1.2  # of 300 samples
    house.result("export", "b.nc", "-o", "b.csv")
    again = house.result("evaluate", "--model", "all.safetensors", "--data", "b.csv")
    assert again["fx"]["rmse_n"] == pytest.approx(found["fx"]["rmse_n"], rel=1e-12)
    house.result("export", "--model", "all.safetensors", "--out", "all.h")
    assert f"pillars {', '.join(names)}" in (tmp_path / "all.h").read_text()
    house.result("identify", "--data", "b.nc", "--out", "own.safetensors", "--twin", "twin.toml")
    assert "\nz3 = [" in (tmp_path / "twin.toml").read_text()
    (tmp_path / "paper.toml").write_text(SMALL)
    house.result("dataset", "--samples", "10", "--protocol", "contact", "--design", "paper.toml", "--out", "paper.nc")
    said = house.refusal("evaluate", "--model", "all.safetensors", "--data", "paper.nc")
    assert f"layout: model {layout}, data song2018" in said


def test_who_picks_uprights_alone_hears_what_their_shear_is_worth(tmp_path):
    """From `design`, `train` and `evaluate`, of the components that are asked for; leaning pillars need no word."""
    house, told = House(tmp_path), "no pillar leans along x or y: forces that way are told by tilt alone"
    assert told in house.tripillar("design", "--layout", "upright-four", "-o", "four.toml").stderr
    assert "tilt" not in house.tripillar("design", "--layout", "eight-pillar", "-o", "eight.toml").stderr
    design = SensorDesign(unit=Unit(layout=LAYOUTS["upright-four"]), array=Array(rows=1, cols=2))
    response, said = layer_response(design), list[str]()
    with called_by(Caller(say=said.append)):
        for protocol, count in (("three-axis", 2), ("contact-fz", 0)):
            samples = simulate(response, DatasetSettings(protocol=protocol, samples=40, seed=1, noise=1e-3))
            tp.evaluate(tp.train(samples, hidden=2, response=response), samples, response=response)
            assert sum(told in line for line in said) == count
            said.clear()


def test_forces_that_pillars_do_not_tell_are_not_trained():
    upright = Layout((Electrode("U", (0, 0)),), (Electrode("L", (0, 0)),), (Pillar("p", "L", "U"),))
    design = SensorDesign(unit=Unit(layout=upright), array=Array(rows=1, cols=1))
    generator = np.random.default_rng(1)
    force_n, resistance_ohm = generator.uniform(-9.0, 9.0, (40, 1, 1, 3)), generator.uniform(8e3, 9e3, (40, 1, 1, 1))
    samples = Samples(force_n=force_n, resistance_ohm=resistance_ohm, design=design)
    with pytest.raises(DesignError, match="pillars p do not tell forces along x and y from others"):
        tp.train(samples, component="all")


def test_a_mat_that_no_design_describes_is_trained_tared_and_read_from_tables_and_logs(tmp_path):
    """Conductance follows force, over more than the factor of 4 that a strained pillar has; another day is 20 % off."""
    house, generator = House(tmp_path), np.random.default_rng(0)
    newtons = generator.uniform(0.0, 20.0, (240, 2, 2)) * (generator.uniform(size=(240, 2, 2)) < 0.6)
    newtons[:30] = 0.0
    ohms = 3e4 * generator.lognormal(0.0, 0.1, (2, 2)) / (1.0 + newtons) * generator.normal(1.0, 1e-3, newtons.shape)
    for name, part in (("train.csv", slice(200)), ("test.csv", slice(200, None))):
        rows = np.hstack([each[part].reshape(-1, 4) for each in (ohms, newtons)])
        header = ",".join(f"{kind}_{row}_{col}" for kind in "rf" for row, col in np.ndindex(2, 2))
        np.savetxt(tmp_path / name, rows, "%.6g", ",", header=header, comments="")
    house.result(
        "train", "--data", "train.csv", "--component", "fz", "--feature", "resistance", "--out", "m.safetensors"
    )
    rmse_n = house.result("evaluate", "--model", "m.safetensors", "--data", "test.csv")["fz"]["rmse_n"]
    for name, factor, part in (
        ("same.log", 1.0, slice(200, 240)),
        ("other.log", 1.2, slice(200, 240)),
        ("rest.log", 1.2, slice(30)),
    ):
        shown = np.tile(ohms[part], (2 if name == "rest.log" else 1, 1, 1)).reshape(-1, 4)
        np.savetxt(tmp_path / name, factor * shown, "%.6g")
    size = ("--rows", "2", "--cols", "2")
    house.result("tare", "rest.log", *size, "--seconds", "0.5", "--out", "rest.json")

    def off(name: str, *calibrated: str) -> float:
        found = house.result("replay", name, "--model", "m.safetensors", *size, *calibrated)
        assert found["left_out"] == []
        return float(np.sqrt(np.mean((np.array(found["force_n"])[..., 0] - newtons[200:]) ** 2)))

    assert off("same.log") == pytest.approx(rmse_n, rel=0.01)
    with (tmp_path / "same.log").open("a") as log:
        log.write("1 2 3\n")
    told = house.tripillar("replay", "same.log", "--model", "m.safetensors", *size).stderr
    assert "1 lines that are no matrix of numbers from 0 on are left out" in told
    assert off("other.log", "--calibration", "rest.json") == pytest.approx(rmse_n, rel=0.05)
    assert off("other.log") > 2.0 * rmse_n


def test_a_sensor_of_one_axis_is_judged_shown_and_trained_by_pressure_alone(tmp_path):
    design = SensorDesign(unit=Unit(layout=LAYOUTS["single"]), array=Array(rows=1, cols=2))
    response = layer_response(design)
    found = metrics_of(response, 1e-3, 12, 0.3)
    assert found["error_n"] == found["error_z_n"] < 10.0
    assert found["error_x_n"] == "pillars do not tell forces along x and y from others"
    samples = simulate(response, DatasetSettings(protocol="three-axis", samples=40, seed=1, noise=1e-3))
    told = inverse_forces(response)(samples.resistance_ohm[0])
    assert np.isnan(told[..., :2]).all()
    assert np.isfinite(told[..., 2]).all()
    with called_by(Caller(say=lambda line: None)):
        assert tp.train(samples, hidden=2, response=response).component.name == "fz"


def test_a_mat_is_identified_by_pressure_from_a_table_of_loads_with_a_reading_a_unit(tmp_path):
    """Its decoder reads contacts without shear, and what to measure next is judged by these."""
    house, design = House(tmp_path), SensorDesign(unit=Unit(layout=LAYOUTS["single"]), array=Array(rows=1, cols=2))
    (tmp_path / "mat.toml").write_text(design_to_toml(design))
    samples = simulate(layer_response(design), DatasetSettings(protocol="independent-fz", samples=6, seed=1))
    rows = [
        f"{n},0,0,{f[0, 0, 2]:.6f},{r[0, 0, 0]:.5f},{r[0, 1, 0]:.5f}\n{n},0,1,{f[0, 1, 2]:.6f},,\n"
        for n, (f, r) in enumerate(zip(samples.force_n, samples.resistance_ohm, strict=True))
    ]
    (tmp_path / "pairs.csv").write_text("load,row,col,fz_n,r_0_0,r_0_1\n" + "".join(rows))
    asked = ("identify", "--design", "mat.toml", "--data", "pairs.csv", "--next", "1", "-o", "m.safetensors")
    assert house.result(*asked)["next"][0]["error_before"] < 1.0
    found = read_model(tmp_path / "m.safetensors")
    assert found.component.name == "fz"
    assert found.forces(samples.resistance_ohm)[..., 0] == pytest.approx(samples.force_n[..., 2], rel=0.05)
