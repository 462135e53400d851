"""A port with a board on it: a stream of scans that goes on after faults of cables and boards.

`Link` follows the port, without a thread and by any clock; `Scanner` is its thread, and a queue.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, Self

import serial

from common.errors import TriPillarError
from hardware.link.frames import Errors, Info
from hardware.link.protocols import PROTOCOLS, BoardProtocol, spoken_on
from hardware.link.reception import LinkStatistics, Reception, Scan
from hardware.link.serial_ports import BAUD, PORT_FAULTS, Port, PortError, open_port

ASK_EVERY_S = 0.25
LISTEN_S = 0.5  #: before the first question: a boot loader may be at the other end, which is to hear nothing odd
RETRY_EVERY_S = 0.1
_ERRORS_WAIT_S = 0.5  # for an answer that firmware before 1.1 does not give
_RATES_HZ = (1, 1000)  # that a board may be asked for


class ScannerError(TriPillarError, RuntimeError):
    """A board that does not answer, or not as it should."""


class Link:
    """The scans of one board on an open port, which `open_again` opens anew once it has gone.

    Without `open_again` the port's loss is raised. `read` is for one thread and waits as long as the port does; `take`
    and all that is asked of a link otherwise may be put under a lock. A silence of `timeout_s` is a stall. `clock` and
    `wait` are as ``time.perf_counter`` and ``time.sleep``; a `wait` that returns True ends the attempts to open.
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
        self.is_finite = False  #: the port plays a recording, as it says by `finished`
        self.is_finished = False  #: the port says that nothing will come any more
        self._is_silent = False  # nothing has come since the connection
        self._port: Port | None = None
        self._open_again, self._timeout_s, self._protocol = open_again, timeout_s, protocol
        self._clock, self._wait = clock, wait
        self._begin(opened)
        self._is_new = False

    def read(self) -> bytes:
        """Ask what is to be asked, and read; empty where nothing came, or while the port is lost."""
        if self._port is None:
            if self._open_again is not None and not self._wait(RETRY_EVERY_S):
                with suppress(OSError):
                    self._begin(self._open_again())
            return b""
        try:
            self._ask(self._port)
            data = self._port.read(max(1, self._port.in_waiting))
        except PORT_FAULTS as error:
            if self._open_again is None:
                raise PortError("the port is gone: plug the board in again.") from error
            self.fault = "disconnected: plug the board in again"
            self.close()
            return b""
        self.is_finished = not data and getattr(self._port, "finished", False)
        self._read_s = self._clock()
        return data

    def take(self, data: bytes) -> list[Scan]:
        """The scans in what was read."""
        reception = self.reception
        if self._is_new:
            self._is_new = False
            reception.counted["reconnects"] += 1
            reception.connected()
        n_frames = reception.n_frames
        scans = reception.take(data, self._read_s) if data else []
        if data and self._is_silent:
            self._is_silent, self._ask_s = False, self._read_s
        if reception.n_frames > n_frames:
            self._heard_s, self.fault = self._read_s, None
        elif self._read_s - self._heard_s > self._timeout_s and self.fault is None:
            self.fault = f"no frames for {self._timeout_s:.1f} s"
            reception.counted["stalls"] += 1
            reception.doubt()
        return scans

    def close(self) -> None:
        """Close the port if it is open, also one that has gone and objects."""
        port, self._port = self._port, None
        if port is not None:
            with suppress(*PORT_FAULTS):
                port.close()

    def _begin(self, port: Port) -> None:
        """Start on a connection: listen first, but to a finite port, which has no boot loader."""
        self._port, self.fault, self._is_new = port, None, True  # `take` has yet to hear of it
        self.is_finite = hasattr(port, "finished")
        self._is_silent = not self.is_finite
        self._heard_s = self._read_s = self._clock()
        self._ask_s = self._heard_s + LISTEN_S * self._is_silent

    def _ask(self, port: Port) -> None:
        reception, wanted_hz = self.reception, self.wanted_hz
        asked = [self.commands.popleft() for _ in range(len(self.commands))]
        if self._clock() >= self._ask_s:
            if reception.asks or reception.info is None:
                asked.insert(0, self._protocol.question)
            elif wanted_hz not in (None, reception.info.rate_hz):  # the board has forgotten it
                asked.insert(0, self._protocol.rate(wanted_hz))
            self._ask_s = self._clock() + ASK_EVERY_S * bool(asked)
        for command in asked:
            with suppress(serial.SerialTimeoutException):  # a board that does not listen is asked again
                port.write(command)


class Scanner:
    """Reads the scans of the board on a port, in a thread of its own, until it is closed::

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
    queue : int
        How many scans wait to be taken; then the oldest is dropped.
    baud : int
        Bits a second.
    stated : Info, optional
        What a board is that cannot say so itself, and sends lines of numbers.

    Raises
    ------
    PortError
        If the port cannot be opened; of an open port also later, if it has gone.
    ScannerError
        If a setting makes no sense, or no board says within `timeout` what it is.

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
        queue: int = 256,
        baud: int = BAUD,
        stated: Info | None = None,
    ) -> None:
        if queue < 1:
            raise ScannerError(f"queue={queue} must be 1 or more: the scans that may wait.")
        if not timeout > 0:
            raise ScannerError(f"timeout={timeout:g} must be above 0 s.")
        self._is_own = isinstance(port, str)
        self._protocol, self._name = spoken_on(port, stated) if self._is_own else (PROTOCOLS["tripillar"], "port")
        self._baud, self._timeout_s = baud, timeout
        self._changed = threading.Condition()  # guards all below
        self._queue: deque[Scan] = deque(maxlen=queue)
        self._error: BaseException | None = None  # that ended the thread
        self._is_error_raised = self._has_ended = False
        self._closing = threading.Event()
        open_again = partial(open_port, self._name, baud=baud) if self._is_own else None
        opened = port if open_again is None else open_again()
        self._link = Link(opened, open_again, timeout, self._protocol, wait=self._closing.wait)
        self._thread = threading.Thread(target=self._run, name="scanner", daemon=True)
        self._thread.start()
        try:
            self._wait_for(lambda: self._link.reception.info is not None, timeout)
            if self._link.reception.info is None:
                raise ScannerError(f"{self._name}: {self._silence()}")
        except BaseException:  # Ctrl-C as well: thread and port would stay open
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
        if error[0] is None and not self._is_error_raised:
            self._raise_error()

    def close(self) -> None:
        """Stop reading, within 0.2 s, and close the port if the scanner opened it. May be called again."""
        self._closing.set()
        self._thread.join()

    def __iter__(self) -> Iterator[Scan]:
        """Scans as they come, until the scanner is closed or its port finished, and the queue is empty."""
        while scan := self.get():
            yield scan

    def get(self, timeout: float | None = None) -> Scan | None:
        """The next scan; None if there is none within `timeout` seconds, or no more at all."""
        with self._changed:  # waiting frees it
            return self._queue.popleft() if self._wait_for(lambda: bool(self._queue), timeout) else None

    @property
    def info(self) -> Info:
        """INFO of the board: size, rate, circuit, firmware."""
        info = self._link.reception.info
        assert info is not None, "no scanner without"
        return info

    @property
    def stats(self) -> LinkStatistics:
        """Counts of all that happened so far."""
        with self._changed:
            found = self._link.reception.statistics
        return replace(found, clock_pace=1.0) if self._link.is_finite else found  # it is played at any pace

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
                return str(self._error)
            return self._link.fault or self._link.reception.trouble

    def errors(self) -> Errors | None:
        """Ask the board what went wrong since its start; None where its firmware does not tell."""
        reception = self._link.reception
        with self._changed:
            reception.errors = None
            self._link.commands.append(self._protocol.errors)
        self._wait_for(lambda: reception.errors is not None, _ERRORS_WAIT_S)
        return reception.errors

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
        link, counted = self._link, self._link.reception.counted
        wanted_hz, link.wanted_hz = link.wanted_hz, None  # the reading thread must not ask for the old one
        try:
            with self._changed:
                before = counted["info"]
                link.commands.append(self._protocol.rate(int(rate_hz)))
            if not self._wait_for(lambda: counted["info"] > before, self._timeout_s):
                raise ScannerError(f"{self._name}: no answer within {self._timeout_s:g} s: is it connected?")
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

    def _silence(self) -> str:
        """Say what came instead of an INFO frame."""
        statistics, n_bytes = self._link.reception.statistics, self._link.reception.n_bytes
        if not n_bytes:
            return f"nothing received within {self._timeout_s:g} s: is this the board's port, and the board powered?"
        if not statistics.ok:
            return f"{n_bytes} bytes but no valid frame: wrong baud rate? {self._baud} is set."
        return f"{statistics.ok} frames but no INFO in answer to '?': does the board's firmware follow the protocol?"

    def _run(self) -> None:
        """Read until closing, or until a finite port has finished; in the reading thread."""
        link, queue = self._link, self._queue
        try:
            while not self._closing.is_set() and not link.is_finished:
                data = link.read()
                with self._changed:
                    scans = link.take(data)
                    dropped = max(0, len(queue) + len(scans) - (queue.maxlen or 0))
                    link.reception.counted["dropped"] += dropped
                    queue.extend(scans)
                    self._changed.notify_all()
        except PortError as fault:
            self._error = PortError(f"{self._name}: {fault}")  # raised to who takes scans
            self._error.__cause__ = fault
        except BaseException as error:
            self._error = error
        finally:
            if self._is_own:
                link.close()
            with self._changed:
                self._has_ended = True
                self._changed.notify_all()
