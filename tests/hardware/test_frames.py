"""The codec follows docs/frames.md: tables and test vectors are read from the page itself."""

import re

import numpy as np
import pytest
from cobs import cobs

from hardware.link.frames import Frame, FrameDecoder, FrameError, Info, ScanMode, Statistics, encode
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


@pytest.mark.parametrize("vector", FRAME_VECTORS, ids=range(len(FRAME_VECTORS)))
def test_data_frame_vectors(vector):
    wire, fields = bytes.fromhex(vector["wire"]), vector["fields"]
    [frame] = FrameDecoder().feed(wire)
    assert frame.counts.tolist() == fields["counts"]
    for name in ("sequence", "device_us", "bits", "overruns", "flags"):
        assert getattr(frame, name) == fields[name]
    assert frame.saturated == bool(fields["flags"] & 1)
    assert frame.scan_mode == fields["flags"] >> 1
    assert encode(frame) == wire


@pytest.mark.parametrize("vector", INFO_VECTORS, ids=range(len(INFO_VECTORS)))
def test_info_vectors(vector):
    wire, fields = bytes.fromhex(vector["wire"]), vector["fields"]
    [info] = FrameDecoder().feed(wire)
    assert isinstance(info, Info)
    for name in fields.keys() - {"type", "crc", "firmware"}:
        assert getattr(info, name) == fields[name]
    assert list(info.firmware) == fields["firmware"]
    assert encode(info) == wire


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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sequence": 65536}, "sequence=65536 must be a whole number from 0 to 65535"),
        ({"device_us": -1}, "device_us=-1 must be"),
        ({"device_us": 1.5}, "device_us=1.5 must be a whole number"),
        ({"bits": 7}, "bits=7 must be a whole number from 8 to 16"),
        ({"overruns": 256}, "overruns=256 must be"),
        ({"counts": [0, 1024]}, "counts run from 0 to 1024, but 10 bits hold 0 to 1023"),
        ({"counts": [-1, 5]}, "counts run from -1 to 5"),
        ({"counts": []}, "counts is float64 of shape"),
        ({"counts": [1.0]}, "expected whole numbers"),
        ({"counts": [[1]]}, r"shape \(1, 1\)"),
    ],
)
def test_frames_refuse_nonsense_by_name(changes, message):
    with pytest.raises(FrameError, match=message):
        a_frame(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"protocol": 2}, "protocol=2 must be"),
        ({"rows": 0}, "rows=0 must be a whole number from 1 to 255"),
        ({"rows": 200, "cols": 200}, "rows=200, cols=200 make 120000 crossings; a frame holds 65535"),
        ({"rate_hz": 0}, "rate_hz=0 must be"),
        ({"sense_ohm": 0}, "sense_ohm=0 must be"),
        ({"firmware": (1, 2)}, r"firmware=\(1, 2\) must be major, minor, patch"),
        ({"firmware": (1, 2, 256)}, "each from 0 to 255"),
    ],
)
def test_info_refuses_nonsense_by_name(changes, message):
    with pytest.raises(FrameError, match=message):
        Info(**changes)


def with_right_crc(packed):
    """The wire bytes of any content."""
    return cobs.encode(packed + crc(packed).to_bytes(2, "little")) + b"\0"


@pytest.mark.parametrize(
    ("offset", "value"),
    [(0, ord("X")), (1, 6), (1, 8), (8, 5), (8, 7), (10, 7), (10, 17), (10, 8)],
    ids=[
        "type",
        "scan mode 3",
        "reserved bit",
        "count low",
        "count high",
        "bits 7",
        "bits 17",
        "over full scale",
    ],
)
def test_a_right_crc_does_not_excuse_a_wrong_frame(offset, value):
    good = unstuffed(encode(a_frame(counts=[300, 1, 2, 3, 4, 5]))[:-1])[:-2]
    wrong = good[:offset] + bytes([value]) + good[offset + 1 :]
    decoder = FrameDecoder()
    assert decoder.feed(b"\0" + with_right_crc(wrong) + with_right_crc(good))[0].sequence == 0
    assert decoder.statistics == Statistics(ok=1, bad_form=1)


@pytest.mark.parametrize(("offset", "value"), [(1, 2), (2, 0), (5, 3)], ids=["protocol", "rows", "scan mode"])
def test_a_right_crc_does_not_excuse_a_wrong_info(offset, value):
    good = unstuffed(encode(Info())[:-1])[:-2]
    wrong = good[:offset] + bytes([value]) + good[offset + 1 :]
    decoder = FrameDecoder()
    assert decoder.feed(b"\0" + with_right_crc(wrong) + with_right_crc(good + b"\0")) == []
    assert decoder.statistics == Statistics(bad_form=2)
