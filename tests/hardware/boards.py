"""What the tests of ports, boards and the scanner share."""

import threading
import time
from collections import deque

import numpy as np

from hardware.boards.virtual_board import a_frame
from hardware.link.frames import Frame, Info, encode
from hardware.readout.calibration import Electronics

INFO = Info(rate_hz=200, serial=3)
# one row a period: scan k, overruns counted in, has COUNTS[k % 50]
COUNTS = np.random.default_rng(0).integers(1, 1023, (50, INFO.n_crossings))


def a_wire(sequence, *, info=INFO, **changes):
    """A frame as `VirtualBoard(COUNTS, INFO)` sends it, on its schedule."""
    counts = COUNTS[sequence % len(COUNTS)] if info.n_crossings == INFO.n_crossings else np.ones(info.n_crossings, int)
    values = {
        "sequence": sequence % 2**16,
        "device_us": round(sequence * 1e6 / info.rate_hz) % 2**32,
        "bits": info.bits,
        "counts": counts,
        "scan_mode": info.scan_mode,
    }
    return encode(Frame(**values | changes))


def recording_from_resistances(resistance_ohm, info, first_sequence=0, first_us=0, electronics=None):
    """The bytes that a board without noise would send of known resistances (n, rows, cols, 3) [Ω], INFO first."""
    counts = (electronics or Electronics()).crossbar(info).counts(resistance_ohm)
    times_us = [first_us + round(k * 1e6 / info.rate_hz) for k in range(len(counts))]
    frames = [a_frame(info, counts[k], first_sequence + k, times_us[k]) for k in range(len(counts))]
    return encode(info) + b"".join(map(encode, frames))


PATIENT_S = 30.0  #: for a thing that takes no time; so long may a busy machine stand still
LOOK_S = 0.002


def wait_until(is_so, within_s=5.0):
    """Wait for what has no event to wait for; the time for which the machine holds this thread up does not count."""
    begun_s, waited_s = time.perf_counter(), 0.0
    while not is_so():
        assert waited_s < within_s, "it did not come about"
        time.sleep(LOOK_S)
        looked_s = time.perf_counter()
        waited_s += min(looked_s - begun_s, 2 * LOOK_S)
        begun_s = looked_s


def closes_within(scanner, seconds):
    """Close a scanner, which must not take longer."""
    closing = threading.Thread(target=scanner.close)
    closing.start()
    wait_until(lambda: not closing.is_alive(), seconds)


class ScriptedPort:
    """Gives what it was told to, piece by piece, as soon as it is asked; an exception among the pieces is raised.

    The first piece comes once ``?`` was written. Behind the last one the port is finished, if `finite`, or silent.
    """

    def __init__(self, *pieces, finite=True):
        self.pieces = deque(pieces)
        self._finite = finite
        self.written = b""
        self.is_open = True

    @property
    def finished(self):
        return self._finite and not self.pieces

    @property
    def in_waiting(self):
        return 0

    def read(self, size):
        if not self.pieces or not self.written:
            time.sleep(0.002)  # as a port's timeout
            return b""
        piece = self.pieces.popleft()
        if isinstance(piece, BaseException):
            raise piece
        return piece

    def write(self, data):
        self.written += data

    def close(self):
        self.is_open = False
