"""What the tests of ports, boards and links share: frames, scripted ports, and a board that can fail."""

import queue
import time

import numpy as np

from hardware.boards.virtual_board import CountedFrames, a_frame
from hardware.link.board_port import BoardPort, Commands
from hardware.link.frames import Frame, Info, encode
from hardware.link.protocols import PROTOCOLS
from hardware.link.scanner import Link
from hardware.link.serial_ports import PortError
from hardware.readout.calibration import Electronics

INFO = Info(rate_hz=200, serial=3)
# one row a period: scan k, overruns counted in, has COUNTS[k % 50]
COUNTS = np.random.default_rng(0).integers(1, 1023, (50, INFO.n_crossings))
PATIENT_S = 30.0  #: for a thing that takes no time; so long may a busy machine stand still


def a_wire(sequence, *, info=INFO, **changes):
    """A frame as a board of COUNTS and INFO sends it, on its schedule."""
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


def wait_until(is_so, within_s=PATIENT_S):
    """Wait for what another thread or process does, and no event tells of."""
    end_s = time.monotonic() + within_s
    while not is_so():
        assert time.monotonic() < end_s, "it did not come about"
        time.sleep(0.002)


def comes_about(scanner, is_so):
    """Wait until something is so of a scanner that reads."""
    with scanner._changed:
        assert scanner._changed.wait_for(is_so, PATIENT_S)


class ScriptedPort:
    """Gives what it was told to, piece by piece, as soon as it is asked; an exception among the pieces is raised.

    The first piece comes once something was written. Behind the last one the port is finished, if `finite`, or silent.
    """

    in_waiting = 0

    def __init__(self, *pieces, finite=True):
        self._pieces = queue.Queue()
        self._finite, self.written, self.is_open = finite, b"", True
        self.add(*pieces)

    def add(self, *pieces):
        for piece in pieces:
            self._pieces.put(piece)

    @property
    def finished(self):
        return self._finite and self._pieces.empty()

    def read(self, size):
        if not self.written:
            return b""
        try:
            piece = self._pieces.get(timeout=0.0 if self._finite else 0.01)
        except queue.Empty:
            return b""
        if isinstance(piece, BaseException):
            raise piece
        return piece

    def write(self, data):
        self.written += data

    def close(self):
        self.is_open = False


class Clock:
    """Seconds that only go by while somebody sleeps."""

    def __init__(self):
        self.now_s = 1000.0

    def __call__(self):
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds + 1e-9  # no system wakes up too early


class FaultyFrames:
    """A `FrameSource` that hangs, restarts, is garbled, or is another board; time goes by meanwhile."""

    def __init__(self, counts, info):
        self._own = self._new = lambda: CountedFrames(counts, info)
        self.frames, self._began_s = self._new(), 0.0
        self.is_stalled, self.garbage = False, []

    @property
    def due_s(self):
        return 1e9 if self.is_stalled else self.frames.due_s + (self._began_s or 0.0)

    def take(self, now_s):
        if self._began_s is None:  # it has just been reset
            self._began_s = now_s
        wire = self.frames.take(now_s - self._began_s)
        return self.garbage.pop() if self.garbage else wire

    def obey(self, command):
        answer = self.frames.obey(command)
        return b"" if self.is_stalled else self.garbage[-1] if self.garbage else answer

    def become(self, info):
        """Begin anew as another device, its counts half scale; None: as oneself."""
        half = None if info is None else np.full(info.n_crossings, 2 ** (info.bits - 1))
        self._new = self._own if info is None else lambda: CountedFrames(half, info)
        self.frames, self._began_s, self.is_stalled = self._new(), None, False


class Bench:
    """A link on a board that fails as it is told to; itself the port, which is plugged in or not."""

    def __init__(self, counts=COUNTS, info=INFO, may_reopen=True):
        self.clock, self.board = Clock(), FaultyFrames(counts, info)
        self.is_plugged, self.hindrance, self.asked = True, None, []
        self._port = BoardPort(self.board, self.clock, self.clock.sleep)
        opens = self._opened if may_reopen else None
        self.link = Link(self, opens, 1.0, PROTOCOLS["tripillar"], self.clock, self.clock.sleep)

    def run(self, seconds):
        """The scans of some seconds."""
        end_s, scans = self.clock() + seconds, []
        while self.clock() < end_s:
            scans += self.link.take(self.link.read())
        return scans

    def restart(self):
        """Begin again from sequence 0, time 0 and the board's own rate, as after a reset."""
        self.become(self.board.frames.info if self.board._new is not self.board._own else None)

    def become(self, info):
        self._port._commands = Commands()
        self.board.become(info)

    def _opened(self):
        if not self.is_plugged or self.hindrance:
            raise PortError(self.hindrance or "no such port")
        self._port._buffer.clear()  # the system's buffer went with the port
        return self

    def _plugged(self):
        if not self.is_plugged:
            raise OSError("Input/output error")
        return self._port

    @property
    def in_waiting(self):
        return self._plugged().in_waiting

    def read(self, size):
        return self._plugged().read(size)

    def write(self, data):
        self.asked.append((data, self.clock()))
        return self._plugged().write(data)

    def close(self):
        pass
