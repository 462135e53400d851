"""A board in Python, on a pseudo-terminal: frames at their pace, answers, and every fault a real board shows.

A host program is tried with it without hardware. It follows docs/frames.md, as the firmware does.
"""

import contextlib
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
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geometry.layout import FloatArray
from hardware.link.frames import MAX_OVERRUNS, Errors, Frame, FrameError, Info, encode
from hardware.link.serial_ports import PortError
from hardware.readout.calibration import Electronics

Counts = Callable[[float], NDArray[Any]]
Command = Literal["info", "errors"] | int  #: a question, or the rate that was asked for [Hz]; 65535 stands for more
_RATES_HZ = range(1, 1001)  # that it can hold
_MAX_HZ = 65535  # that a command can name
_MAX_LINE = 1000  # characters of a command
NO_TERMINALS = "a simulated board needs a pseudo-terminal, which Windows has not: use Linux, macOS or WSL."


class VirtualBoard:
    """Sends frames of known counts `info.rate_hz` times a second until closed.

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
        A symbolic link to keep on the port, so that its name stays the same when it is plugged in again.

    Notes
    -----
    As from a UART, bytes that nobody reads are lost once the terminal's buffer is full. `dropped_bytes` counts
    them. A scan that is late by more than a period is skipped and counted in the frames' overruns.

    All of the board, its faults included, happens in one thread; the methods hand it work and wait until it is
    done. What goes wrong in that thread is raised by the next method called, `close` among them.

    Examples
    --------
    >>> with VirtualBoard(np.full(108, 512), Info(rate_hz=100)) as board:
    ...     with open(board.port, "rb", buffering=0) as port:
    ...         len(port.read(1))
    1
    """

    def __init__(
        self, counts: Counts | ArrayLike, info: Info, *, step_s: float | None = None, link: Path | str | None = None
    ) -> None:
        self.dropped_bytes = 0  #: that nobody read in time
        self.sent: deque[tuple[int, float]] = deque(maxlen=10_000)  #: (sequence, time.perf_counter() at its sending)
        step_s = 1 / info.rate_hz if step_s is None else step_s
        self._counts = counts if callable(counts) else _looped(np.atleast_2d(counts), step_s)
        self._own_info = self._start_info = self._info = info
        self._link = None if link is None else Path(link)
        self._port = ""
        self._fds: tuple[int, int] | None = None  # of the host's end, which only stays open, and of the board's
        self._garbage: deque[bytes] = deque()
        self._work: deque[tuple[Callable[[], None], threading.Event]] = deque()
        self._error: BaseException | None = None
        self._running = True
        self._closed = False
        self._connect()
        self._boot()
        self._wake_read, self._wake_write = os.pipe()
        self._thread = threading.Thread(target=self._run, name="virtual board", daemon=True)
        self._thread.start()

    @property
    def port(self) -> str:
        """The port for the host to open: the link, if there is one."""
        return str(self._link or self._port)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop sending and take the port away."""
        if self._closed:
            return
        self._closed = True
        with contextlib.suppress(RuntimeError):  # the thread has ended by itself; its error is raised below
            self._do(self._stop)
        self._thread.join()
        self._disconnect()
        os.close(self._wake_read)
        os.close(self._wake_write)
        if self._error:
            raise self._error

    def stall(self, seconds: float) -> None:
        """Hang for some time: nothing is sent, nothing is answered, scans are missed; the clock runs on."""
        self._do(lambda: self._hang(seconds))

    def unplug(self) -> None:
        """Take the port away. The board runs on, and its frames are lost."""
        self._do(self._disconnect)

    def replug(self) -> None:
        """Bring a port back after `unplug`: another one, to which the link points."""
        self._do(self._connect)

    def restart(self) -> None:
        """Begin again from sequence 0, time 0 and the board's own rate, as after a reset; that also ends a stall."""
        self._do(self._boot)

    def garble(self, garbage: bytes, n_frames: int = 1) -> None:
        """Send these bytes in the place of each of the next frames, and of answers meanwhile."""
        self._do(lambda: self._garbage.extend([garbage] * n_frames))

    def impostor(self, info: Info | None) -> None:
        """Be another device, which starts anew; None: be oneself again.

        If its array or its converter is another, all its counts are half scale.
        """
        self._do(lambda: self._become(info))

    # the methods below run in the board's thread

    def _run(self) -> None:
        try:
            while self._running:
                self._listen()
                now_s = time.perf_counter()
                if now_s >= max(self._due_s, self._stalled_until_s):
                    self._scan(now_s)
        except BaseException as error:
            self._error = error
        finally:
            self._running = False

    def _listen(self) -> None:
        """Wait for the host, for work, or for the next scan to be due."""
        now_s = time.perf_counter()
        hears = [] if self._fds is None or now_s < self._stalled_until_s else [self._fds[1]]
        wait_s = max(self._due_s, self._stalled_until_s) - now_s
        ready, _, _ = select.select([self._wake_read, *hears], [], [], max(wait_s, 0.0))
        if self._wake_read in ready:
            os.read(self._wake_read, 1)
            action, done = self._work.popleft()
            action()
            done.set()
        elif ready:
            self._obey(os.read(ready[0], 4096))

    def _obey(self, received: bytes) -> None:
        """Set the rate where one is asked for that can be held; answer each command."""
        for command in self._commands.heard(received):
            if command == "errors":
                self._answer(Errors())
                continue
            if command != "info" and command in _RATES_HZ:
                self._info = replace(self._info, rate_hz=command)  # holds from the scan after the one already due
            self._answer(self._info)

    def _answer(self, frame: Info | Errors) -> None:
        self._send(self._garbage[0] if self._garbage else encode(frame))

    def _scan(self, now_s: float) -> None:
        period_s = 1 / self._info.rate_hz
        n_skipped = int((now_s - self._due_s) / period_s)
        self._overruns += n_skipped
        self._due_s += (1 + n_skipped) * period_s  # never from now_s: the schedule does not drift
        if self._garbage:
            wire = self._garbage.popleft()
        else:
            wire = encode(self._frame(now_s))
            self.sent.append((self._number % 2**16, time.perf_counter()))
        self._number += 1
        self._send(wire)

    def _frame(self, now_s: float) -> Frame:
        info = self._info
        if info.n_crossings != self._own_info.n_crossings or info.bits != self._own_info.bits:
            counts: NDArray[Any] = np.full(info.n_crossings, 2 ** (info.bits - 1))
        else:
            counts = self._counts(now_s - self._started_s)
        return Frame(
            sequence=self._number % 2**16,
            device_us=round((now_s - self._started_s) * 1e6) % 2**32,
            bits=info.bits,
            counts=counts,
            saturated=bool((counts % (2**info.bits - 1) == 0).any()),  # 0 or full scale
            scan_mode=info.scan_mode,
            overruns=min(self._overruns, MAX_OVERRUNS),
        )

    def _send(self, wire: bytes) -> None:
        if self._fds is None:
            return
        try:
            n_sent = os.write(self._fds[1], wire)
        except BlockingIOError:  # the buffer is full
            n_sent = 0
        self.dropped_bytes += len(wire) - n_sent

    def _hang(self, seconds: float) -> None:
        self._stalled_until_s = time.perf_counter() + seconds

    def _boot(self) -> None:
        self._info = self._start_info
        self._commands = Commands()
        self._number = self._overruns = 0
        self._stalled_until_s = 0.0
        self._started_s = self._due_s = time.perf_counter()
        self._send(b"\0")  # a delimiter: ends what the reset cut off

    def _become(self, info: Info | None) -> None:
        self._start_info = info or self._own_info
        self._boot()

    def _connect(self) -> None:
        if self._fds is not None:
            return
        self._fds, self._port = _terminal()
        if self._link:
            if self._link.exists() and not self._link.is_symlink():
                raise PortError(f"{self._link} exists and is no link: give another name for the link to the port.")
            beside = self._link.with_name(self._link.name + ".new")
            beside.unlink(missing_ok=True)
            beside.symlink_to(self._port)
            beside.replace(self._link)

    def _disconnect(self) -> None:
        if self._fds is None:
            return
        if self._link and self._link.is_symlink() and os.readlink(self._link) == self._port:  # not another board's
            self._link.unlink()
        for fd in self._fds:
            os.close(fd)
        self._fds = None

    def _stop(self) -> None:
        self._running = False

    # this one runs in the thread that calls

    def _do(self, action: Callable[[], None]) -> None:
        """Have the board's thread do something, and wait until it has."""
        if not self._running:
            raise RuntimeError("the board is closed: make another.") from self._error
        done = threading.Event()
        self._work.append((action, done))
        os.write(self._wake_write, b"!")
        while not done.wait(0.1):
            if not self._running:  # it ended before it saw the work
                raise RuntimeError("the board is closed: make another.") from self._error


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


class Commands:
    """Finds the host's commands in a stream of bytes that comes in pieces of any size.

    It hears what firmware/commands.c hears; the tests run one table of cases through both.

    >>> commands = Commands()
    >>> commands.heard(b"R007"), commands.heard(bytes([10]) + b"?")
    ([], [7, 'info'])
    """

    def __init__(self) -> None:
        self._line = b""  # an R command that has begun

    def heard(self, received: bytes) -> list[Command]:
        """The commands that these bytes complete."""
        commands: list[Command] = []
        for k in range(len(received)):
            byte = received[k : k + 1]
            if byte in b"?!":  # always heard, even where a host went away in the middle of a command
                self._line = b""
                commands.append("info" if byte == b"?" else "errors")
            elif byte == b"\n":
                if self._line[1:].isdigit():
                    commands.append(min(int(self._line[1:]), _MAX_HZ))
                self._line = b""
            elif self._line or byte == b"R":
                self._line = self._line + byte if len(self._line) < _MAX_LINE else b"R?"  # is no number any more
        return commands


def recording_from_resistances(
    resistance_ohm: FloatArray,
    info: Info,
    first_sequence: int = 0,
    first_us: int = 0,
    electronics: Electronics | None = None,
) -> bytes:
    """The bytes that a board without noise would send of known resistances, crosstalk included.

    Parameters
    ----------
    resistance_ohm : array, shape (n, rows, cols, 3)
        Pillars z, x, y [Ω] of n scans, `info.rate_hz` a second.
    info : Info
        The board: its converter's bits and sense resistor set the counts.
    first_sequence, first_us : int
        Sequence number and device time [µs] of the first frame.
    electronics : Electronics, optional
        Switches, wires and amplifiers; default: the usual ones.

    Returns
    -------
    bytes
        An INFO frame and n data frames.

    Examples
    --------
    >>> from hardware.recording import parse_recording
    >>> info = Info(rows=1, cols=2, bits=12)
    >>> parse_recording(recording_from_resistances(np.full((5, 1, 2, 3), 10e3), info)).counts.shape
    (5, 6)
    """
    counts = (electronics or Electronics()).crossbar(info).counts(resistance_ohm)
    saturated = (counts % (2**info.bits - 1) == 0).any(axis=1)  # 0 or full scale
    frames = [
        Frame(
            sequence=(first_sequence + k) % 2**16,
            device_us=(first_us + round(k * 1e6 / info.rate_hz)) % 2**32,
            bits=info.bits,
            counts=counts[k],
            saturated=bool(saturated[k]),
            scan_mode=info.scan_mode,
        )
        for k in range(len(counts))
    ]
    return encode(info) + b"".join(encode(frame) for frame in frames)
