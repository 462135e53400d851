"""A port with a board on it: a stream of scans that goes on after faults of cables and boards.

`Link` follows the port, without a thread and by any clock; `Scanner` is its thread, and a queue.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import TracebackType
from typing import Any, Self

from geometry.errors import TriPillarError
from hardware.link.frames import Errors, Info
from hardware.link.protocols import BoardProtocol, spoken_on
from hardware.link.reception import LinkStatistics, Reception, Scan
from hardware.link.serial_ports import BAUD, Port, PortError, close, open_port, read_available, write

ASK_EVERY_S = 0.25
LISTEN_S = 0.5  #: before the first question: a boot loader may be at the other end, which is to hear nothing odd
RETRY_EVERY_S = 0.1
_READ_TIMEOUT_S = 0.1  # bounds how long closing takes
_ERRORS_WAIT_S = 0.5  # for an answer that firmware before 1.1 does not give
_RATES_HZ = (1, 1000)  # that a board may be asked for


class ScannerError(TriPillarError, RuntimeError):
    """A board that does not answer, or not as it should."""


class Link:
    """The scans of one board on a port that may go and come back.

    `read` is for one thread and waits as long as the port does; `take` and all that is asked of a link otherwise may be
    put under a lock.

    Parameters
    ----------
    opened : port
        The port, open.
    open_again : callable, optional
        Opens it anew once it has gone; None: its loss is raised.
    timeout_s : float
        How long a silence is a stall [s].
    protocol : BoardProtocol
    clock, wait : callable
        As ``time.perf_counter`` and ``time.sleep``; a `wait` that returns True ends the attempts to open.
    """

    def __init__(
        self,
        opened: Port,
        open_again: Callable[[], Port] | None,
        timeout_s: float,
        protocol: BoardProtocol,
        clock: Callable[[], float] = time.perf_counter,
        wait: Callable[[float], Any] = time.sleep,
    ) -> None:
        self.reception = Reception(protocol.decoder)
        self.commands: deque[bytes] = deque()  #: to be sent
        self.wanted_hz: int | None = None  #: the rate that was set, which a reset makes the board forget
        self.fault: str | None = None  #: why nothing comes, in one line; what `Reception` refuses has its own
        self.n_stalls = self.n_reconnects = 0
        self.is_finished = False  #: the port says that nothing will come any more
        self._port: Port | None = opened
        self._open_again, self._timeout_s, self._protocol = open_again, timeout_s, protocol
        self._clock, self._wait = clock, wait
        self._is_new = self._is_silent = False
        self._begin()

    def read(self) -> bytes:
        """Ask what is to be asked, and read; empty where nothing came, or while the port is lost.

        Raises
        ------
        PortError
            If the port has gone and is not to be opened again.
        """
        if self._port is None:
            self._reopen()
            return b""
        try:
            self._ask(self._port)
            data = read_available(self._port)
            self.is_finished = not data and getattr(self._port, "finished", False)
        except PortError as fault:
            if self._open_again is None:
                raise
            self.fault = f"disconnected, trying again: {fault}"
            self.close()
            return b""
        self._read_s = self._clock()
        return data

    def take(self, data: bytes) -> list[Scan]:
        """The scans in what was read."""
        reception = self.reception
        if self._is_new:
            self._is_new = False
            self.n_reconnects += 1
            reception.connected()
        n_frames = reception.n_frames
        scans = reception.take(data, self._read_s) if data else []
        if data and self._is_silent:
            self._is_silent, self._ask_s = False, self._read_s
        if reception.n_frames > n_frames:
            self._heard_s, self.fault = self._read_s, None
        elif self._read_s - self._heard_s > self._timeout_s and self.fault is None:
            self.fault = f"no frames for {self._timeout_s:.1f} s"
            self.n_stalls += 1
            reception.doubt()
        return scans

    def close(self) -> None:
        """Close the port, if it is open."""
        if self._port is not None:
            close(self._port)
            self._port = None

    def _begin(self) -> None:
        """Start on a connection: listen first, but to a finite port, which has no boot loader."""
        self._is_new = False  # `take` has yet to hear of it
        self._is_silent = not hasattr(self._port, "finished")
        self._heard_s = self._read_s = self._clock()
        self._ask_s = self._heard_s + LISTEN_S * self._is_silent

    def _ask(self, port: Port) -> None:
        if self._clock() >= self._ask_s and (question := self._question()):
            self._ask_s = self._clock() + ASK_EVERY_S
            write(port, question)
        while self.commands:
            write(port, self.commands.popleft())

    def _question(self) -> bytes | None:
        """The command to send unasked: the question while the board is unknown, or the rate that it forgot."""
        if self.reception.asks or self.reception.info is None:
            return self._protocol.question
        wanted_hz = self.wanted_hz
        return None if wanted_hz in (None, self.reception.info.rate_hz) else self._protocol.rate(wanted_hz)

    def _reopen(self) -> None:
        if self._open_again is None or self._wait(RETRY_EVERY_S):
            return
        try:
            self._port = self._open_again()
        except OSError:  # PortError among them
            return
        self._begin()
        self._is_new, self.fault = True, None


class Scanner:
    """Reads the scans of the board on a port, in a thread of its own, as long as the with block lasts::

        with Scanner("/dev/ttyUSB0") as scanner:
            for scan in scanner:
                print(scan.time_s, scan.frame.counts)

    Parameters
    ----------
    port : str or Port
        What `open_port` opens, with a protocol in front if it is another (`spoken_on`); or an open port, which stays
        open in the end, and cannot be reconnected.
    timeout : float
        How long to wait for the board's answer, and how long a silence is a stall [s].
    reconnect : bool
        Whether to wait for a port that has gone. If not, its loss is raised to who asks for scans.
    queue : int
        How many scans wait to be taken; then the oldest is dropped.
    baud : int
        Bits a second.
    opener : callable
        Opens a port as `open_port` does.

    Raises
    ------
    PortError
        On entering: if the port cannot be opened. Later: if it has gone and there is no reconnecting.
    ScannerError
        On entering: if no board says within `timeout` what it is.

    Notes
    -----
    Scans come in their order, without those that were lost. Those of another device are not delivered; `trouble`
    says so. Whatever ends the reading thread is raised to who takes scans, never swallowed.

    A board that resets when its port is opened, as an Arduino does, has until `timeout` to start; its boot loader
    swallows what comes in the first second or two. So the scanner listens first, asks once a byte has come or half a
    second has passed, and goes on asking four times a second. A port with ``finished`` is asked at once.

    A board that comes back under another name is not found again: give a name that stays, as in /dev/serial/by-id.
    """

    def __init__(
        self,
        port: Any,
        *,
        timeout: float = 4.0,
        reconnect: bool = True,
        queue: int = 256,
        baud: int = BAUD,
        opener: Callable[..., Any] = open_port,
    ) -> None:
        if queue < 1:
            raise ScannerError(f"queue={queue} must be 1 or more: the scans that may wait.")
        if not timeout > 0:
            raise ScannerError(f"timeout={timeout:g} must be above 0 s.")
        self._protocol, url = spoken_on(port if isinstance(port, str) else "")
        self._url = url if isinstance(port, str) else None
        self._port = None if isinstance(port, str) else port
        self._opener, self._baud, self._timeout_s = opener, baud, timeout
        self._may_reconnect = reconnect and self._url is not None
        self._changed = threading.Condition()  # guards all below
        self._link: Link | None = None  # until it is entered
        self._queue: deque[Scan] = deque(maxlen=queue)
        self._latest: Scan | None = None
        self._n_dropped = 0
        self._error: BaseException | None = None  # that ended the thread
        self._is_error_raised = False
        self._has_ended = False
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="scanner", daemon=True)

    def __enter__(self) -> Self:
        if self._thread.ident is not None:
            raise ScannerError("this scanner was used already: make another.")
        opened = self._open() if self._port is None else self._port
        open_again = self._open if self._may_reconnect else None
        link = Link(opened, open_again, self._timeout_s, self._protocol, wait=self._closing.wait)
        self._link = link
        self._thread.start()
        try:
            self._wait_for(lambda: link.reception.info is not None, self._timeout_s)
            if link.reception.info is None:
                raise ScannerError(f"{self._name}: {self._silence()}")
        except BaseException:  # Ctrl-C as well: without __exit__, thread and port would stay open
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
        if kind is None and not self._is_error_raised:
            self._raise_error()

    def close(self) -> None:
        """Stop reading, within 0.2 s, and close the port if the scanner opened it. May be called again."""
        self._closing.set()
        if self._thread.ident is not None:
            self._thread.join()

    def __iter__(self) -> Iterator[Scan]:
        """Scans as they come, until the scanner is closed or its port finished, and the queue is empty."""
        while scan := self.get():
            yield scan

    def get(self, timeout: float | None = None) -> Scan | None:
        """The next scan; None if there is none within `timeout` seconds, or no more at all."""
        with self._changed:  # waiting frees it
            return self._queue.popleft() if self._wait_for(lambda: bool(self._queue), timeout) else None

    def latest(self) -> Scan | None:
        """The newest scan, at once; None if there is none yet. Leaves the queue as it is."""
        with self._changed:
            self._raise_error()
            return self._latest

    @property
    def info(self) -> Info:
        """INFO of the board: size, rate, circuit, firmware."""
        info = self._entered.reception.info
        if info is None:
            raise ScannerError("the board was not asked yet: enter the scanner, with Scanner(...) as scanner.")
        return info

    @property
    def stats(self) -> LinkStatistics:
        """Counts of all that happened so far."""
        with self._changed:
            link = self._entered
            return replace(
                link.reception.statistics,
                dropped=self._n_dropped,
                stalls=link.n_stalls,
                reconnects=link.n_reconnects,
            )

    @property
    def dropped(self) -> int:
        """Scans that fell out of the queue; quicker than `stats`."""
        return self._n_dropped

    @property
    def ended(self) -> bool:
        """No scan will come any more: closed, or a finite port is finished and all its scans are taken."""
        with self._changed:
            return self._has_ended and not self._queue

    @property
    def trouble(self) -> str | None:
        """Why no scans come, in one line; None as long as they do."""
        with self._changed:
            if self._error:
                return f"{type(self._error).__name__}: {self._error}"
            return self._entered.fault or self._entered.reception.trouble

    def request(self, command: bytes) -> Info:
        """Send the board a command and return the INFO that it answers with; for the rate there is `set_rate`.

        Raises
        ------
        ScannerError
            If no answer comes within the timeout.
        """
        link = self._entered
        with self._changed:
            before = link.reception.n_infos
            link.commands.append(command)
        if not self._wait_for(lambda: link.reception.n_infos > before, self._timeout_s):
            raise ScannerError(f"{self._name}: no answer to {command!r} within {self._timeout_s:g} s: is it connected?")
        return self.info

    def errors(self) -> Errors | None:
        """Ask the board what went wrong since its start; None where its firmware does not tell."""
        link = self._entered
        with self._changed:
            link.reception.errors = None
            link.commands.append(self._protocol.errors)
        self._wait_for(lambda: link.reception.errors is not None, _ERRORS_WAIT_S)
        return link.reception.errors

    def set_rate(self, rate_hz: int) -> Info:
        """Have the board scan `rate_hz` times a second, also after it was reset or plugged in again.

        Raises
        ------
        ScannerError
            If it does not answer, or keeps to another rate. The rate that was set before, if any, is then the one
            that is wanted.
        """
        low, high = _RATES_HZ
        if rate_hz != int(rate_hz) or not low <= rate_hz <= high:
            raise ScannerError(f"rate_hz={rate_hz} must be a whole number from {low} to {high}.")
        link = self._entered
        wanted_hz, link.wanted_hz = link.wanted_hz, None  # the reading thread must not ask for the old one
        try:
            self.request(self._protocol.rate(int(rate_hz)))
            if not self._wait_for(lambda: self.info.rate_hz == rate_hz, self._timeout_s):  # an older answer came first
                raise ScannerError(
                    f"{self._name}: the board keeps to {self.info.rate_hz} Hz, not {rate_hz} Hz: ask for less."
                )
            wanted_hz = rate_hz
        finally:
            link.wanted_hz = wanted_hz
        return self.info

    def _wait_for(self, is_so: Callable[[], bool], timeout_s: float | None) -> bool:
        """Wait until something is so, or the reading has ended; raise the error that ended it."""
        _ = self._entered
        with self._changed:
            self._changed.wait_for(lambda: is_so() or self._has_ended, timeout_s)
            if not is_so():
                self._raise_error()
                return False
            return True

    def _raise_error(self) -> None:
        if self._error:
            self._is_error_raised = True
            raise self._error

    @property
    def _entered(self) -> Link:
        if self._link is None:
            raise ScannerError("the scanner reads nothing yet: enter it, with Scanner(...) as scanner.")
        return self._link

    @property
    def _name(self) -> str:
        return self._url or "port"

    def _silence(self) -> str:
        """Say what came instead of an INFO frame."""
        statistics, n_bytes = self._entered.reception.statistics, self._entered.reception.n_bytes
        if not n_bytes:
            return f"nothing received within {self._timeout_s:g} s: is this the board's port, and the board powered?"
        if not statistics.ok:
            return f"{n_bytes} bytes but no valid frame: wrong baud rate? {self._baud} is set."
        return f"{statistics.ok} frames but no INFO in answer to '?': does the board's firmware follow the protocol?"

    def _open(self) -> Port:
        return self._opener(self._url, baud=self._baud, timeout_s=_READ_TIMEOUT_S)

    def _run(self) -> None:
        """Read until closing, or until a finite port has finished; in the reading thread."""
        link = self._entered
        try:
            while not self._closing.is_set() and not link.is_finished:
                data = link.read()
                with self._changed:
                    scans = link.take(data)
                    self._n_dropped += max(0, len(self._queue) + len(scans) - (self._queue.maxlen or 0))
                    self._queue.extend(scans)
                    self._latest = scans[-1] if scans else self._latest
                    self._changed.notify_all()
        except PortError as fault:
            self._error = PortError(f"{self._name}: {fault}")  # raised to who takes scans
            self._error.__cause__ = fault
        except BaseException as error:
            self._error = error
        finally:
            if self._url is not None:
                link.close()
            with self._changed:
                self._has_ended = True
                self._changed.notify_all()
