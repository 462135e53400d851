"""A recording played as a board: the same bytes, at the same times."""

import time
from dataclasses import replace

import numpy as np
import pytest

from geometry.errors import DesignError
from hardware.link.frames import Frame, FrameDecoder, Info, encode
from hardware.recording import parse_recording
from hardware.recording.playback import PlaybackPort
from tests.hardware.recording.recorded_frames import frames

INFO = Info(rows=1, cols=2, bits=10, rate_hz=100)
SIZE = len(encode(frames(1, info=INFO)[0]))  # bytes a frame


def stream_of(n=20):
    return b"".join(encode(frame) for frame in frames(n, info=INFO))


def a_recording(n=20):
    return parse_recording(encode(INFO) + stream_of(n))


@pytest.mark.parametrize("size", [1, 7, 100_000, None])
def test_as_fast_as_read_it_sends_the_boards_bytes(size):
    """Several times what the port lets wait, in reads of any size."""
    port, data = PlaybackPort(a_recording(500), speed=np.inf), b""
    while not port.finished:
        piece = port.read(size or max(1, port.in_waiting))
        assert 0 < len(piece) <= (size or 10_000)
        data += piece
    assert data == stream_of(500)
    assert port.write(b"x??") == 3
    assert not port.finished  # it answers after the end, too
    assert port.read(100) == 2 * encode(INFO)


@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_no_frame_comes_before_its_time_and_none_is_skipped(speed):
    """Six frames 10 ms apart."""
    port, came_s = PlaybackPort(a_recording(6), speed=speed), []
    started = time.monotonic()
    while not port.finished:
        n_come = len(port.read(SIZE)) // SIZE
        came_s += [time.monotonic() - started] * n_come
    assert len(came_s) == 6
    assert (np.array(came_s) >= np.arange(6) * 0.010 / speed - 1e-6).all()
    assert came_s[-1] < 5.0


def test_a_restart_of_the_board_is_no_pause():
    """The clock falls back from 1000 s to 0, which would read as 55 minutes forward."""
    before, after = frames(3, info=INFO, device_us=10**9), frames(3, info=INFO, device_us=0)
    port = PlaybackPort(parse_recording(b"".join(encode(frame) for frame in [INFO, *before, *after])))
    started = time.monotonic()
    while not port.finished:
        port.read(SIZE)
    assert time.monotonic() - started < 5.0


def test_a_read_waits_a_tenth_of_a_second_at_most():
    """The second frame is an hour away."""
    port = PlaybackPort(replace(a_recording(2), time_s=np.array([0.0, 3600.0])))
    started = time.monotonic()
    assert port.read(SIZE + 1) == stream_of(1)
    assert port.in_waiting == 0
    assert port.read() == b""
    assert 0.1 <= time.monotonic() - started < 5.0
    assert not port.finished


def test_it_answers_a_question_mark_between_two_frames():
    port = PlaybackPort(a_recording(2), speed=np.inf)
    head = port.read(5)
    port.write(b"x?")
    received = FrameDecoder().feed(head + port.read(1000))
    assert [type(each) for each in received] == [Frame, Frame, Info]
    assert received[2] == INFO


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan")])
def test_speeds_that_never_end_are_refused(speed):
    with pytest.raises(DesignError, match=r"must be above 0: 1 is real time"):
        PlaybackPort(a_recording(), speed=speed)
