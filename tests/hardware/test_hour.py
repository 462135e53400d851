"""Five minutes, or an hour, of frames at 200 Hz by the board's clock: nothing lost, memory flat."""

import threading

import numpy as np
import psutil
import pytest

from hardware.link.frames import Frame, Info, ScanMode, encode
from hardware.link.scanner import Scanner
from hardware.readout.calibration import Electronics
from hardware.readout.forces import ForceReader
from tests.hardware.models import PillarModel

SECONDS, MANY_SECONDS = 300, 3600  #: 60,000 and 720,000 frames
INFO = Info(rate_hz=200, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700)
TOGETHER = 100  #: frames that the port gives at a time, and the reader works on
START = 65_000, 2**32 - 10_000_000  #: sequence and clock, so that both wrap early


class FastBoard:
    """A port that gives the next frames once the last were worked on."""

    def __init__(self, n):
        self.n, self.sent = n, 0
        self.may_send = threading.Semaphore(1)
        self.to_answer = False
        base = np.array([1e4, 1.4e4, 1.4e4])
        states = base * np.random.default_rng(0).uniform(0.6, 1.1, (TOGETHER, 6, 6, 3))
        self.counts = Electronics().crossbar(INFO).counts(states)

    in_waiting = 1

    @property
    def finished(self):
        return self.sent == self.n

    def read(self, size):
        if self.to_answer:
            self.to_answer = False
            return encode(INFO)
        if self.finished or not self.may_send.acquire(timeout=0.05):
            return b""
        frames = range(self.sent, self.sent + TOGETHER)
        self.sent += TOGETHER
        return b"".join(
            encode(
                Frame(
                    sequence=(START[0] + k) % 2**16,
                    device_us=(START[1] + k * 1_000_000 // INFO.rate_hz) % 2**32,
                    bits=INFO.bits,
                    counts=self.counts[k % TOGETHER],
                    scan_mode=INFO.scan_mode,
                )
            )
            for k in frames
        )

    def write(self, data):
        self.to_answer |= b"?" in data


@pytest.mark.parametrize("seconds", [SECONDS, pytest.param(MANY_SECONDS, marks=pytest.mark.long)])
def test_many_frames_in_flat_memory(seconds):
    """Between a tenth of the time and its end, the process grows by less than 4 MB: 5.5 bytes a frame of an hour."""
    n = seconds * INFO.rate_hz
    board, process = FastBoard(n), psutil.Process()
    batch, n_done, memory_mb = [], 0, []
    with Scanner(board, queue=2 * TOGETHER) as scanner:
        reader = ForceReader(scanner.info, PillarModel(lambda ohms: ohms / ohms[:, :1, :1] - 1))
        for scan in scanner:
            batch.append(scan)
            if len(batch) == TOGETHER:
                forces = reader.forces(np.stack([one.frame.counts for one in batch]))
                assert np.isfinite(forces.force_n).all()
                n_done += TOGETHER
                batch.clear()
                board.may_send.release()
                if n_done % (n // 10) == 0:
                    memory_mb.append(process.memory_info().rss / 2**20)
        statistics = scanner.stats
    assert n_done == statistics.ok == n
    assert statistics.lost == statistics.dropped == statistics.restarts == statistics.bad_crc == 0
    assert max(memory_mb[1:]) - memory_mb[0] < 4
