"""Messages of ROS 2 in MCAP, read by the public reader; stamps by the board's clock."""

from pathlib import Path

import numpy as np
import pytest

from hardware import replay
from hardware.readout.wrench import SIGNS
from hardware.streams import ros2_file
from hardware.streams.forces_file import write_forces
from hardware.streams.ros2_file import FRAMES, SHAPE
from tests.hardware.streams.conftest import BEGAN_S

reader = pytest.importorskip("mcap_ros2.reader")


def vectors(messages):
    return np.array([[each.x, each.y, each.z] for each in messages])


@pytest.fixture
def written(recording, pressed, tmp_path):
    """A recording, its forces, and the messages of the file by topic."""
    forces, path, found = replay(recording, pressed.model), tmp_path / "press.mcap", {}
    write_forces(recording, forces, path, ros2=True)
    for message in reader.read_ros2_messages(path):
        found.setdefault(message.channel.topic, []).append(message)
    return recording, forces, found


def test_the_public_reader_finds_every_force(written):
    recording, forces, found = written
    assert set(found) == {SHAPE, FRAMES}
    assert len(found[FRAMES]) == 40
    for k, message in enumerate(found[FRAMES]):
        frame, wrench = message.ros_msg, forces.wrench
        assert (frame.sequence, frame.device_us) == (recording.sequence[k], recording.device_us[k])
        on_pads = forces.force_n[k].reshape(-1, 3) * SIGNS
        assert np.array_equal(vectors(frame.forces), on_pads)
        assert np.array_equal(vectors(frame.force_deviations), forces.deviation_n[k].reshape(-1, 3))
        assert frame.resistances == forces.resistance_ohm[k].reshape(-1).tolist()
        assert vectors([frame.net.force])[0] == pytest.approx(on_pads.sum(axis=0))
        torque = np.cross(forces.description.position_m.reshape(-1, 3), on_pads).sum(axis=0)
        assert vectors([frame.net.torque])[0] == pytest.approx(torque)
        assert vectors([frame.net_deviation.force])[0] == pytest.approx(wrench.force_deviation_n[k])
        assert frame.has_center_of_pressure
        assert vectors([frame.center_of_pressure])[0, :2] == pytest.approx(1e-3 * wrench.centre_mm[k])


def test_the_shape_comes_once_first_and_latched(written):
    _, forces, found = written
    [message] = found[SHAPE]
    shape, sensor = message.ros_msg, forces.description
    assert (shape.rows, shape.cols, shape.axes) == (2, 3, ["x", "y", "z"])
    assert vectors(shape.positions) == pytest.approx(sensor.position_m.reshape(-1, 3))
    assert vectors(shape.normals).tolist() == [[0.0, 0.0, 1.0]] * 6
    assert (shape.design_hash, shape.board_serial) == (sensor.design_hash, 3)
    assert (vectors(shape.force_low) <= vectors(shape.force_high)).all()
    assert vectors(shape.force_low)[:, 2].max() < 0  # what presses has a z below 0
    assert message.log_time_ns == found[FRAMES][0].log_time_ns
    assert "durability: 1" in message.channel.metadata["offered_qos_profiles"]


def test_stamps_are_the_boards_clock_and_only_grow(written):
    """Within 0.1 ms of when the board scanned, where arrivals are up to 3 ms late; through rollover and restart."""
    recording, _, found = written
    stamps = [message.ros_msg.header.stamp for message in found[FRAMES]]
    times_s = np.array([stamp.sec - BEGAN_S + 1e-9 * stamp.nanosec for stamp in stamps])
    assert times_s == pytest.approx(0.005 * np.arange(40), abs=1e-4)
    assert np.abs(recording.received_s - BEGAN_S - 0.005 * np.arange(40)).max() > 2e-3
    assert np.diff(times_s).min() > 0
    assert [message.log_time_ns for message in found[FRAMES]] == [s.sec * 10**9 + s.nanosec for s in stamps]


def test_bytes_of_a_board_without_arrivals_keep_its_own_clock(recording):
    object.__setattr__(recording, "received_s", None)
    assert recording.stamps_ns().tolist() == [round(time_s * 1e9) for time_s in recording.time_s.tolist()]


def test_definitions_are_whole_files_of_messages():
    folder = Path(ros2_file.__file__).parent / "msg"
    assert sorted(path.name for path in folder.iterdir()) == ["TactileFrame.msg", "TactileShape.msg"]
    for name in ("TactileShape", "TactileFrame"):
        assert ros2_file.definition(name).startswith((folder / f"{name}.msg").read_text())
