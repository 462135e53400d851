"""Boards and the frames they send, for tests of what becomes of these."""

import numpy as np

from hardware.link.frames import Frame, Info, ScanMode
from hardware.recording import Recorder

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


def frames(n, start=0, info=INFO):
    """Consecutive frames whose counts tell them apart; both counters and the clock wrap soon after the start."""
    counts = np.random.default_rng(start).integers(0, 2**info.bits, (n, info.n_crossings))
    return [
        Frame(
            sequence=(65_530 + k) % 2**16,
            device_us=(2**32 - 20_000 + k * 1_000_000 // info.rate_hz) % 2**32,
            bits=info.bits,
            counts=counts[k - start],
            saturated=k % 3 == 0,
            scan_mode=info.scan_mode,
            overruns=(250 + k) % 2**8,
        )
        for k in range(start, start + n)
    ]


def record(path, sent, received_s=None, **options):
    """Record frames and give back their times, which use every bit of a float64."""
    if received_s is None:
        received_s = (1.8e9 + np.cumsum(np.random.default_rng(1).exponential(0.005, len(sent)))).tolist()
    with Recorder(path, INFO, **options) as recorder:
        for frame, time_s in zip(sent, received_s, strict=True):
            recorder.append(frame, time_s)
    return received_s


def assert_same(recording, sent, received_s):
    """Every bit of every frame, and nothing else."""
    assert recording.counts.tolist() == [frame.counts.tolist() for frame in sent]
    for name in ("sequence", "device_us", "flags", "overruns"):
        assert getattr(recording, name).tolist() == [getattr(frame, name) for frame in sent], name
    assert recording.received_s.tolist() == list(received_s)
