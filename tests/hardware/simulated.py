"""What tests of boards share: builds of the firmware, readings, and an ear at the port."""

import subprocess
import time
from contextlib import contextmanager

import numpy as np

from geometry.wiring import crossings
from hardware.boards.simavr_board import FIRMWARE
from hardware.link.frames import Errors, FrameDecoder, Info, ScanMode
from hardware.link.serial_ports import close, open_port, read_available
from tests.hardware.boards import PATIENT_S

INFO = Info(scan_mode=ScanMode.ZERO_POTENTIAL, firmware=(1, 1, 0), sense_ohm=4700)
DISTINCT = np.arange(144).reshape(1, 12, 12) * 7 + 1  # tells every crossing from all others; none saturates
ROW_WIRE, COLUMN_WIRE = crossings(6, 6).T


def build(folder, *arguments):
    command = ["make", "-s", "-C", str(FIRMWARE), f"OUT={folder}", *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


class Listener:
    """What has come out of a board's port so far."""

    def __init__(self, port):
        self.port, self.decoder = port, FrameDecoder()
        self.longest_pause_s = 0.0  #: between two reads
        self.frames, self.infos, self.errors = [], [], []

    def take(self, enough):
        """Listen until `enough` holds of self."""
        before = time.monotonic()
        end = before + PATIENT_S
        while not enough(self):
            now = time.monotonic()
            self.longest_pause_s, before = max(self.longest_pause_s, now - before), now
            assert now < end, f"{len(self.frames)} frames, {self.infos}, {self.decoder.statistics}"
            for received in self.decoder.feed(read_available(self.port)):
                {Info: self.infos, Errors: self.errors}.get(type(received), self.frames).append(received)
        return self

    def take_frames(self, n):
        """Listen for n more frames; returns them."""
        start = len(self.frames)
        self.take(lambda self: len(self.frames) >= start + n)
        return self.frames[start : start + n]

    def ask(self, command=b"?"):
        """Send a command and return the INFO frame that answers it."""
        n_before = len(self.infos)
        self.port.write(command)
        return self.take(lambda self: len(self.infos) > n_before).infos[-1]

    def ask_errors(self):
        """What the board says went wrong."""
        n_before = len(self.errors)
        self.port.write(b"!")
        return self.take(lambda self: len(self.errors) > n_before).errors[-1]


@contextmanager
def listening(board):
    port = open_port(board.port, timeout_s=0.05)
    port.write_timeout = None  # a busy machine may leave a board no time to read
    try:
        yield Listener(port)
    finally:
        close(port)


def is_gapless(frames):
    """Whether no frame is missing; the first ones may be, since who opens a port clears what is waiting there."""
    return (np.diff([frame.sequence for frame in frames]) == 1).all()


def starts_us(frames):
    return np.array([frame.device_us for frame in frames])
