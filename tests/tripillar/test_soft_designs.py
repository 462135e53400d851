"""A design of soft rubber goes through every command by loads that it bears; what is moved too far is said."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import tripillar as tp
from dataset import read_samples
from dataset.loads import PAPERS, Loads, loads_of
from decoupler.twin.next_load import loads_at_hand
from fem.array.closed_forms import layer_response
from geometry.design import Array, Material, SensorDesign
from tests.house import SMALL, House
from tripillar.face import twins
from tripillar.face.caller import Caller, called_by
from tripillar.viewer.page.controls import controls_of, sliders_of

SOFT = Material(young_mpa=0.05, poisson=0.49)
DESIGN = SensorDesign(array=Array(rows=1, cols=2), matrix_material=SOFT, pillar_material=SOFT)
RUBBER = "young_mpa = 0.05\npoisson = 0.49\n"
AREA_MM2 = DESIGN.pad.size_mm**2


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """A folder with a soft design."""
    folder = tmp_path_factory.mktemp("soft")
    text = f"{SMALL}[matrix_material]\n{RUBBER}[pillar_material]\n{RUBBER}"
    (folder / "soft.toml").write_text(text)
    return House(folder)


def test_a_data_set_is_drawn_within_the_designs_own_range_and_says_so_in_newtons(house):
    """Rubber 122 times softer than the paper's bears a load 122 times smaller; what is given is taken as it is."""
    command = "dataset", "--design", "soft.toml", "--samples", "50", "--protocol", "contact", "--out", "soft.nc"
    done = house.tripillar(*command)
    found = house.result(*command)
    low, high = found["pressure_mpa"]
    assert 3.0 < high * 6.1 / 0.05 < 5.0  # the paper's 2 units bear as much
    assert low == pytest.approx(high / 5)
    assert (
        f"pressure of {low:.3g} to {high:.3g} MPa ({low * AREA_MM2:.3g} to {high * AREA_MM2:.3g} N a pad)"
        in done.stdout
    )
    assert "the paper's loads strain this design's pillars beyond the cap of 0.3" in done.stdout
    assert "light loads are more frequent" not in done.stdout
    with xr.open_dataset(house.folder / "soft.nc") as data:
        assert data.attrs["pressure_mpa"].tolist() == [low, high]
        assert data.force_n.sel(axis="z").max() <= high * AREA_MM2 * (1 + 1e-12)  # rounding
    far = house.tripillar(*command, "--pressure", str(high), str(2 * high))
    assert "of all draws passed the cap, so light loads are more frequent than in the protocol" in far.stdout
    assert "--pressure 5 1 must be the least and the largest" in house.refusal(*command, "--pressure", "5", "1")


def test_a_table_of_loads_is_a_protocol(house):
    """Every load comes, as often as the others to five standard deviations, and no other."""
    (house.folder / "loads.csv").write_text(
        "load,kind,row,col,fz_n,fx_n\na,pad,0,0,2,0\nb,pad,0,1,3,0.5\nc,nothing,,,,\n"
    )
    command = "dataset", "--design", "soft.toml", "--samples", "300", "--out", "table.nc", "--protocol"
    assert house.result(*command, "table", "--loads", "loads.csv")["redrawn"] == 0
    data = read_samples(house.folder / "table.nc")
    loads, count = np.unique(data.force_n.reshape(300, -1).round(9), axis=0, return_counts=True)
    assert loads.tolist() == [[0] * 6, [0, 0, 0, 0.5, 0, 3], [0, 0, 2, 0, 0, 0]]
    assert np.abs(count - 100).max() < 5 * np.sqrt(300 * 2 / 9)
    assert data.made_from["summary"] == "3 loads of a table, drawn at random"
    assert "pressure_mpa" not in data.made_from
    assert "give --loads, too" in house.refusal(*command, "table")
    assert "--loads loads.csv belongs to --protocol table" in house.refusal(*command, "contact", "--loads", "loads.csv")
    of_range = house.refusal(*command, "table", "--loads", "loads.csv", "--pressure", "1", "5")
    assert "protocol 'table' has no such loads on pads: leave it out" in of_range


def test_loads_to_measure_next_are_those_that_it_bears(coarse):
    """15 kg on a pad are 30 times what it bears; a load that it bears is named."""
    said = []
    with called_by(Caller(say=said.append)):
        kept = twins._bearable(loads_at_hand("pad:15kg,pad:1N", DESIGN), DESIGN)
    assert [load.name for load in kept] == ["nothing", "1N on 0 0", "1N on 0 1"]
    bears_n, named_n = map(float, re.fullmatch(r".* ([\d.]+) N a pad that this .* pad:([\d.]+)N", said[0]).groups())
    assert 1.0 < bears_n < 5.0 * AREA_MM2 / 100  # rubber 122 times softer than the paper's
    assert named_n == pytest.approx(bears_n / 2, rel=5e-3)
    assert said[0].startswith("2 of 5 loads are left out")


def test_what_is_shown_bears_its_load_unless_another_is_asked_for_which_is_said(house):
    """By its own load the top moves by a part of its height; by the paper's 3 MPa linear rubber would pass the base.

    The most that can be drawn moves it by its height.
    """
    done = house.tripillar("view", "soft.toml", "--save", "own.vtm", "--json")
    ((name, moved_mm),) = json.loads(done.stdout)["largest_displacement_mm"].items()
    assert float(name.split()[0]) < 0.1
    assert 0.5 < moved_mm < 0.4 * 10.0
    assert "the design does not bear the paper's loads; shown in the middle of its own range" in done.stderr
    far = house.result("view", "soft.toml", "--save", "far.vtm", "--pressure", "60%", "100%")["largest_displacement_mm"]
    assert next(iter(far)) == name
    assert list(far.values()) == pytest.approx([moved_mm, moved_mm / 0.6], rel=1e-4)  # linear; pressures have 6 digits
    refused = house.tripillar("view", "soft.toml", "--save", "no.vtm", "--pressure", "3")
    assert refused.returncode == 2
    most = re.search(r"times its height there: draw at most (\S+) MPa, or write", refused.stderr)
    assert most, refused.stderr
    assert not (house.folder / "no.vtm").exists()
    far = house.result("view", "soft.toml", "--save", "far.vtm", "--pressure", most[1])
    (moved_mm,) = far["largest_displacement_mm"].values()
    assert 9.0 < moved_mm <= 10.0
    assert f"and the top moves by {moved_mm / 10:.0%} of the height" in far["note"]
    paper = house.tripillar("view", "small.toml", "--save", "paper.vtm")
    assert paper.stdout.startswith("3 MPa at the indenter's middle")
    assert "bear" not in paper.stderr


def test_a_press_that_moves_the_top_by_more_than_a_fifth_of_its_height_is_warned_of(house):
    """The rubber beside it moves aside, too, so that the depth is the least that it moves by."""
    punch = "press", "--design", "soft.toml", "--shape", "flat", "--size", "14"
    for depth, is_far in (("1.0", False), ("2.1", True)):
        said = house.tripillar(*punch, "--depth", depth).stderr
        assert ("mm, over 0.2 of the slab's height of 10 mm" in said) == is_far, said


def test_another_law_is_pressed_at_finite_strain_and_with_friction_by_its_tangent_at_rest_which_is_said(
    house, monkeypatch
):
    """The tangent's contact is linear rubber's; the response says what it is, too."""
    monkeypatch.setattr("fem.contact.finite.CELLS", (2, 3))
    text = (house.folder / "soft.toml").read_text().replace("young_mpa", 'model = "neo-hookean"\nyoung_mpa')
    (house.folder / "neo.toml").write_text(text)
    ball = "press", "--shape", "sphere", "--radius", "10", "--depth", "2", "--json", "--design"
    for friction in ("0.5", "0"):
        (linear, own) = (house.tripillar(*ball, f"{name}.toml", "--friction", friction) for name in ("soft", "neo"))
        ratio = json.loads(own.stdout)["net_force_n"][2] / json.loads(linear.stdout)["net_force_n"][2]
        assert (ratio == 1.0) == (friction == "0.5")
        assert abs(ratio - 1.0) < 0.05
        told = "the contact of neo-hookean rubber is that of its tangent at rest, as there is friction; where the top"
        assert (told in own.stderr) == (friction == "0.5")
        assert ("finite strain: " in own.stderr) == (friction == "0")
        assert "tangent" not in linear.stderr
    assert "tangent at rest" in house.tripillar("response", "--design", "neo.toml", "--out", "neo.nc").stderr


def test_a_board_is_pressed_and_a_page_loaded_within_the_range(tmp_path):
    response = layer_response(DESIGN)
    own = loads_of(response)
    assert own != PAPERS
    with (
        pytest.warns(UserWarning, match="does not bear the paper's loads"),
        tp.board(response, chip="python", period_s=1.0, truth=tmp_path / "truth.nc"),
        xr.open_dataset(tmp_path / "truth.nc") as truth,
    ):
        assert float(truth.force_n.max()) == pytest.approx(own.middle_mpa * AREA_MM2, rel=0.01)
    for loads in (own, PAPERS):
        controls = controls_of(DESIGN, False, loads)
        assert (controls["peak"].start, controls["pressure"].max) == (loads.middle_mpa, loads.normal_mpa[1])
        asked = np.array([loads.tangential_mpa[1] / 2, 0.0, -loads.normal_mpa[1] / 3])
        pressure, shear, angle = sliders_of(asked, loads)
        assert (pressure, shear, angle) == pytest.approx((-asked[2], asked[0], 0.0), rel=0.02)  # rounded
        assert sliders_of(10 * asked, loads)[0] == loads.normal_mpa[1]
    given = replace(DESIGN, pillar_material=Material(), matrix_material=Material())
    assert loads_of(layer_response(given)) == PAPERS == Loads()


def test_a_contact_with_a_large_estimated_error_is_warned_of_or_refused(house):
    """A small ball between electrodes, and one at the sensor's side; nothing is written of what is refused."""
    ball = "press", "--design", "soft.toml", "--shape", "sphere", "--out", "ball.nc"
    said = house.tripillar(*ball, "--radius", "1", "--depth", "0.2").stderr
    assert re.search(r"warning: the estimated error of the electrodes is \d+%, above 5%", said), said
    at_side = *ball[:-1], "side.nc", "--radius", "2", "--depth", "0.3", "--at=14.8,0"
    refused = house.tripillar(*at_side)
    mend = r"the estimated error of the \w+ is \d\d%, above 20%: press with .* or take .* by --force"
    assert refused.returncode == 2
    assert re.search(mend, refused.stderr)
    assert not (house.folder / "side.nc").exists()
    house.tripillar(*at_side, "--force")
    assert (house.folder / "side.nc").exists()
