"""Recorders of both kinds where something goes wrong: kills, Ctrl-C, disks that are full or slow."""

import resource
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest

from hardware.recording import read_recording, recorder_for
from hardware.recording.recorder import RecordingError
from tests.hardware.recording.recorded_frames import INFO, KINDS, assert_same, frames

ROOT = Path(__file__).parents[3]


@pytest.fixture(params=KINDS)
def path(request, tmp_path):
    return tmp_path / f"press{request.param}"


def test_frames_are_on_disk_half_a_second_later_even_if_no_more_come(path, monkeypatch):
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr("hardware.recording.recorder.time", SimpleNamespace(monotonic=lambda: clock.now))
    with recorder_for(path, INFO) as recorder:
        recorder.append(frames(3), 1.8e9)
        assert recorder.frames == 0
        clock.now += 0.5
        recorder.append([], 1.8e9)
        assert recorder.frames == 3
        assert len(read_recording(path).counts) == 3  # while it is being written


RECORDER = """
import os, sys, time
from pathlib import Path
from hardware.recording import recorder_for
from tests.hardware.recording.recorded_frames import INFO, frames
recorder = recorder_for(Path(sys.argv[1]), INFO)
k = 0
while True:
    now = time.time()
    recorder.append(frames(5, k), now)
    k += 5
    os.write(1, f"{k} {now!r}\\n".encode())
    time.sleep(0.004)
"""


@pytest.mark.parametrize("seed", range(4))
def test_a_killed_recorder_loses_less_than_a_second(path, seed):
    """Killed at a random moment: the frames on disk are all of the first ones, whole, and the lost ones are recent."""
    command = [sys.executable, "-c", RECORDER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT) as process:
        first = process.stdout.readline()  # it records now
        time.sleep(np.random.default_rng(seed).uniform(0.55, 1.3))  # the moment of the kill; nothing waits for it
        process.send_signal(signal.SIGKILL)
        lines = first + process.stdout.read()
    noted = [line.split() for line in lines.decode().splitlines(keepends=True) if line.endswith("\n")]
    total, last_s = int(noted[-1][0]), float(noted[-1][1])
    recording = read_recording(path)
    n = len(recording.counts)
    assert_same(recording, [frame for k in range(0, n, 5) for frame in frames(5, k)], recording.received_s)
    assert 0 < n <= total + 5  # the kill may come between an append and its note
    assert last_s - recording.received_s[-1] < 1.0
    with recorder_for(path, INFO, append=True) as recorder:
        recorder.append(frames(5, n), 1.8e9)
    assert len(read_recording(path).counts) == n + 5


def test_ctrl_c_waits_for_the_frames_to_be_written(path, monkeypatch):
    sent = frames(10)
    recorder = recorder_for(path, INFO)
    write = recorder._write

    def interrupted(*frames_and_times):
        signal.raise_signal(signal.SIGINT)
        write(*frames_and_times)

    monkeypatch.setattr(recorder, "_write", interrupted)
    recorder.append(sent, 1.8e9)
    with pytest.raises(KeyboardInterrupt):
        recorder.close()
    assert_same(read_recording(path), sent, [1.8e9] * 10)
    recorder.close()


@contextmanager
def room_for(size):
    """A limit on the size of files stands for a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_full_disk_is_one_line_and_costs_only_what_did_not_fit(path):
    with recorder_for(path, INFO) as recorder:
        recorder.append(frames(100), 1.8e9)
        recorder.flush()
        recorder.append(frames(100, 100), 1.8e9)
        message = r"too large.*: recording ended, its first 100 frames are kept"
        with room_for(path.stat().st_size + 1000), pytest.raises(RecordingError, match=message) as failure:
            recorder.flush()
    assert "\n" not in str(failure.value)
    assert str(failure.value).startswith(f"{path}: ")
    recording = read_recording(path)
    assert recording.counts[:100].tolist() == [frame.counts.tolist() for frame in frames(100)]
    assert len(recording.counts) < 200


def test_a_disk_without_room_for_the_header_is_one_line(path):
    with room_for(10), pytest.raises(RecordingError, match=r"too large: give a file on a disk that can") as failure:
        recorder_for(path, INFO)
    assert "\n" not in str(failure.value)


def test_a_stalled_disk_is_one_line_and_its_frames_are_there(path, monkeypatch):
    monkeypatch.setattr("hardware.recording.recorder.STALL_S", 0.0)
    with recorder_for(path, INFO) as recorder:
        recorder.append(frames(5), 1.8e9)
        with pytest.raises(RecordingError, match=r"the disk stalled for 0 s: recording ended, its first 5 frames"):
            recorder.flush()
    assert len(read_recording(path).counts) == 5


def test_no_file_is_left_open(path):
    before = psutil.Process().num_fds()
    for start in (0, 10):
        with recorder_for(path, INFO, append=True) as recorder:
            recorder.append(frames(10, start), 1.8e9)
        read_recording(path)
    assert psutil.Process().num_fds() == before
