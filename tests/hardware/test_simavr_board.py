"""The firmware as it is flashed, run on a simulated board and asked over its serial port."""

import json
import re
import subprocess
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import serial

from geometry.wiring import crossings
from hardware.frames import FrameDecoder, Info, ScanMode
from hardware.simavr_board import FIRMWARE, MCUS, SimavrBoard, SimavrError, find_tools, write_table

missing = find_tools()
pytestmark = pytest.mark.skipif(missing is not None, reason=str(missing))

INFO = Info(scan_mode=ScanMode.ZERO_POTENTIAL, firmware=(1, 0, 0), sense_ohm=4700)
DISTINCT = np.arange(144).reshape(1, 12, 12) * 7 + 1  # tells every crossing from all others; none saturates
ROW_WIRE, COLUMN_WIRE = crossings(6, 6).T
SETTLE_US = 30  # what scan.c promises the circuit
PATIENCE_S = 30  # of real time, until a test calls a board silent


def build(folder, *arguments):
    command = ["make", "-s", "-C", str(FIRMWARE), f"OUT={folder}", *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("built")
    build(folder, "all", "simulator")
    return folder


@pytest.fixture
def board(built, tmp_path):
    """Starts boards that read a table of counts; DISTINCT unless told."""

    def start(mcu=MCUS[0], counts=DISTINCT, step_us=1000, elf=None, table=None, **options):
        if table is None:
            table = tmp_path / "readings.table"
            write_table(table, counts, step_us)
        elf = elf or built / f"tripillar-{mcu}.elf"
        return SimavrBoard(elf, mcu, table, program=built / "simavr-board", **options)

    return start


class Listener:
    """What has come out of a board's port so far."""

    def __init__(self, port):
        self.port, self.decoder = port, FrameDecoder()
        self.frames, self.infos = [], []

    def take(self, enough):
        """Listen until `enough` holds of self."""
        end = time.monotonic() + PATIENCE_S
        while not enough(self):
            assert time.monotonic() < end, f"{len(self.frames)} frames, {self.infos}, {self.decoder.statistics}"
            for received in self.decoder.feed(self.port.read(max(1, self.port.in_waiting))):
                (self.infos if isinstance(received, Info) else self.frames).append(received)
        return self

    def take_frames(self, n):
        """Listen for n more frames; returns them."""
        start = len(self.frames)
        self.take(lambda self: len(self.frames) >= start + n)
        return self.frames[start : start + n]

    def ask(self, command):
        """Send a command and return the INFO frame that answers it."""
        n_before = len(self.infos)
        self.port.write(command)
        return self.take(lambda self: len(self.infos) > n_before).infos[-1]


@contextmanager
def listening(board):
    with serial.Serial(board.port, 1_000_000, timeout=0.05) as port:
        yield Listener(port)


def is_gapless(frames):
    """Whether no frame is missing; the first ones may be, since who opens a port clears what is waiting there."""
    return (np.diff([frame.sequence for frame in frames]) == 1).all()


def starts_us(frames):
    return np.array([frame.device_us for frame in frames])


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


def test_the_table_goes_round_or_stays(board, tmp_path):
    counts = np.repeat([100, 200], 144).reshape(2, 12, 12)
    last = {}
    for loop in (True, False):
        write_table(tmp_path / "steps", counts, 100_000, loop=loop)
        with board(table=tmp_path / "steps", fast=True) as running, listening(running) as listener:
            frames = listener.take_frames(40)
        last[loop] = [frame.counts[0] for frame in frames if 210_000 < frame.device_us < 290_000]
    assert set(last[True]) == {100}
    assert set(last[False]) == {200}


def test_a_table_written_in_place_takes_effect(board, tmp_path):
    table = tmp_path / "live"
    write_table(table, np.full((1, 12, 12), 5), 1000)
    with board(table=table, fast=True) as running, listening(running) as listener:
        assert set(listener.take_frames(3)[-1].counts) == {5}
        np.memmap(table, "<u2", "r+", offset=32)[:] = 9
        listener.take(lambda self: self.frames and set(self.frames[-1].counts) == {9})


@pytest.mark.parametrize("mcu", MCUS)
def test_in_real_time_nothing_is_lost_and_the_board_does_not_run_ahead(board, mcu):
    before = time.monotonic()
    with board(mcu) as running, listening(running) as listener:
        frames = listener.take_frames(300)
        assert frames[-1].device_us * 1e-6 <= time.monotonic() - before
        assert running.stop()["bytes_dropped"] == 0
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


@pytest.mark.parametrize("mcu", MCUS)
def test_a_talkative_host_costs_neither_counts_nor_settling(board, mcu):
    """Commands at full speed while frames go out: the serial port's interrupts then want all of the CPU."""
    said = (b"?", b"???", b"R150\n", b"R100\n", b"nonsense?\n", b"R176\n")
    with board(mcu, fast=True) as running, listening(running) as listener:
        for k in range(300):
            listener.port.write(said[k % len(said)])
            listener.take_frames(1)
        assert running.stop()["min_settle_us"] >= SETTLE_US
    assert len(listener.infos) > 100
    assert all((frame.counts == DISTINCT[0, ROW_WIRE, COLUMN_WIRE]).all() for frame in listener.frames)
    assert listener.decoder.statistics.lost == listener.decoder.statistics.bad_crc == 0


def test_one_scan_a_second(board):
    with board(fast=True) as running, listening(running) as listener:
        assert listener.ask(b"R1\n").rate_hz == 1
        listener.take_frames(2)
        assert set(np.diff(starts_us(listener.take_frames(4)))) == {1_000_000}


def test_questions_are_answered_one_by_one_between_frames(board):
    with board(fast=True) as running, listening(running) as listener:
        listener.port.write(20 * b"?")
        listener.take(lambda self: len(self.infos) == 20)
        listener.take_frames(20)
    assert listener.infos == 20 * [INFO]
    assert listener.decoder.statistics.lost == 0


def test_skipped_scans_are_counted_and_take_no_sequence_number(built, board, tmp_path):
    """At 250 kbaud a frame takes longer to send than to scan: every scan is sent or counted as skipped."""
    build(tmp_path, f"{tmp_path}/tripillar-{MCUS[0]}.elf", "BAUD=250000")
    with board(elf=tmp_path / f"tripillar-{MCUS[0]}.elf", fast=True) as running, listening(running) as listener:
        frames = listener.take_frames(800)
        assert listener.ask(b"?") == INFO  # though frames wait all the time
    assert is_gapless(frames)
    skipped = np.diff(np.array([frame.overruns for frame in frames], dtype=np.uint8))  # modulo 256, as sent
    assert skipped.sum() > 256
    periods = np.rint(np.diff(starts_us(frames)) * 150e-6).astype(int)
    assert (periods == 1 + skipped).all()


def test_the_reset_button_starts_the_sequence_and_the_table_again(board, tmp_path):
    write_table(tmp_path / "steps", np.repeat([100, 200], 144).reshape(2, 12, 12), 50_000, loop=False)
    with board(table=tmp_path / "steps", fast=True) as running, listening(running) as listener:
        listener.ask(b"R100\n")
        listener.take(lambda self: self.frames and self.frames[-1].counts[0] == 200)
        running.press_reset()
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


def test_a_changed_setting_makes_another_firmware_and_the_same_none(tmp_path):
    target = f"{tmp_path}/tripillar-{MCUS[0]}.hex"
    build(tmp_path, target, "SERIAL=1")
    first = (tmp_path / f"tripillar-{MCUS[0]}.hex").read_bytes()
    assert "flash" not in build(tmp_path, target, "SERIAL=1")
    assert "flash" in build(tmp_path, target, "SERIAL=2")
    assert (tmp_path / f"tripillar-{MCUS[0]}.hex").read_bytes() != first


def test_a_rate_that_no_scan_can_hold_is_refused_by_the_build(tmp_path):
    with pytest.raises(subprocess.CalledProcessError) as refusal:
        build(tmp_path, "all", "RATE=177")
    assert "RATE: 1 to what the scan time allows" in refusal.value.stderr


def test_a_fast_board_waits_for_its_reader(board):
    with board(fast=True) as running, listening(running) as listener:
        end = time.monotonic() + PATIENCE_S
        while listener.port.in_waiting < 4000:  # what a port holds: beyond, the board must wait or drop
            assert time.monotonic() < end
        listener.take_frames(200)
        assert running.stop()["bytes_dropped"] == 0
    assert listener.decoder.statistics.lost == listener.decoder.statistics.bad_crc == 0


def test_a_board_in_real_time_drops_what_nobody_reads(board):
    with board(seconds=1.0) as running:
        statistics = running.wait()
    assert statistics["bytes_dropped"] > 0
    assert statistics["bytes_sent"] + statistics["bytes_dropped"] == pytest.approx(148 * 232, abs=232)
    assert statistics["seconds"] == pytest.approx(1.0, abs=2e-3)


def test_a_link_names_the_port_as_long_as_the_board_runs(board, tmp_path):
    link = tmp_path / "board"
    with board(link=link, fast=True) as first:
        assert str(link.resolve()) == first.port
        with board(link=link, fast=True) as second:  # takes the name over
            assert str(link.resolve()) == second.port
            first.stop()
            assert str(link.resolve()) == second.port
    assert not link.is_symlink()


def test_a_link_replaces_no_file(board, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(SimavrError, match=r"notes\.txt: exists and is no link"), board(link=tmp_path / "notes.txt"):
        pass
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_what_cannot_run_is_refused_in_one_line(built, tmp_path):
    table, elf = tmp_path / "table", built / f"tripillar-{MCUS[0]}.elf"
    write_table(table, DISTINCT, 1000)
    good = ["--elf", elf, "--mcu", MCUS[0], "--table", table]
    (tmp_path / "short").write_bytes(table.read_bytes()[:-1])
    (tmp_path / "other").write_bytes(b"RIFF" + table.read_bytes()[4:])
    (tmp_path / "later").write_bytes(b"TPTB\2" + table.read_bytes()[5:])
    cases = [
        (good[:4], "--table is missing"),
        ([*good, "--elf", tmp_path / "none.elf"], "none.elf: No such file or directory: build"),
        ([*good, "--elf", table], "no AVR program in ELF form"),
        ([*good, "--mcu", MCUS[1]], "built for the family avr5, but atmega2560 is of avr6"),
        ([*good, "--mcu", "attiny85"], "--mcu attiny85 is unknown, expected atmega328p or atmega2560"),
        ([*good, "--table", tmp_path / "none"], "none: No such file or directory: give a table"),
        ([*good, "--table", tmp_path / "short"], "319 bytes, its header announces 320"),
        ([*good, "--table", tmp_path / "other"], "does not start with TPTB"),
        ([*good, "--table", tmp_path / "later"], "table version 2, this program reads 1"),
        ([*good, "--seconds", "-1"], "--seconds is '-1', expected a number above 0"),
        ([*good, "--quick"], "unknown option '--quick'"),
        ([*good, "--link", tmp_path / "no" / "link"], "link: No such file or directory"),
    ]
    for arguments, message in cases:
        ended = subprocess.run([built / "simavr-board", *arguments], capture_output=True, text=True, timeout=PATIENCE_S)
        assert ended.returncode == 2
        assert message in ended.stderr
        assert ended.stderr.count("\n") == 1
        assert ended.stdout == ""


def test_output_is_two_lines_of_json(built, tmp_path):
    write_table(tmp_path / "table", DISTINCT, 1000)
    command = [built / "simavr-board", "--elf", built / f"tripillar-{MCUS[1]}.elf", "--mcu", MCUS[1]]
    command += ["--table", tmp_path / "table", "--seconds", "0.05", "--link", tmp_path / 'a "link"']
    start, end = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert json.loads(start).keys() == {"port", "link", "mcu"}
    assert json.loads(start)["link"] == str(tmp_path / 'a "link"')
    assert json.loads(end).keys() == {
        *("seconds", "cycles", "bytes_sent", "bytes_dropped", "bytes_received", "conversions"),
        *("min_settle_us", "bad_addresses", "max_lag_ms"),
    }


def test_the_example_of_the_page_runs(built, tmp_path, monkeypatch, capsys):
    page = (FIRMWARE.parents[1] / "docs" / "board.md").read_text()
    [example] = [block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "SimavrBoard" in block]
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "firmware").symlink_to(built)
    monkeypatch.chdir(tmp_path)
    exec(example, {})
    assert "firmware=(1, 0, 0)" in capsys.readouterr().out


def test_missing_tools_are_named_with_their_packages(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    advice = find_tools()
    assert advice.startswith(
        "no make, cc, avr-gcc, avr-size, simavr/sim_avr.h, libelf.h, avr/io.h for the simulated board"
    )
    assert advice.endswith("apt install make gcc gcc-avr binutils-avr libsimavr-dev libelf-dev avr-libc.")
    assert "\n" not in advice


def test_a_board_that_was_not_built_says_how(tmp_path):
    with (
        pytest.raises(SimavrError, match=r"No such file or directory: build it with 'make -C hardware/firmware"),
        SimavrBoard(tmp_path / "elf", MCUS[0], tmp_path / "table", program=tmp_path / "simavr-board"),
    ):
        pass


@pytest.mark.parametrize(
    ("counts", "step_us", "message"),
    [
        (DISTINCT[0], 1000, r"shape \(12, 12\), expected whole numbers of shape \(steps, row wires, column wires\)"),
        (DISTINCT / 2, 1000, "float64"),
        (DISTINCT + 1000, 1000, "counts run from 1001 to 2002: clip them to 0 to 1023"),
        (-DISTINCT, 1000, "counts run from -1002 to -1"),
        (DISTINCT, 0, "step_us=0 must be from 1"),
    ],
)
def test_tables_refuse_nonsense(tmp_path, counts, step_us, message):
    with pytest.raises(SimavrError, match=message):
        write_table(tmp_path / "table", counts, step_us)
    assert not (tmp_path / "table").exists()
