"""A layout from its name to decoded forces on the command line, and what is refused of another one's files."""

from pathlib import Path

import numpy as np
import pytest

import tripillar as tp
from dataset import DatasetSettings, Samples, read_samples, simulate
from decoupler import read_model
from fem.array.closed_forms import layer_response
from geometry.design import Array, SensorDesign, Unit
from geometry.errors import DesignError
from geometry.layout import LAYOUTS, Electrode, Layout, Pillar
from tests.house import SMALL, House
from tripillar.face.caller import Caller, called_by

READ = ("--noise", "0.001", "--bits", "12")


@pytest.mark.long  # its parts are in tests/decoupler/test_layouts.py
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
