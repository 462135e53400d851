"""A port with a board on it, followed through faults of cables and boards. No thread, and any clock.

`Scanner` turns it in a thread: `read` what has come, then `take` scans of it.
"""

import time
from collections import deque
from collections.abc import Callable
from typing import Any

from hardware.link.protocols import BoardProtocol
from hardware.link.reception import Reception, Scan
from hardware.link.serial_ports import Port, PortError, close, read_available, write

ASK_EVERY_S = 0.25
LISTEN_S = 0.5  #: before the first question: a boot loader may be at the other end, which is to hear nothing odd
RETRY_EVERY_S = 0.1


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
