"""Records, which a recording's file is made of: each checked by itself, so that damage costs what it touches.

A record is one letter, its content and a CRC-32 over both, made free of zero bytes by COBS, between two zero bytes: a
damaged one merges no two. A board's own frames, D, I and E with their CRC-16, are records, too (`docs/recordings.md`).
"""

import zlib
from collections.abc import Iterator
from typing import IO

from cobs import cobs

from hardware.link.frames import unpack

SESSION, FRAME, END = b"s", b"f", b"e"  #: JSON: what follows comes from; time of arrival and a frame; JSON: statistics
BOARD_FRAME, BOARD_INFO, BOARD_ERRORS = b"D", b"I", b"E"
CUT = b"..."  #: bytes at the end that no zero byte ends: a record that was begun
_OURS, _BOARDS = (SESSION, FRAME, END), (BOARD_FRAME, BOARD_INFO, BOARD_ERRORS)
_PIECE = 2**20  # bytes read at a time
_MOST = 2**26  # bytes of a record; longer ones are damaged


def record(kind: bytes, content: bytes) -> bytes:
    """The bytes of one record.

    >>> record(END, b"{}").hex(" ")
    '00 08 65 7b 7d 65 7d 22 53 00'
    """
    body = kind + content
    return b"\0" + cobs.encode(body + zlib.crc32(body).to_bytes(4, "little")) + b"\0"


def content_of(chunk: bytes) -> tuple[bytes, bytes]:
    """Kind and content of what stands between two zero bytes; of a damaged one no kind and what is wrong with it.

    The content of a board's frame is `hardware.link.frames.pack` of it.
    """
    try:
        body = cobs.decode(chunk)
    except cobs.DecodeError:
        return b"", b"bad_cobs"
    kind = body[:1]
    if kind in _OURS and zlib.crc32(body[:-4]).to_bytes(4, "little") == body[-4:]:
        return kind, body[1:-4]
    if kind in _BOARDS:
        frame = unpack(body)
        return (b"", frame.encode()) if isinstance(frame, str) else (kind, body)
    return b"", b"bad_crc"


def records_in(file: IO[bytes]) -> Iterator[tuple[int, bytes, bytes]]:
    """Place, kind and content of every record from here on; of a damaged one as `content_of` says.

    What comes before the first zero byte may be the tail of a board's frame: it is no damage. Behind the last zero
    byte comes, as the kind `CUT`, what was begun and not ended.
    """
    at, pending, is_first = 0, b"", True
    while piece := file.read(_PIECE):
        *chunks, rest = piece.split(b"\0")
        for chunk in chunks:
            whole = pending + chunk
            if whole:
                kind, content = content_of(whole) if len(whole) <= _MOST else (b"", b"bad_form")
                if kind or not is_first:
                    yield at, kind, content
            at += len(whole) + 1
            pending, is_first = b"", False
        pending += rest[: _MOST + 1]
    if pending:
        yield at, CUT, pending
