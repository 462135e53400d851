"""The firmware's portable files, compiled for this machine: frames to the byte, commands; and what `make flash` sends.

`test_firmware_run.py` runs the whole firmware on a simulated board.
"""

import ctypes
import os
import shutil
import subprocess
from ctypes import c_uint8, c_uint16, c_uint32

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.boards.simavr_board import FIRMWARE
from hardware.link.board_port import Commands
from hardware.link.frames import Errors, Frame, Info, encode, stated
from tests.hardware.test_decoder import errors, frames, infos

fuzzed = settings(max_examples=150, derandomize=True, deadline=None)
pytestmark = pytest.mark.real
CANARY = 0xA5


class Header(ctypes.Structure):
    _fields_ = (
        ("flags", c_uint8),
        ("sequence", c_uint16),
        ("device_us", c_uint32),
        ("count", c_uint16),
        ("bits", c_uint8),
        ("overruns", c_uint8),
    )


class InfoFields(ctypes.Structure):
    _fields_ = (
        *((name, c_uint8) for name in ("rows", "cols", "bits", "scan_mode")),
        ("firmware", c_uint8 * 3),
        ("rate_hz", c_uint16),
        ("serial", c_uint32),
        ("sense_ohm", c_uint32),
        ("vref_mv", c_uint16),
        ("layout", ctypes.c_char_p),
    )


class ErrorFields(ctypes.Structure):
    _fields_ = tuple((name, c_uint8) for name in ("reset_cause", "bad_bytes", "losses"))


class CCommands(ctypes.Structure):
    _fields_ = (("state", ctypes.c_int), ("digits", c_uint8), ("rate_hz", c_uint16))


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    compiler = shutil.which("cc")
    if not compiler:
        pytest.skip("no C compiler 'cc' on this machine: on Debian or Ubuntu, apt install gcc")
    path = tmp_path_factory.mktemp("firmware") / "firmware.so"
    sources = [FIRMWARE / "frame.c", FIRMWARE / "commands.c"]
    flags = ["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O1", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, "-o", path, *sources], check=True)
    library = ctypes.CDLL(str(path))
    for function in (library.frame_crc, library.frame_data, library.frame_info, library.frame_errors):
        function.restype = c_uint16
    return library


def written(write, n_packed, *values):
    """What a function writes, checked to stay within what frame.h's FRAME_WIRE_SIZE reserves for it."""
    n_reserved = n_packed + -(-n_packed // 254) + 1
    wire = (c_uint8 * (n_reserved + 8))(*[CANARY] * (n_reserved + 8))
    size = write(wire, *values)
    assert size <= n_reserved
    assert set(wire[size:]) == {CANARY}
    return bytes(wire[:size])


def wire_of(library, frame):
    if isinstance(frame, Info):
        names = ("rows", "cols", "bits", "scan_mode", "rate_hz", "serial", "sense_ohm", "vref_mv")
        layout = stated(frame.layout).encode()
        fields = InfoFields(firmware=frame.firmware, layout=layout, **{name: getattr(frame, name) for name in names})
        return written(library.frame_info, 23 + len(layout), ctypes.byref(fields))
    if isinstance(frame, Errors):
        fields = ErrorFields(frame.reset_cause, frame.bad_bytes, frame.losses)
        return written(library.frame_errors, 6, ctypes.byref(fields))
    names = ("flags", "sequence", "device_us", "bits", "overruns")
    header = Header(count=frame.counts.size, **{name: getattr(frame, name) for name in names})
    counts = (c_uint16 * frame.counts.size)(*frame.counts.tolist())
    return written(library.frame_data, 14 + 2 * frame.counts.size, ctypes.byref(header), counts)


@fuzzed
@given(frame=frames() | infos() | errors())
def test_firmware_and_host_write_the_same_bytes(library, frame):
    assert wire_of(library, frame) == encode(frame)


@pytest.mark.parametrize("n", [1, 119, 120, 121, 122])
@pytest.mark.parametrize("count", [0, 0x0101])
def test_blocks_of_254_bytes(library, n, count):
    """Frames without a zero byte, and with hardly anything else, on both sides of where COBS takes one more byte."""
    frame = Frame(sequence=0x0101, device_us=0x01010101, bits=10, counts=np.full(n, count), saturated=True, overruns=1)
    assert wire_of(library, frame) == encode(frame)


@pytest.fixture(scope="module", params=["firmware", "virtual board"])
def heard(request):
    """What a board makes of bytes: a question, or the rate of an R command; the one in C and the one in Python."""
    if request.param == "virtual board":
        return lambda sent: Commands().heard(sent)
    library = request.getfixturevalue("library")

    def heard_in_c(sent):
        commands, heard = CCommands(), []
        for byte in sent:
            command = library.commands_take(ctypes.byref(commands), c_uint8(byte))
            heard += {0: [], 1: ["info"], 2: [commands.rate_hz], 3: ["errors"]}[command]
        return heard

    return heard_in_c


@pytest.mark.parametrize(
    ("sent", "expected"),
    [
        (b"??", ["info", "info"]),
        (b"!?R5!0\n", ["errors", "info", "errors"]),
        (b"R1\xff00\nR5\xff\nR6\n", [6]),  # what stands for a byte that was damaged or lost
        (b"R007\nR100\n?", [7, 100, "info"]),
        (b"R65534\nR65535\nR65536\nR99999999999999999999\n", [65534, 65535, 65535, 65535]),
        (b"R" + 300 * b"0" + b"9\n", [9]),
        (b"R-5\nR1.5\nR 5\nR5 \nR5\r\nRR5\nr5\n", []),
        (b"hello\n\n\0\xff150\nR5\n", [5]),
        (b"R15?0\nR20\n", ["info", 20]),
        (b"Rx?5\nR20\n", ["info", 20]),
    ],
)
def test_commands(heard, sent, expected):
    assert heard(sent) == expected


@fuzzed
@given(sent=st.binary(max_size=200) | st.text("?R19\n", max_size=50).map(str.encode))
def test_a_question_is_always_heard(heard, sent):
    assert heard(sent).count("info") == sent.count(b"?")
    assert heard(sent).count("errors") == sent.count(b"!")
    assert heard(sent + b"\nR42\n")[-1] == 42


TOOLS = {  # stand-ins for the AVR's
    "avr-gcc": 'while [ "$1" != -o ]; do shift; done; echo built > "$2"',
    "avr-size": "echo; echo 1 1 1",
    "avr-objcopy": 'for last; do :; done; echo ":00000001FF" > "$last"',
    "avrdude": 'echo avrdude "$@"',
}


def test_what_is_flashed_is_what_was_built(tmp_path):
    """Each board's firmware knows its own settings; those on the flash line must be the same."""
    if not shutil.which("make"):
        pytest.skip("no 'make' on this machine: on Debian or Ubuntu, apt install make")
    tools, out = tmp_path / "tools", tmp_path / "out"
    tools.mkdir()
    for name, script in TOOLS.items():
        (tools / name).write_text(f"#!/bin/sh\n{script}\n")
        (tools / name).chmod(0o755)

    def make(*arguments):
        command = ["make", "-s", "-C", str(FIRMWARE), f"OUT={out}", *arguments]
        environment = os.environ | {"PATH": f"{tools}:{os.environ['PATH']}"}
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        return done.returncode, done.stdout + done.stderr

    status, said = make("flash")
    assert (status > 0, "avrdude" in said) == (True, False)
    assert "tripillar-atmega328p.hex: build it first" in said
    make()
    assert "built with no settings: the defaults" in make("flash")[1]
    hex_file = out / "tripillar-atmega2560.hex"
    assert make("SCAN_MODE=0", "SENSE_OHM=2200", str(hex_file))[0] == 0
    assert make("flash", "BOARD=atmega2560", "PORT=/dev/ttyUSB7") == (
        0,
        f"{hex_file}, built with SCAN_MODE=0 SENSE_OHM=2200\n"
        f"avrdude -p atmega2560 -c wiring -b 115200 -D -P /dev/ttyUSB7 -U flash:w:{hex_file}:i\n",
    )
    status, said = make("flash", "BOARD=atmega2560", "SCAN_MODE=1")
    assert (status > 0, "avrdude" in said) == (True, False)
    assert "was built with SCAN_MODE=0 SENSE_OHM=2200, not SCAN_MODE=1: build it again first" in said
