"""What the tests of ports, boards and links share: frames, a scripted port, a board that can fail, an ear at a port."""

import queue
import subprocess
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from geometry.layout import LAYOUTS
from geometry.wiring import crossings, fewest_wires
from hardware.boards.python_board import CountedPort, a_frame
from hardware.boards.simavr_board import EMPTY, FIRMWARE, SimavrBoard
from hardware.link.frames import Errors, FrameDecoder, Info, ScanMode, encode
from hardware.link.protocols import PROTOCOLS
from hardware.link.scanner import Link
from hardware.link.serial_ports import PortError, open_port
from hardware.readout.calibration import Electronics
from tests.house import PATIENT_S

INFO = Info(rate_hz=200, serial=3)
# one row a period: scan k, overruns counted in, has COUNTS[k % 50]
COUNTS = np.random.default_rng(0).integers(1, 1023, (50, INFO.n_crossings))


def sharing_wires(layout):
    """The same layout on as few wires as do."""
    of = {name: f"w{number}" for level in fewest_wires(layout) for number, names in enumerate(level) for name in names}
    levels = {
        side: tuple(replace(one, wire=of[one.name]) for one in getattr(layout, side)) for side in ("upper", "lower")
    }
    return replace(layout, **levels)


SHARED = sharing_wires(LAYOUTS["six-pillar"])  #: 3 + 2 wires a unit

CHIP = Info(scan_mode=ScanMode.ZERO_POTENTIAL, firmware=(1, 1, 0), sense_ohm=4700)  #: of the simulated chip
ROW_WIRE, COLUMN_WIRE = crossings(6, 6).T
DISTINCT = np.full((1, 12, 12), EMPTY)  # tells every crossing from all others; none saturates
DISTINCT[0, ROW_WIRE, COLUMN_WIRE] = (np.arange(144).reshape(12, 12) * 7 + 1)[ROW_WIRE, COLUMN_WIRE]


def a_wire(sequence, *, info=INFO, device_us=None, overruns=0):
    """A frame as a board of COUNTS and INFO sends it, on its schedule."""
    counts = COUNTS[sequence % len(COUNTS)] if info.n_crossings == INFO.n_crossings else np.ones(info.n_crossings, int)
    time_us = round(sequence * 1e6 / info.rate_hz) if device_us is None else device_us
    return encode(a_frame(info, counts, sequence, time_us, overruns))


def recording_from_resistances(resistance_ohm, info, first_sequence=0, first_us=0, electronics=None):
    """The bytes that a board without noise would send of known resistances (n, rows, cols, 3) [Ω], INFO first."""
    counts = (electronics or Electronics()).crossbar(info).counts(resistance_ohm)
    times_us = [first_us + round(k * 1e6 / info.rate_hz) for k in range(len(counts))]
    frames = [a_frame(info, counts[k], first_sequence + k, times_us[k]) for k in range(len(counts))]
    return encode(info) + b"".join(map(encode, frames))


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


class Bench(CountedPort):
    """A board that hangs, is garbled, restarts as itself or another, or is unplugged, and a link on it.

    All by a clock of the tests.
    """

    def __init__(self, counts=COUNTS, info=INFO, may_reopen=True):
        self.clock, self._own = Clock(), (counts, info)
        self.is_plugged, self.is_hindered, self.is_stalled, self.garbage, self.asked = True, False, False, [], []
        self.device = None
        opens = self._opened if may_reopen else None
        self.link = Link(self, opens, 1.0, PROTOCOLS["tripillar"], self.clock, self.clock.sleep)

    @property
    def finished(self):
        raise AttributeError("a real board's port has no end")

    @property
    def device(self):
        return self.info

    @device.setter
    def device(self, info):
        """Restart, as another device with counts of half scale if its INFO is given."""
        counts = self._own[0] if info is None else np.full(info.n_crossings, 2 ** (info.bits - 1))
        sent = getattr(self, "_buffer", b"")
        CountedPort.__init__(self, counts, info or self._own[1], clock=self.clock, sleep=self.clock.sleep)
        self._buffer += sent

    def become(self, **changes):
        for name, value in changes.items():
            setattr(self, name, value)

    def run(self, seconds):
        """The scans of some seconds."""
        end_s, scans = self.clock() + seconds, []
        while self.clock() < end_s:
            scans += self.link.take(self.link.read())
        return scans

    @property
    def trouble(self):
        return self.link.fault or self.link.reception.trouble

    def wait_s(self):
        if not self.is_plugged:
            raise OSError("Input/output error")
        return 1e9 if self.is_stalled else super().wait_s()

    def take(self, now_s):
        wire = super().take(now_s)
        return self.garbage.pop() if self.garbage else wire

    def obey(self, command):
        answer = super().obey(command)
        return b"" if self.is_stalled else self.garbage[-1] if self.garbage else answer

    def write(self, data):
        self.asked.append((data, self.clock()))
        return super().write(data)

    def _opened(self):
        if not self.is_plugged or self.is_hindered:
            raise PortError("no such port, or in use")
        self._buffer.clear()  # the system's buffer went with the port
        return self


class Chip(SimavrBoard):
    """A simulated board that can be asked what it did."""

    def stop(self, at_once=True):
        """Stop it, or wait until it has by its option ``--seconds``; what its program then says."""
        if at_once:
            self.process.terminate()
        return self.answer(self.process.communicate()[0])


def build(folder, *arguments):
    command = ["make", "-s", "-C", str(FIRMWARE), f"OUT={folder}", *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


class Listener:
    """What has come out of a board's port so far."""

    def __init__(self, port, clock=time.monotonic):
        self.port, self.clock, self.decoder = port, clock, FrameDecoder()
        self.frames, self.infos, self.errors = [], [], []

    def take(self, enough):
        """Listen until `enough` holds of self."""
        end = self.clock() + PATIENT_S
        while not enough(self):
            assert self.clock() < end, f"{len(self.frames)} frames, {self.infos}, {self.decoder.statistics}"
            for received in self.decoder.feed(self.port.read(max(1, self.port.in_waiting))):
                {Info: self.infos, Errors: self.errors}.get(type(received), self.frames).append(received)
        return self

    def take_frames(self, n):
        """Listen for n more frames; returns them."""
        start = len(self.frames)
        self.take(lambda self: len(self.frames) >= start + n)
        return self.frames[start : start + n]

    def ask(self, command=b"?"):
        """Send a command and return the INFO frame that answers it; the ERRORS frame that answers ``!``."""
        answers = self.errors if command == b"!" else self.infos
        n_before = len(answers)
        while len(answers) == n_before:  # a busy machine may lose a command
            self.port.write(command)
            enough = len(self.frames) + 200
            self.take(lambda _, enough=enough: len(answers) > n_before or len(self.frames) > enough)
        return answers[-1]


@contextmanager
def listening(board):
    port = open_port(board.port)
    port.write_timeout = None  # a busy machine may leave a board no time to read
    yield Listener(port)
    port.close()


def is_gapless(frames):
    """Whether no frame is missing; the first ones may be, since who opens a port clears what is waiting there."""
    return (np.diff([frame.sequence for frame in frames]) == 1).all()


def starts_us(frames):
    return np.array([frame.device_us for frame in frames])
