"""The firmware as it is flashed, run on a simulated board and asked over its serial port."""

import contextlib
import os
import signal
import subprocess
import time
from dataclasses import replace

import numpy as np
import pytest

from geometry.wiring import crossings
from hardware.boards.simavr_board import MCUS, write_table
from hardware.link.frames import Errors, ScanMode
from tests.hardware.simulated import COLUMN_WIRE, DISTINCT, INFO, ROW_WIRE, build, is_gapless, listening, starts_us

SETTLE_US = 30  # what scan.c promises the circuit


@pytest.mark.parametrize("mcu", MCUS)
def test_a_board_reads_every_crossing_on_time(board, mcu):
    with board(mcu, fast=True) as running, listening(running) as listener:
        assert listener.ask(b"?") == INFO
        listener.take_frames(300)
        statistics = running.stop()
    frames = listener.frames
    assert all((frame.counts == DISTINCT[0, ROW_WIRE, COLUMN_WIRE]).all() for frame in frames)
    assert is_gapless(frames)
    # whole microseconds of k + 1 periods, with none lost to the 2/3 µs by which a period at 150 Hz exceeds 6666
    assert starts_us(frames).tolist() == [(frame.sequence + 1) * 1_000_000 // 150 for frame in frames]
    assert {(frame.flags, frame.bits, frame.overruns) for frame in frames} == {(2 << 1, 10, 0)}
    assert statistics["bad_addresses"] == statistics["bytes_dropped"] == 0
    assert SETTLE_US <= statistics["min_settle_us"] < 58  # a whole conversion, up to the next one's sample


@pytest.mark.parametrize("mcu", MCUS)
def test_all_counts_arrive_as_they_are_and_change_with_the_boards_time(board, mcu):
    step_us = 50_000
    counts = np.zeros((10, 12, 12), dtype=int)
    counts[:, ROW_WIRE, COLUMN_WIRE] = np.arange(10 * 108).reshape(10, 108) % 1024
    with board(mcu, counts, step_us, fast=True) as running, listening(running) as listener:
        frames = listener.take_frames(150)
    steps, places = np.divmod(starts_us(frames), step_us)
    # the table's time runs from the reset, the board's from when its timer starts, less than 1 ms later
    seen = [(frame, step) for frame, step, place in zip(frames, steps, places, strict=True) if place < step_us - 7000]
    for frame, step in seen:
        expected = counts[step % 10, ROW_WIRE, COLUMN_WIRE]
        assert (frame.counts == expected).all()
        assert frame.saturated == (expected % 1023 == 0).any()
    assert set(np.concatenate([frame.counts for frame, _ in seen])) == set(range(1024))


def test_in_real_time_nothing_is_lost_and_the_board_does_not_run_ahead(board):
    for _ in range(5):  # until the machine has held up neither the reader, whose port holds 118 ms, nor the board
        before = time.monotonic()
        with board(MCUS[0]) as running, listening(running) as listener:
            frames = listener.take_frames(300)
            assert frames[-1].device_us * 1e-6 <= time.monotonic() - before
            statistics = running.stop()
        if max(1e3 * listener.longest_pause_s, statistics["max_lag_ms"]) < 50:
            break
    assert statistics["bytes_dropped"] == 0
    assert is_gapless(frames)
    assert frames[-1].overruns == 0


def test_rates(board):
    """176 Hz is the largest that a scan of 108 × 52 µs and its margin allow, and it costs no overrun."""
    with board(fast=True) as running, listening(running) as listener:
        for rate in (100, 176, 30, 150):
            assert listener.ask(b"R%d\n" % rate).rate_hz == rate
            listener.take_frames(2)  # the one that was due, and the first of the new rate
            steps = np.diff(starts_us(listener.take_frames(20)))
            assert set(steps) <= {1_000_000 // rate, 1_000_000 // rate + 1}
            assert steps.mean() == pytest.approx(1e6 / rate, abs=0.1)  # a step's rounding over 20
        for command in (b"R0\n", b"R177\n", b"R65686\n"):
            assert listener.ask(command) == INFO
        assert listener.ask(b"R\nRx\nnoise\n?") == INFO
        assert len(listener.infos) == 8
        listener.take_frames(5)
        assert running.stop()["min_settle_us"] >= SETTLE_US  # commands do not hold the converter up
    assert len(listener.infos) == 8
    assert listener.decoder.statistics.lost == listener.frames[-1].overruns == 0


def test_a_talkative_host_costs_neither_counts_nor_settling(board):
    """Commands at full speed while frames go out: the serial port's interrupts then want all of the CPU."""
    said = (b"?", b"???", b"R150\n", b"R100\n", b"nonsense?\n", b"R176\n")
    with board(MCUS[1], fast=True) as running, listening(running) as listener:
        for k in range(150):
            listener.port.write(said[k % len(said)])
            listener.take_frames(1)
        assert running.stop()["min_settle_us"] >= SETTLE_US
    assert len(listener.infos) > 50
    assert all((frame.counts == DISTINCT[0, ROW_WIRE, COLUMN_WIRE]).all() for frame in listener.frames)
    assert listener.decoder.statistics.lost == listener.decoder.statistics.bad_crc == 0


@pytest.mark.parametrize("flood", [b"?", b"R150\n", b"x", b"R" + 4095 * b"1"], ids=["?", "R150", "x", "R1111"])
def test_a_flood_of_commands_silences_nothing(board, flood):
    """At 1 Mbaud without a pause, for 2 s: every scan is sent, at its time, and none at a rate nobody asked for."""
    with board(fast=True) as running, listening(running) as listener:
        listener.ask(b"?")
        os.set_blocking(listener.port.fd, False)
        start = len(listener.frames)
        while len(listener.frames) < start + 300:
            with contextlib.suppress(BlockingIOError):
                os.write(listener.port.fd, flood * (4096 // len(flood)))
            listener.take_frames(1)
        lost = running.stop()["bytes_overrun"]
    assert lost > 1000  # no more could come in
    assert is_gapless(listener.frames)
    assert listener.frames[-1].overruns == 0
    assert set(np.diff(starts_us(listener.frames))) <= {6666, 6667}


def test_a_board_that_hangs_is_restarted_by_its_watchdog(board):
    """Within 2 s and the firmware's start; a chip's oscillator is worth 10 %, the simulated one is exact."""
    with board(fast=True) as running, listening(running) as listener:
        assert listener.ask_errors() == Errors(reset_cause=1 << 0)  # power
        last = listener.take_frames(10)[-1]
        running._running().send_signal(signal.SIGUSR2)
        listener.take(lambda self: self.frames[-1].sequence < last.sequence)
        assert listener.ask_errors() == Errors(reset_cause=1 << 3)
        assert listener.ask(b"?") == INFO
        listener.take_frames(500)  # and feeds it again: 3.3 s
        assert is_gapless(listener.frames[-500:])


def test_damaged_and_lost_bytes_are_counted_and_make_no_command(board):
    """Every fifth byte has a wrong stop bit, which in R100 is the line feed or a digit."""
    with board(fast=True, options=["--damage", "5"]) as running, listening(running) as listener:
        for _ in range(20):
            listener.port.write(b"R100\n")
            listener.take_frames(1)
        listener.port.write(b"\n")
        assert listener.ask(b"?").rate_hz == 150
        assert listener.ask_errors().bad_bytes == 20
        assert listener.errors[-1].losses == 0


def test_a_counter_stays_at_its_largest(board):
    with board(fast=True, options=["--damage", "2"]) as running, listening(running) as listener:
        for _ in range(15):
            listener.port.write(40 * b"x")
            listener.take_frames(1)
        listener.port.write(b"!!")  # one of them is damaged
        assert listener.take(lambda self: self.errors).errors[-1].bad_bytes == 255


def test_the_watchdog_lets_a_board_be_that_scans_once_a_second(board):
    with board(fast=True) as running, listening(running) as listener:
        assert listener.ask(b"R1\n").rate_hz == 1
        listener.take_frames(2)
        assert set(np.diff(starts_us(listener.take_frames(4)))) == {1_000_000}
        assert is_gapless(listener.frames)


def test_skipped_scans_are_counted_and_take_no_sequence_number(built, board, tmp_path):
    """At 250 kbaud a frame takes longer to send than to scan: every scan is sent or counted as skipped."""
    build(tmp_path, f"{tmp_path}/tripillar-{MCUS[0]}.elf", "BAUD=250000")
    with board(elf=tmp_path / f"tripillar-{MCUS[0]}.elf", fast=True) as running, listening(running) as listener:
        frames = listener.take_frames(800)
        assert listener.ask(b"?") == INFO  # though frames wait all the time
    assert is_gapless(frames)
    overruns = np.array([frame.overruns for frame in frames])
    periods = np.rint(np.diff(starts_us(frames)) * 150e-6).astype(int)
    assert overruns[0] + (periods - 1).sum() > 256
    assert (overruns == np.minimum(overruns[0] + np.cumsum([0, *periods - 1]), 255)).all()  # 255 stands for more


def test_the_reset_button_starts_the_sequence_and_the_table_again(board, tmp_path):
    write_table(tmp_path / "steps", np.repeat([100, 200], 144).reshape(2, 12, 12), 50_000, loop=False)
    with board(table=tmp_path / "steps", fast=True) as running, listening(running) as listener:
        listener.ask(b"R100\n")
        listener.take(lambda self: self.frames and self.frames[-1].counts[0] == 200)
        running._running().send_signal(signal.SIGUSR1)
        listener.take(lambda self: self.decoder.statistics.restarts == 1)
        assert listener.ask(b"?") == INFO
    sequence = [frame.sequence for frame in listener.frames]
    [restart] = np.flatnonzero(np.diff(sequence) != 1) + 1
    first = listener.frames[restart]
    assert (first.sequence, first.device_us, first.counts[0]) == (0, 6666, 100)


def test_settings_of_a_build(built, board, tmp_path):
    build(tmp_path, "all", "SERIAL=4294967295", "SCAN_MODE=0", "SENSE_OHM=10000", "VREF_MV=4950", "RATE=99", "ROWS=1")
    info = replace(INFO, serial=2**32 - 1, scan_mode=ScanMode.DIVIDER, sense_ohm=10_000, vref_mv=4950, rate_hz=99)
    for mcu in MCUS:
        with board(mcu, elf=tmp_path / f"tripillar-{mcu}.elf", fast=True) as running, listening(running) as listener:
            assert listener.ask(b"?") == replace(info, rows=1)
            frame = listener.take_frames(1)[0]
        row_wire, column_wire = crossings(1, 6).T
        assert (frame.counts == DISTINCT[0, row_wire, column_wire]).all()
        assert frame.scan_mode == ScanMode.DIVIDER


def test_a_changed_setting_makes_another_firmware_and_the_same_none(built, tmp_path):
    target = f"{tmp_path}/tripillar-{MCUS[0]}.hex"
    build(tmp_path, target, "SERIAL=1")
    first = (tmp_path / f"tripillar-{MCUS[0]}.hex").read_bytes()
    assert "flash" not in build(tmp_path, target, "SERIAL=1")
    assert "flash" in build(tmp_path, target, "SERIAL=2")
    assert (tmp_path / f"tripillar-{MCUS[0]}.hex").read_bytes() != first


def test_a_rate_that_no_scan_can_hold_is_refused_by_the_build(built, tmp_path):
    with pytest.raises(subprocess.CalledProcessError) as refusal:
        build(tmp_path, "all", "RATE=177")
    assert "RATE: 1 to what the scan time allows" in refusal.value.stderr
