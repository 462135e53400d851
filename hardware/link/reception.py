"""Bytes from one board to scans with their times. No port and no thread: bytes and their time of arrival are given."""

import math
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hardware.link.frames import MAX_DRIFT, MAX_OVERRUNS, Errors, Frame, FrameDecoder, Info, Statistics, missing_between
from hardware.link.protocols import Decoder

WAIT_NS = 1000  #: least time between two stamps; seconds since 1970 as floating-point numbers tell 240 ns
MAX_HELD_NS = 1_000_000_000  #: step back of the clock that stamps wait for; after a longer one they follow it
OFF_PACE = 0.1  #: logarithm of a clock's pace that is said: ten times what resonators are off
_TURN_US = 2**32  # the board's clock starts again from 0
_BUCKET_S = 1.0  # the quickest frame of each second is kept
_MAX_POINTS = 20  # so many seconds back frames count
_MIN_POINTS = 4  # for a drift: with fewer, one second without a quick frame would tilt the line


@dataclass(frozen=True, kw_only=True, eq=False, slots=True)
class Scan:
    """A frame and its times.

    Its stamp follows the fitted clock of the board, and waits where that steps back (`DeviceClock.stamp_ns`). For the
    time between two scans take the difference of their ``frame.device_us``, modulo 2³².
    """

    frame: Frame
    received_s: float  #: time.perf_counter() when its last byte was read [s]
    restarts: int  #: of the board, before it
    run: int  #: counts up where the board restarted or was connected again; nothing counts as lost in between
    stamp_ns: int  #: start of the scan on the host's Unix clock [ns], late by the link's least delay

    @property
    def time_s(self) -> float:
        """The stamp [s]."""
        return self.stamp_ns * 1e-9


@dataclass(frozen=True, kw_only=True)
class LinkStatistics(Statistics):
    """Counts of a link's events, over all connections.

    `lost` are frames missing within a run; `restarts` include those between two connections; `foreign` are data and
    INFO frames of another device, which are not delivered.
    """

    overruns: int = 0  #: scans that the board skipped, as far as it counted
    uncounted: bool = False  #: its counter was at its end, which stands for more: it may have skipped more
    dropped: int = 0  #: scans that fell out of the scanner's queue, because nobody took them in time
    stalls: int = 0  #: silences longer than the timeout
    reconnects: int = 0  #: the port was lost and found again
    clock_pace: float = 1.0  #: of the board's clock over this computer's

    @property
    def overruns_said(self) -> str:
        """The overruns in words, as 'at least 243 overruns'."""
        return f"{'at least ' * self.uncounted}{self.overruns} overruns"

    @property
    def clock_said(self) -> str:
        """In words that the board's clock is wrong; nothing while it is right within what boards' clocks are."""
        off = f"the board's clock runs {self.clock_pace:.3g} times as fast as this computer's"
        return off if abs(math.log(self.clock_pace)) > OFF_PACE else ""


_IDENTITY = ("rows", "cols", "layout", "bits", "scan_mode", "serial", "sense_ohm")  # of a device: these never change
_OF_THE_DECODER = ("ok", "repeated", "bad_crc", "bad_cobs", "bad_form")  # the others need the host's clock or the INFO


class Reception:
    """Makes scans of the bytes of one board: the one that first said what it is.

    Scans are delivered once an INFO frame says what they mean: after each (re)connection, and again after
    another device was met.

    The board has restarted where its sequence or its clock steps back, or where its clock has gone on by more than
    the host's: see `frames.missing_between`. A pause above 1 s counts as a restart where a recording is played faster
    than in real time, and where the host's clock stood still while it slept.
    """

    def __init__(self, decoder: Callable[[], Decoder] = FrameDecoder) -> None:
        self.info: Info | None = None  #: of the board; its rate is the latest
        self.errors: Errors | None = None  #: the last ERRORS frame
        self.counted: Counter[str] = Counter()  #: fields of `LinkStatistics`; who has port and queue counts here, too
        self.n_bytes = 0  #: received
        self.n_frames = 0  #: valid data frames received, delivered or not
        self.asks = True  #: the board is to be asked for INFO
        self._new_decoder, self._decoder = decoder, decoder()
        self._clock = DeviceClock()
        self._unix_s = 0.0  # to be added to time.perf_counter()
        self._previous: Frame | None = None
        self._scanned_s = 0.0  # when it was scanned, by the host's clock, at the latest
        self._run = 0
        self._uncounted = False
        self._foreign: str | None = None  # why nothing is delivered
        self.connected()

    @property
    def trouble(self) -> str | None:
        """Why valid frames are not delivered, in one line."""
        if self._foreign is None and not self._is_trusted and self._has_frames:
            return "frames but no INFO, which says what they mean: is this the firmware's protocol?"
        return self._foreign

    @property
    def statistics(self) -> LinkStatistics:
        counts = self.counted + self._decoded()
        return LinkStatistics(uncounted=self._uncounted, clock_pace=self._clock.pace, **counts)

    def connected(self) -> None:
        """Start anew on the bytes of a new connection."""
        self.counted.update(self._decoded())
        self._decoder = self._new_decoder()
        self._has_frames = self._is_trusted = False  # no data and no INFO frame came since the connection
        self.doubt()

    def doubt(self) -> None:
        """After a silence anything may have happened: fit the clock anew, and ask who is there."""
        self._clock.restart()
        self._unix_s = time.time() - time.perf_counter()
        self.asks = True

    def take(self, data: bytes, received_s: float) -> list[Scan]:
        """The scans that `data` completes, received at `received_s` by time.perf_counter()."""
        self.n_bytes += len(data)
        scans: list[Scan] = []
        waiting: list[Frame] = []  # of one run: the one that was quickest to come sets the times of all
        for received in self._decoder.feed(data):
            if isinstance(received, Info):
                self._identify(received)
                continue
            if isinstance(received, Errors):
                self.errors = received
                continue
            self.n_frames += 1
            if self._is_foreign(received):
                continue
            since_s = received_s - self._scanned_s
            missing = missing_between(self._previous, received, since_s) if self._previous else 0
            if missing is None:
                scans += self._timed(waiting, received_s)
                waiting = []
            self._follow(received, received_s, missing)
            if self._is_trusted:
                waiting.append(received)
        return scans + self._timed(waiting, received_s)

    def _timed(self, frames: list[Frame], received_s: float) -> list[Scan]:
        """Scans of frames of the newest run."""
        found, clock = [], self._clock
        for frame in frames:
            stamp_ns = clock.stamp_ns(self._unix_s + clock.host_time(frame.device_us))
            restarts = self.counted["restarts"]
            found.append(Scan(frame=frame, received_s=received_s, restarts=restarts, run=self._run, stamp_ns=stamp_ns))
        return found

    def _decoded(self) -> Counter[str]:
        """Counts of this connection's decoder that need no clock and no other connection."""
        return Counter({name: getattr(self._decoder.statistics, name) for name in _OF_THE_DECODER})

    def _identify(self, info: Info) -> None:
        now, before = info.plain(), (self.info or info).plain()
        pairs = [(name, now[name], before[name]) for name in _IDENTITY]
        if difference := ", ".join(f"{name} {new} instead of {old}" for name, new, old in pairs if new != old):
            self.counted["foreign"] += 1
            self._foreign = f"another device answers, {difference}: connect the first one again."
            return
        self.info = info
        self.counted["info"] += 1
        self._foreign, self._is_trusted, self.asks = None, True, False

    def _follow(self, frame: Frame, received_s: float, missing: int | None) -> None:
        """Keep the clock, and count what is missing between the previous frame and this one."""
        scanned_s = received_s
        self._uncounted |= frame.overruns == MAX_OVERRUNS
        if self._previous:
            if missing is None:
                self.counted["restarts"] += 1
                self.counted["overruns"] += frame.overruns
                self.doubt()
            else:
                # a frame that waited in a buffer was scanned long before it arrived
                elapsed_s = 1e-6 * ((frame.device_us - self._previous.device_us) % 2**32)
                scanned_s = min(received_s, self._scanned_s + (1 + MAX_DRIFT) * elapsed_s)
            if missing is None or not self._has_frames:  # what a board sends between two connections is not lost
                self._run += 1
            else:
                self.counted["lost"] += missing
                self.counted["overruns"] += (frame.overruns - self._previous.overruns) % 2**8
        self._previous, self._scanned_s, self._has_frames = frame, scanned_s, True
        self._clock.add(frame.device_us, received_s)

    def _is_foreign(self, frame: Frame) -> bool:
        """True for a frame of another device, as far as it can be told; then the board is asked."""
        if self.info is None:
            return False
        shape = frame.counts.size, frame.bits, frame.scan_mode
        if self._foreign is None and shape != (self.info.n_crossings, self.info.bits, self.info.scan_mode):
            self._foreign = (
                f"frames of {shape[0]} counts of {shape[1]} bits in mode {shape[2].name} came, but the board has "
                f"{self.info.n_crossings} of {self.info.bits} bits in {self.info.scan_mode.name}: connect it again."
            )
        if self._foreign:
            self.counted["foreign"] += 1
            self.asks = True
        return self._foreign is not None


class DeviceClock:
    """Puts the board's clock on the host's time: host time = board's time + offset + drift · board's time.

    A frame may arrive late by anything (buffers, other programs) but never early. So only the quickest frames of the
    last seconds set the offset and the drift. `host_time` is late by the link's least delay, which cannot be told from
    the clock's offset.

    Notes
    -----
    The line lies below all kept points and comes closest to them on average: of the lines through two points it is the
    one that can be highest at their mean time (Moon, Skelly & Towsley, "Estimation and removal of clock skew from
    network delay measurements", INFOCOM 1999). It is fitted once a second; a frame in between only lowers it. In the
    first four seconds the drift is taken as 0.
    """

    def __init__(self) -> None:
        self._quickest: deque[tuple[float, float]] = deque(maxlen=_MAX_POINTS)
        self._last_ns: int | None = None  # the last stamp
        self.restart()

    def restart(self) -> None:
        """Forget all: the board has started anew."""
        self._quickest.clear()  # of each second gone by: (board's time, delay), both [s], as below
        self._current: tuple[float, float] | None = None  # of the second that runs
        self._last_us: int | None = None  # never wraps
        self.pace = 1.0  #: of the board's clock over the host's, however wrong
        self.drift = 0.0  #: fraction by which the host's clock runs faster than the board's
        self._bucket_end_s = self._offset_s = 0.0

    def add(self, device_us: int, received_s: float) -> None:
        """Take note that a frame of the board's time [µs, modulo 2³²] was received at `received_s` [s, host].

        Frames come in their order, with no pause of 2³¹ µs (35.8 min) or more between two.
        """
        self._last_us = self._unwrapped(device_us)
        board_s = self._last_us * 1e-6
        delay_s = received_s - board_s
        if self._current is None:
            self._offset_s = delay_s
        elif board_s >= self._bucket_end_s:
            self._quickest.append(self._current)
            self._fit()
            self._current = None
        if self._current is None:
            self._current = (board_s, delay_s)
            self._bucket_end_s = board_s + _BUCKET_S
        elif delay_s < self._current[1] + self.drift * (board_s - self._current[0]):
            self._current = (board_s, delay_s)
        self._offset_s = min(self._offset_s, delay_s - self.drift * board_s)  # no frame arrives early

    def host_time(self, device_us: int) -> float:
        """When the board's clock stood at `device_us` [s, host]; for times near that of the last frame added."""
        board_s = self._unwrapped(device_us) * 1e-6
        return board_s + self._offset_s + self.drift * board_s

    def stamp_ns(self, time_s: float) -> int:
        """A scan's time [s] as nanoseconds that only grow, also over restarts.

        Times may step back by the link's delays, when the fit improves or the board has restarted. A stamp then waits
        `WAIT_NS` behind the one before, until the clock has caught up. A step back of more than `MAX_HELD_NS` is one of
        the host's own clock, and is followed.
        """
        stamp_ns = round(time_s * 1e9)
        if self._last_ns is not None and -WAIT_NS < self._last_ns - stamp_ns <= MAX_HELD_NS:
            stamp_ns = self._last_ns + WAIT_NS
        self._last_ns = stamp_ns
        return stamp_ns

    def _unwrapped(self, device_us: int) -> int:
        """The time nearest to the last one that is `device_us` modulo a turn."""
        if self._last_us is None:
            return device_us
        step = (device_us - self._last_us + _TURN_US // 2) % _TURN_US - _TURN_US // 2
        return self._last_us + step

    def _fit(self) -> None:
        points = list(self._quickest)
        if len(points) >= _MIN_POINTS:
            board_s, delay_s = np.array(points).T
            board_s -= board_s.mean()
            i, j = np.triu_indices(len(points), 1)
            slopes = (delay_s[j] - delay_s[i]) / (board_s[j] - board_s[i])
            highest = (delay_s - np.outer(slopes, board_s)).min(axis=1).argmax()
            slope = float(slopes[highest])
            self.pace = 1 / max(1 + slope, 1e-3)
            self.drift = min(max(slope, -MAX_DRIFT), MAX_DRIFT)
        self._offset_s = min(delay_s - self.drift * board_s for board_s, delay_s in points)
