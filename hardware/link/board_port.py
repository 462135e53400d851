"""A board that is not there: a port in memory that sends frames when they are due and answers as a board does.

`BoardPort` stands in for pyserial's ``Serial`` and follows docs/frames.md, as the firmware does. Its kinds are a
recording that is played (`recording.PlaybackPort`) and a board of known counts (`boards.python_board.CountedPort`).
"""

import re
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Literal

Command = Literal["info", "errors"] | int  #: a question, or the rate that was asked for [Hz]; 65535 stands for more
_CAPACITY = 4096  # bytes that wait at most, as in a serial driver; the frames behind them wait, too, and are not lost
_TIMEOUT_S = 0.1  # longest wait of a read
_MAX_HZ = 65535  # that a command can name
_MAX_DIGITS = 1000  # of a command


class BoardPort(ABC):
    """A port with a board on it that is not there, for one thread; its clock starts with the first read.

    Frames can be read once they are due, and stay until they are: a slow reader loses none.

    Parameters
    ----------
    clock, sleep : callable
        As ``time.monotonic`` and ``time.sleep``; another clock plays in another time.
    """

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self.due_s: float | None = 0.0  #: when the next frame is due, since the first read [s]; None at the end
        self._clock, self._sleep = clock, sleep
        self._commands = Commands()
        self._buffer = bytearray()
        self._start_s: float | None = None

    @abstractmethod
    def take(self, now_s: float) -> bytes:
        """The next frame on the wire, which is due; renews `due_s`."""

    @abstractmethod
    def obey(self, command: Command) -> bytes:
        """The answer to a command."""

    @property
    def finished(self) -> bool:
        """The last byte was read: nothing will come any more unless something is asked."""
        return self.due_s is None and not self._buffer

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
            self._buffer += self.obey(command)
        return len(data)

    def close(self) -> None:  # noqa: B027
        """Nothing is held that could be given back."""

    def wait_s(self) -> float | None:
        """Make the frames that are due ready to be read; seconds until the next one, None at the end."""
        if self._start_s is None:
            self._start_s = self._clock()
        while (due_s := self.due_s) is not None:
            now_s = self._clock() - self._start_s
            if due_s > now_s or len(self._buffer) >= _CAPACITY:
                return max(due_s - now_s, 0.0)
            self._buffer += self.take(now_s)
        return None


class Commands:
    """Finds the host's commands in a stream of bytes that comes in pieces of any size.

    It hears what firmware/commands.c hears; the tests run one table of cases through both.

    >>> commands = Commands()
    >>> commands.heard(b"R007"), commands.heard(bytes([10]) + b"?")
    ([], [7, 'info'])
    """

    def __init__(self) -> None:
        self._begun = b""  # an R command

    def heard(self, received: bytes) -> list[Command]:
        """The commands that these bytes complete; a question is heard even within another command."""
        *said, rest = re.split(rb"(?<=[?!\n])", self._begun + received)
        commands: list[Command] = []
        for piece in said:
            digits = piece[:-1].partition(b"R")[2]
            if piece.endswith((b"?", b"!")):
                commands.append("info" if piece.endswith(b"?") else "errors")
            elif digits.isdigit() and len(digits) <= _MAX_DIGITS:
                commands.append(min(int(digits), _MAX_HZ))
        _, letter, begun = rest.partition(b"R")
        self._begun = letter + begun[: _MAX_DIGITS + 1]
        return commands
