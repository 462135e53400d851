"""One scan as streams and messages take it: forces, deviations, net wrench, and a stamp by the board's clock."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from geometry.layout import FloatArray
from hardware.link.reception import DeviceClock, Scan
from hardware.readout.forces import Forces, LiveSensor
from hardware.readout.wrench import Wrench, net_values, net_wrench
from hardware.recording import Recording
from hardware.recording.topics import wrench_content

RENEWED_S = 0.1  #: between two calculations of the deviations, which take twenty times as long as the forces
MAX_HELD_NS = 1_000_000_000  #: step back of the clock that stamps wait for; after a longer one they follow it


@dataclass(frozen=True, kw_only=True, eq=False)
class TactileFrame:
    """Forces of one scan; k components, as the model gives them."""

    stamp_ns: int  #: start of the scan [ns]: the board's clock on the host's Unix time
    device_us: int  #: the board's clock as sent [µs], modulo 2³²
    sequence: int  #: frames sent since the board's start, modulo 2¹⁶
    force_n: FloatArray  #: (rows, cols, k)
    deviation_n: FloatArray | None  #: (rows, cols, k): half-widths that hold 68 % of the errors; None if unknown
    resistance_ohm: FloatArray  #: (rows, cols, 3): pillars z, x, y as the model saw them
    saturated: NDArray[np.bool_]  #: (rows, cols, 3): counts at 0 or full scale, which only bound a resistance
    wrench: Wrench  #: n = 1
    chi2: float | None  #: over its degrees of freedom if a load that the model knows is on the sensor
    is_explained: bool  #: by a load that the model knows, or nothing is known of loads
    faults: tuple[str, ...] = ()  #: of pillars and wires, in words, of a live sensor's last window of scans

    def net(self) -> dict[str, Any]:
        """Net force, moment and centre of pressure as the message `WRENCH` of recordings."""
        return wrench_content({name: values[0] for name, (values, _) in net_values(self.wrench).items()})


class Stream(Protocol):
    """A viewer or a file that takes frames, as long as its with block lasts."""

    def add(self, frame: TactileFrame) -> None:
        """Take a frame."""


class Stamps:
    """Times of frames [s] as nanoseconds that only grow.

    The board's clock on the host's time may step back by the link's delays, when its fit improves or the board has
    restarted. A stamp then waits 1 ns behind the one before, until the clock has caught up. A step back of more than
    `MAX_HELD_NS` is one of the host's own clock, and is followed.

    >>> stamps = Stamps()
    >>> [stamps.after(time_s) for time_s in (5.0, 4.5, 5.25, 1.0)]
    [5000000000, 5000000001, 5250000000, 1000000000]
    """

    def __init__(self) -> None:
        self._last_ns: int | None = None

    def after(self, time_s: float) -> int:
        """The stamp of the next frame."""
        stamp_ns = round(time_s * 1e9)
        if self._last_ns is not None and 0 <= self._last_ns - stamp_ns <= MAX_HELD_NS:
            stamp_ns = self._last_ns + 1
        self._last_ns = stamp_ns
        return stamp_ns


class LiveFrames:
    """Makes frames of a sensor's scans; their deviations are `RENEWED_S` old at most."""

    def __init__(self, sensor: LiveSensor) -> None:
        self.sensor = sensor
        self._stamps = Stamps()
        self._renew_s = 0.0
        self._known: tuple[FloatArray | None, FloatArray | None] = (None, None)

    def frame(self, scan: Scan) -> TactileFrame:
        """The frame of the next scan."""
        latest = self.sensor.forces(scan)
        found = latest.source
        if scan.received_s >= self._renew_s:
            self._renew_s, self._known = scan.received_s + RENEWED_S, found.deviations
        deviation_n, covariance = self._known
        return TactileFrame(
            stamp_ns=self._stamps.after(scan.time_s),
            device_us=scan.frame.device_us,
            sequence=scan.frame.sequence,
            force_n=found.force_n[0],
            deviation_n=None if deviation_n is None else deviation_n[0],
            resistance_ohm=found.resistance_ohm[0],
            saturated=found.saturated[0],
            wrench=net_wrench(found.force_n, found.weights, covariance),
            chi2=None if found.chi2 is None else float(found.chi2[0]),
            is_explained=not found.unexplained[0],
            faults=tuple(map(str, latest.faults)),
        )


def recorded_frames(recording: Recording, forces: Forces) -> Iterator[TactileFrame]:
    """The frames of a recording and of the forces that `replay` made of it, with the deviations of each."""
    stamps, unexplained = Stamps(), forces.unexplained
    for k, time_s in enumerate(unix_times(recording)):
        yield TactileFrame(
            stamp_ns=stamps.after(time_s),
            device_us=int(recording.device_us[k]),
            sequence=int(recording.sequence[k]),
            force_n=forces.force_n[k],
            deviation_n=None if forces.deviation_n is None else forces.deviation_n[k],
            resistance_ohm=forces.resistance_ohm[k],
            saturated=forces.saturated[k],
            wrench=forces.wrench.one(k),
            chi2=None if forces.chi2 is None else float(forces.chi2[k]),
            is_explained=not unexplained[k],
        )


def unix_times(recording: Recording) -> list[float]:
    """Start of every scan on the host's Unix clock [s], by the board's clock as `DeviceClock` fits it while live.

    The bytes of a board hold no times of arrival: then they are the board's clock.
    """
    if recording.received_s is None:
        return recording.time_s.tolist()
    clock, times, begins = DeviceClock(), [], np.diff(recording.run, prepend=recording.run[:1]) != 0
    first_s = float(recording.received_s[0])  # small numbers keep their nanoseconds
    for device_us, received_s, is_new in zip(recording.device_us.tolist(), recording.received_s, begins, strict=True):
        if is_new:
            clock.restart()
        clock.add(device_us, float(received_s) - first_s)
        times.append(first_s + clock.host_time(device_us))
    return times
