"""The recorder where something goes wrong: kills, Ctrl-C, disks that are full."""

import os
import resource
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from hardware.link.frames import Info
from hardware.recording import Recorder, RecordingError, read_recording
from tests.hardware.recording.recorded_frames import INFO, assert_same, frames, record

ROOT = Path(__file__).parents[3]
MANY = frames(200)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "press.frames"


RECORDER = """
import os, sys, time
from pathlib import Path
from hardware.link.frames import Info
from hardware.recording import Recorder
from tests.hardware.recording.recorded_frames import INFO, frames
recorder = Recorder(Path(sys.argv[1]), INFO)
for k in range(10**6):
    recorder.append(frames(1, k)[0], time.time())
    os.write(1, b".")
"""


def test_a_killed_recorder_loses_one_frame_at_most(path):
    """Killed while it writes: the file holds all frames that were appended, and can be continued."""
    command = [sys.executable, "-c", RECORDER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT) as process:
        noted = len(process.stdout.read(50))
        process.send_signal(signal.SIGKILL)
        noted += len(process.stdout.read())
    recording = read_recording(path)
    n = len(recording.counts)
    assert noted <= n <= noted + 1  # the kill may come between an append and its note
    assert_same(recording, [frame for k in range(n) for frame in frames(1, k)], recording.received_s)
    record(path, frames(5, n), append=True)
    assert len(read_recording(path).counts) == n + 5


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
@pytest.mark.parametrize("append", [False, True])
def test_a_full_disk_is_one_line_and_the_frames_up_to_there_are_kept(path, room, append):
    """However much of the next frame still finds room."""
    before = 10 if append else 0
    if append:
        record(path, frames(10))
    with Recorder(path, INFO, append=append) as recorder:
        for frame in MANY[:100]:
            recorder.append(frame, 1.8e9)
        size = path.stat().st_size
        message = r"the disk is full .* recording ended, all 100 frames up to here are kept: make room"
        with room_for(size + room), pytest.raises(RecordingError, match=message) as failure:
            recorder.append(MANY[100], 1.8e9)
    assert "\n" not in str(failure.value)
    assert str(failure.value).startswith(f"{path}: ")
    recording = read_recording(path)
    assert recording.counts[before:].tolist() == [frame.counts.tolist() for frame in MANY[:100]]
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


@pytest.mark.parametrize("n", [20_000, pytest.param(100_000, marks=pytest.mark.long)])
def test_memory_stays_flat_and_appending_is_cheap(path, n):
    """100,000 frames are 24 MB; less than 50 µs of processor time each, so that 150 a second cost below 1 %."""
    info, process = Info(bits=12), psutil.Process()
    some, n_open = frames(250, info=info), process.num_fds()
    with Recorder(path, info) as recorder:
        started, early = time.process_time(), 0
        for k in range(n):
            recorder.append(some[k % 250], 1.8e9 + k)
            early = early or process.memory_info().rss
        took, grown = time.process_time() - started, process.memory_info().rss - early
    assert recorder.frames == n
    assert process.num_fds() == n_open
    assert grown < 60 * n  # a quarter of their bytes
    assert took / n < 50e-6
