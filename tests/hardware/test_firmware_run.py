"""The firmware as it is flashed, run on a simulated chip and asked over its port; and the program that simulates it."""

import contextlib
import os
import re
import signal
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geometry.design import SensorDesign, Unit
from geometry.layout import LAYOUTS
from hardware.boards.simavr_board import EMPTY, MCUS, write_table
from hardware.boards.simulated import by_wire, usual_rate
from hardware.link.frames import Errors, ScanMode
from tests.hardware.boards import (
    CHIP,
    COLUMN_WIRE,
    DISTINCT,
    PATIENT_S,
    ROW_WIRE,
    SHARED,
    build,
    is_gapless,
    listening,
    starts_us,
)
from tripillar.face.exporting import export

pytestmark = pytest.mark.real
SETTLE_US = 30  # what scan.c promises the circuit


@contextlib.contextmanager
def heard(board, *options, **chip):
    """A board that runs, and who listens to it."""
    with board(*options, **chip) as running, listening(running) as listener:
        yield running, listener


@pytest.mark.parametrize("mcu", MCUS)
def test_a_board_reads_every_crossing_on_time(board, mcu):
    with heard(board, "--fast", mcu=mcu) as (running, listener):
        assert listener.ask(b"?") == CHIP
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


OTHERS = [(MCUS[0], LAYOUTS["six-pillar"], 50), (MCUS[0], SHARED, 50), (MCUS[1], LAYOUTS["eight-pillar"], 50)]


@pytest.mark.parametrize(("mcu", "layout", "least_hz"), OTHERS, ids=["six pillars", "on shared wires", "eight pillars"])
def test_a_board_of_another_layout_reads_every_crossing_at_its_own_rate(board, tmp_path, mcu, layout, least_hz):
    """6 × 6 units, by the header that `tripillar export --to header` writes; the highest rate costs no overrun."""
    export(design=SensorDesign(unit=Unit(layout=layout)), to="header", out=tmp_path / "sensor.h")
    elf = tmp_path / f"tripillar-{mcu}.elf"
    build(tmp_path, str(elf), f"SENSOR={tmp_path}/sensor.h")
    info = replace(CHIP, layout=layout, rate_hz=usual_rate(36 * len(layout.pillars)))
    counts = np.arange(1, info.n_crossings + 1)[None] * 3  # tells each crossing from all others
    with heard(board, "--fast", mcu=mcu, counts=by_wire(counts, info), elf=elf) as (running, listener):
        assert listener.ask(b"?") == info
        frames = listener.take_frames(3 + 100)[3:]  # answers cost a frame where memory holds one
        statistics = running.stop()
    assert all((frame.counts == counts[0]).all() for frame in listener.frames)
    assert is_gapless(frames)
    assert frames[-1].overruns == frames[0].overruns
    assert 1e6 / np.diff(starts_us(frames)).max() >= least_hz
    assert statistics["bad_addresses"] == statistics["bytes_dropped"] == 0
    assert statistics["min_settle_us"] >= SETTLE_US


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["ROWS=33", "COLS=1"], "the pins of an atmega328p number 64 row and 64 column wires, those of an atmega2560"),
        (
            ["ROWS=11", "COLS=11"],
            "this sensor has more pillars than the RAM of this board holds frames of: build for a larger",
        ),
        (["SENSOR=none.h"], "no none.h: give the whole path of a header that 'tripillar export --to header' wrote"),
    ],
)
def test_what_a_chip_cannot_hold_is_one_line(built, tmp_path, settings, said):
    with pytest.raises(subprocess.CalledProcessError) as refusal:
        build(tmp_path, f"BOARD={MCUS[0]}", "all", *settings)
    assert re.search(said, refusal.value.stderr)
    assert not list(tmp_path.glob("*.hex"))


def test_all_counts_arrive_as_they_are_and_change_with_the_boards_time(board):
    step_us = 50_000
    counts = np.full((10, 12, 12), EMPTY)
    counts[:, ROW_WIRE, COLUMN_WIRE] = np.arange(10 * 108).reshape(10, 108) % 1024
    with heard(board, "--fast", counts=counts, step_us=step_us) as (_, listener):
        frames = listener.take_frames(150)
    steps, places = np.divmod(starts_us(frames), step_us)
    # the table's time runs from the reset, the board's from when its timer starts, less than 1 ms later
    seen = [(frame, step) for frame, step, place in zip(frames, steps, places, strict=True) if place < step_us - 7000]
    for frame, step in seen:
        expected = counts[step % 10, ROW_WIRE, COLUMN_WIRE]
        assert (frame.counts == expected).all()
        assert frame.saturated == (expected % 1023 == 0).any()
    assert set(np.concatenate([frame.counts for frame, _ in seen])) == set(range(1024))


def test_in_real_time_nothing_is_lost_but_what_nobody_reads_and_the_board_does_not_run_ahead(board):
    before = time.monotonic()
    with heard(board) as (running, listener):
        frames = listener.take_frames(100)
        assert frames[-1].device_us * 1e-6 <= time.monotonic() - before
        statistics = running.stop()
    assert is_gapless(frames) or statistics["bytes_dropped"] > 0  # a busy machine reads late; the port holds 118 ms
    with board("--seconds", "0.8") as running:
        statistics = running.stop(at_once=False)
    assert statistics["bytes_dropped"] > 0
    assert statistics["bytes_sent"] + statistics["bytes_dropped"] == pytest.approx(118 * 232, abs=232)
    assert statistics["seconds"] == pytest.approx(0.8, abs=2e-3)


def test_rates(board):
    """176 Hz is the largest that a scan of 108 × 52 µs and its margin allow, and it costs no overrun."""
    with heard(board, "--fast") as (running, listener):
        for rate in (100, 176, 30, 150):
            assert listener.ask(b"R%d\n" % rate).rate_hz == rate
            listener.take_frames(2)  # the one that was due, and the first of the new rate
            steps = np.diff(starts_us(listener.take_frames(20)))
            assert set(steps) <= {1_000_000 // rate, 1_000_000 // rate + 1}
            assert steps.mean() == pytest.approx(1e6 / rate, abs=0.1)  # a step's rounding over 20
        for command in (b"R0\n", b"R177\n", b"R65686\n", b"R\nRx\nnoise\n?"):
            assert listener.ask(command) == CHIP
        listener.take_frames(5)
        assert len(listener.infos) == 8
        assert is_gapless(listener.frames)
        assert listener.frames[-1].overruns == 0
        assert listener.ask(b"R1\n").rate_hz == 1  # and the watchdog lets it be
        listener.take_frames(2)
        assert set(np.diff(starts_us(listener.take_frames(4)))) == {1_000_000}
        assert running.stop()["min_settle_us"] >= SETTLE_US  # commands do not hold the converter up


def test_a_flood_of_commands_costs_neither_scans_nor_counts_nor_settling(board):
    """At 1 Mbaud without a pause, for 1 s: every scan is sent, at its time, and none at a rate nobody asked for."""
    with heard(board, "--fast", mcu=MCUS[1]) as (running, listener):
        listener.ask(b"?")
        os.set_blocking(listener.port.fd, False)
        start = len(listener.frames)
        while len(listener.frames) < start + 150:
            with contextlib.suppress(BlockingIOError):
                os.write(listener.port.fd, b"?R150\n?R" + 4088 * b"1")
            listener.take_frames(1)
        statistics = running.stop()
    assert statistics["bytes_overrun"] > 1000  # no more could come in
    assert statistics["min_settle_us"] >= SETTLE_US
    assert all((frame.counts == DISTINCT[0, ROW_WIRE, COLUMN_WIRE]).all() for frame in listener.frames)
    assert is_gapless(listener.frames)
    assert listener.frames[-1].overruns == 0
    assert set(np.diff(starts_us(listener.frames))) <= {6666, 6667}


def test_a_board_that_hangs_is_restarted_by_its_watchdog(board):
    """Within 2 s and the firmware's start; a chip's oscillator is worth 10 %, the simulated one is exact."""
    with heard(board, "--fast") as (running, listener):
        assert listener.ask(b"!") == Errors(reset_cause=1 << 0)  # power
        last = listener.take_frames(10)[-1]
        running.process.send_signal(signal.SIGUSR2)
        listener.take(lambda self: self.frames[-1].sequence < last.sequence)
        assert listener.ask(b"!") == Errors(reset_cause=1 << 3)
        assert listener.ask(b"?") == CHIP
        listener.take_frames(500)  # and feeds it again: 3.3 s
        assert is_gapless(listener.frames[-500:])


def test_damaged_bytes_are_counted_up_to_the_largest_number_and_make_no_command(board):
    """Every fifth byte has a wrong stop bit, which in R100 is the line feed or a digit."""
    with heard(board, "--fast", "--damage", "5") as (_, listener):
        for _ in range(20):
            listener.port.write(b"R100\n")
            listener.take_frames(1)
        listener.port.write(b"\n")
        assert listener.ask(b"?").rate_hz == 150
        assert listener.ask(b"!") == Errors(reset_cause=1, bad_bytes=20)
        for _ in range(35):
            listener.port.write(40 * b"x")
            listener.take_frames(1)
        listener.port.write(b"!!")  # one of them may be damaged
        assert listener.take(lambda self: len(self.errors) > 1).errors[-1].bad_bytes == 255


def test_settings_make_another_firmware_and_the_same_none(built, board, tmp_path):
    """At 250 kbaud a frame takes longer to send than to scan: every scan is sent or counted as skipped."""
    settings = ["SERIAL=4294967295", "SCAN_MODE=0", "SENSE_OHM=10000", "VREF_MV=4950", "BAUD=250000"]
    elf, target = (f"{tmp_path}/tripillar-{MCUS[0]}.{suffix}" for suffix in ("elf", "hex"))
    build(tmp_path, elf, target, *settings)
    info = replace(CHIP, serial=2**32 - 1, scan_mode=ScanMode.DIVIDER, sense_ohm=10_000, vref_mv=4950)
    with heard(board, "--fast", elf=Path(elf)) as (running, listener):
        frames = listener.take_frames(700)
        assert listener.ask(b"?") == info  # though frames wait all the time
        running.process.send_signal(signal.SIGUSR1)  # the reset button
        listener.take(lambda self: self.frames[-1].sequence < 700)
        assert listener.ask(b"?") == info
    assert frames[-1].scan_mode == ScanMode.DIVIDER
    assert is_gapless(frames)  # what is skipped takes no sequence number
    overruns = np.array([frame.overruns for frame in frames])
    periods = np.rint(np.diff(starts_us(frames)) * 150e-6).astype(int)
    assert overruns[0] + (periods - 1).sum() > 256
    assert (overruns == np.minimum(overruns[0] + np.cumsum([0, *periods - 1]), 255)).all()  # 255 stands for more
    sequence = [frame.sequence for frame in listener.frames]
    first = listener.frames[np.flatnonzero(np.diff(sequence) != 1)[0] + 1]
    assert (first.sequence, first.device_us) == (0, 6666)
    assert "flash" not in build(tmp_path, target, *settings)
    with pytest.raises(subprocess.CalledProcessError) as refusal:
        build(tmp_path, "all", "RATE=177")
    assert "RATE: 1 to what the scan time allows" in refusal.value.stderr


# the program that simulates the chip


def test_what_cannot_run_is_refused_in_one_line(built, tmp_path):
    table, elf = tmp_path / "table", built / f"tripillar-{MCUS[0]}.elf"
    write_table(table, DISTINCT, 1000)
    good = ["--elf", elf, "--mcu", MCUS[0], "--table", table]
    (tmp_path / "short").write_bytes(table.read_bytes()[:-1])
    cases = [
        (good[:4], "--table is missing"),
        ([*good, "--mcu", MCUS[1]], "built for the family avr5, but atmega2560 is of avr6"),
        ([*good, "--table", tmp_path / "short"], "319 bytes, its header announces 320"),
        ([*good, "--seconds", "-1"], "--seconds is '-1', expected a number above 0"),
    ]
    for arguments, message in cases:
        ended = subprocess.run([built / "simavr-board", *arguments], capture_output=True, text=True, timeout=PATIENT_S)
        assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1)
        assert message in ended.stderr
