"""The decoder under damage: it never raises, accepts only what was sent, and resumes at the next frame.

A wrong CRC-16 passes once in 65536 damaged frames, and must then also have a right type, length and range of values.
"""

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.layout import LAYOUTS
from hardware.link.frames import Errors, Frame, FrameDecoder, Info, ScanMode, Statistics, encode
from tests.geometry.test_layout_file import OWN

fuzzed = settings(max_examples=100, derandomize=True, deadline=None)
U8, U16, U32 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32))


@st.composite
def frames(draw):
    bits = draw(st.integers(8, 16))
    generator = np.random.default_rng(draw(U32))
    return Frame(
        sequence=draw(U16),
        device_us=draw(U32),
        bits=bits,
        counts=generator.integers(0, 2**bits, draw(st.integers(1, 300))),
        saturated=draw(st.booleans()),
        scan_mode=draw(st.sampled_from(ScanMode)),
        overruns=draw(U8),
    )


@st.composite
def infos(draw, max_rows=255, max_cols=32):
    return Info(
        rows=draw(st.integers(1, max_rows)),
        cols=draw(st.integers(1, max_cols)),
        bits=draw(st.integers(8, 16)),
        scan_mode=draw(st.sampled_from(ScanMode)),
        firmware=draw(st.tuples(U8, U8, U8)),
        rate_hz=draw(st.integers(1, 65535)),
        serial=draw(U32),
        sense_ohm=draw(st.integers(1, 2**32 - 1)),
        vref_mv=draw(st.integers(1, 65535)),
        layout=draw(st.sampled_from([*LAYOUTS.values(), OWN])),
    )


def errors():
    return st.builds(Errors, reset_cause=st.integers(0, 15), bad_bytes=U8, losses=U8)


def wires_of(n_frames, n_counts=108, first=0):
    """Distinct frames as sent, every count drawn."""
    counts = np.random.default_rng(first).integers(0, 1024, (n_frames, n_counts))
    return [
        encode(Frame(sequence=(first + k) % 2**16, device_us=6667 * (first + k), bits=10, counts=counts[k]))
        for k in range(n_frames)
    ]


def fed_in_pieces(decoder, stream, cuts):
    """The frames of a stream that is cut anywhere, as sent."""
    bounds = [0, *sorted(cut % (len(stream) + 1) for cut in cuts), len(stream)]
    return [encode(frame) for start, end in pairwise(bounds) for frame in decoder.feed(stream[start:end])]


CUTS = st.lists(U32, max_size=8)


@fuzzed
@given(st.lists(frames() | infos() | errors(), max_size=6, unique_by=encode), CUTS)
def test_round_trip_in_pieces_of_any_size(sent, cuts):
    decoder, wires = FrameDecoder(), [encode(frame) for frame in sent]
    assert fed_in_pieces(decoder, b"".join(wires), cuts) == wires
    assert decoder.statistics.ok == sum(isinstance(frame, Frame) for frame in sent)
    assert decoder.statistics.info == sum(isinstance(frame, Info) for frame in sent)
    assert len(decoder._pending) == 0


@st.composite
def damaged(draw, stream):
    """A stream with bytes that are flipped, left out, put in or sent twice; or only noise."""
    stream = bytearray(stream)
    for kind, place, value in draw(st.lists(st.tuples(st.integers(0, 3), U32, U8), min_size=1, max_size=12)):
        k = place % (len(stream) + 1)
        if kind == 0:
            stream[k : k + 1] = bytes(byte ^ 1 << value % 8 for byte in stream[k : k + 1])
        elif kind == 1:
            del stream[k : k + 1 + value]
        elif kind == 2:
            stream[k : k + value % 2] = bytes([value])
        else:
            stream[k:k] = stream[max(k - value, 0) : k]
    return bytes(stream) if draw(st.integers(0, 4)) else draw(st.binary(max_size=2000))


@fuzzed
@given(st.data(), CUTS, st.sampled_from([3, 6, 108]))
def test_damage_costs_only_what_it_touches(data, cuts, n_counts):
    head, tail = wires_of(6, n_counts), wires_of(3, n_counts, first=6)
    stream = data.draw(damaged(b"".join(head)))
    received = fed_in_pieces(FrameDecoder(), stream + b"".join(tail), cuts)
    assert set(received) <= {*head, *tail}
    if stream.endswith(b"\0") or not stream:
        assert received[-3:] == tail
    else:  # the damage ran into the first frame behind it, the next delimiter ends it
        assert received[-2:] == tail[1:]


def test_each_kind_of_damage_is_counted_as_itself_and_fills_no_memory():
    wire = encode(Frame(sequence=0, device_us=0, bits=10, counts=np.full(108, 0x101)))
    decoder = FrameDecoder()
    decoder.feed(wire[7:] + b"\x05ab\0")  # COBS announces four more bytes, two come
    decoder.feed(wire[:100] + b"\x03" + wire[101:])  # one count changed
    decoder.feed(b"\x02X\0")  # too short for a CRC
    for _ in range(100):
        decoder.feed(b"\xff" * 10_000)  # no delimiter
    assert len(decoder._pending) < 132_000
    decoder.feed(b"\0\0" + 3 * wire)  # empty chunks are nothing; a board never sends the same bytes twice
    assert decoder.statistics == Statistics(ok=1, repeated=2, bad_cobs=1, bad_crc=2, bad_form=1)
