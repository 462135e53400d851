"""Boards that are not there, recorded ones and those of Python, by a clock of the tests; and one on a real terminal."""

import math
import os
from dataclasses import replace

import numpy as np
import pytest

from geometry.errors import DesignError
from hardware.boards.virtual_board import CountedFrames, VirtualBoard
from hardware.link.board_port import BoardPort
from hardware.link.frames import Frame, FrameDecoder, FrameError, Info, encode
from hardware.recording import PlaybackPort, parse_recording
from tests.hardware.boards import COUNTS, INFO, a_wire, wait_until
from tests.hardware.simulated import listening

PERIOD_S = 1 / INFO.rate_hz
N = 60


class Clock:
    """Seconds that only go by while somebody sleeps."""

    def __init__(self):
        self.now_s = 1000.0

    def __call__(self):
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds + 1e-9  # no system wakes up too early


class Host:
    """Reads a port, and has what came."""

    def __init__(self, port, clock):
        self.port, self.clock, self.decoder, self.came = port, clock, FrameDecoder(), []

    def take(self, n):
        """The next n frames; INFO and ERRORS frames go to `came`."""
        found = []
        while len(found) < n:
            for each in self.decoder.feed(self.port.read(max(1, self.port.in_waiting))):
                (found if isinstance(each, Frame) else self.came).append(each)
        return found

    def ask(self, command):
        self.port.write(command)
        while not self.came:
            self.take(1)
        return self.came.pop()


def a_board(counts=COUNTS, info=INFO, step_s=None):
    clock = Clock()
    return Host(BoardPort(CountedFrames(counts, info, step_s), clock, clock.sleep), clock)


def a_recording(n=N):
    return parse_recording(encode(INFO) + b"".join(a_wire(k) for k in range(n)))


def a_playback(recording=None, **options):
    clock = Clock()
    port = PlaybackPort(recording or a_recording(), clock=clock, sleep=clock.sleep, **options)
    return Host(port, clock)


@pytest.mark.parametrize("start", [a_board, a_playback])
def test_frames_come_in_their_order_at_their_times_and_answers_between_them(start):
    host = start()
    began_s = host.clock.now_s
    for k in range(N):
        [frame] = host.take(1)
        assert frame.sequence == k
        assert (frame.counts == COUNTS[k % 50]).all()
        assert frame.device_us == pytest.approx(k * 1e6 * PERIOD_S, abs=2)
        assert host.clock.now_s - began_s == pytest.approx(k * PERIOD_S, abs=1e-4)
        host.port.write(b"x?")
    host.came += host.decoder.feed(host.port.read(host.port.in_waiting))
    assert host.came == [INFO] * N
    assert host.decoder.statistics.lost == host.decoder.statistics.bad_form == 0


def test_a_reader_that_is_away_loses_no_recorded_frame():
    host = a_playback()
    host.take(1)
    host.clock.sleep(3600.0)
    assert [frame.sequence for frame in host.take(N - 1)] == list(range(1, N))
    assert host.port.finished
    assert host.port.write(b"?") == 1
    assert not host.port.finished  # it answers after the end, too
    assert host.port.read(100) == encode(INFO)


@pytest.mark.parametrize("speed", [0.5, 2.0, math.inf])
def test_a_recording_is_played_at_any_speed(speed):
    host = a_playback(speed=speed)
    began_s = host.clock.now_s
    host.take(N)
    assert host.clock.now_s - began_s == pytest.approx((N - 1) * PERIOD_S / speed, abs=1e-4)


def test_a_restart_of_a_recorded_board_is_no_pause():
    """The clock falls back from 1000 s to 0, which would read as 55 minutes forward."""
    sent = [a_wire(k, device_us=10**9 + 5000 * k) for k in range(3)] + [a_wire(k) for k in range(3)]
    host = a_playback(parse_recording(encode(INFO) + b"".join(sent)))
    began_s = host.clock.now_s
    host.take(6)
    assert host.clock.now_s - began_s == pytest.approx(5 * PERIOD_S, abs=1e-4)


def test_a_read_waits_a_tenth_of_a_second_at_most():
    host = a_playback(replace(a_recording(2), time_s=np.array([0.0, 3600.0])))
    host.take(1)
    began_s = host.clock.now_s
    assert host.port.read() == b""
    assert host.clock.now_s - began_s == pytest.approx(0.1, abs=1e-6)
    assert not host.port.finished


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan")])
def test_speeds_that_never_end_are_refused(speed):
    with pytest.raises(DesignError, match=r"must be above 0: 1 is real time"):
        a_playback(speed=speed)


def test_a_late_scan_is_skipped_and_counted_up_to_the_counters_end_and_the_schedule_does_not_drift():
    host = a_board()
    host.take(5)
    host.clock.sleep(4.5 * PERIOD_S)  # of four scans that fell due, the last is only late
    frames = host.take(3)
    assert [frame.overruns for frame in frames] == [3, 3, 3]
    assert [frame.sequence for frame in frames] == [5, 6, 7]
    assert frames[2].device_us == pytest.approx(10 * 1e6 * PERIOD_S, abs=2)
    host.clock.sleep(400 * PERIOD_S)
    assert host.take(1)[0].overruns == 255


@pytest.mark.parametrize("rate_hz", [100, 1000])
def test_counts_go_by_at_their_own_pace_whatever_the_rate(rate_hz):
    """And they may be computed from the board's time."""
    for counts, step_s in (
        (np.arange(1000)[:, None] * np.ones(108, int), 0.01),
        (lambda s: np.full(108, int(s / 0.01)), None),
    ):
        host = a_board(counts, step_s=step_s)
        host.ask(b"R%d\n" % rate_hz)
        frames = host.take(20)
        host.clock.sleep(0.1)
        late = {(frame.device_us + 1) // 10_000 - int(frame.counts[0]) for frame in frames + host.take(20)}
        assert late <= {0, 1}  # 1 where rounding to a microsecond took the time to the next step


def test_answers_and_rates():
    """A rate that can be held holds after the scan that is due; nonsense is no command; a question ends one."""
    host = a_board()
    assert host.ask(b"?") == INFO
    assert host.ask(b"R500\n") == replace(INFO, rate_hz=500)
    assert np.diff([frame.device_us for frame in host.take(10)[1:]]) == pytest.approx(2000, abs=2)
    for command, rate_hz in (
        (b"R0\n", 500),
        (b"R1001\n", 500),
        (b"Rx7\nR\n7\n?", 500),
        (b"R10?", 500),
        (b"0\nR000300\n", 300),
    ):
        assert host.ask(command) == replace(INFO, rate_hz=rate_hz)
        assert not host.came  # one answer, none to nonsense


@pytest.mark.parametrize(
    ("counts", "step_s", "message"),
    [
        (COUNTS, 0.0, "step_s=0 must be above 0"),
        (np.zeros((2, 3, 4)), None, r"shape \(2, 3, 4\), expected \(n, n_cross"),
    ],
)
def test_counts_of_no_frame_are_refused(counts, step_s, message):
    with pytest.raises(FrameError, match=message):
        CountedFrames(counts, INFO, step_s)


def test_a_terminal_carries_what_the_port_sends_and_its_link_goes_with_it(tmp_path):
    """It fills where nobody reads, within 70 frames or so; the board goes on, and who reads then gets whole frames."""
    link = tmp_path / "board"
    with VirtualBoard(COUNTS, replace(INFO, rate_hz=1000), link=link) as board:
        assert board.port == str(link)
        wait_until(lambda: board.dropped_bytes)
        with listening(board) as host:
            assert host.ask() == replace(INFO, rate_hz=1000)
            newest = board.sent[-1][0]
            while (frame := host.take_frames(1)[0]).sequence < newest:
                pass
            assert host.decoder.statistics.bad_form == 0
            assert (frame.counts == COUNTS).all(axis=1).any()
    assert not os.path.lexists(link)


def test_what_goes_wrong_in_the_boards_thread_is_not_lost():
    board = VirtualBoard(lambda time_s: np.full(3, 2000), Info(rows=1, cols=1))  # more than 10 bits hold
    wait_until(lambda: not board._thread.is_alive())
    with pytest.raises(FrameError, match="counts run from 2000"):
        board.close()
    board.close()
