"""The native format, `.frames`: a recorder appends records, a reader takes those that are whole.

A record is one letter, its content and a CRC-32 over both, made free of zero bytes by COBS, between two zero bytes:
damage costs only the records that it touches. A board's own frames, D, I and E with their CRC-16, are records, too
(`docs/frames.md`). Each record is handed to the operating system at once, whole or not at all.
"""

import json
import os
import struct
import time
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import numpy as np
from cobs import cobs

from geometry.errors import FileFormatError, TriPillarError
from geometry.storage.files import FULL, require_file, uninterrupted
from hardware.link.frames import (
    PROTOCOL,
    Frame,
    Info,
    Statistics,
    missing_between,
    pack,
    packed_dtype,
    unpack,
)
from hardware.recording.recorded import Header, Recording, assemble, read_header, require_same_board

_SESSION, _FRAME, _END = b"s", b"f", b"e"  # JSON: a run's header; time of arrival and a frame; JSON: statistics
_BOARD_FRAME, _BOARD_INFO, _BOARD_ERRORS = b"D", b"I", b"E"
_CUT = b"..."  # bytes at the end that no zero byte ends: a record that was begun
_PIECE_BYTES = 2**20  # read at a time
_MAX_RECORD_BYTES = 2**26  # longer ones are damaged
_MAX_UNIX_S = 1e10  # beyond, nanoseconds do not fit the 64 bits that MCAP has for them
_TIME = struct.Struct("<d")
_NO_TIME = _TIME.pack(np.nan)
_FROM_THE_RECEIVER = ("bad_cobs", "bad_crc", "bad_form", "repeated", "foreign")


class RecordingError(TriPillarError, OSError):
    """A disk is full, gone or cannot be written; what was recorded before stays readable."""


class Recorder:
    """Appends frames to a file of one board, one thread at a time.

    Parameters
    ----------
    path : Path
        File to make; missing folders are made.
    info : Info
        Of the board. Frames of another are refused.
    calibration : str
        JSON text, kept as it is.
    made_from : mapping
        ``model_recipe`` and ``design_hash``, either or both.
    append : bool
        Continue `path` if it exists. It must have the same info, calibration and made_from.

    Raises
    ------
    FileFormatError
        If the file exists (without `append`), or is another board's or no recording (with it).
    RecordingError
        If the file cannot be made or written; then it is not there, or as it was.

    Notes
    -----
    A process that is killed loses the frame that it was writing. A computer that loses its power may lose what the
    system had not yet written to the disk, 30 s on a usual Linux. On any failure the file ends with its last whole
    frame.

    >>> import tempfile
    >>> import numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "press.frames"
    ...     with Recorder(path, Info(rows=1, cols=1), made_from={"design_hash": "a1b2"}) as recorder:
    ...         recorder.append(Frame(sequence=7, device_us=0, bits=10, counts=np.array([1, 2, 3])), 1.8e9)
    ...     recording = parse_recording(path.read_bytes())
    >>> recording.counts.tolist(), recording.received_s.tolist(), recording.made_from
    ([[1, 2, 3]], [1800000000.0], {'design_hash': 'a1b2'})
    """

    def __init__(
        self,
        path: Path,
        info: Info,
        calibration: str = "",
        made_from: Mapping[str, str] | None = None,
        append: bool = False,
    ) -> None:
        self.path = Path(path)
        require_file(self.path)
        self.header = Header(info=info, calibration=calibration, made_from=made_from or {})
        self.frames = 0  #: recorded so far
        self.lost = 0  #: frames missing between them
        self.restarts = 0  #: of the board, between them
        self._previous: Frame | None = None
        self._runs = 0
        self._file = -1
        is_there = self.path.exists()
        if is_there and not append:
            raise FileFormatError(f"{path}: the file exists: give another name, or continue it by --append.")
        if is_there:
            self._require_same_header()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            flags = os.O_WRONLY | os.O_APPEND | (0 if is_there else os.O_CREAT | os.O_EXCL)
            self._file = os.open(self.path, flags | getattr(os, "O_BINARY", 0), 0o666)
            self._write(2 * self._session("append" if is_there else "start"))  # twice: one damaged header costs nothing
        except OSError as error:
            is_made = self._file >= 0 and not is_there
            self._close()
            if is_made:
                with suppress(OSError):
                    self.path.unlink()
            kept = "; the recording is as it was" if is_there else ""
            raise RecordingError(
                f"{path}: {_reason(error)}{kept}: give a file on a disk that has room and can be written."
            ) from None

    def append(self, frames: Frame | Iterable[Frame], received_s: float | Sequence[float]) -> None:
        """Add frames, one, several or none.

        Parameters
        ----------
        frames : Frame or several
            As decoded.
        received_s : float, or one a frame
            Host's Unix time of arrival [s].
        """
        batch = [frames] if isinstance(frames, Frame) else list(frames)
        arrivals = [received_s] * len(batch) if isinstance(received_s, int | float) else list(received_s)
        if self._file < 0:
            raise RecordingError(f"{self.path}: the recorder is closed: make a new one, with append to continue.")
        for frame, arrival in zip(batch, arrivals, strict=True):
            require_same_board(frame, self.header.info, str(self.path))
            if not 0 <= arrival < _MAX_UNIX_S:
                raise ValueError(
                    f"received_s={arrival!r} must be a Unix time [s], 0 to {_MAX_UNIX_S:g}: give time.time()."
                )
        for frame, arrival in zip(batch, arrivals, strict=True):
            self._write_or_end(_record(_FRAME, _TIME.pack(arrival) + pack(frame)))
            self._count(frame)

    def begin_run(self, because: str) -> None:
        """Say that nothing is lost between the last frame and the next one, and why: "restart" or "reconnect"."""
        self._write_or_end(self._session(because))
        self._previous = None
        self.restarts += because == "restart"

    def close(self, statistics: Statistics | None = None) -> None:
        """Write the statistics of who received the frames, if they are given, and close; again, it does nothing."""
        if self._file >= 0:
            if statistics is not None:
                self._write_or_end(_record(_END, json.dumps(asdict(statistics)).encode()))
            self._close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _count(self, frame: Frame) -> None:
        self.frames += 1
        missing = missing_between(self._previous, frame) if self._previous else 0
        self.restarts += missing is None
        self.lost += missing or 0
        self._previous = frame

    def _session(self, because: str) -> bytes:
        self._runs += 1
        run = {"because": because, "began_s": time.time(), "run": self._runs}
        return _record(_SESSION, json.dumps(self.header.plain() | run).encode())

    def _write_or_end(self, data: bytes) -> None:
        try:
            self._write(data)
        except OSError as error:
            self._close()
            raise RecordingError(
                f"{self.path}: {_reason(error)}: recording ended, all {self.frames} frames up to here are kept: "
                "make room or take another disk."
            ) from None

    def _write(self, data: bytes) -> None:
        """Append some bytes; on failure none of them is left."""
        with uninterrupted():
            start = os.fstat(self._file).st_size
            try:
                while data:
                    data = data[os.write(self._file, data) :]  # a disk that gets full takes a part of them first
            except OSError:
                with suppress(OSError):
                    os.ftruncate(self._file, start)
                raise

    def _close(self) -> None:
        if self._file >= 0:
            with suppress(OSError):
                os.close(self._file)
            self._file = -1

    def _require_same_header(self) -> None:
        there = _header_of(self.path)
        for name, new in vars(self.header).items():
            if (old := getattr(there, name)) != new:
                raise FileFormatError(
                    f"{self.path}: recorded with {name} {old!r}, not {new!r}: give another file, "
                    "a recording has one board, one calibration and one model."
                )


def _reason(error: OSError) -> str:
    return f"the disk is full ({error.strerror})" if error.errno in FULL else str(error.strerror)


def parse_recording(stream: bytes, source: str = "recording") -> Recording:
    """Read a recording from bytes: a recorder's file, or what a board sent; `source` names them in messages.

    Time is unwrapped under the assumption that no pause between two frames reaches 2³² µs (71.6 min), and goes on by
    the host's clock where a run ends.
    """
    return read_frames(BytesIO(stream), source)


def _header_of(path: Path) -> Header:
    """The first header in a recorder's file; anything else is a FileFormatError."""
    with path.open("rb") as file:
        for _, kind, content in _records_in(file):
            if kind == _SESSION:
                return read_header(_json(content), str(path))
    raise FileFormatError(f"{path}: not made by a recorder: record to a new file.")


def _json(content: bytes) -> dict[str, Any]:
    try:
        plain = json.loads(content)
    except ValueError:
        plain = None
    return plain if isinstance(plain, dict) else {}


def read_frames(file: IO[bytes], source: str) -> Recording:
    """Read a recording from an open file, as `parse_recording` does."""
    stated: list[Header] = []
    session = frame = b""  # the last ones: a session stands twice, a frame should not
    rows, runs, run = bytearray(), bytearray(), 0
    sizes: dict[int, int] = {}  # bytes of a frame: the first one that has them
    counted: Counter[str] = Counter()
    damaged_at: list[int] = []
    n = truncated_bytes = 0
    for at, kind, content in _records_in(file):
        if kind in (_FRAME, _BOARD_FRAME):
            row = content if kind == _FRAME else _NO_TIME + content
            if row[8:] == frame:
                counted["repeated"] += 1
                continue
            frame = row[8:]
            sizes.setdefault(len(row), n)
            rows += row
            runs += run.to_bytes(4, "little")
            n += 1
        elif kind == _SESSION and content != session:
            session, plain = content, _json(content)
            stated.append(read_header(plain, source))
            counted["restarts"] += plain.get("because") == "restart"
            run += 1
        elif kind == _BOARD_INFO and isinstance(info := unpack(content), Info):
            stated.append(Header(info=info))
            counted["info"] += 1
        elif kind == _END:
            counted.update({name: int(_json(content).get(name, 0)) for name in _FROM_THE_RECEIVER})
        elif kind == _CUT:
            truncated_bytes = len(content)
        elif not kind:
            counted[content.decode()] += 1
            damaged_at.append(at)
    header = _common_header(stated, n, file.tell(), source)
    dtype = np.dtype([("received_s", "<f8"), *packed_dtype(header.info.n_crossings).descr])
    for row_bytes, k in sizes.items():
        if row_bytes != dtype.itemsize:
            n_counts = (row_bytes - dtype.itemsize) // 2 + header.info.n_crossings
            raise FileFormatError(
                f"{source}: data frame {k} has {n_counts} counts, but the INFO frame's {header.info.rows} × "
                f"{header.info.cols} units make {header.info.n_crossings}: keep one board to a recording."
            )
    columns = np.frombuffer(rows, dtype)
    return assemble(
        header,
        {name: columns[name] for name in dtype.names or ()} | {"run": np.frombuffer(runs, "<u4")},
        source,
        counted,
        damaged_at=tuple(damaged_at),
        truncated_bytes=truncated_bytes,
    )


def _common_header(stated: list[Header], n: int, size: int, source: str) -> Header:
    """The header that all sessions and INFO frames agree on."""
    if not size:
        raise FileFormatError(f"{source}: the file is empty: record again.")
    if not n and not stated:
        raise FileFormatError(
            f"{source}: no valid frame in {size} bytes: give a recording, made at the right baud rate."
        )
    if not stated:
        raise FileFormatError(
            f"{source}: {n} data frames but no INFO frame of protocol {PROTOCOL}, which says what the counts mean: "
            "record again, with the answer to '?' first."
        )
    if not n:
        raise FileFormatError(f"{source}: an INFO frame but no data frame: record for longer.")
    for other in stated:
        if other != stated[0]:
            raise FileFormatError(
                f"{source}: two INFO frames that differ, {stated[0].info} and {other.info}: "
                "keep one board with one setting to a recording."
            )
    return stated[0]


def _record(kind: bytes, content: bytes) -> bytes:
    """The bytes of one record.

    >>> _record(_END, b"{}").hex(" ")
    '00 08 65 7b 7d 65 7d 22 53 00'
    """
    body = kind + content
    return b"\0" + cobs.encode(body + zlib.crc32(body).to_bytes(4, "little")) + b"\0"


def _content_of(chunk: bytes) -> tuple[bytes, bytes]:
    """Kind and content of what stands between two zero bytes; of a damaged one no kind and what is wrong with it."""
    try:
        body = cobs.decode(chunk)
    except cobs.DecodeError:
        return b"", b"bad_cobs"
    kind = body[:1]
    if kind in (_SESSION, _FRAME, _END) and zlib.crc32(body[:-4]).to_bytes(4, "little") == body[-4:]:
        return kind, body[1:-4]
    if kind in (_BOARD_FRAME, _BOARD_INFO, _BOARD_ERRORS):
        frame = unpack(body)
        return (b"", frame.encode()) if isinstance(frame, str) else (kind, body)
    return b"", b"bad_crc"


def _records_in(file: IO[bytes]) -> Iterator[tuple[int, bytes, bytes]]:
    """Place, kind and content of every record from here on; of a damaged one as `_content_of` says.

    What comes before the first zero byte may be the tail of a board's frame: it is no damage. Behind the last zero
    byte comes, as the kind `_CUT`, what was begun and not ended.
    """
    at, pending, is_first = 0, b"", True
    while piece := file.read(_PIECE_BYTES):
        *chunks, rest = piece.split(b"\0")
        for chunk in chunks:
            whole = pending + chunk
            if whole:
                kind, content = _content_of(whole) if len(whole) <= _MAX_RECORD_BYTES else (b"", b"bad_form")
                if kind or not is_first:
                    yield at, kind, content
            at += len(whole) + 1
            pending, is_first = b"", False
        pending += rest[: _MAX_RECORD_BYTES + 1]
    if pending:
        yield at, _CUT, pending
