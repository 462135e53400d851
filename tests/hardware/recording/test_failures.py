"""The recorder where something goes wrong: Ctrl-C, disks that are full; kills are those of its command."""

import os
import resource
import signal
from contextlib import contextmanager

import pytest

from hardware.recording import Recorder, RecordingError, read_recording
from tests.hardware.recording.recorded_frames import INFO, assert_same, frames, record


@pytest.fixture
def path(tmp_path):
    return tmp_path / "press.frames"


def test_ctrl_c_waits_for_the_frame_to_be_written(path, monkeypatch):
    recorder = Recorder(path, INFO)
    write = os.write

    def interrupted(file, data):
        signal.raise_signal(signal.SIGINT)
        return write(file, data[:100])  # the rest is yet to be written

    monkeypatch.setattr("hardware.recording.frames_file.os.write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        recorder.append(frames(1)[0], 1.8e9)
    monkeypatch.undo()
    recorder.close()
    assert_same(read_recording(path), frames(1), [1.8e9])


@contextmanager
def room_for(size):
    """A limit on the size of files stands for a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.mark.parametrize("room", [0, 14, 49])
def test_a_full_disk_is_one_line_and_the_frames_up_to_there_are_kept(path, room):
    """However much of the next frame still finds room."""
    many = frames(101)
    record(path, many[:50])
    with Recorder(path, INFO, append=True) as recorder:
        for frame in many[50:100]:
            recorder.append(frame, 1.8e9)
        size = path.stat().st_size
        message = rf"^{path}: the disk is full [^\n]* recording ended, all 50 frames up to here are kept: make room"
        with room_for(size + room), pytest.raises(RecordingError, match=message):
            recorder.append(many[100], 1.8e9)
    recording = read_recording(path)
    assert recording.counts.tolist() == [frame.counts.tolist() for frame in many[:100]]
    assert (recording.truncated_bytes, recording.damaged_at, path.stat().st_size) == (0, (), size)


def test_a_disk_without_room_for_a_header_leaves_what_was_there(path):
    with room_for(10), pytest.raises(RecordingError, match=r"the disk is full .*: give a file on a disk that has"):
        Recorder(path, INFO)
    assert list(path.parent.iterdir()) == []
    record(path, frames(10))
    before = path.read_bytes()
    message = r"the disk is full .*; the recording is as it was: give a file"
    with room_for(len(before) + 100), pytest.raises(RecordingError, match=message):
        Recorder(path, INFO, append=True)
    assert path.read_bytes() == before
