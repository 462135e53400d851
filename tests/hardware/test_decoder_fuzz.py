"""The decoder under damage in bulk: every second frame is damaged, none that was not sent comes out."""

from itertools import pairwise

import numpy as np
import pytest

from hardware import FrameDecoder
from tests.hardware.boards import a_wire

TRIES = 50_000  #: damaged frames
MANY_TRIES = 1_000_000
BATCH = 10_000
SIZE = 232  # bytes of a frame
FLIPPED = 1e-4  # of all bits

WIRES = [a_wire(k, counts=np.random.default_rng(k).integers(0, 1024, 108)) for k in range(2000)]
TO_DAMAGE, TO_ARRIVE = WIRES[:1000], WIRES[1000:]


def content(frame):
    return frame.device_us, frame.bits, frame.flags, frame.overruns, frame.counts.tobytes()


SENT = {frame.sequence: content(frame) for wire in WIRES for frame in FrameDecoder().feed(wire)}


def flipped(wires, generator):
    """At least one bit of each flipped, so many as fall together at the rate."""
    n_bits = 8 * SIZE
    n_flips = generator.binomial(n_bits, FLIPPED, len(wires))
    while (unhurt := n_flips == 0).any():
        n_flips[unhurt] = generator.binomial(n_bits, FLIPPED, unhurt.sum())
    bytes_of = np.frombuffer(b"".join(wires), np.uint8).reshape(-1, SIZE).copy()
    frame_of_flip = np.repeat(np.arange(len(wires)), n_flips)
    bit = generator.integers(0, n_bits, frame_of_flip.size)
    np.bitwise_xor.at(bytes_of, (frame_of_flip, bit // 8), (1 << bit % 8).astype(np.uint8))
    return [row.tobytes() for row in bytes_of]


def places(wires, generator):
    """Where each is hurt, and over how many bytes."""
    return zip(
        wires,
        generator.integers(0, SIZE, len(wires)).tolist(),
        generator.integers(1, 9, len(wires)).tolist(),
        strict=True,
    )


def shortened(wires, generator):
    return [wire[:at] + wire[at + n :] for wire, at, n in places(wires, generator)]


def lengthened(wires, generator):
    return [wire[:at] + generator.bytes(n) + wire[at:] for wire, at, n in places(wires, generator)]


def overwritten(wires, generator):
    return [wire[:at] + generator.bytes(n) + wire[at + n :] for wire, at, n in places(wires, generator)]


def random_bytes(wires, generator):
    return [generator.bytes(SIZE - 1) + wire[-1:] for wire in wires]


@pytest.mark.parametrize("tries", [TRIES, pytest.param(MANY_TRIES, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    ("damage", "share"),
    [(flipped, 0.6), (shortened, 0.1), (lengthened, 0.1), (overwritten, 0.1), (random_bytes, 0.1)],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_no_damaged_frame_is_accepted_and_the_next_one_is(damage, share, tries):
    """Each damaged frame is followed by one that is not, and read in pieces that end anywhere.

    A frame that follows is lost only where the damage took the delimiter between.
    """
    generator = np.random.default_rng(1)
    decoder = FrameDecoder()
    for start in range(0, round(tries * share), BATCH):
        n = min(BATCH, round(tries * share) - start)
        damaged = damage([TO_DAMAGE[k % 1000] for k in range(n)], generator)
        intact = [TO_ARRIVE[k % 1000] for k in range(n)]
        stream = b"".join(b"".join(pair) for pair in zip(damaged, intact, strict=True)) + b"\0"
        cuts = np.cumsum(generator.integers(0, 3000, len(stream) // 1000)).tolist()
        frames = [frame for one, next_one in pairwise([0, *cuts]) for frame in decoder.feed(stream[one:next_one])]
        frames += decoder.feed(stream[cuts[-1] :])
        foreign = [frame for frame in frames if SENT.get(frame.sequence) != content(frame)]
        assert foreign == []
        received = [frame.sequence for frame in frames if frame.sequence >= 1000]
        assert received == [1000 + k % 1000 for k in range(n) if damaged[k].endswith(b"\0")]
