"""What the bytes from one board mean: scans with their times, and what of it comes from another board.

No port and no thread: bytes and their time of arrival are given. `hardware.link.scanner` feeds it.
"""

import time
from collections import Counter
from dataclasses import dataclass

from hardware.link.clock import DeviceClock
from hardware.link.frames import MAX_DRIFT, Errors, Frame, FrameDecoder, Info, Statistics, missing_between


@dataclass(frozen=True, kw_only=True, eq=False, slots=True)
class Scan:
    """A frame and its times.

    `time_s` follows the fit of the board's clock, and may step back by what that is mended by, or after a restart. For
    the time between two scans take the difference of their ``frame.device_us``, modulo 2³².
    """

    frame: Frame
    received_s: float  #: time.perf_counter() when its last byte was read [s]
    restarts: int  #: of the board, before it
    run: int  #: counts up where the board restarted or was connected again; from one run to the next nothing is lost
    time_s: float  #: start of the scan on the host's Unix clock [s], late by the link's least delay


@dataclass(frozen=True, kw_only=True)
class ReceptionStatistics(Statistics):
    """What was met so far, over all connections.

    `lost` are frames missing within a run; `restarts` has those between two connections among them; `foreign` are data
    and INFO frames of another device, not delivered.
    """

    overruns: int = 0  #: scans that the board skipped


_OF_THE_DECODER = ("ok", "repeated", "bad_crc", "bad_cobs", "bad_form")  # which has no clock to tell restarts by


class Reception:
    """Scans out of the bytes of one board, which is the one that first said what it is.

    Scans are delivered once an INFO frame says what they mean: after each (re)connection, and again after
    another device was met.

    The board has restarted where its sequence or its clock steps back, or where its clock has gone on by more than
    the host's: see `frames.missing_between`. A port that gives frames quicker than they were scanned (a recording's)
    makes a restart of a pause above 1 s; a host whose clock stood still while it slept does so, too.
    """

    def __init__(self) -> None:
        self.info: Info | None = None  #: of the board; its rate is the latest
        self.n_infos = 0  #: INFO frames of the board
        self.errors: Errors | None = None  #: the last ERRORS frame
        self.n_bytes = 0  #: received
        self.n_frames = 0  #: valid data frames received, delivered or not
        self.asks = True  #: the board is to be asked for INFO
        self._decoder = FrameDecoder()
        self._clock = DeviceClock()
        self._unix_s = 0.0  # to be added to time.perf_counter()
        self._counted: Counter[str] = Counter()
        self._previous: Frame | None = None
        self._scanned_s = 0.0  # when it was scanned, by the host's clock, at the latest
        self._run = 0
        self._foreign: str | None = None  # why nothing is delivered
        self.connected()

    @property
    def trouble(self) -> str | None:
        """Why valid frames are not delivered, in one line."""
        if self._foreign is None and not self._is_trusted and self._has_frames:
            return "frames but no INFO, which says what they mean: is this the firmware's protocol?"
        return self._foreign

    @property
    def statistics(self) -> ReceptionStatistics:
        met = self._counted + Counter(_counts(self._decoder.statistics))
        return ReceptionStatistics(info=self.n_infos, **met)

    def connected(self) -> None:
        """Start anew on the bytes of a new connection."""
        self._counted.update(_counts(self._decoder.statistics))
        self._decoder = FrameDecoder()
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
        scans = []
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
            self._follow(received, received_s)
            if self._is_trusted:
                time_s = self._unix_s + self._clock.host_time(received.device_us)
                restarts = self._counted["restarts"]
                scans.append(
                    Scan(frame=received, received_s=received_s, time_s=time_s, restarts=restarts, run=self._run)
                )
        return scans

    def _identify(self, info: Info) -> None:
        self.info = self.info or info
        if _identity(info) != _identity(self.info):
            self._counted["foreign"] += 1
            self._foreign = f"another device answers, {_difference(info, self.info)}: connect the first one again."
            return
        self.info = info
        self.n_infos += 1
        self._foreign = None
        self._is_trusted = True
        self.asks = False

    def _follow(self, frame: Frame, received_s: float) -> None:
        """Keep the clock, and count what is missing between the previous frame and this one."""
        scanned_s = received_s
        if self._previous:
            missing = missing_between(self._previous, frame, received_s - self._scanned_s)
            if missing is None:
                self._counted["restarts"] += 1
                self._counted["overruns"] += frame.overruns
                self.doubt()
            else:
                # one that waited in a buffer while this program did not read was scanned long before its arrival
                elapsed_s = 1e-6 * ((frame.device_us - self._previous.device_us) % 2**32)
                scanned_s = min(received_s, self._scanned_s + (1 + MAX_DRIFT) * elapsed_s)
            if missing is None or not self._has_frames:  # what a board sends between two connections is not lost
                self._run += 1
            else:
                self._counted["lost"] += missing
                self._counted["overruns"] += (frame.overruns - self._previous.overruns) % 2**8
        self._previous, self._scanned_s, self._has_frames = frame, scanned_s, True
        self._clock.add(frame.device_us, received_s)

    def _is_foreign(self, frame: Frame) -> bool:
        """Whether a frame is another device's, as far as it can be told; then the board is asked."""
        if self.info is None:
            return False
        shape = frame.counts.size, frame.bits, frame.scan_mode
        if self._foreign is None and shape != (self.info.n_crossings, self.info.bits, self.info.scan_mode):
            self._foreign = (
                f"frames of {shape[0]} counts of {shape[1]} bits in mode {shape[2].name} came, but the board has "
                f"{self.info.n_crossings} of {self.info.bits} bits in {self.info.scan_mode.name}: connect it again."
            )
        if self._foreign:
            self._counted["foreign"] += 1
            self.asks = True
        return self._foreign is not None


def _counts(statistics: Statistics) -> dict[str, int]:
    return {name: getattr(statistics, name) for name in _OF_THE_DECODER}


def _identity(info: Info) -> tuple[int, ...]:
    """What does not change as long as a device stays the same."""
    return info.rows, info.cols, info.bits, info.scan_mode, info.serial, info.sense_ohm


def _difference(info: Info, expected: Info) -> str:
    names = ("rows", "cols", "bits", "scan_mode", "serial", "sense_ohm")
    pairs = [(name, getattr(info, name), getattr(expected, name)) for name in names]
    return ", ".join(f"{name} {value} instead of {wanted}" for name, value, wanted in pairs if value != wanted)
