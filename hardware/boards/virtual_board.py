"""A board in Python: known counts as frames at their pace, behind a pseudo-terminal for other programs.

A host program is tried with it without hardware.
"""

import os
import select
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hardware.link.board_port import BoardPort, Command
from hardware.link.frames import MAX_OVERRUNS, Errors, Frame, FrameError, Info, encode
from hardware.link.serial_ports import PortError, link_to

Counts = Callable[[float], NDArray[Any]]
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


class CountedFrames:
    """Frames of known counts `info.rate_hz` times a second, a `FrameSource`; arguments as of `VirtualBoard`.

    A scan that is late by more than a period is skipped and counted in the frames' overruns.
    """

    def __init__(self, counts: Counts | ArrayLike, info: Info, step_s: float | None = None) -> None:
        self.info, self.due_s = info, 0.0
        self.sent: deque[tuple[int, float]] = deque(maxlen=10_000)  #: (sequence, time.perf_counter() when made)
        step_s = 1 / info.rate_hz if step_s is None else step_s
        self.counts = counts if callable(counts) else _looped(np.atleast_2d(counts), step_s)
        self._number = self._overruns = 0

    def take(self, now_s: float) -> bytes:
        """The frame that is due."""
        period_s = 1 / self.info.rate_hz
        n_skipped = int((now_s - self.due_s) / period_s)
        self._overruns += n_skipped
        self.due_s += (1 + n_skipped) * period_s  # never from now_s: the schedule does not drift
        wire = encode(a_frame(self.info, self.counts(now_s), self._number, round(now_s * 1e6), self._overruns))
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


class VirtualBoard:
    """Sends frames of known counts `info.rate_hz` times a second on a pseudo-terminal, until closed.

    Parameters
    ----------
    counts : callable or array
        Board's time since its start [s] -> counts, shape (info.n_crossings,); or an array of shape
        (n, info.n_crossings) or (info.n_crossings,), gone through over and over. The callable runs in the board's
        thread and must be quicker than a scan.
    info : Info
        What the board answers to ``?``; its rate is the one after each start.
    step_s : float, optional
        How long the board stays at each row of an array [s]; one period of `info.rate_hz` unless given. Counts
        belong to times, not to frames: neither another rate nor overruns change how fast they go by.
    link : path, optional
        A symbolic link to keep on the port, so that its name stays the same.

    Notes
    -----
    As from a UART, bytes that nobody reads are lost once the terminal's buffer is full. `dropped_bytes` counts
    them. What goes wrong in the board's thread is raised by `close`.

    Examples
    --------
    >>> with VirtualBoard(np.full(108, 512), Info(rate_hz=100)) as board:
    ...     with open(board.port, "rb", buffering=0) as port:
    ...         len(port.read(1))
    1
    """

    make_frames: Callable[..., Any] = CountedFrames  #: what the counts become, a `FrameSource`

    def __init__(
        self, counts: Counts | ArrayLike, info: Info, *, step_s: float | None = None, link: Path | str | None = None
    ) -> None:
        self.frames = self.make_frames(counts, info, step_s)
        self.dropped_bytes = 0  #: that nobody read in time
        self._board = BoardPort(self.frames)
        self._link = None if link is None else Path(link)
        self._fds: tuple[int, int] | None = None  # of the host's end, which only stays open, and of the board's
        self._error: BaseException | None = None
        self._closing = threading.Event()
        self._connect()
        self._thread = threading.Thread(target=self._run, name="virtual board", daemon=True)
        self._thread.start()

    @property
    def port(self) -> str:
        """The port for the host to open: the link, if there is one."""
        return str(self._link or self._port)

    @property
    def sent(self) -> deque[tuple[int, float]]:
        """Sequence numbers of the last frames, and time.perf_counter() when they were sent."""
        return self.frames.sent

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop sending and take the port away."""
        self._closing.set()
        self._thread.join()
        self._disconnect()
        if self._error:
            error, self._error = self._error, None
            raise error

    def _run(self) -> None:
        try:
            while not self._closing.is_set():
                self._turn()
        except BaseException as error:
            self._error = error

    def _turn(self) -> None:
        """Hear the host until a frame is due, and send what there is to be sent."""
        hears = [] if self._fds is None else [self._fds[1]]
        wait_s = self._board.wait_s()
        ready, _, _ = select.select(hears, [], [], _TURN_S if wait_s is None else min(wait_s, _TURN_S))
        if ready:
            self._board.write(os.read(ready[0], 4096))
        n_bytes = self._board.in_waiting
        if n_bytes:
            self._send(self._board.read(n_bytes))

    def _send(self, wire: bytes) -> None:
        if self._fds is None:
            return
        try:
            n_sent = os.write(self._fds[1], wire)
        except BlockingIOError:  # the buffer is full
            n_sent = 0
        self.dropped_bytes += len(wire) - n_sent

    def _connect(self) -> None:
        self._fds, self._port = _terminal()
        if self._link:
            link_to(self._link, self._port)

    def _disconnect(self) -> None:
        if self._fds is None:
            return
        if self._link and self._link.is_symlink() and os.readlink(self._link) == self._port:  # not another board's
            self._link.unlink()
        for fd in self._fds:
            os.close(fd)
        self._fds = None


def _terminal() -> tuple[tuple[int, int], str]:
    """Both ends of a new pseudo-terminal, the host's and the board's, and the name of the host's."""
    if sys.platform == "win32":
        raise PortError(NO_TERMINALS)
    import tty

    board_end, host_end = os.openpty()
    tty.setraw(host_end)
    os.set_blocking(board_end, False)
    return (host_end, board_end), os.ttyname(host_end)


def _looped(counts: NDArray[Any], step_s: float) -> Counts:
    if counts.ndim != 2 or not len(counts):
        raise FrameError(f"counts has shape {counts.shape}, expected (n, n_crossings): one row a step.")
    if not step_s > 0:
        raise FrameError(f"step_s={step_s:g} must be above 0: the seconds that the board stays at a row of counts.")
    return lambda time_s: counts[int(time_s / step_s) % len(counts)]
