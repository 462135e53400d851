"""A recording played as a board: the same bytes, at the same times."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from geometry.errors import DesignError
from hardware.link.frames import Frame, FrameDecoder, Info, encode
from hardware.recording import parse_recording, recording_bytes
from hardware.recording.playback import PlaybackPort
from tests.hardware.recording.recorded_frames import frames

INFO = Info(rows=1, cols=2, bits=10, rate_hz=100)
SIZE = len(encode(frames(1, info=INFO)[0]))  # bytes a frame


def a_recording(n=20, **changes):
    return parse_recording(encode(INFO) + b"".join(encode(frame) for frame in frames(n, info=INFO, **changes)))


def everything(port):
    data = b""
    while not port.finished:
        data += port.read(max(1, port.in_waiting))
    return data


def test_as_fast_as_read_it_sends_the_boards_bytes():
    recording = a_recording(2000)  # several times what the port lets wait
    with PlaybackPort(recording, speed=np.inf) as port:
        assert encode(INFO) + everything(port) == recording_bytes(recording)


@pytest.mark.parametrize("size", [1, 7, 100_000])
def test_reads_of_any_size_leave_nothing_out(size):
    recording = a_recording(300)
    data = b""
    with PlaybackPort(recording, speed=np.inf, timeout=None) as port:
        while not port.finished:
            piece = port.read(size)
            assert 0 < len(piece) <= size
            data += piece
    assert encode(INFO) + data == recording_bytes(recording)


@pytest.mark.parametrize("clock", ["device", "received"])
@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_no_frame_comes_before_its_time_and_none_is_skipped(clock, speed):
    """Six frames 10 ms apart: each is read within one `read`, by the clock that was chosen."""
    recording = a_recording(6)
    due_s = np.arange(6) * 0.010 / speed
    if clock == "received":
        due_s = np.array([0, 0, 0, 0.03, 0.03, 0.03]) / speed  # arrived in two bursts
        recording = replace(recording, received_s=1.8e9 + due_s * speed)
    came_s = []
    with PlaybackPort(recording, speed=speed, timeout=10.0, clock=clock) as port:
        started = time.monotonic()
        for _ in range(6):
            assert len(port.read(SIZE)) == SIZE
            came_s.append(time.monotonic() - started)
    assert (np.array(came_s) >= due_s - 1e-6).all()  # Unix times are held to 0.2 µs
    assert came_s[-1] < 5.0


def test_a_restart_of_the_board_is_no_pause():
    """The clock falls back from 1000 s to 0, which would read as 55 minutes forward."""
    before, after = frames(3, info=INFO, device_us=10**9), frames(3, info=INFO, device_us=0)
    recording = parse_recording(b"".join(encode(frame) for frame in [INFO, *before, *after]))
    with PlaybackPort(recording, timeout=10.0) as port:
        assert len(port.read(6 * SIZE)) == 6 * SIZE


def test_read_waits_no_longer_than_its_timeout():
    """The second frame is an hour away."""
    recording = replace(a_recording(2), received_s=np.array([0.0, 3600.0]))
    with PlaybackPort(recording, timeout=0.05, clock="received") as port:
        started = time.monotonic()
        assert len(port.read(SIZE + 1)) == SIZE
        assert port.in_waiting == 0
        port.timeout = 0.0
        assert port.read() == b""
        assert 0.05 <= time.monotonic() - started < 5.0
        assert not port.finished


def test_close_wakes_a_reader():
    recording = replace(a_recording(2), received_s=np.array([0.0, 3600.0]))
    port = PlaybackPort(recording, timeout=None, clock="received")
    port.read(SIZE)
    answers = []
    has_begun = threading.Event()

    def reader():
        has_begun.set()
        answers.append(port.read())

    thread = threading.Thread(target=reader, daemon=True)  # so that a reader that is not woken ends, too
    thread.start()
    has_begun.wait()
    port.close()
    thread.join(timeout=10.0)
    assert answers == [b""]
    assert port.finished
    assert not port.is_open
    assert port.read() == b""


def test_it_answers_a_question_mark_between_two_frames_and_wakes_the_reader():
    recording = replace(a_recording(3), received_s=np.array([0.0, 0.0, 3600.0]))
    with PlaybackPort(recording, timeout=None, clock="received") as port:
        assert port.in_waiting == 2 * SIZE
        head = port.read(5)
        thread = threading.Timer(0.0, port.write, [b"x?"])
        thread.start()
        rest = port.read(2 * SIZE - 5 + len(encode(INFO)))
        thread.join()
    received = FrameDecoder().feed(head + rest)
    assert [type(each) for each in received] == [Frame, Frame, Info]
    assert received[2] == INFO


def test_it_answers_after_the_end_too():
    with PlaybackPort(a_recording(1), speed=np.inf) as port:
        everything(port)
        assert port.write(b"??") == 2
        assert not port.finished
        assert everything(port) == 2 * encode(INFO)


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan")])
def test_speeds_that_never_end_are_refused(speed):
    with pytest.raises(DesignError, match=r"must be above 0: 1 is real time"):
        PlaybackPort(a_recording(), speed=speed)


def test_without_times_of_arrival_they_cannot_be_followed():
    with pytest.raises(DesignError, match="no times of arrival: play it with clock='device'"):
        PlaybackPort(a_recording(), clock="received")
