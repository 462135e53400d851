"""How good a board's link is: rate, losses, jitter, latency."""

import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from geometry.layout import FloatArray
from hardware.link.scanner import Scanner, ScannerError
from tripillar.board.session import Session, scans


@dataclass(frozen=True, kw_only=True)
class Link:
    """What was measured on one link."""

    seconds: float
    scans: int
    rate_hz: float  #: of scans received, by the host's clock
    device_rate_hz: float  #: of scans made, by the board's
    jitter_us: float  #: standard deviation of arrivals about the board's clock
    latency_ms: dict[str, float] | None  #: last byte read -> forces: median, p99, worst
    statistics: dict[str, Any]


def measured_link(scanner: Scanner, reading: Session | None, seconds: float) -> Link:
    """Read a board for some seconds, with forces of every scan if there is a session.

    Raises
    ------
    ScannerError
        If fewer than three scans come.
    """
    arrivals, device_us, latencies = [], [], []
    for scan in scans(scanner, seconds):
        if scan is None:
            continue
        if reading is not None:
            reading.forces(scan)
            latencies.append(time.perf_counter() - scan.received_s)
        arrivals.append(scan.received_s)
        device_us.append(scan.frame.device_us)
    if len(arrivals) < 3:
        raise ScannerError(
            f"{len(arrivals)} scans within {seconds:g} s are too few: {scanner.trouble or 'wait longer'}."
        )
    ticks_us = np.array(device_us, dtype=np.uint32)
    steps_s = 1e-6 * (ticks_us[1:] - ticks_us[:-1])  # u32 differences wrap as the board's clock does
    waits_s = np.diff(arrivals)
    return Link(
        seconds=arrivals[-1] - arrivals[0],
        scans=len(arrivals),
        rate_hz=float(1.0 / waits_s.mean()),
        device_rate_hz=float(1.0 / steps_s.mean()) if steps_s.any() else 0.0,
        jitter_us=float(1e6 * (waits_s - steps_s).std() / np.sqrt(2.0)),
        latency_ms=None if reading is None else milliseconds(np.array(latencies)),
        statistics=asdict(scanner.stats),
    )


def milliseconds(latency_s: FloatArray) -> dict[str, float]:
    """Median, 99th percentile and worst of some latencies [s], in ms."""
    median, p99, worst = 1e3 * np.quantile(latency_s, [0.5, 0.99, 1.0])
    return {"median": float(median), "p99": float(p99), "worst": float(worst)}
