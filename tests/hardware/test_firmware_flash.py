"""What `make flash` sends: the firmware as it was built, whatever was given then; stand-ins for the AVR's tools."""

import os
import shutil
import subprocess

import pytest

from hardware.boards.simavr_board import FIRMWARE

TOOLS = {
    "avr-gcc": 'while [ "$1" != -o ]; do shift; done; echo built > "$2"',
    "avr-size": "echo; echo 1 1 1",
    "avr-objcopy": 'for last; do :; done; echo ":00000001FF" > "$last"',
    "avrdude": 'echo avrdude "$@"',
}


@pytest.fixture
def make(tmp_path):
    """Runs make in hardware/firmware; returns its exit status and what it said."""
    if not shutil.which("make"):
        pytest.skip("no 'make' on this machine: on Debian or Ubuntu, apt install make")
    tools, out = tmp_path / "tools", tmp_path / "out"
    tools.mkdir()
    for name, script in TOOLS.items():
        (tools / name).write_text(f"#!/bin/sh\n{script}\n")
        (tools / name).chmod(0o755)
    environment = os.environ | {"PATH": f"{tools}:{os.environ['PATH']}"}

    def run(*arguments):
        command = ["make", "-s", "-C", str(FIRMWARE), f"OUT={out}", *arguments]
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        return done.returncode, done.stdout + done.stderr

    return run


def test_what_is_flashed_is_what_was_built(make, tmp_path):
    assert make("SCAN_MODE=0", "SENSE_OHM=2200")[0] == 0
    hex_file = tmp_path / "out" / "tripillar-atmega2560.hex"
    built_ns = hex_file.stat().st_mtime_ns
    status, said = make("flash", "BOARD=atmega2560", "PORT=/dev/ttyUSB7")
    assert status == 0
    assert said.splitlines() == [
        f"{hex_file}, built with SCAN_MODE=0 SENSE_OHM=2200",
        f"avrdude -p atmega2560 -c wiring -b 115200 -D -P /dev/ttyUSB7 -U flash:w:{hex_file}:i",
    ]
    assert hex_file.stat().st_mtime_ns == built_ns


def test_settings_on_the_flash_line_must_be_those_of_the_build(make):
    make("SCAN_MODE=0")
    assert make("flash", "SCAN_MODE=0")[0] == 0
    status, said = make("flash", "SCAN_MODE=1")
    assert status
    assert "was built with SCAN_MODE=0, not SCAN_MODE=1: build it again first" in said
    assert "avrdude" not in said


def test_each_board_knows_its_own_settings(make, tmp_path):
    make("SERIAL=1")
    make("SERIAL=2", str(tmp_path / "out" / "tripillar-atmega2560.hex"))
    assert "built with SERIAL=1\n" in make("flash")[1]
    assert "built with SERIAL=2\n" in make("flash", "BOARD=atmega2560")[1]


def test_the_defaults_are_named_as_such(make):
    make()
    assert "built with no settings: the defaults" in make("flash")[1]


def test_without_a_build_there_is_nothing_to_flash(make):
    status, said = make("flash")
    assert status
    assert "tripillar-atmega328p.hex: build it first" in said
    assert "avrdude" not in said
