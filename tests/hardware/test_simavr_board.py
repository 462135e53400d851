"""The program that simulates a board, and what starts it: readings, ports, links, refusals."""

import re
import subprocess
import time

import numpy as np
import pytest

from hardware.boards.simavr_board import FIRMWARE, MCUS, SimavrBoard, SimavrError, find_tools, write_table
from tests.hardware.boards import PATIENT_S
from tests.hardware.simulated import DISTINCT, listening


def test_a_table_written_in_place_takes_effect(board, tmp_path):
    table = tmp_path / "live"
    write_table(table, np.full((1, 12, 12), 5), 1000)
    with board(table=table, fast=True) as running, listening(running) as listener:
        assert set(listener.take_frames(3)[-1].counts) == {5}
        np.memmap(table, "<u2", "r+", offset=32)[:] = 9
        listener.take(lambda self: self.frames and set(self.frames[-1].counts) == {9})


def test_a_fast_board_waits_for_its_reader(board):
    with board(fast=True) as running, listening(running) as listener:
        end = time.monotonic() + PATIENT_S
        while listener.port.in_waiting < 4000:  # what a port holds: beyond, the board must wait or drop
            assert time.monotonic() < end
        listener.take_frames(200)
        assert running.stop()["bytes_dropped"] == 0
    assert listener.decoder.statistics.lost == listener.decoder.statistics.bad_crc == 0


def test_a_board_in_real_time_drops_what_nobody_reads(board):
    with board(options=["--seconds", "1.0"]) as running:
        statistics = running.stop(at_once=False)
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
        ([*good, "--damage", "0"], "--damage is '0', expected a whole number above 0"),
        ([*good, "--quick"], "unknown option '--quick'"),
        ([*good, "--link", tmp_path / "no" / "link"], "link: No such file or directory"),
    ]
    for arguments, message in cases:
        ended = subprocess.run([built / "simavr-board", *arguments], capture_output=True, text=True, timeout=PATIENT_S)
        assert ended.returncode == 2
        assert message in ended.stderr
        assert ended.stderr.count("\n") == 1
        assert ended.stdout == ""


def test_the_example_of_the_page_runs(built, tmp_path, monkeypatch, capsys):
    page = (FIRMWARE.parents[1] / "docs" / "board.md").read_text()
    [example] = [block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "SimavrBoard" in block]
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "firmware").symlink_to(built)
    monkeypatch.chdir(tmp_path)
    exec(example, {})
    assert "firmware=(1, 1, 0)" in capsys.readouterr().out


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
