"""docs/frames.md is enough: a reader made from its words alone, sharing no code with the product, reads every board."""

import numpy as np
import pytest
import serial

from hardware import Crossbar, Frame, FrameDecoder, Info
from hardware.boards.virtual_board import CountedFrames
from hardware.link.board_port import BoardPort
from hardware.link.frames import ScanMode, encode
from tests.hardware.frames_page import Reader
from tests.hardware.simulated import DISTINCT, INFO


def test_it_reads_the_firmware(board):
    """A chip's bytes: each crossing's count in the order of the page, INFO and ERRORS between data frames."""
    reader = Reader()
    with board(fast=True) as running, serial.Serial(running.port, 1_000_000, timeout=0.05) as port:
        port.write(b"?!")
        while len(reader.frames) < 50:
            reader.feed(port.read(232))
    data = [frame for frame in reader.frames if chr(frame["type"]) == "D"]
    wires = [(row, column) for row in range(12) for column in range(12) if not (row % 2 and column % 2)]
    assert all(frame["counts"] == [DISTINCT[0, row, column] for row, column in wires] for frame in data)
    assert reader.lost == reader.repeated == reader.restarts == 0
    [info] = [frame for frame in reader.frames if chr(frame["type"]) == "I"]
    assert {name: info[name] for name in ("rows", "cols", "rate_hz", "sense_ohm", "vref_mv", "scan_mode")} == {
        "rows": 6, "cols": 6, "rate_hz": 150, "sense_ohm": 4700, "vref_mv": 5000, "scan_mode": INFO.scan_mode
    }  # fmt: skip
    assert [frame["reset_cause"] for frame in reader.frames if chr(frame["type"]) == "E"] == [1]


def test_it_reads_the_board_in_python():
    reader, port = Reader(), BoardPort(CountedFrames(np.arange(1, 109), Info(rate_hz=200)))
    port.write(b"R150\n!")
    while len(reader.frames) < 5:
        reader.feed(port.read(232))
    kinds = [chr(frame["type"]) for frame in reader.frames]
    assert (kinds.count("I"), kinds.count("E"), kinds.count("D")) == (1, 1, len(kinds) - 2)
    assert next(frame for frame in reader.frames if chr(frame["type"]) == "I")["rate_hz"] == 150


def test_both_endings_of_cobs_are_one_frame():
    """After the count's zero byte come 254 bytes that are not: a full block, which an empty one may follow."""
    for device_us in range(0x01010101, 0x01010101 + 1000):
        frame = Frame(sequence=257, device_us=device_us, bits=10, counts=np.full(125, 257), overruns=1, saturated=True)
        wire = encode(frame)
        if 0 not in wire[:-1] and wire[10] == 255:
            break
    assert len(wire) == 10 + 255 + 1
    for ending in (wire, wire[:-1] + b"\x01\0"):
        reader = Reader()
        reader.feed(ending)
        assert reader.frames[0]["counts"] == [257] * 125
        [decoded] = FrameDecoder().feed(ending)
        assert decoded.device_us == device_us


@pytest.mark.parametrize("mode", list(ScanMode))
def test_the_readings_of_one_pillar_are_those_of_the_page(mode):
    """The page's formulas with r_s, r_l and A, beside the host's circuit in which the other pillars are broken."""
    pillar, r_s, r_l, sense, gain = 8e3, 70.0, 5.0, 4.7e3, 2e3
    crossbar = Crossbar(
        rows=1, cols=1, scan_mode=mode, sense_ohm=sense, switch_ohm=r_s, line_ohm=r_l, amplifier_gain=gain, bits=None
    )
    alone = crossbar.readings(np.array([[[[pillar, 1e12, 1e12]]]]))[0, 0]
    if mode == ScanMode.ZERO_POTENTIAL:
        said = gain / (1 + gain) * sense / (pillar + r_s + 2 * r_l + sense / (1 + gain))
    else:
        said = sense / (pillar + sense + 2 * (r_s + r_l))
    assert alone == pytest.approx(said, rel=1e-6)
