"""The codec follows docs/frames.md, whose tables and test vectors are read from the page."""

import re

import numpy as np
import pytest
import serial
from cobs import cobs

from hardware.link.frames import Frame, FrameDecoder, FrameError, Info, ScanMode, encode
from tests.hardware.boards import CHIP, DISTINCT
from tests.hardware.frames_page import PAGE, VECTORS, crc, frames_in, unstuffed


def a_frame(sequence=0, n=108, **changes):
    counts = np.random.default_rng(sequence).integers(0, 1024, n)
    values = {"sequence": sequence % 2**16, "device_us": sequence * 6667, "bits": 10, "counts": counts}
    return Frame(**values | changes)


# the page


def test_the_page_agrees_with_itself():
    """Offsets, sizes, types and CRC of the tables, the vectors and the scan modes, without the product's codec."""
    for vector in VECTORS:
        assert frames_in(bytes.fromhex(vector["wire"]))[chr(vector["fields"]["type"])] == [vector["fields"]]
    assert {chr(vector["fields"]["type"]) for vector in VECTORS} == set("DIE")
    assert crc(b"123456789") == 0x29B1
    assert "`123456789` is 0x29B1" in PAGE
    listed = re.findall(r"^\| (\d) \| ([A-Z_]+) \|", PAGE, re.MULTILINE)
    assert {name: int(value) for value, name in listed} == {mode.name: mode.value for mode in ScanMode}


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: chr(vector["fields"]["type"]))
def test_vectors_are_decoded_and_encoded(vector):
    wire, fields = bytes.fromhex(vector["wire"]), vector["fields"]
    [found] = FrameDecoder().feed(wire)
    assert encode(found) == wire
    for name in fields.keys() - {"type", "crc", "count"}:
        assert np.array_equal(getattr(found, name), fields[name]), name


def test_a_reader_made_from_the_page_reads_the_firmware(board):
    """A chip's bytes: each crossing's count in the order of the page, INFO and ERRORS between data frames."""
    with board("--fast") as running, serial.Serial(running.port, 1_000_000, timeout=5.0) as port:
        begun = port.read(10 * 232).partition(b"\0")[2]  # whoever opens a port may find half a frame
        port.write(b"?!")  # to a chip that sends: one that still starts may not hear it
        found = frames_in(begun + port.read(50 * 232))
    wires = [(row, column) for row in range(12) for column in range(12) if not (row % 2 and column % 2)]
    assert all(frame["counts"] == [DISTINCT[0, row, column] for row, column in wires] for frame in found["D"])
    assert (np.diff([frame["sequence"] for frame in found["D"]]) == 1).all()
    [info], [errors] = found["I"], found["E"]
    assert (info | {"firmware": tuple(info["firmware"])}).items() >= (vars(CHIP).items() - {("layout", CHIP.layout)})
    assert errors["reset_cause"] == 1


# values


NONSENSE = [
    (a_frame, {"device_us": -1}, "device_us=-1 must be a whole number from 0 to 4294967295"),
    (a_frame, {"counts": [0, 1024]}, "counts run from 0 to 1024, but 10 bits hold 0 to 1023"),
    (a_frame, {"counts": [[1]]}, r"shape \(1, 1\)"),
    (Info, {"rows": 200, "cols": 200}, "rows=200, cols=200 make 120000 crossings; a frame holds 65535"),
    (Info, {"firmware": (1, 2, 256)}, "each from 0 to 255"),
]


@pytest.mark.parametrize(("make", "changes", "message"), NONSENSE)
def test_nonsense_is_refused_by_name(make, changes, message):
    with pytest.raises(FrameError, match=message):
        make(**changes)


def with_right_crc(packed):
    """The wire bytes of any content."""
    return cobs.encode(packed + crc(packed).to_bytes(2, "little")) + b"\0"


SOUND = {
    "frame": unstuffed(encode(a_frame(counts=[300, 1, 2, 3, 4, 5]))[:-1])[:-2],
    "info": unstuffed(encode(Info())[:-1])[:-2],
}
WRONG = [  # what, at which offset, by which value
    ("frame", "type", 0, ord("X")),
    ("frame", "reserved bit", 1, 16),
    ("frame", "count high", 8, 7),
    ("frame", "over full scale", 10, 8),
    ("info", "protocol", 1, 2),
    ("info", "scan mode", 5, 5),
]


@pytest.mark.parametrize(("kind", "what", "offset", "value"), WRONG)
def test_a_right_crc_does_not_excuse_a_wrong_content_or_length(kind, what, offset, value):
    good, decoder = SOUND[kind], FrameDecoder()
    wrong = good[:offset] + bytes([value]) + good[offset + 1 :]
    stream = b"\0" + with_right_crc(wrong) + with_right_crc(good + b"\0") + with_right_crc(good)
    assert [encode(frame) for frame in decoder.feed(stream)] == [with_right_crc(good)]
    assert decoder.statistics.bad_form == 2
