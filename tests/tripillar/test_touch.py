"""Touch on the command line and live: `train --touch`, `evaluate`, `live` and `replay` with its file."""

import json

import numpy as np
import pytest
import trimesh

import tripillar as tp
from dataset import read_samples
from hardware.link.frames import Info, ScanMode
from tests.hardware.boards import recording_from_resistances
from tests.house import House

INFO = Info(rows=1, cols=2, bits=12, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700)
PRESSES = 60
READ = ("--noise", "0.001", "--bits", "12", "-q")
TESTED = ("evaluate", "--model", "touch.safetensors", "--data")


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """Contacts with a small sensor, and a decoder that was made of few presses."""
    house = House(tmp_path_factory.mktemp("touch"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("decoupler.touch.library.PRESSES", PRESSES)
        patch.setattr("decoupler.touch.library.OWN", 3)
        touched = ("train", "--touch", "--design", "small.toml", "-q", "-o")
        made = house.result(*touched, "touch.safetensors")
        assert PRESSES / 2 < made["presses"] <= PRESSES < made["rows"] / 2
        assert house.result(*touched, "t.safetensors")["reused"]
        trimesh.creation.capsule(height=9.0, radius=3.0).export(house.folder / "tool.stl")
        with patch.context() as fewer:
            fewer.setattr("decoupler.touch.library.PRESSES", 6)
            assert 6 < house.result(*touched, "t.safetensors", "--shape", "tool.stl")["presses"] <= 9
        indent = ("dataset", "--protocol", "indent", "--samples", "12", "--seed", "5", *READ)
        house.result(*indent, "--design", "small.toml", "-o", "indent.nc")
        yield house


def test_its_errors_are_those_of_units_of_the_net_force_and_of_the_place(house):
    found = house.result(*TESTED, "indent.nc", "-q")
    none = np.sqrt((read_samples(house.folder / "indent.nc").force_n[..., 2] ** 2).mean())
    assert found["fz"]["rmse_n"] < none
    assert set(found["fz"]) >= {"rel_err", "rmse_n", "full_scale_pct", "coverage"}
    assert 0 < found["net"]["fz_median_pct"] < 60
    assert 0 < found["net"]["centre_mm"] < 6
    assert found["loaded"]["fz_rmse_n"] < none * 2
    assert len(found["loaded"]["coverage"]) == 2
    assert "centre of pressure" in house.tripillar(*TESTED, "indent.nc", "-q").stdout


def test_a_recording_is_replayed_and_shown_with_it(house):
    data, model = read_samples(house.folder / "indent.nc"), tp.read_model(house.folder / "touch.safetensors")
    depth = np.array([0.7, 0.8, 0.9, 1.0])[:, None, None, None]  # one press, deeper from scan to scan
    ohms = model.rest_resistances() + depth * (data.resistance_ohm[0] - model.rest_resistances())
    (house.folder / "press.frames").write_bytes(recording_from_resistances(ohms, INFO))
    replayed = house.result("replay", "press.frames", "--model", "touch.safetensors")
    found = np.array(replayed["force_n"])[..., 2].sum(axis=(1, 2))
    # the crossbar's converter is another one
    assert found == pytest.approx(model.forces(ohms)[..., 2].sum(axis=(1, 2)), rel=0.3, abs=5.0)
    lines = house.tripillar("live", "press.frames", "--model", "touch.safetensors", "--json", "-q").stdout.splitlines()
    shown = [json.loads(line) for line in lines]
    assert [one["net_force_n"][2] for one in shown] == pytest.approx(found, abs=1e-3)
    (contact,) = shown[-1]["contacts"]
    net = np.array(shown[-1]["net_force_n"])
    assert (np.abs(np.array(contact["force_n"]) - net) < 3 * np.array(contact["force_deviation_n"])).all()


def test_what_a_decoder_of_touch_cannot_is_refused(house):
    (house.folder / "text.stl").write_text("no solid")
    tp.write(tp.dataset(tp.SensorDesign(), samples=5), house.folder / "large.nc")
    for words, told in (
        (("export", "--model", "touch.safetensors", "-o", "m.h"), "export takes a model of loads on pads"),
        (("train", "--touch", "--shape", "text.stl", "-o", "none.safetensors"), "holds no triangles"),
        (("train", "--data", "indent.nc", "--shape", "tool.stl", "-o", "n.safetensors"), "is of decoders of touch"),
        ((*TESTED, "large.nc"), "rows: model 1, data 6"),
    ):
        assert told in house.refusal(*words)


@pytest.fixture(scope="module")
def as_made(house):
    """Contacts with a sensor as made, and its twin from ten pairs on pads."""
    made = (house.folder / "small.toml").read_text()
    (house.folder / "made.toml").write_text(f"{made}[unit]\nheight_mm = 10.3\n")
    as_made = ("--gain-spread", "0.1", "--offset", "40", "--specimen", "3", *READ, "--design", "made.toml")
    house.result("dataset", "--protocol", "three-axis", "--samples", "10", "--seed", "1", *as_made, "-o", "pairs.nc")
    house.result("dataset", "--protocol", "indent", "--samples", "12", "--seed", "5", *as_made, "-o", "made.nc")
    own = ("-o", "own.safetensors", "--twin", "own.toml", "-q")
    house.result("identify", "--data", "pairs.nc", "--design", "small.toml", *own)
    return house


def test_no_decoder_of_another_sensor_or_of_pads_feels_contacts_unsaid(as_made):
    assert "trained for another sensor" in as_made.refusal(*TESTED, "made.nc", "-q")
    said = as_made.tripillar("evaluate", "--model", "own.safetensors", "--data", "made.nc", "-q").stderr
    assert "of these readings, so errors of own.safetensors are large" in said
    assert "seem" not in said  # no mistake is named that explains nothing


@pytest.mark.long
def test_a_sensor_as_made_is_felt_by_its_twin(as_made):
    """Its own library and pillars; errors are as of one as designed."""
    as_made.result("train", "--touch", "--design", "own.toml", "-o", "own-touch.safetensors", "-q")
    found = as_made.result("evaluate", "--model", "own-touch.safetensors", "--data", "made.nc", "-q")
    designed = as_made.result(*TESTED, "indent.nc", "-q")
    assert found["fz"]["rmse_n"] < 1.3 * designed["fz"]["rmse_n"]
    assert found["net"]["centre_mm"] < 1.3 * designed["net"]["centre_mm"]
    assert tp.read_model(as_made.folder / "own-touch.safetensors").is_identified
