"""A board in Python: known counts as frames at their pace, behind a pseudo-terminal for other programs.

A host program is tried with it without hardware.
"""

import os
import select
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hardware.link.board_port import BoardPort, Command
from hardware.link.frames import MAX_OVERRUNS, Errors, Frame, FrameError, Info, encode
from hardware.link.serial_ports import PortError

_RATES_HZ = range(1, 1001)  # that it can hold
_TURN_S = 0.05  # longest wait for the host
NO_TERMINALS = "a simulated board needs a pseudo-terminal, which Windows has not: use Linux, macOS or WSL."


def a_frame(info: Info, counts: NDArray[Any], number: int, time_us: int, overruns: int = 0) -> Frame:
    """Frame `number` of a board, scanned at a time of its clock [µs]."""
    return Frame(
        sequence=number % 2**16,
        device_us=time_us % 2**32,
        bits=info.bits,
        counts=counts,
        saturated=bool((counts % (2**info.bits - 1) == 0).any()),  # 0 or full scale
        scan_mode=info.scan_mode,
        overruns=min(overruns, MAX_OVERRUNS),
    )


class CountedPort(BoardPort):
    """A board in memory of known counts, `info.rate_hz` times a second; parameters as of `PythonBoard`, `BoardPort`.

    A scan that is late by more than a period is skipped and counted in the frames' overruns.
    """

    def __init__(self, counts: ArrayLike, info: Info, step_s: float | None = None, **clock: Any) -> None:
        super().__init__(**clock)
        self.info, self.counts = info, np.atleast_2d(counts)
        self.step_s = 1 / info.rate_hz if step_s is None else step_s
        if self.counts.ndim != 2 or not len(self.counts):
            raise FrameError(f"counts has shape {self.counts.shape}, expected (n, n_crossings): one row a step.")
        if not self.step_s > 0:
            raise FrameError(f"step_s={step_s:g} must be above 0: the seconds that the board stays at a row of counts.")
        for extreme in (self.counts.min(axis=0), self.counts.max(axis=0)):
            a_frame(info, extreme, 0, 0)  # refuses what no frame holds
        self.sent: deque[tuple[int, float]] = deque(maxlen=10_000)  #: (sequence, time.perf_counter() when made)
        self._number = self._overruns = 0

    def take(self, now_s: float) -> bytes:
        """The frame that is due."""
        assert self.due_s is not None, "a board has no end"
        period_s = 1 / self.info.rate_hz
        n_skipped = int((now_s - self.due_s) / period_s)
        self._overruns += n_skipped
        self.due_s += (1 + n_skipped) * period_s  # never from now_s: the schedule does not drift
        counts = self.counts[int(now_s / self.step_s) % len(self.counts)]
        wire = encode(a_frame(self.info, counts, self._number, round(now_s * 1e6), self._overruns))
        self.sent.append((self._number % 2**16, time.perf_counter()))
        self._number += 1
        return wire if self._number > 1 else b"\0" + wire  # a delimiter: ends what came before the start

    def obey(self, command: Command) -> bytes:
        """Set the rate where one is asked for that can be held; answer."""
        if command == "errors":
            return encode(Errors())
        if command != "info" and command in _RATES_HZ:
            self.info = replace(self.info, rate_hz=command)  # holds from the scan after the one already due
        return encode(self.info)


class PythonBoard:
    """Sends frames of known counts `info.rate_hz` times a second on a pseudo-terminal, until closed.

    Parameters
    ----------
    counts : array, shape (n, info.n_crossings) or (info.n_crossings,)
        Gone through over and over.
    info : Info
        What the board answers to ``?``; its rate is the one after each start.
    step_s : float, optional
        How long the board stays at each row of counts [s]; one period of `info.rate_hz` unless given. Counts
        belong to times, not to frames: neither another rate nor overruns change how fast they go by.

    Notes
    -----
    As from a UART, bytes that nobody reads are lost once the terminal's buffer is full.

    Examples
    --------
    >>> with PythonBoard(np.full(108, 512), Info(rate_hz=100)) as board:
    ...     with open(board.port, "rb", buffering=0) as port:
    ...         len(port.read(1))
    1
    """

    def __init__(self, counts: ArrayLike, info: Info, *, step_s: float | None = None) -> None:
        if sys.platform == "win32":
            raise PortError(NO_TERMINALS)
        import tty

        self._board = CountedPort(counts, info, step_s)
        self.sent = self._board.sent  #: sequence numbers of the last frames, time.perf_counter() when they were sent
        self._end, self._host_end = os.openpty()  # the board's; the host's, which only stays open
        self.port = os.ttyname(self._host_end)  #: for the host to open
        tty.setraw(self._host_end)
        os.set_blocking(self._end, False)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="virtual board", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop sending and take the port away; again, it does nothing."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._thread.join()
        for end in (self._end, self._host_end):
            os.close(end)

    def _run(self) -> None:
        """Hear the host until a frame is due, send what there is to be sent, and so on."""
        while not self._closing.is_set():
            wait_s = self._board.wait_s()
            ready, _, _ = select.select([self._end], [], [], _TURN_S if wait_s is None else min(wait_s, _TURN_S))
            if ready:
                self._board.write(os.read(self._end, 4096))
            wire = self._board.read(self._board.in_waiting) if self._board.in_waiting else b""
            with suppress(BlockingIOError):  # the buffer is full
                os.write(self._end, wire)
