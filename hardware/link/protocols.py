"""Board protocols: which bytes a kind of board sends, and which it hears.

A port is named with its protocol, as ``NAME+/dev/ttyUSB0``; without one it is that of docs/frames.md. Another kind of
board is one file with a `Decoder`, and one line in `PROTOCOLS`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

from common.errors import DesignError
from hardware.link.frames import Errors, Frame, FrameDecoder, Info, Statistics
from hardware.link.lines import SIZELESS, LineDecoder


class Decoder(Protocol):
    """Finds frames in a stream of bytes that comes in pieces of any size, and never raises."""

    @property
    def statistics(self) -> Statistics:
        """Counts of all that came; `ok`, `repeated` and the damaged ones are looked at."""

    def feed(self, data: bytes) -> Sequence[Frame | Info | Errors]:
        """The frames that `data` completes, in the order of their arrival."""


@dataclass(frozen=True, kw_only=True)
class BoardProtocol:
    """The bytes that a kind of board sends and hears."""

    decoder: Callable[..., Decoder] = FrameDecoder  #: makes a new one for each connection
    question: bytes = b"?"  #: that is answered by INFO
    errors: bytes = b"!"  #: that is answered by ERRORS
    rate: Callable[[int], bytes] = b"R%d\n".__mod__  #: asks for so many scans a second; answered by INFO


PROTOCOLS = {"tripillar": BoardProtocol()} | {
    "lines": BoardProtocol(decoder=LineDecoder, question=b"", errors=b"", rate=lambda _: b""),
}  #: by the name in front of a port


def spoken_on(port: str, stated: Info | None = None) -> tuple[BoardProtocol, str]:
    """The protocol on a port, and the port's own name; of a board that is `stated`, as it cannot say so itself, lines.

    >>> spoken_on("tripillar+/dev/ttyUSB0")[1], spoken_on("socket://host:1")[1]
    ('/dev/ttyUSB0', 'socket://host:1')
    """
    name, plus, url = port.partition("+")
    usual = "tripillar" if stated is None else "lines"
    name, url = (name, url) if plus and name in PROTOCOLS else (usual, port)
    if name != "lines":
        return PROTOCOLS[name], url
    if stated is None:
        raise DesignError(SIZELESS)
    return replace(PROTOCOLS[name], decoder=partial(LineDecoder, [stated])), url
