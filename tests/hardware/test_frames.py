"""The codec follows docs/frames.md, whose tables and test vectors are read from the page; and survives any damage.

A wrong CRC-16 passes once in 65536 damaged frames, and must then also have a right type, length and range of
values. The some ten thousand damaged frames below meet one by bad luck at most; seeds are fixed, so that luck
never changes.
"""

import re
from itertools import pairwise

import numpy as np
import pytest
import serial
from cobs import cobs
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware import Crossbar
from hardware.boards.virtual_board import CountedPort
from hardware.link.frames import Errors, Frame, FrameDecoder, FrameError, Info, ScanMode, Statistics, encode
from tests.hardware.boards import CHIP, DISTINCT
from tests.hardware.frames_page import PAGE, VECTORS, Reader, crc, unstuffed

fuzzed = settings(max_examples=150, derandomize=True, deadline=None)
U8, U16, U32 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32))
COUNTS = st.builds(
    lambda seed, bits, n: (bits, np.random.default_rng(seed).integers(0, 2**bits, n)),
    U32, st.integers(8, 16), st.integers(1, 300),
)  # fmt: skip
FRAMES = st.builds(
    lambda drawn, **values: Frame(bits=drawn[0], counts=drawn[1], **values),
    COUNTS, sequence=U16, device_us=U32, saturated=st.booleans(), scan_mode=st.sampled_from(ScanMode), overruns=U8,
)  # fmt: skip
INFOS = st.builds(
    Info,
    rows=st.integers(1, 255), cols=st.integers(1, 85), bits=st.integers(8, 16), scan_mode=st.sampled_from(ScanMode),
    firmware=st.tuples(U8, U8, U8), rate_hz=st.integers(1, 2**16 - 1), serial=U32, sense_ohm=st.integers(1, 2**32 - 1),
    vref_mv=st.integers(1, 2**16 - 1),
)  # fmt: skip
ERRORS = st.builds(Errors, reset_cause=st.integers(0, 15), bad_bytes=U8, losses=U8)


def a_frame(sequence=0, n=108, **changes):
    counts = np.random.default_rng(sequence).integers(0, 1024, n)
    values = {"sequence": sequence % 2**16, "device_us": sequence * 6667, "bits": 10, "counts": counts}
    return Frame(**values | changes)


def wires_of(n_frames, n_counts=108, first=0):
    """Distinct frames as sent, every count drawn."""
    return [encode(a_frame(first + k, n_counts)) for k in range(n_frames)]


# the page


def test_the_page_agrees_with_itself():
    """Offsets, sizes, types and CRC of the tables, the vectors and the scan modes, without the product's codec."""
    reader = Reader()
    reader.feed(b"".join(bytes.fromhex(vector["wire"]) for vector in VECTORS))
    assert reader.refused == 0
    assert reader.frames == [vector["fields"] for vector in VECTORS]
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
    reader = Reader()
    with board(fast=True) as running, serial.Serial(running.port, 1_000_000, timeout=0.05) as port:
        port.write(b"?!")
        while len(reader.frames) < 50:
            reader.feed(port.read(232))
    kinds = {kind: [frame for frame in reader.frames if chr(frame["type"]) == kind] for kind in "DIE"}
    wires = [(row, column) for row in range(12) for column in range(12) if not (row % 2 and column % 2)]
    assert all(frame["counts"] == [DISTINCT[0, row, column] for row, column in wires] for frame in kinds["D"])
    assert reader.lost == reader.repeated == reader.restarts == 0
    [info], [errors] = kinds["I"], kinds["E"]
    assert (info | {"firmware": tuple(info["firmware"])}).items() >= vars(CHIP).items()
    assert errors["reset_cause"] == 1


def test_it_reads_the_board_in_python_and_both_endings_of_cobs():
    """After a block of 254 bytes that are not zero, an empty one may follow."""
    reader, port = Reader(), CountedPort(np.arange(1, 109), Info(rate_hz=200))
    port.write(b"R150\n!")
    while len(reader.frames) < 5:
        reader.feed(port.read(232))
    assert [chr(frame["type"]) for frame in reader.frames][:3] == list("IED")
    assert reader.frames[0]["rate_hz"] == 150
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


# values


@pytest.mark.parametrize("n", [1, 119, 120, 121, 122, 65535])
def test_frames_of_any_size_survive_and_cannot_be_changed(n):
    """119 to 122 counts straddle the 254 bytes after which COBS takes a second byte."""
    counts = np.full(n, 65535)
    wire = encode(a_frame(counts=counts, bits=16))
    [decoded] = FrameDecoder().feed(wire)
    counts[0] = 7
    assert (decoded.counts == 65535).all()
    assert len(encode(a_frame(n=108))) == 232
    with pytest.raises(ValueError, match="read-only"):
        decoded.counts[0] = 1


NONSENSE = [
    (a_frame, {"device_us": -1}, "device_us=-1 must be a whole number from 0 to 4294967295"),
    (a_frame, {"device_us": 1.5}, "device_us=1.5 must be a whole number"),
    (a_frame, {"bits": 7}, "bits=7 must be a whole number from 8 to 16"),
    (a_frame, {"overruns": 256}, "overruns=256 must be"),
    (a_frame, {"counts": [0, 1024]}, "counts run from 0 to 1024, but 10 bits hold 0 to 1023"),
    (a_frame, {"counts": [-1, 5]}, "counts run from -1 to 5"),
    (a_frame, {"counts": []}, "counts is float64 of shape"),
    (a_frame, {"counts": [[1]]}, r"shape \(1, 1\)"),
    (Info, {"protocol": 2}, "protocol=2 must be"),
    (Info, {"rows": 0}, "rows=0 must be a whole number from 1 to 255"),
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
    ("frame", "scan mode 3", 1, 6),
    ("frame", "reserved bit", 1, 8),
    ("frame", "count low", 8, 5),
    ("frame", "count high", 8, 7),
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


# damage


def feed_in_pieces(decoder, stream, cuts):
    bounds = [0, *sorted(cut % (len(stream) + 1) for cut in cuts), len(stream)]
    return [frame for start, end in pairwise(bounds) for frame in decoder.feed(stream[start:end])]


@fuzzed
@given(st.lists(FRAMES | INFOS | ERRORS, max_size=6, unique_by=encode), st.lists(U32, max_size=8))
def test_round_trip_in_pieces_of_any_size(sent, cuts):
    decoder = FrameDecoder()
    wires = [encode(frame) for frame in sent]
    assert [encode(frame) for frame in feed_in_pieces(decoder, b"".join(wires), cuts)] == wires
    assert decoder.statistics.ok == sum(isinstance(frame, Frame) for frame in sent)
    assert decoder.statistics.info == sum(isinstance(frame, Info) for frame in sent)


@fuzzed
@given(st.binary(max_size=2000), st.lists(U32, max_size=8))
def test_random_bytes_give_no_frame_and_no_exception(noise, cuts):
    decoder = FrameDecoder()
    assert feed_in_pieces(decoder, noise, cuts) == []
    assert len(decoder.feed(b"\0" + wires_of(1)[0])) == 1


DAMAGES = st.lists(st.tuples(st.sampled_from(["flip", "delete", "insert", "repeat"]), U32, U8), min_size=1, max_size=12)


def damaged(stream, damages):
    stream = bytearray(stream)
    for kind, place, value in damages:
        k = place % len(stream) if stream else 0
        if kind == "flip":
            stream[k : k + 1] = bytes(byte ^ 1 << value % 8 for byte in stream[k : k + 1])
        elif kind == "delete":
            del stream[k : k + 1 + value]
        else:
            stream[k:k] = bytes([value]) if kind == "insert" else stream[max(k - value, 0) : k]
    return bytes(stream)


@fuzzed
@given(DAMAGES, st.lists(U32, max_size=8), st.sampled_from([3, 6, 108]))
def test_damage_costs_only_what_it_touches(damages, cuts, n_counts):
    head, tail = wires_of(6, n_counts), wires_of(3, n_counts, first=6)
    stream = damaged(b"".join(head), damages)
    received = [encode(frame) for frame in feed_in_pieces(FrameDecoder(), stream + b"".join(tail), cuts)]
    assert set(received) <= {*head, *tail}
    if stream.endswith(b"\0") or not stream:
        assert received[-3:] == tail
    else:  # the damage ran into the first frame behind it, the next delimiter ends it
        assert received[-2:] == tail[1:]


def test_bit_flips_at_one_in_ten_thousand():
    """1 in 6 frames is hit; each arrives unhurt or not at all, none is out of place."""
    wires = wires_of(5000)
    stream = np.frombuffer(b"".join(wires), dtype=np.uint8)
    flips = (np.random.default_rng(1).random((stream.size, 8)) < 1e-4) @ (1 << np.arange(8))
    decoder = FrameDecoder()
    received = [encode(frame) for frame in decoder.feed((stream ^ flips.astype(np.uint8)).tobytes())]
    hit = flips.reshape(len(wires), 232).astype(bool)
    unhurt = ~hit.any(axis=1) & ~np.roll(hit[:, -1], 1)  # nor the delimiter before it
    came = set(received)
    assert [wire for wire in wires if wire in came] == received
    assert {wire for wire, is_unhurt in zip(wires, unhurt, strict=True) if is_unhurt} <= came
    n_sent_between = wires.index(received[-1]) - wires.index(received[0]) + 1
    assert decoder.statistics.lost == n_sent_between - len(received) > 600
    assert decoder.statistics.restarts == 0


WITHIN, ACROSS_THE_WRAP = wires_of(20, n_counts=3), wires_of(20, n_counts=3, first=65_530)
WIRE = encode(a_frame(counts=np.full(108, 0x101)))
LATE = encode(a_frame(1000, device_us=40 * 60_000_000))
STREAMS = [  # the last frame delivered, and all that is counted
    (WITHIN[:4] + WITHIN[9:12] + WITHIN[13:], {"ok": 14, "lost": 6}),
    (ACROSS_THE_WRAP[:4] + ACROSS_THE_WRAP[9:12] + ACROSS_THE_WRAP[13:], {"ok": 14, "lost": 6}),
    (wires_of(3, first=1000) + wires_of(3), {"ok": 6, "restarts": 1}),
    (WITHIN[:1] * 3 + WITHIN[1:2] * 2, {"ok": 2, "repeated": 3}),  # a board never sends the same bytes twice
    (wires_of(1, first=60_000) + wires_of(1), {"ok": 2, "restarts": 1}),  # the clock going back tells
    ([LATE, WIRE], {"ok": 2, "restarts": 1}),  # the clock seems to go on by 31 min; the sequence going back tells
    ([encode(a_frame(60_000, device_us=3_600_000_000)), WIRE], {"ok": 2, "lost": 5535}),  # only a host's clock tells
    ([b"\0", b"\x05ab\0", WIRE], {"ok": 1, "bad_cobs": 1}),  # COBS announces four more bytes, two come
    ([b"\0", WIRE[:100] + b"\x03" + WIRE[101:], WIRE], {"ok": 1, "bad_crc": 1}),
    ([b"\0", b"\x02X\0", b"\0\0", WIRE], {"ok": 1, "bad_crc": 1}),  # too short for a CRC; empty chunks are nothing
    ([b"\0", *[b"\xff" * 10_000] * 100, b"\0", WIRE], {"ok": 1, "bad_form": 1}),
    ([WIRE[100:], WIRE], {"ok": 1}),  # what comes before the first delimiter is no damage
]


@pytest.mark.parametrize(("pieces", "counted"), STREAMS)
def test_what_is_lost_repeated_damaged_or_begun_anew_is_counted(pieces, counted):
    decoder = FrameDecoder()
    received = [encode(frame) for piece in pieces for frame in decoder.feed(piece)]
    assert decoder.statistics == Statistics(**counted)
    assert len(received) == counted["ok"]
    assert received[-1] == pieces[-1]
    assert len(decoder._pending) < 132_000
