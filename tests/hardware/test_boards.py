"""One contract for all boards on all ports; and boards that are not there, by a clock of the tests."""

import math
from contextlib import contextmanager, nullcontext
from dataclasses import replace

import numpy as np
import pytest

from common.errors import DesignError
from geometry.layout import LAYOUTS
from hardware.boards.python_board import CountedPort, PythonBoard
from hardware.link.frames import Errors, ScanMode, Statistics, encode
from hardware.link.lines import matrix_info
from hardware.link.protocols import PROTOCOLS, spoken_on
from hardware.link.scanner import Link, Scanner
from hardware.recording import PlaybackPort, parse_recording, read_recording
from hardware.session import record_scans
from tests.hardware.boards import (
    CHIP,
    COLUMN_WIRE,
    COUNTS,
    DISTINCT,
    INFO,
    ROW_WIRE,
    Clock,
    Listener,
    ScriptedPort,
    a_wire,
    listening,
)
from tests.house import PATIENT_S

PERIOD_S = 1 / INFO.rate_hz
N = 60


MAT = replace(INFO, cols=18, bits=16, scan_mode=ScanMode.PLAIN, rate_hz=100, serial=0, sense_ohm=65535)
MAT = replace(MAT, layout=LAYOUTS["single"])  # whole numbers, one a unit


def a_line(k):
    return b"Mat: %s\r\n" % b", ".join(b"%d" % count for count in COUNTS[k % 50])


def a_mat():
    port = ScriptedPort(b"ready\n1,2,3\n", *(a_line(k) for k in range(N)))
    port.written = b"no question"
    return port


def a_board(counts=COUNTS, step_s=None):
    clock = Clock()
    return CountedPort(counts, INFO, step_s, clock=clock, sleep=clock.sleep)


def a_playback(*sent, speed=1.0):
    clock = Clock()
    recording = parse_recording(encode(INFO) + b"".join(sent or (a_wire(k) for k in range(N))))
    return PlaybackPort(recording, speed, clock=clock, sleep=clock.sleep)


@contextmanager
def on_a_terminal(board):
    with board, listening(board) as listener:
        yield listener.port


BOARDS = {
    "python in memory": lambda chip: nullcontext(a_board()),
    "recorded": lambda chip: nullcontext(a_playback(speed=math.inf)),
    "scripted": lambda chip: nullcontext(ScriptedPort(encode(INFO), *(a_wire(k) for k in range(N)))),
    "lines": lambda chip: nullcontext(a_mat()),
    "python on a terminal": lambda chip: on_a_terminal(PythonBoard(COUNTS, INFO)),
    "chip on a terminal": lambda chip: on_a_terminal(chip("board")("--fast")),
}


@pytest.mark.parametrize("kind", BOARDS)
def test_any_board_on_any_port_gives_its_info_and_its_scans(kind, request):
    """In their order, with their counts, at the times of the board's clock; all of them where a port has an end."""
    info = CHIP if "chip" in kind else MAT if kind == "lines" else INFO
    with BOARDS[kind](request.getfixturevalue) as port:
        protocol, _ = spoken_on(f"{kind}+", matrix_info(6, 18) if kind == "lines" else None)
        link, scans = Link(port, None, PATIENT_S, protocol), []
        while len(scans) < N and not link.is_finished:
            scans += link.take(link.read())
    assert link.reception.info == info
    assert len(scans) >= N
    frames = [scan.frame for scan in scans]
    first = 0 if hasattr(port, "finished") else frames[0].sequence
    assert [frame.sequence for frame in frames] == list(range(first, first + len(frames)))
    if kind == "lines":  # which tell no time
        assert np.array_equal([f.counts for f in frames], COUNTS[np.arange(N) % 50])
        return
    if "chip" in kind:
        assert all((frame.counts == DISTINCT[0, ROW_WIRE, COLUMN_WIRE]).all() for frame in frames)
    else:  # a step of counts is a period
        assert np.array_equal([f.counts for f in frames], COUNTS[[(f.device_us + 1) // 5000 % 50 for f in frames]])
    periods = len(frames) - 1 + frames[-1].overruns - frames[0].overruns
    late_us = 1e6 / info.rate_hz if kind == "python on a terminal" else 2  # more is an overrun
    elapsed_us = frames[-1].device_us - frames[0].device_us
    assert elapsed_us == pytest.approx(1e6 * periods / info.rate_hz, abs=late_us)
    assert link.reception.statistics.lost == link.reception.statistics.restarts == 0


def test_a_port_is_named_with_its_protocol_and_what_it_sends_is_recorded_as_any(monkeypatch, tmp_path):
    with pytest.raises(DesignError, match="do not say how many units there are: give rows= and cols="):
        spoken_on("lines+socket://host:1")
    assert spoken_on("lines+socket://host:1", MAT)[1] == "socket://host:1"
    assert spoken_on("spam+/dev/ttyUSB0") == (PROTOCOLS["tripillar"], "spam+/dev/ttyUSB0")
    port, opened = ScriptedPort(*(a_line(k) for k in range(N))), []
    monkeypatch.setattr("hardware.link.scanner.open_port", lambda url, baud: opened.append(url) or port)
    port.written = b"heard nothing, says all"
    with Scanner("lines+/dev/board", stated=matrix_info(6, 18)) as scanner:
        n, _ = record_scans(scanner, tmp_path / "lines.frames")
    assert (n, opened) == (N, ["/dev/board"])
    assert np.array_equal(read_recording(tmp_path / "lines.frames").counts, COUNTS[np.arange(N) % 50])


# boards in memory


@pytest.mark.parametrize("start", [a_board, a_playback])
def test_frames_come_at_their_times_and_answers_between_them(start):
    port = start()
    host, began_s = Listener(port, port._clock), port._clock()
    for k in range(N):
        assert host.take_frames(1)[0].sequence == k
        assert host.clock() - began_s == pytest.approx(k * PERIOD_S, abs=1e-4)
        port.write(b"x?")
    host.take(lambda self: len(self.infos) == N)
    assert host.infos == [INFO] * N
    assert host.decoder.statistics == Statistics(ok=N, info=N)


def test_a_reader_that_is_away_loses_no_recorded_frame_and_waits_a_tenth_of_a_second_at_most():
    port = a_playback(*(a_wire(k) for k in range(N - 1)), a_wire(N - 1, device_us=10**9))
    host = Listener(port, port._clock)
    host.take_frames(1)
    port._sleep(900.0)
    assert port.in_waiting < 5000  # as much as a serial driver holds
    assert [frame.sequence for frame in host.take_frames(N - 2)] == list(range(1, N - 1))
    began_s = port._clock()
    assert port.read() == b""
    assert port._clock() - began_s == pytest.approx(0.1, abs=1e-6)
    assert not port.finished
    port._sleep(900.0)
    host.take_frames(1)
    assert port.finished
    assert host.ask() == INFO  # after the end, too


@pytest.mark.parametrize("speed", [0.5, math.inf])
def test_a_recording_is_played_at_any_speed_and_a_boards_restart_is_no_pause(speed):
    """The clock falls back from 1000 s to 0, which would read as 55 minutes forward."""
    sent = [a_wire(k, device_us=10**9 + 5000 * k) for k in range(3)] + [a_wire(k) for k in range(3)]
    port = a_playback(*sent, speed=speed)
    began_s = port._clock()
    Listener(port, port._clock).take_frames(6)
    assert port._clock() - began_s == pytest.approx(5 * PERIOD_S / speed, abs=1e-4)


def test_a_late_scan_is_skipped_and_counted_up_to_the_counters_end_and_the_schedule_does_not_drift():
    """And counts go by at their own pace."""
    port = a_board(np.arange(1000)[:, None] * np.ones(108, int), step_s=0.01)
    host = Listener(port, port._clock)
    host.take_frames(5)
    port._sleep(4.5 * PERIOD_S)  # of four scans that fell due, the last is only late
    frames = host.take_frames(3)
    assert [(frame.overruns, frame.sequence) for frame in frames] == [(3, 5), (3, 6), (3, 7)]
    assert frames[2].device_us == pytest.approx(10 * 1e6 * PERIOD_S, abs=2)
    port._sleep(400 * PERIOD_S)
    assert host.take_frames(1)[0].overruns == 255
    late = {(frame.device_us + 1) // 10_000 - int(frame.counts[0]) for frame in host.frames}
    assert late <= {0, 1}  # 1 where rounding to a microsecond took the time to the next step


def test_answers_and_rates():
    """A rate that can be held holds after the scan that is due; nonsense is no command; a question ends one."""
    port = a_board()
    host = Listener(port, port._clock)
    assert (host.ask(b"?"), host.ask(b"!")) == (INFO, Errors())
    assert host.ask(b"R500\n") == replace(INFO, rate_hz=500)
    assert np.diff([frame.device_us for frame in host.take_frames(10)[1:]]) == pytest.approx(2000, abs=2)
    commands = {b"R0\n": 500, b"R1001\n": 500, b"R10?": 500, b"0\nR000300\n": 300}
    assert [host.ask(command).rate_hz for command in commands] == list(commands.values())
    host.take_frames(2)
    assert len(host.infos) == 2 + len(commands)  # one answer each, none to nonsense
