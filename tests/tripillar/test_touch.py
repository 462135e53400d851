"""Touch on the command line and live: `train --touch`, `evaluate`, `live` and `replay` with its file."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import tripillar as tp
from dataset import DatasetSettings, read_samples, simulate
from decoupler.data.pairs import Pairs
from decoupler.twin import identify
from fem.array.closed_forms import layer_response
from fem.contact import surface_compliance
from hardware.link.frames import Info, ScanMode
from studies.pictures.touch import draw_ball, traction_of
from studies.touched import read_touch
from tests.decoupler.synthetic_sensor import layer_sensitivities
from tests.hardware.boards import recording_from_resistances
from tests.house import SMALL, House

PRESSES = 16
READ = ("--noise", "0.001", "--bits", "12", "-q", "-o")
INDENT = ("dataset", "--protocol", "indent", "--samples", "8", "--seed", "5")
TRAIN = ("train", "--touch", "-q", "--design")
TRACTIONS = DatasetSettings(protocol="three-axis", samples=60, seed=1, noise=0.001, bits=12)
EVALUATE = ("evaluate", "-q", "--model")


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """Contacts with a small sensor, and a decoder that was made of few presses."""
    house = House(tmp_path_factory.mktemp("touch"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("decoupler.touch.library.PRESSES", PRESSES)
        patch.setattr("decoupler.touch.library.OWN_PRESSES", 3)
        made = house.result(*TRAIN, "small.toml", "-o", "touch.safetensors")
        assert PRESSES / 2 < made["presses"] <= PRESSES
        assert made["rows"] > 3 * made["presses"]
        assert house.result(*TRAIN, "small.toml", "-o", "t.safetensors")["reused"]
        trimesh.creation.capsule(height=9.0, radius=3.0).apply_scale(1e-3).export(house.folder / "tool.stl")
        patch.setattr("decoupler.touch.library.PRESSES", 2)
        own = house.result(*TRAIN, "small.toml", "--shape", "tool.stl", "--unit", "m", "-o", "t.safetensors")
        assert 2 < own["presses"] <= 5
    house.result(*INDENT, "--design", "small.toml", *READ, "indent.nc")
    return house


def test_its_errors_are_those_of_units_of_the_net_force_and_of_the_place(house):
    found = house.result(*EVALUATE, "touch.safetensors", "--data", "indent.nc")
    none = np.sqrt((read_samples(house.folder / "indent.nc").force_n[..., 2] ** 2).mean())
    assert found["fz"]["rmse_n"] < none
    assert set(found["fz"]) >= {"rel_err", "rmse_n", "full_scale_pct", "coverage"}
    assert 0 < found["net"]["fz_median_pct"] < 60
    assert 0 < found["net"]["centre_mm"] < 6
    assert found["loaded"]["fz_rmse_n"] < none * 2
    assert len(found["loaded"]["coverage"]) == 2
    shown = house.tripillar(*EVALUATE, "touch.safetensors", "--data", "indent.nc")
    assert "centre of pressure" in shown.stdout


def test_a_recording_is_replayed_and_shown_with_it(house):
    data = read_samples(house.folder / "indent.nc")
    model = tp.read_model(house.folder / "touch.safetensors")
    depth = np.array([0.7, 0.8, 0.9, 1.0])[:, None, None, None]  # one press, deeper from scan to scan
    ohms = model.rest_resistances() + depth * (data.resistance_ohm[0] - model.rest_resistances())
    info = Info(rows=1, cols=2, bits=12, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700)
    (house.folder / "press.frames").write_bytes(recording_from_resistances(ohms, info))
    replayed = house.result("replay", "press.frames", "--model", "touch.safetensors")
    expected = model.forces(ohms)[..., 2].sum(axis=(1, 2))
    found = np.array(replayed["force_n"])[..., 2].sum(axis=(1, 2))
    assert found == pytest.approx(expected, rel=0.3, abs=5.0)  # the crossbar's converter is another one
    lines = house.tripillar("live", "press.frames", "--model", "touch.safetensors", "--json", "-q").stdout.splitlines()
    shown = [json.loads(line) for line in lines]
    assert [one["net_force_n"][2] for one in shown] == pytest.approx(found, abs=1e-3)
    (contact,) = shown[-1]["contacts"]
    net = np.array(shown[-1]["net_force_n"])
    assert (np.abs(np.array(contact["force_n"]) - net) < 3 * np.array(contact["force_deviation_n"])).all()


def test_the_traction_that_is_drawn_carries_the_decoded_force(house, coarse):
    model = read_touch(house.folder / "touch.safetensors")
    images = draw_ball(model, surface_compliance(model.design)[0], frames=2)
    assert len({image.tobytes() for image in images}) == 2
    reading = model.columns(read_samples(house.folder / "indent.nc").resistance_ohm)[0]
    whole = model.touched(reading)
    followed = model.touched(reading, whole)  # no nearest presses in it, which have no traction
    assert traction_of(followed)[1][2].sum() == pytest.approx(followed.force_n[:, 2].sum(), rel=0.01)


def test_what_a_decoder_of_touch_cannot_is_refused_and_one_of_pads_says_that_contacts_are_none_of_its_loads(house):
    (house.folder / "text.stl").write_text("no solid")
    for words, told in (
        (("export", "--model", "touch.safetensors", "-o", "m.h"), "is a decoder of touch: export takes a model of"),
        (("train", "--touch", "--shape", "tool.stl", "-o", "n.safetensors"), "give --unit m (15 mm)"),
        (("train", "--touch", "--turn", "90", "-o", "n.safetensors"), "--turn, --unit and --scale are of tools"),
        (("train", "--touch", "--shape", "text.stl", "-o", "n.safetensors"), "holds no triangles"),
        (("train", "--data", "indent.nc", "--shape", "tool.stl", "-o", "n.safetensors"), "is of decoders of touch"),
        (("train", "--data", "indent.nc", "-o", "n.safetensors"), "'tripillar train --touch' decodes these"),
    ):
        assert told in house.refusal(*words)
    pads = simulate(layer_response(tp.read_design(house.folder / "small.toml")), TRACTIONS)
    tp.write(pads, house.folder / "pads.nc")
    house.result("train", "--data", "pads.nc", "-o", "pads.safetensors", "-q", "--force")  # of an endless layer
    said = house.tripillar(*EVALUATE, "pads.safetensors", "--data", "indent.nc").stderr
    assert "warning: indent.nc: the protocol 'indent' presses shapes" in said
    tp.write(replace(read_samples(house.folder / "indent.nc"), made_from={}), house.folder / "measured.nc")
    said = house.tripillar(*EVALUATE, "pads.safetensors", "--data", "measured.nc").stderr
    assert "of these readings, of its own sensor's 97% and more" in said
    assert "seem" not in said  # no mistake is named that explains nothing


@pytest.mark.parametrize("presses", [2, pytest.param(60, marks=pytest.mark.long)])
def test_a_sensor_as_made_is_felt_by_its_twin(house, monkeypatch, presses):
    """Ten pairs on pads lead to its own library and pillars; errors, of presses enough, are as of one as designed."""
    monkeypatch.setattr("decoupler.touch.library.PRESSES", presses)
    (house.folder / "made.toml").write_text(f"{SMALL}[unit]\nheight_mm = 10.3\n")
    meant, made = (tp.read_design(house.folder / name) for name in ("small.toml", "made.toml"))
    specimen = {"gain_spread": 0.1, "offset_ohm": 40.0, "specimen": 3}
    read = simulate(layer_response(made), replace(TRACTIONS, samples=10, **specimen))
    tp.write(read, house.folder / "read.nc")
    pairs = Pairs.of(replace(read.labels(), design=meant))
    tp.write(identify(pairs, layer_response(meant), layer_sensitivities(meant)), house.folder / "own.toml")
    house.result(*TRAIN, "own.toml", "-o", "own-touch.safetensors")
    assert tp.read_model(house.folder / "own-touch.safetensors").is_identified
    said = house.refusal(*EVALUATE, "touch.safetensors", "--data", "read.nc")
    assert "trained for another sensor" in said
    if presses == 60:
        as_made = ("--gain-spread", "0.1", "--offset", "40", "--specimen", "3", "--design", "made.toml")
        house.result(*INDENT, *as_made, *READ, "made.nc")
        house.result(*TRAIN, "small.toml", "-o", "designed.safetensors")
        found = house.result(*EVALUATE, "own-touch.safetensors", "--data", "made.nc")
        designed = house.result(*EVALUATE, "designed.safetensors", "--data", "indent.nc")
        assert found["fz"]["rmse_n"] < 1.3 * designed["fz"]["rmse_n"]
        assert found["net"]["centre_mm"] < 1.3 * designed["net"]["centre_mm"]


@pytest.mark.long
def test_stiff_pads_have_a_decoder_of_whatever_presses_them_too(house, monkeypatch):
    """Six pillars a unit: presses made and read by commands, without a library of presses."""
    monkeypatch.setattr("fem.contact.surface._extrapolated", lambda source: source.condensed(1, 3))
    stiff = 'layout = "six-pillar"\n' + SMALL + '[pad]\nkind = "stiff"\n'
    (house.folder / "stiff.toml").write_text(stiff)
    made = house.result(*TRAIN, "stiff.toml", "-o", "plates.safetensors")
    assert made["plates"] == 2
    house.result(*INDENT, "--design", "stiff.toml", *READ, "stiff.nc")
    found = house.result(*EVALUATE, "plates.safetensors", "--data", "stiff.nc")
    assert found["fz"]["rmse_n"] < 2.0  # noise leaves 0.8 N on a loaded plate
    assert found["net"]["fz_median_pct"] < 3
