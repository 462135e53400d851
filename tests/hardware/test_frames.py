"""The codec follows docs/frames.md: tables and test vectors are read from the page itself."""

import re

import numpy as np
import pytest
from cobs import cobs

from hardware.link.frames import Frame, FrameDecoder, FrameError, Info, ScanMode, encode
from tests.hardware.frames_page import FRAME_VECTORS, INFO_VECTORS, PAGE, VECTORS, Reader, crc, unstuffed


def a_frame(sequence=0, n=108, **changes):
    counts = np.random.default_rng(sequence).integers(0, 1024, n)
    values = {"sequence": sequence, "device_us": sequence * 6667, "bits": 10, "counts": counts}
    return Frame(**values | changes)


def test_page_has_vectors_of_all_frames():
    assert len(INFO_VECTORS) + len(FRAME_VECTORS) < len(VECTORS)
    assert len(INFO_VECTORS) >= 1
    assert len(FRAME_VECTORS) >= 2


def test_vectors_follow_the_tables():
    """Offsets, sizes, types and CRC of the page agree with its vectors, without any of the product's code."""
    reader = Reader()
    reader.feed(b"".join(bytes.fromhex(vector["wire"]) for vector in VECTORS))
    assert reader.refused == 0
    assert reader.frames == [vector["fields"] for vector in VECTORS]


def test_crc_check_value_of_the_page():
    assert crc(b"123456789") == 0x29B1
    assert "`123456789` is 0x29B1" in PAGE


@pytest.mark.parametrize("vector", FRAME_VECTORS + INFO_VECTORS, ids=lambda vector: chr(vector["fields"]["type"]))
def test_vectors_are_decoded_and_encoded(vector):
    wire, fields = bytes.fromhex(vector["wire"]), vector["fields"]
    [found] = FrameDecoder().feed(wire)
    assert encode(found) == wire
    for name in fields.keys() - {"type", "crc", "count"}:
        assert np.array_equal(getattr(found, name), fields[name]), name
    if isinstance(found, Frame):
        assert (found.saturated, found.scan_mode) == (bool(fields["flags"] & 1), fields["flags"] >> 1)


def test_scan_modes_of_the_page():
    listed = re.findall(r"^\| (\d) \| ([A-Z_]+) \|", PAGE, re.MULTILINE)
    assert {name: int(value) for value, name in listed} == {mode.name: mode.value for mode in ScanMode}


def test_a_frame_of_108_counts_takes_232_bytes_whatever_they_are():
    zeros, ones = np.zeros(108, dtype=int), np.full(108, 65535)
    for counts in (zeros, ones):
        assert len(encode(a_frame(counts=counts, bits=16))) == 232
    assert len(encode(Info())) == 25


@pytest.mark.parametrize("n", [1, 119, 120, 121, 122, 1000, 65535])
def test_frames_of_any_size_survive(n):
    """119 to 122 counts straddle the 254 bytes after which COBS takes a second byte."""
    frame = a_frame(n=n)
    [decoded] = FrameDecoder().feed(encode(frame))
    assert (decoded.counts == frame.counts).all()


def test_counts_cannot_be_changed_afterwards():
    counts = np.arange(3)
    frame = a_frame(counts=counts)
    counts[0] = 7
    assert frame.counts.tolist() == [0, 1, 2]
    with pytest.raises(ValueError, match="read-only"):
        frame.counts[0] = 1


NONSENSE = [
    (a_frame, {"sequence": 65536}, "sequence=65536 must be a whole number from 0 to 65535"),
    (a_frame, {"device_us": -1}, "device_us=-1 must be"),
    (a_frame, {"device_us": 1.5}, "device_us=1.5 must be a whole number"),
    (a_frame, {"bits": 7}, "bits=7 must be a whole number from 8 to 16"),
    (a_frame, {"overruns": 256}, "overruns=256 must be"),
    (a_frame, {"counts": [0, 1024]}, "counts run from 0 to 1024, but 10 bits hold 0 to 1023"),
    (a_frame, {"counts": [-1, 5]}, "counts run from -1 to 5"),
    (a_frame, {"counts": []}, "counts is float64 of shape"),
    (a_frame, {"counts": [1.0]}, "expected whole numbers"),
    (a_frame, {"counts": [[1]]}, r"shape \(1, 1\)"),
    (Info, {"protocol": 2}, "protocol=2 must be"),
    (Info, {"rows": 0}, "rows=0 must be a whole number from 1 to 255"),
    (Info, {"rows": 200, "cols": 200}, "rows=200, cols=200 make 120000 crossings; a frame holds 65535"),
    (Info, {"rate_hz": 0}, "rate_hz=0 must be"),
    (Info, {"sense_ohm": 0}, "sense_ohm=0 must be"),
    (Info, {"firmware": (1, 2)}, r"firmware=\(1, 2\) must be major, minor, patch"),
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
WRONG = [
    ("frame", "type", 0, ord("X")),
    ("frame", "scan mode 3", 1, 6),
    ("frame", "reserved bit", 1, 8),
    ("frame", "count low", 8, 5),
    ("frame", "count high", 8, 7),
    ("frame", "bits 7", 10, 7),
    ("frame", "bits 17", 10, 17),
    ("frame", "over full scale", 10, 8),
    ("info", "protocol", 1, 2),
    ("info", "rows", 2, 0),
    ("info", "scan mode", 5, 3),
]


@pytest.mark.parametrize(("kind", "what", "offset", "value"), WRONG)
def test_a_right_crc_does_not_excuse_a_wrong_content_or_length(kind, what, offset, value):
    good, decoder = SOUND[kind], FrameDecoder()
    wrong = good[:offset] + bytes([value]) + good[offset + 1 :]
    stream = b"\0" + with_right_crc(wrong) + with_right_crc(good + b"\0") + with_right_crc(good)
    assert [encode(frame) for frame in decoder.feed(stream)] == [with_right_crc(good)]
    assert decoder.statistics.bad_form == 2
