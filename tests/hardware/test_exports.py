"""Files for other programs, as any reader of their formats finds them: NetCDF, CSV, MCAP of ROS 2 messages."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from common.errors import DesignError, FileFormatError
from decoupler.touch.decoder import TouchContact
from hardware import convert, replay, write_forces
from hardware.link.frames import Frame
from hardware.readout.wrench import SIGNS
from hardware.recording import Recorder, read_recording
from hardware.streams.ros2_file import FRAMES, SHAPE
from hardware.streams.topics import CONTACT, CONTENTS, FORCES, SCENE, SENSOR, json_bytes, schemas
from tests.hardware.models import INFO as BOARD

BEGAN_S = 1.8e9  #: Unix time
ros2_reader = pytest.importorskip("mcap_ros2.reader")
TYPES = {"integer": int, "number": (int, float), "string": str, "array": list, "object": dict, "boolean": bool}


def check(content, schema):
    """The part of JSON schema that ours use."""
    assert isinstance(content, TYPES[schema["type"]])
    if schema["type"] == "object" and schema["properties"]:
        assert set(content) == set(schema["properties"])
        for name, value in content.items():
            check(value, schema["properties"][name])
    if schema["type"] == "array":
        for value in content:
            assert value is None or check(value, schema["items"]) is None


@pytest.fixture(scope="module")
def recording(pressed, tmp_path_factory):
    """40 scans, 5 ms apart by the board's clock; they arrive up to 3 ms late, and the board restarts after 20."""
    late_s = np.random.default_rng(2).uniform(0.0, 0.003, 40)
    late_s[[0, 20]] = 0.0  # what each run is told by at once
    given = {"bits": BOARD.bits, "scan_mode": BOARD.scan_mode}
    with Recorder(tmp_path_factory.mktemp("recorded") / "press.frames", BOARD) as recorder:
        for k in range(40):
            if k == 20:
                recorder.begin_run("restart")
            us = (2**32 - 20_000 + 5000 * k) % 2**32 if k < 20 else 5000 * (k - 20)
            frame = Frame(sequence=k % 20, device_us=us, counts=pressed.counts[k], **given)
            recorder.append(frame, BEGAN_S + 0.005 * k + late_s[k])
    return read_recording(recorder.path)


@pytest.fixture(scope="module")
def forces(recording, pressed):
    return replay(recording, pressed.model)


def test_a_recording_is_the_same_in_every_form(recording, tmp_path):
    """NetCDF and CSV to the last bit."""
    for name in ("press.nc", "press.csv"):
        convert(recording, tmp_path / name)
    with xr.open_dataset(tmp_path / "press.nc", decode_times=False) as data:
        for name, values in recording.columns().items():
            assert np.array_equal(data[name], values), name
        assert data["counts"].dtype == np.uint16
        assert {name: data.attrs[name] for name in recording.plain()} == recording.plain()
        assert data.attrs["ok"] == 40
    with (tmp_path / "press.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [float(line["received_s"]) for line in lines] == recording.received_s.tolist()
    assert [[int(line[f"count_{k}"]) for k in range(18)] for line in lines] == recording.counts.tolist()


def test_forces_and_net_load_are_in_netcdf(recording, forces, pressed, tmp_path):
    write_forces(recording, forces, path := tmp_path / "press.nc")
    with xr.open_dataset(path) as data:
        for name in ("force_n", "deviation_n", "chi2"):
            assert np.array_equal(data[name], getattr(forces, name)), name
        assert np.array_equal(data["net_force_n"], forces.wrench.force_n)
        assert json.loads(data.attrs["sensor"]) == forces.description.plain()
    known, force_n = forces.description, pressed.samples.force_n
    pitch_mm = pressed.samples.design.array.pitch_mm
    assert known.position_mm[1, 2].tolist() == [pitch_mm, pitch_mm / 2, 0.0]
    assert known.range_n == pytest.approx(np.stack([force_n.min(axis=0), force_n.max(axis=0)], axis=-1), abs=1e-9)
    assert (known.design_hash, known.model_hash) == (pressed.model.design_hash, pressed.model.made_from["recipe"])


def vectors(of):
    return np.array([[each.x, each.y, each.z] for each in of])


def test_ros_finds_the_sensor_latched_and_every_force_at_the_boards_clock(recording, forces, tmp_path):
    """Stamps lie within 0.1 ms of the scans, where arrivals are up to 3 ms late; through rollover and restart."""
    write_forces(recording, forces, path := tmp_path / "press.mcap")
    found, sensor = {SHAPE: [], FRAMES: []}, forces.description
    for message in ros2_reader.read_ros2_messages(path):
        found[message.channel.topic].append(message)
    [first] = found[SHAPE]
    assert (first.ros_msg.rows, first.ros_msg.cols, first.ros_msg.axes) == (2, 3, ["x", "y", "z"])
    pads_m = 1e-3 * sensor.position_mm.reshape(-1, 3)
    assert vectors(first.ros_msg.positions) == pytest.approx(pads_m)
    assert (first.ros_msg.design_hash, first.ros_msg.board_serial) == (sensor.design_hash, 3)
    assert (vectors(first.ros_msg.force_low) <= vectors(first.ros_msg.force_high)).all()
    assert vectors(first.ros_msg.force_low)[:, 2].max() < 0  # what presses has a z below 0
    assert "durability: 1" in first.channel.metadata["offered_qos_profiles"]
    assert first.log_time_ns == found[FRAMES][0].log_time_ns
    for k, message in enumerate(found[FRAMES]):
        frame, wrench, on_pads = message.ros_msg, forces.wrench, forces.force_n[k].reshape(-1, 3) * SIGNS
        assert (frame.sequence, frame.device_us) == (recording.sequence[k], recording.device_us[k])
        assert np.array_equal(vectors(frame.forces), on_pads)
        assert np.array_equal(vectors(frame.force_deviations), forces.deviation_n[k].reshape(-1, 3))
        assert frame.resistances == forces.resistance_ohm[k].reshape(-1).tolist()
        assert vectors([frame.net.force])[0] == pytest.approx(on_pads.sum(axis=0))
        assert vectors([frame.net.torque])[0] == pytest.approx(np.cross(pads_m, on_pads).sum(axis=0))
        assert vectors([frame.net_deviation.force])[0] == pytest.approx(wrench.force_deviation_n[k])
        assert vectors([frame.center_of_pressure])[0, :2] == pytest.approx(1e-3 * wrench.centre_mm[k])
    stamps = [message.ros_msg.header.stamp for message in found[FRAMES]]
    times_s = np.array([stamp.sec - BEGAN_S + 1e-9 * stamp.nanosec for stamp in stamps])
    assert times_s == pytest.approx(0.005 * np.arange(40), abs=1e-4)
    assert np.abs(recording.received_s - BEGAN_S - 0.005 * np.arange(40)).max() > 2e-3
    assert np.diff(times_s).min() > 0
    own = replace(recording, received_s=None)  # the bytes of a board keep its clock
    assert own.stamps_ns().tolist() == [round(time_s * 1e9) for time_s in own.time_s.tolist()]


def test_contacts_are_in_each_frame(recording, forces, tmp_path):
    """On the sensor, as its forces are: what presses has a z below 0."""
    found = TouchContact(**{name: np.full(3 if "force" in name else 2, 2.0) for name in CONTACT})
    write_forces(recording, replace(forces, contacts=[(found,)] * 40), path := tmp_path / "press.mcap")
    *_, last = ros2_reader.read_ros2_messages(path, topics=[FRAMES])
    (contact,) = last.ros_msg.contacts
    assert vectors([contact.force, contact.force_deviation]).tolist() == [[2.0 * sign for sign in SIGNS], [2.0] * 3]
    lengths_m = vectors([contact.center, contact.half_size, contact.half_size_deviation])
    assert lengths_m.tolist() == [[0.002, 0.002, 0.0]] * 3


def test_schemas_keep_to_what_viewers_know(forces):
    """Foxglove refuses a topic whose schema has arrays of arrays, and knows its picture by name."""
    known = schemas()
    assert set(known) == {SENSOR, *CONTENTS}
    assert {known[SCENE]["title"], known[FORCES]["title"]} == {"foxglove.SceneUpdate", "tripillar.Forces"}
    assert '"items": {"type": "array"' not in json.dumps(known)
    found = TouchContact(**{name: np.zeros(3 if "force" in name else 2) for name in CONTACT})
    for topic, content in CONTENTS.items():
        check(json.loads(json_bytes(content(replace(forces[0], stamp_ns=0, contacts=[found])))), known[topic])


def test_what_cannot_be_written_is_one_line_and_leaves_the_old_file(recording, forces, tmp_path, monkeypatch):
    for write in (convert, lambda of, path: write_forces(of, forces, path)):
        with pytest.raises(FileFormatError, match=r"end the name in \.nc or \.(csv|mcap)"):
            write(recording, tmp_path / "a.txt")
    (path := tmp_path / "press.mcap").write_text("old")
    nowhere = replace(forces.description, position_mm=np.full_like(forces.description.position_mm, np.nan))
    with pytest.raises(DesignError):
        write_forces(recording, replace(forces, description=nowhere), path)
    assert [each.name for each in tmp_path.iterdir()] == ["press.mcap"]
    assert path.read_text() == "old"
