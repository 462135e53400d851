"""What the host says to a board, byte by byte: docs/frames.md, section "Commands".

The same three states as in firmware/commands.c; the tests run one table of cases through both.
"""

from enum import Enum, auto
from typing import Literal

Command = Literal["info", "errors"] | int  #: a question, or the rate that was asked for [Hz]; 65535 stands for more
_MOST_HZ = 65535


class _State(Enum):
    BETWEEN = auto()
    NUMBER = auto()
    MALFORMED = auto()


class Commands:
    """Commands out of a stream of bytes that comes in pieces of any size.

    >>> commands = Commands()
    >>> commands.heard(b"R007"), commands.heard(bytes([10]) + b"?")
    ([], [7, 'info'])
    """

    def __init__(self) -> None:
        self._state = _State.BETWEEN
        self._number: int | None = None  # None: no digit yet

    def heard(self, received: bytes) -> list[Command]:
        """The commands that these bytes complete."""
        taken = map(self._take, received)
        return [command for command in taken if command is not None]

    def _take(self, byte: int) -> Command | None:
        if byte in b"?!":  # always heard, even where a host went away in the middle of a command
            self._state = _State.BETWEEN
            return "info" if byte == ord("?") else "errors"
        if byte == ord("\n"):
            is_number = self._state is _State.NUMBER
            self._state = _State.BETWEEN
            return self._number if is_number else None
        if self._state is _State.BETWEEN and byte == ord("R"):
            self._state, self._number = _State.NUMBER, None
        elif self._state is _State.NUMBER:
            if ord("0") <= byte <= ord("9"):
                self._number = min(10 * (self._number or 0) + byte - ord("0"), _MOST_HZ)
            else:
                self._state = _State.MALFORMED
        return None
