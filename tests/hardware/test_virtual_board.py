"""The board in Python sends what docs/frames.md says, at its pace, and fails as it is told to."""

import os
import threading
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from hardware.boards.virtual_board import VirtualBoard
from hardware.link.frames import FrameError
from tests.hardware.boards import COUNTS, INFO, wait_until
from tests.hardware.faulty_board import FaultyBoard
from tests.hardware.simulated import listening


def quiet(board, listener):
    """Have the board hang, and read what it had sent, to the last frame that the port had room for."""
    board.stall()
    last, _ = board.sent[-1]
    listener.take(lambda self: not self.port.in_waiting if board.dropped_bytes else self.frames[-1].sequence == last)


@contextmanager
def a_board_and_host(counts=COUNTS, info=INFO, **options):
    with FaultyBoard(counts, info, **options) as board, listening(board) as listener:
        yield board, listener


def periods_us(frames):
    """The board's periods between frames, those of the scans that it skipped between them counted."""
    skipped = np.diff([frame.overruns for frame in frames])
    return np.diff([frame.device_us for frame in frames]) / (1 + skipped)


def test_frames_carry_the_counts_in_their_order():
    with a_board_and_host() as (_, host):
        frames = host.take_frames(60)
    first = frames[0].sequence
    assert [frame.sequence for frame in frames] == list(range(first, first + 60))
    assert all((frame.counts == COUNTS[(frame.sequence + frame.overruns) % 50]).all() for frame in frames)
    assert (frames[0].bits, frames[0].scan_mode, frames[0].saturated) == (10, INFO.scan_mode, False)


def test_counts_may_be_computed_from_the_boards_time():
    with a_board_and_host(lambda time_s: np.full(108, int(time_s * 1e3))) as (_, host):
        frames = host.take_frames(5)
    assert all(abs(frame.counts - frame.device_us / 1e3).max() <= 1 for frame in frames)


@pytest.mark.parametrize("rate_hz", [100, 1000])
def test_counts_go_by_at_their_own_pace(rate_hz):
    """Whatever the rate, and whatever a stall has cost."""
    steps = np.arange(1000)[:, None] * np.ones(108, int)
    with a_board_and_host(steps, step_s=0.01) as (board, host):
        host.ask(b"R%d\n" % rate_hz)
        frames = host.take_frames(20)
        board.stall()
        time.sleep(0.1)
        board.stall(False)
        frames += host.take_frames(20)
    late = [frame.device_us // 10_000 - frame.counts[0] for frame in frames]
    assert set(late) <= {0, 1}  # 1 where rounding to a microsecond took the time to the next step


def test_a_looped_array_needs_a_step():
    with pytest.raises(FrameError, match="step_s=0 must be above 0"):
        VirtualBoard(COUNTS, INFO, step_s=0)


def test_the_schedule_does_not_drift():
    """Frame k, overruns counted in, starts k periods after the first: up to what the system is late by."""
    with a_board_and_host() as (_, host):
        frames = host.take_frames(200)
    late_us = [frame.device_us - 5000 * (frame.sequence + frame.overruns) for frame in frames]
    late_us = np.array([late + 1 for late in late_us]) % (256 * 5000)  # 1 for the rounding; overruns are modulo 256
    assert late_us.max() <= 5002  # never early; and what is later by a period is an overrun
    assert late_us[-50:].min() < 2000  # 200 periods are 1 s: a relative schedule would be behind by some 10 ms


def test_answers_and_rates():
    with a_board_and_host() as (_, host):
        assert host.ask() == INFO
        assert host.ask(b"R500\n") == replace(INFO, rate_hz=500)
        assert np.median(periods_us(host.take_frames(52)[1:])) == pytest.approx(2000, abs=500)
        assert host.ask(b"R0\n") == host.ask(b"R1001\n") == replace(INFO, rate_hz=500)
        assert host.ask(b"Rx7\nR\n7\n?") == replace(INFO, rate_hz=500)
        host.take_frames(20)
        assert host.decoder.statistics.info == 5  # one an answer, none to nonsense
        assert host.ask(b"R10?") == replace(INFO, rate_hz=500)
        assert host.ask(b"0\nR000300\n") == replace(INFO, rate_hz=300)
        host.take_frames(20)
        assert host.decoder.statistics.info == 7  # the question ended the command, the digit behind it is nothing


def test_a_new_rate_holds_after_the_scan_that_is_due():
    with a_board_and_host(info=replace(INFO, rate_hz=5)) as (_, host):
        host.take_frames(1)
        start = len(host.frames)
        host.ask(b"R1000\n")
        frames = host.take(lambda self: len(self.frames) >= start + 5).frames[start:]
    assert frames[0].device_us >= 200_000 * frames[0].sequence  # still on the old schedule
    assert np.median(periods_us(frames)) == pytest.approx(1000, abs=500)


def test_nobody_reads():
    """The pty fills within 70 frames or so. The board goes on; who reads then, gets whole frames again."""
    with VirtualBoard(COUNTS, replace(INFO, rate_hz=1000)) as board:
        wait_until(lambda: board.dropped_bytes)
        with listening(board) as host:
            newest = board.sent[-1][0]
            while host.take_frames(1)[0].sequence < newest:
                pass
            assert host.decoder.statistics.bad_form == 0


def test_a_slow_scan_is_an_overrun_without_a_sequence_number():
    is_slow = threading.Event()

    def counts(time_s):
        if is_slow.is_set():
            is_slow.clear()
            time.sleep(4.5 / INFO.rate_hz)
        return COUNTS[0]

    with a_board_and_host(counts) as (_, host):
        frames = host.take_frames(5)
        is_slow.set()
        while is_slow.is_set():
            frames += host.take_frames(1)
        frames += host.take_frames(30)
    assert host.decoder.statistics.lost == 0
    assert frames[-1].overruns >= 3  # of the four that fell due meanwhile, the last is only late
    assert frames[0].overruns < frames[-1].overruns
    # the clock tells of the scans that were skipped
    elapsed_us = frames[-1].device_us - frames[0].device_us
    n_scans = frames[-1].sequence - frames[0].sequence + frames[-1].overruns - frames[0].overruns
    assert elapsed_us == pytest.approx(n_scans * 1e6 / INFO.rate_hz, abs=2 * 1e6 / INFO.rate_hz)


def test_a_stall_is_silent_and_counted():
    with a_board_and_host() as (board, host):
        before = host.take_frames(1)[0]
        board.stall()
        time.sleep(0.2)
        board.stall(False)
        after = host.take_frames(10)[-1]
    assert after.device_us - before.device_us > 200_000
    assert (after.overruns - before.overruns) % 256 >= 39  # 0.2 s of 200 scans a second, less one


def test_the_link_follows_the_port(tmp_path):
    link = tmp_path / "board"
    with FaultyBoard(COUNTS, INFO, link=link) as board:
        assert board.port == str(link)
        with listening(board) as host:
            board.unplug()
            assert not os.path.lexists(link)
            with pytest.raises(OSError, match="the port is gone"):
                host.take_frames(1000)
        board.unplug()  # once more does nothing
        board.replug()
        with listening(board) as host:
            assert host.take_frames(1)[0].sequence > 0  # it ran on
    assert not os.path.lexists(link)


def test_a_restart_begins_at_0():
    with a_board_and_host() as (board, host):
        host.take_frames(20)
        quiet(board, host)  # else what waits might leave no room for frame 0
        board.restart()
        assert min(frame.sequence for frame in host.take_frames(20)) == 0
        assert host.decoder.statistics.restarts == 1


def test_a_restart_forgets_the_rate_and_half_a_command():
    with a_board_and_host() as (board, host):
        assert host.ask(b"R500\n").rate_hz == 500
        host.port.write(b"R30")
        wait_until(lambda: board._board._commands._line == b"R30")
        board.restart()
        host.port.write(b"0\n")
        assert host.ask() == INFO
        host.take_frames(20)
        assert host.decoder.statistics.info == 2


def test_a_restart_begins_with_a_delimiter():
    """So that what the reset cut off, here garbage without an end, does not take the first frame along."""
    with a_board_and_host() as (board, host):
        host.take_frames(1)
        quiet(board, host)
        board.do(lambda: board._send(b"\x05ab"))
        board.restart()
        assert host.take_frames(1)[0].sequence == 0


def test_garbage_takes_the_place_of_frames():
    with a_board_and_host() as (board, host):
        host.take_frames(3)
        board.garble(b"\x05ab\0", n_frames=4)
        while not host.decoder.statistics.lost:
            host.take_frames(1)
    assert (host.decoder.statistics.bad_cobs, host.decoder.statistics.lost) == (4, 4)


def test_an_impostor_says_so():
    other = replace(INFO, rows=2, cols=3, serial=7)
    with a_board_and_host() as (board, host):
        board.impostor(other)
        assert host.ask() == other
        assert host.take_frames(2)[-1].counts.tolist() == [512] * 18
        board.impostor(None)
        assert host.ask() == INFO
        assert host.take_frames(2)[-1].counts.size == 108


def test_what_was_sent_is_logged_with_its_time():
    with a_board_and_host() as (board, host):
        frames = host.take_frames(20)
        received_s = time.perf_counter()
        sent = dict(board.sent)
    times = [sent[frame.sequence] for frame in frames]
    assert times == sorted(times)
    assert times[-1] < received_s


def test_what_goes_wrong_in_the_boards_thread_is_not_lost():
    board = VirtualBoard(lambda time_s: np.full(3, 2000), INFO)  # more than 10 bits hold
    wait_until(lambda: not board._thread.is_alive())
    with pytest.raises(FrameError, match="counts run from 2000"):
        board.close()
    board.close()


def test_counts_of_no_frame_are_refused():
    with pytest.raises(FrameError, match=r"counts has shape \(2, 3, 4\), expected \(n, n_crossings\)"):
        VirtualBoard(np.zeros((2, 3, 4)), INFO)
