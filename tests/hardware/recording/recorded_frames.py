"""Boards and the frames they send, for tests of what becomes of these."""

from dataclasses import asdict

import numpy as np
import pytest

from geometry.errors import FileFormatError
from hardware.link.frames import Frame, Info, ScanMode
from hardware.recording import Recorder, read_recording

INFO = Info(
    rows=2,
    cols=3,
    bits=16,
    scan_mode=ScanMode.GROUNDED,
    firmware=(1, 2, 255),
    rate_hz=200,
    serial=2**32 - 1,
    sense_ohm=2**32 - 1,
    vref_mv=3300,
)
MADE_FROM = {"model_recipe": "0123456789abcdef", "design_hash": "fedcba9876543210"}
CALIBRATION = '{"note": "Prüfstand, 20 °C", "gain": [1.0, 0.98]}'


def frames(n, start=0, info=INFO, **changes):
    """Consecutive frames whose counts tell them apart; both counters and the clock wrap soon after the start."""
    random = np.random.default_rng(start)
    return [
        Frame(
            **{
                "sequence": (65_530 + k) % 2**16,
                "device_us": (2**32 - 20_000 + k * 1_000_000 // info.rate_hz) % 2**32,
                "bits": info.bits,
                "counts": random.integers(0, 2**info.bits, info.n_crossings, dtype=np.uint16, endpoint=False),
                "saturated": k % 3 == 0,
                "scan_mode": info.scan_mode,
                "overruns": (250 + k) % 2**8,
            }
            | changes
        )
        for k in range(start, start + n)
    ]


def arrivals(n, seed=1):
    """Unix times that use every bit of a float64."""
    return (1.8e9 + np.cumsum(np.random.default_rng(seed).exponential(0.005, n))).tolist()


def record(path, n=10, start=0, statistics=None, **options):
    """Record n frames and give them back with their times."""
    sent, received_s = frames(n, start), arrivals(n, start)
    with Recorder(path, INFO, **options) as recorder:
        recorder.append(sent, received_s)
        recorder.close(statistics)
    return sent, received_s


def assert_same(recording, sent, received_s):
    """Every bit of every frame, and nothing else."""
    assert recording.counts.tolist() == [frame.counts.tolist() for frame in sent]
    for name, column in (("sequence", "sequence"), ("device_us", "device_us"), ("flags", "flags")):
        assert getattr(recording, column).tolist() == [getattr(frame, name) for frame in sent]
    assert recording.overrun_counts.tolist() == [frame.overruns for frame in sent]
    assert recording.received_s.tolist() == list(received_s)


def without_info(statistics):
    """Statistics of the frames alone; a stream of bytes may hold the INFO frame any number of times."""
    return {name: value for name, value in asdict(statistics).items() if name != "info"}


def assert_refused(path, message):
    """In one line that begins with the file's name."""
    with pytest.raises(FileFormatError, match=message) as refusal:
        read_recording(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert "\n" not in str(refusal.value)
