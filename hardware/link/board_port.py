"""A board that is not there: a port in memory that sends frames when they are due and answers as a board does.

`BoardPort` stands in for pyserial's ``Serial``; where its frames come from is a `FrameSource`, such as a recording or
counts that are known. It follows docs/frames.md, as the firmware does.
"""

import time
from collections.abc import Callable
from typing import Literal, Protocol

Command = Literal["info", "errors"] | int  #: a question, or the rate that was asked for [Hz]; 65535 stands for more
_CAPACITY = 4096  # bytes that wait at most, as in a serial driver; the frames behind them wait, too, and are not lost
_TIMEOUT_S = 0.1  # longest wait of a read
_MAX_HZ = 65535  # that a command can name
_MAX_LINE = 1000  # characters of a command


class FrameSource(Protocol):
    """Frames with the times when they are due, and answers to commands; times [s] are since the first read."""

    @property
    def due_s(self) -> float | None:
        """When the next frame is due; None at the end."""

    def take(self, now_s: float) -> bytes:
        """The next frame on the wire, which is due."""

    def obey(self, command: Command) -> bytes:
        """The answer to a command."""


class BoardPort:
    """A port with a board on it that is not there, for one thread; its clock starts with the first read.

    Frames can be read once they are due, and stay until they are: a slow reader loses none.

    Parameters
    ----------
    source : FrameSource
    clock, sleep : callable
        As ``time.monotonic`` and ``time.sleep``; another clock plays in another time.
    """

    def __init__(
        self,
        source: FrameSource,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._source, self._clock, self._sleep = source, clock, sleep
        self._commands = Commands()
        self._buffer = bytearray()
        self._start_s: float | None = None

    @property
    def finished(self) -> bool:
        """The last byte was read: nothing will come any more unless something is asked."""
        return self._source.due_s is None and not self._buffer

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        self.wait_s()
        return len(self._buffer)

    def read(self, size: int = 1) -> bytes:
        """Up to `size` of the bytes that are there, or that come within 0.1 s."""
        wait_s = self.wait_s()
        if not self._buffer and wait_s is not None:
            self._sleep(min(wait_s, _TIMEOUT_S))
            self.wait_s()
        taken = bytes(self._buffer[:size])
        del self._buffer[:size]
        return taken

    def write(self, data: bytes) -> int:
        """Give the board commands; it answers between two frames, since whole ones wait to be read."""
        for command in self._commands.heard(data):
            self._buffer += self._source.obey(command)
        return len(data)

    def close(self) -> None:
        """Nothing is held that could be given back."""

    def wait_s(self) -> float | None:
        """Make the frames that are due ready to be read; seconds until the next one, None at the end."""
        if self._start_s is None:
            self._start_s = self._clock()
        while (due_s := self._source.due_s) is not None:
            now_s = self._clock() - self._start_s
            if due_s > now_s or len(self._buffer) >= _CAPACITY:
                return max(due_s - now_s, 0.0)
            self._buffer += self._source.take(now_s)
        return None


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
