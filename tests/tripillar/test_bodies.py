"""`tripillar solve` and `press`: one JSON object, tables, fields and pictures; what leaves linear strain is said."""

import json

import numpy as np
import pytest
import pyvista as pv
import trimesh
from PIL import Image

from dataset import read_samples
from tests.fem.scenes import PILLAR
from tests.house import House

KEYS = {"probes", "energy_mj", "residual", "dofs", "error_estimate", "seconds", "plan"}
FINITE = {"work_mj", "energy_imbalance", "least_j", "iterations", "load_steps"}
ROUGHLY = ("--tolerance", "0.1")


@pytest.fixture
def house(tmp_path):
    house = House(tmp_path)
    (tmp_path / "pillar.toml").write_text(PILLAR)
    return house


def test_people_get_a_table_the_plan_and_a_field_and_programs_one_json_object(house):
    """The field in a folder that is made; with --json stdout holds nothing but the object."""
    done = house.tripillar("solve", "pillar.toml", "--explain", *ROUGHLY, "--vtu", "new/p.vtu")
    assert done.returncode == 0
    assert "mesh: hexahedra, the body is one box" in done.stdout
    assert "uz [mm]" in done.stdout
    assert done.stderr.splitlines()[-1] == "new/p.vtu"
    assert np.isclose(pv.read(house.folder / "new/p.vtu").volume, 40.0, rtol=1e-6)
    done = house.tripillar("solve", "pillar.toml", "--json", "--explain", *ROUGHLY)
    found = json.loads(done.stdout)
    assert (set(found), "mesh: hexahedra" in done.stderr) == (KEYS, True)
    ux, uy, uz = found["probes"]["top"]
    assert ux > 1 > -1 > uz  # pressed down, a pillar that leans to +x gives way along +x
    assert abs(uy) < 1e-3
    assert np.isclose(found["energy_mj"], 0.5 * -0.04 * uz, rtol=1e-6)  # the load's work, ½ f·u


def test_finite_strain_says_what_it_did_and_what_is_beyond_linear_strain_or_the_tolerance_is_a_warning(
    house, monkeypatch
):
    text = PILLAR.replace("poisson = 0.49", 'poisson = 0.49\nmodel = "neo-hookean"')
    (house.folder / "finite.toml").write_text(text)
    found = house.result("solve", "finite.toml", "--tolerance", "0.5")
    assert set(found) == KEYS | FINITE
    assert abs(found["energy_imbalance"]) < 0.01
    (house.folder / "far.toml").write_text(PILLAR.replace("-0.01]", "-1e6]"))
    monkeypatch.setattr("fem.methods.box_refinement.MAX_BOXES", 10)
    monkeypatch.setattr("fem.methods.box_refinement.SplitBoxes.error", lambda _: 0.3)
    done = house.tripillar("solve", "far.toml", "--json")
    assert json.loads(done.stdout)["error_estimate"] == 0.3
    assert "linear elasticity holds for small strains only" in done.stderr
    assert "warning: the estimated error 3.0e-01 stays above the tolerance 0.001" in done.stderr


def test_a_tool_is_pressed_by_its_unit_and_turn_and_refused_where_they_are_in_doubt(house):
    cone = trimesh.creation.cone(8.0, 12.0, sections=24).apply_scale(1 / 25.4)
    trimesh.Trimesh(cone.vertices, cone.faces[:, ::-1], process=False).export(house.folder / "tool.stl")
    asked = ("press", "--design", "small.toml", "--depth", "0.3", "--shape")
    assert "give --unit cm (6.3 mm) or --unit inch (16 mm), or --unit mm" in house.refusal(*asked, "tool.stl")
    done = house.tripillar(*asked, "tool.stl", "--unit", "inch", "--json")
    assert "warning: tool.stl: 100% of its underside faces inwards" in done.stderr
    upright = house.result(*asked, "tool.stl", "--unit", "inch", "--turn", "180,0,30")
    assert 0 < upright["net_force_n"][2] < 0.05 * json.loads(done.stdout)["net_force_n"][2]
    told = house.refusal(*asked, "tool.stl", "--unit", "mm", "--scale", "0.1")
    assert (
        "deeper than the tool is high, 0.0472 mm: press less deep, or give --unit cm (4.72 mm) or --unit inch" in told
    )
    for words, told in (
        (
            ("tool.stl", "--radius", "3"),
            "--radius is not of --shape tool.stl, which takes --turn and --unit and --scale",
        ),
        (("tool.stl", "--turn", "1,2"), "--turn 1,2: must be one about z or three angles, such as 180,0,45"),
        (("flat", "--size", "4", "--turn", "1,2,3"), "--turn 1,2,3: must be one angle, about z"),
        (("tool.dwg",), "a file that ends in .stl, .obj, .ply, .step, .stp"),
    ):
        assert told in house.refusal(*asked, *words)


def test_a_shape_is_pressed_dragged_written_and_drawn(house):
    turned = ("--shape", "flat", "--size", "6,4", "--turn", "20", "--depth", "0.3", "--at", "5,-1", "--slide", "0.1,0")
    written = ("--design", "small.toml", "--out", "contact.nc", "--picture", "contact.png")
    found = house.result("press", *turned, "--friction", "0.5", *written)
    assert np.sum(found["force_n"], axis=(0, 1)) == pytest.approx(found["net_force_n"], rel=1e-9)
    assert found["net_force_n"][0] > 0
    assert found["centre_mm"] == pytest.approx([5.0, -1.0], abs=0.5)
    kept = read_samples(house.folder / "contact.nc")
    assert kept.resistance_ohm[0] == pytest.approx(np.array(found["resistance_ohm"]), rel=1e-12)
    with Image.open(house.folder / "contact.png") as picture:
        assert picture.size[0] > 1000
