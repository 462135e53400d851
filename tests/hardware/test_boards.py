"""One contract for all boards on all ports; and boards that are not there, by a clock of the tests."""

import math
import os
from collections import Counter
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from geometry.errors import DesignError
from hardware.boards.virtual_board import CountedFrames, VirtualBoard
from hardware.link.board_port import BoardPort
from hardware.link.frames import Frame, FrameDecoder, FrameError, Info, Statistics, encode
from hardware.link.protocols import PROTOCOLS, BoardProtocol, spoken_on
from hardware.link.scanner import Link, Scanner
from hardware.link.serial_ports import close, open_port
from hardware.recording import PlaybackPort, Recorder, parse_recording, read_recording
from hardware.session import record_scans
from tests.hardware.boards import COUNTS, INFO, PATIENT_S, Clock, ScriptedPort, a_wire, wait_until
from tests.hardware.simulated import COLUMN_WIRE, DISTINCT, ROW_WIRE, listening
from tests.hardware.simulated import INFO as CHIP

PERIOD_S = 1 / INFO.rate_hz
N = 60


class LineDecoder:
    """Frames of another kind of board: lines of text, ``I rate serial`` and ``D sequence us count...``."""

    def __init__(self):
        self._rest, self._counted = b"", Counter()

    @property
    def statistics(self):
        return Statistics(**self._counted)

    def feed(self, data):
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [frame for line in lines if (frame := self._frame(line.split()))]

    def _frame(self, words):
        try:
            kind, numbers = words[0], [int(word) for word in words[1:]]
            if kind == b"I":
                return Info(rate_hz=numbers[0], serial=numbers[1])
            frame = Frame(sequence=numbers[0], device_us=numbers[1], bits=10, counts=np.array(numbers[2:]))
            self._counted["ok"] += 1
            return frame
        except (ValueError, IndexError):
            self._counted["bad_form"] += 1
            return None


LINES = BoardProtocol(decoder=LineDecoder, question=b"info\n", rate=b"rate %d\n".__mod__)


def a_line(k):
    return b"D %d %d %s\n" % (k, round(k * 1e6 * PERIOD_S), b" ".join(b"%d" % count for count in COUNTS[k % 50]))


def a_recording(n=N):
    return parse_recording(encode(INFO) + b"".join(a_wire(k) for k in range(n)))


@contextmanager
def on_a_port(board):
    port = open_port(board.port)
    yield port
    close(port)


@contextmanager
def python_in_memory(_):
    clock = Clock()
    yield BoardPort(CountedFrames(COUNTS, INFO), clock, clock.sleep)


@contextmanager
def recorded(_):
    yield PlaybackPort(a_recording(), speed=math.inf)


@contextmanager
def scripted(_):
    yield ScriptedPort(encode(INFO), *(a_wire(k) for k in range(N)))


@contextmanager
def another_protocol(_):
    yield ScriptedPort(b"I 200 3\nD broken 1\n", *(a_line(k) for k in range(N)))


@contextmanager
def python_on_a_terminal(_):
    with VirtualBoard(COUNTS, INFO) as board, on_a_port(board) as port:
        yield port


@contextmanager
def chip_on_a_terminal(request):
    with request.getfixturevalue("board")(fast=True) as board, on_a_port(board) as port:
        yield port


BOARDS = [python_in_memory, recorded, scripted, another_protocol, python_on_a_terminal, chip_on_a_terminal]


@pytest.mark.parametrize("kind", BOARDS, ids=lambda kind: kind.__name__)
def test_any_board_on_any_port_gives_its_info_and_its_scans(kind, request):
    """In their order, with their counts, at the times of the board's clock; all of them where a port has an end."""
    info = CHIP if kind is chip_on_a_terminal else INFO
    with kind(request) as port:
        link, scans = Link(port, None, PATIENT_S, LINES if kind is another_protocol else PROTOCOLS["tripillar"]), []
        while len(scans) < N and not link.is_finished:
            scans += link.take(link.read())
    assert link.reception.info == info
    assert len(scans) >= N
    frames = [scan.frame for scan in scans]
    first = 0 if hasattr(port, "finished") else frames[0].sequence
    assert [frame.sequence for frame in frames] == list(range(first, first + len(frames)))
    if kind is chip_on_a_terminal:
        assert all((frame.counts == DISTINCT[0, ROW_WIRE, COLUMN_WIRE]).all() for frame in frames)
    else:  # a step of counts is a period
        assert np.array_equal([f.counts for f in frames], COUNTS[[(f.device_us + 1) // 5000 % 50 for f in frames]])
    periods = len(frames) - 1 + frames[-1].overruns - frames[0].overruns
    late_us = 1e6 / info.rate_hz if kind is python_on_a_terminal else 2  # by a period in real time: more is an overrun
    elapsed_us = frames[-1].device_us - frames[0].device_us
    assert elapsed_us == pytest.approx(1e6 * periods / info.rate_hz, abs=late_us)
    assert link.reception.statistics.lost == link.reception.statistics.restarts == 0


def test_a_port_is_named_with_its_protocol_and_what_it_sends_is_recorded_as_any(monkeypatch, tmp_path):
    monkeypatch.setitem(PROTOCOLS, "lines", LINES)
    assert spoken_on("lines+socket://host:1") == (LINES, "socket://host:1")
    assert spoken_on("spam+/dev/ttyUSB0") == (PROTOCOLS["tripillar"], "spam+/dev/ttyUSB0")
    port, opened = ScriptedPort(b"I 200 3\n", *(a_line(k) for k in range(N))), []
    with Scanner("lines+/dev/board", opener=lambda url, **options: opened.append(url) or port) as scanner:
        n, _ = record_scans(scanner, tmp_path / "lines.frames")
    assert (n, opened, port.written) == (N, ["/dev/board"], b"info\n")
    assert np.array_equal(read_recording(tmp_path / "lines.frames").counts, COUNTS[np.arange(N) % 50])
    with pytest.raises(FrameError), Recorder(tmp_path / "other.frames", Info(rows=0)):
        pass


# boards that are not there, in memory


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


def a_playback(recording=None, **options):
    clock = Clock()
    return Host(PlaybackPort(recording or a_recording(), clock=clock, sleep=clock.sleep, **options), clock)


@pytest.mark.parametrize("start", [a_board, a_playback])
def test_frames_come_at_their_times_and_answers_between_them(start):
    host = start()
    began_s = host.clock.now_s
    for k in range(N):
        [frame] = host.take(1)
        assert frame.sequence == k
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
def test_a_recording_is_played_at_any_speed_and_a_boards_restart_is_no_pause(speed):
    """The clock falls back from 1000 s to 0, which would read as 55 minutes forward."""
    sent = [a_wire(k, device_us=10**9 + 5000 * k) for k in range(3)] + [a_wire(k) for k in range(3)]
    host = a_playback(parse_recording(encode(INFO) + b"".join(sent)), speed=speed)
    began_s = host.clock.now_s
    host.take(6)
    assert host.clock.now_s - began_s == pytest.approx(5 * PERIOD_S / speed, abs=1e-4)


def test_a_read_waits_a_tenth_of_a_second_at_most():
    host = a_playback(replace(a_recording(2), time_s=np.array([0.0, 3600.0])))
    host.take(1)
    began_s = host.clock.now_s
    assert host.port.read() == b""
    assert host.clock.now_s - began_s == pytest.approx(0.1, abs=1e-6)
    assert not host.port.finished


def test_a_late_scan_is_skipped_and_counted_up_to_the_counters_end_and_the_schedule_does_not_drift():
    host = a_board()
    host.take(5)
    host.clock.sleep(4.5 * PERIOD_S)  # of four scans that fell due, the last is only late
    frames = host.take(3)
    assert [(frame.overruns, frame.sequence) for frame in frames] == [(3, 5), (3, 6), (3, 7)]
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
    ("refused", "message"),
    [
        (lambda: CountedFrames(COUNTS, INFO, 0.0), "step_s=0 must be above 0"),
        (lambda: CountedFrames(np.zeros((2, 3, 4)), INFO), r"shape \(2, 3, 4\), expected \(n, n_cross"),
        *(
            (lambda speed=speed: a_playback(speed=speed), "must be above 0: 1 is real time")
            for speed in (0, -1, np.nan)
        ),
    ],
)
def test_what_no_board_can_be_is_refused(refused, message):
    with pytest.raises((FrameError, DesignError), match=message):
        refused()


# on a terminal


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
    board._thread.join(PATIENT_S)
    with pytest.raises(FrameError, match="counts run from 2000"):
        board.close()
    board.close()
