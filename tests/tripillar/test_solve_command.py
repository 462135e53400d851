"""`tripillar solve`: one JSON object as the contract has it, one line for a mistake."""

import json

import numpy as np
import pytest
import pyvista as pv

from tests.fem.scenes import PILLAR
from tests.house import House

KEYS = {"probes", "energy_mj", "residual", "dofs", "error_estimate", "seconds", "plan"}


@pytest.fixture
def house(tmp_path):
    house = House(tmp_path)
    (tmp_path / "pillar.toml").write_text(PILLAR)
    return house


def test_the_answer_is_one_json_object(house):
    """As a person runs it: a process of its own, whose stdout holds nothing but the object."""
    done = house.process("solve", "pillar.toml", "--tolerance", "0.02", "--json", "--explain")
    found = json.loads(done.stdout)
    assert set(found) == KEYS
    assert set(found["seconds"]) == {"mesh", "assemble", "factor", "solve"}
    assert found["error_estimate"] <= 0.02
    ux, uy, uz = found["probes"]["top"]
    assert ux > 1  # pressed down, a pillar that leans to +x gives way along +x
    assert uz < -1
    assert abs(uy) < 1e-3
    # the load does its work on the mean displacement of the top: ½ f·u
    assert np.isclose(found["energy_mj"], 0.5 * -0.04 * uz, rtol=1e-6)
    assert any(line.startswith("mesh: hexahedra") for line in found["plan"])
    assert "mesh: hexahedra" in done.stderr


def test_leaving_linear_elasticity_is_a_warning(house):
    (house.folder / "far.toml").write_text(PILLAR.replace("-0.01]", "-1e6]"))
    assert (
        "linear elasticity holds for small strains only"
        in house.tripillar("solve", "far.toml", "--tolerance", "0.1", "--json").stderr
    )


def test_finite_strain_says_what_it_did_and_draws(house):
    text = PILLAR.replace("poisson = 0.49", 'poisson = 0.49\nmodel = "neo-hookean"')
    (house.folder / "finite.toml").write_text(text)
    done = house.tripillar("solve", "finite.toml", "--tolerance", "0.2", "--json", "--vtu", "finite.vtu")
    found = json.loads(done.stdout)
    assert set(found) == KEYS | {"work_mj", "energy_imbalance", "least_j", "iterations", "load_steps"}
    assert abs(found["energy_imbalance"]) < 0.01
    assert 0 < found["least_j"] < 1
    field = pv.read(house.folder / "finite.vtu")
    top = field.points[:, 2] == field.points[:, 2].max()
    assert field["displacement_mm"][top].mean(axis=0)[2] == pytest.approx(found["probes"]["top"][2], rel=0.05)
    (house.folder / "finite.toml").write_text(text.replace("-0.01]", "-10.0]"))
    refused = house.tripillar("solve", "finite.toml", "--tolerance", "0.2")
    assert refused.returncode == 2
    assert "equilibrium above" in refused.stderr
    assert "smaller load" in refused.stderr


def test_people_get_a_table_the_plan_and_a_field_for_pictures(house):
    """The field in a folder that is made."""
    done = house.tripillar("solve", "pillar.toml", "--explain", "--tolerance", "0.02", "--vtu", "new/p.vtu")
    assert done.returncode == 0
    assert "mesh: hexahedra, the body is one box" in done.stdout
    assert "uz [mm]" in done.stdout
    assert "estimated error" not in done.stderr
    assert done.stderr.splitlines()[-1] == "new/p.vtu"
    grid = pv.read(house.folder / "new/p.vtu")
    assert np.isclose(grid.volume, 40.0, rtol=1e-6)
    assert -9 < grid.point_data["displacement_mm"][:, 2].min() < -1


def test_an_estimate_above_the_tolerance_is_a_warning(house, monkeypatch):
    monkeypatch.setattr("fem.methods.box_refinement.MAX_BOXES", 10)
    monkeypatch.setattr("fem.methods.box_refinement.SplitBoxes.error", lambda _: 0.3)
    done = house.tripillar("solve", "pillar.toml", "--json")
    assert done.returncode == 0
    assert json.loads(done.stdout)["error_estimate"] == 0.3
    assert "warning: the estimated error 3.0e-01 stays above the tolerance 0.001" in done.stderr
