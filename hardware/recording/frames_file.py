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
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
from cobs import cobs
from numpy.typing import NDArray

from common.bounded import require_memory, require_regular
from common.errors import FileFormatError, TriPillarError
from common.storage.files import FULL, require_file, uninterrupted
from common.storage.text_file import why_unreadable
from geometry.layout import FloatArray
from hardware.link.frames import PROTOCOL, Frame, Info, ScanMode, Statistics, pack, packed_dtype, unpack
from hardware.link.lines import RANGES, LineDecoder, counted, ranged
from hardware.recording.recorded import MADE_FROM, Header, Recording, is_restart, read_header, unwrapped_s

_SESSION, _FRAME, _END = b"s", b"f", b"e"  # JSON: a run's header; time of arrival and a frame; JSON: statistics
_BOARD_FRAME, _BOARD_INFO, _BOARD_ERRORS = b"D", b"I", b"E"
_CUT = b"..."  # bytes at the end that no zero byte ends: a record that was begun
_EXPORTS = (b"CDF", b"\x89HDF\r\n\x1a\n", b"\x89MCAP0\r\n")  # files that an export made begin with these
_PIECE_BYTES = 2**20  # read at a time
_MAX_RECORD_BYTES = 2**26  # longer ones are damaged
_MAX_UNIX_S = 1e10  # beyond, nanoseconds do not fit the 64 bits that MCAP has for them
_TIME = struct.Struct("<d")
_NO_TIME = _TIME.pack(np.nan)
_AROUND = packed_dtype(0).itemsize  # bytes of a packed frame beside its counts
OF_FRAMES = ("counts", "sequence", "device_us", "flags", "overruns")  #: what a recording keeps of each
_FROM_THE_RECEIVER = ("bad_cobs", "bad_crc", "bad_form", "repeated", "foreign")


class RecordingError(TriPillarError, OSError):
    """A disk is full, gone or cannot be written; what was recorded before stays readable."""


class Recorder:
    """Appends frames to a file of one board, one thread at a time; missing folders are made.

    With `append` it continues the file if there is one, of the same info, calibration and made_from.

    `FileFormatError` if the file exists (without `append`), or is another board's or no recording (with it);
    `RecordingError` if it cannot be made or written: then it is not there, or as it was.

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
        self._runs = 0
        is_there = self.path.exists()
        if is_there and not append:
            raise FileFormatError(f"{path}: the file exists: give another name, or continue it by --append.")
        if is_there:
            self._require_same_header()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("ab" if is_there else "xb", buffering=0)
            self._write(2 * self._session("append" if is_there else "start"))  # twice: one damaged header costs nothing
        except OSError as error:
            if "_file" in vars(self):
                self.close()
                if not is_there:
                    self.path.unlink()
            unchanged = "; the recording is as it was" if is_there else ""
            raise RecordingError(
                f"{path}: {_reason(error)}{unchanged}: give a file on a disk that has room and can be written."
            ) from None

    def append(self, frame: Frame, received_s: float) -> None:
        """Add a frame, with the host's Unix time of its arrival [s]."""
        if self._file.closed:
            raise RecordingError(f"{self.path}: the recorder is closed: make a new one, with append to continue.")
        if not 0 <= received_s < _MAX_UNIX_S:
            raise ValueError(
                f"received_s={received_s!r} must be a Unix time [s], 0 to {_MAX_UNIX_S:g}: give time.time()."
            )
        _require_same_board(self.header.info, frame.counts.size, frame.bits, frame.flags, str(self.path))
        self._write_or_end(_record(_FRAME, _TIME.pack(received_s) + pack(frame)))
        self.frames += 1

    def begin_run(self, because: str) -> None:
        """Say that nothing is lost between the last frame and the next one, and why: "restart" or "reconnect"."""
        self._write_or_end(self._session(because))

    def close(self, statistics: Statistics | None = None) -> None:
        """Write the statistics of who received the frames, if they are given, and close; again, it does nothing."""
        if statistics is not None and not self._file.closed:
            self._write_or_end(_record(_END, json.dumps(asdict(statistics)).encode()))
        with suppress(OSError):
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _session(self, because: str) -> bytes:
        self._runs += 1
        run = {"because": because, "began_s": time.time(), "run": self._runs}
        return _record(_SESSION, json.dumps(self.header.plain() | run).encode())

    def _write_or_end(self, data: bytes) -> None:
        try:
            self._write(data)
        except OSError as error:
            self.close()
            raise RecordingError(
                f"{self.path}: {_reason(error)}: recording ended, all {self.frames} frames up to here are kept: "
                "make room or take another disk."
            ) from None

    def _write(self, data: bytes) -> None:
        """Append some bytes; on failure none of them is left."""
        with uninterrupted():
            start = self._file.seek(0, os.SEEK_END)
            try:
                while data:
                    data = data[self._file.write(data) :]  # a disk that gets full takes a part of them first
            except OSError:
                with suppress(OSError):
                    self._file.truncate(start)
                raise

    def _require_same_header(self) -> None:
        with self.path.open("rb") as file:
            stated = next((_json(content) for _, kind, content in _records_in(file) if kind == _SESSION), None)
        if stated is None:
            raise FileFormatError(f"{self.path}: not made by a recorder: record to a new file.")
        there = read_header(stated, str(self.path))
        old, new = there.plain(), self.header.plain()
        differing = [name for name in new if old[name] != new[name]]
        if differing:
            name = differing[0]
            is_text = name in ("calibration", *MADE_FROM)
            what = f"another {name.replace('_', ' ')}, or none" if is_text else f"{name} {old[name]}, not {new[name]}"
            raise FileFormatError(
                f"{self.path}: recorded with {what}: give another file, a recording has one board, one calibration and "
                "one model."
            )


def _reason(error: OSError) -> str:
    return f"the disk is full ({error.strerror})" if error.errno in FULL else str(error.strerror)


def _require_same_board(info: Info, n_counts: float, bits: int, flags: int, source: str) -> None:
    """Refuse a frame that a board with this INFO does not send."""
    if (n_counts, bits, flags >> 1) != (info.n_crossings, info.bits, info.scan_mode):
        raise FileFormatError(
            f"{source}: a data frame has {n_counts:g} counts of {bits} bits in scan mode {flags >> 1}, but its INFO "
            f"frame says {info.rows} × {info.cols} units, which make {info.n_crossings} of {info.bits} bits in "
            f"{info.scan_mode.name}: keep one board with one setting to a recording."
        )


def _json(content: bytes) -> dict[str, Any]:
    try:
        plain = json.loads(content)
    except (ValueError, RecursionError):
        plain = None
    return plain if isinstance(plain, dict) else {}


def read_recording(path: Path, stated: Info | None = None) -> Recording:
    """Read a recording, whatever its name: a recorder's file, or the bytes that a board sent, or lines of one `stated`.

    Damaged frames are left out, counted, and named in `Recording.damaged_at`; so is the unfinished last one of a
    recorder that was killed. `FileFormatError` if the file is missing, no recording, or holds no frame or those of two
    boards.
    """
    require_regular(path, "give a recording")
    try:
        require_memory(4 * Path(path).stat().st_size, f"{path}: its frames", "record shorter pieces")
        with Path(path).open("rb") as file:
            if file.read(8).startswith(_EXPORTS):
                raise FileFormatError(
                    f"{path}: a data set, or an export for other programs, which is not read back: give the recording "
                    "(.frames)."
                )
            file.seek(0)
            return _read(file, str(path)) if stated is None else _read_lines(file, stated, str(path))
    except OSError as error:
        raise FileFormatError(f"{path}: {why_unreadable(error)}: give a recording.") from error


def _read_lines(file: IO[bytes], stated: Info, source: str) -> Recording:
    decoder, rows, cols = LineDecoder([stated]), stated.rows, stated.cols
    matrices = [
        each for piece in (*iter(partial(file.read, _PIECE_BYTES), b""), b"\n") for each in decoder.matrices(piece)
    ]
    width = max(map(len, matrices), default=0)
    if not (whole := [each for each in matrices if len(each) == width]):
        raise FileFormatError(
            f"{source}: no line of {rows} × {cols} numbers from 0 on, and no {rows} lines of {cols}: correct rows= and "
            "cols=, or leave them out for a recording (.frames)."
        )
    numbers = np.array(whole)
    clock = np.arange(len(numbers)) / stated.rate_hz
    if numbers.shape[1] > rows * cols:
        is_last = bool((np.diff(numbers[:, 0]) < 0).any() and (np.diff(numbers[:, -1]) >= 0).all())
        clock, numbers = numbers[:, -is_last], np.delete(numbers, -is_last, axis=1)
        clock = (clock - clock[0]) * (1.0 if (clock % 1.0).any() else 1e-3)  # with decimals seconds, else milliseconds
        stated = replace(stated, rate_hz=round(1.0 / np.clip(np.median(np.diff(clock, prepend=-1.0)), 1e-3, 1.0)))
    if stated.scan_mode == ScanMode.PLAIN and (most := numbers.max()) and not RANGES[0] <= most <= RANGES[1]:
        raise FileFormatError(
            f"{source}: its largest number is {most:.3g}, the largest must be {RANGES[0]:g} to {RANGES[1]:.0e}: take "
            "another unit, here and in training, such as mS for S."
        )
    info, n = ranged(stated, numbers), len(numbers)
    columns = np.zeros(n, packed_dtype(info.n_crossings))
    columns["counts"], is_bound = counted(info, numbers)
    columns["flags"], columns["sequence"] = is_bound | info.scan_mode << 1, np.arange(n) % 2**16
    columns["device_us"] = np.rint(1e6 * clock).astype(np.int64) % 2**32
    counts = Counter({"ok": n, "bad_form": decoder.statistics.bad_form + len(matrices) - n})
    return _recorded(Header(info=info), columns, np.zeros(n, np.uint32), None, counts)


def parse_recording(stream: bytes, source: str = "recording") -> Recording:
    """Read a recording from bytes, as `read_recording` does; `source` names them in messages."""
    return _read(BytesIO(stream), source)


def _read(file: IO[bytes], source: str) -> Recording:
    stated: list[Header] = []
    session = frame = b""  # the last ones: a session stands twice, a frame should not
    rows, runs, run = bytearray(), bytearray(), 0
    shapes: set[tuple[int, int, int]] = set()  # of packed frames: bytes, bits, flags
    counted: Counter[str] = Counter()
    damaged_at: list[int] = []
    truncated_bytes = 0
    for at, kind, content in _records_in(file):
        if kind in (_FRAME, _BOARD_FRAME):
            row = content if kind == _FRAME else _NO_TIME + content
            if row[8:] == frame:
                counted["repeated"] += 1
                continue
            frame = row[8:]
            rows += row
            runs += run.to_bytes(4, "little")
            counted["ok"] += 1
            shapes.add((len(frame), frame[10], frame[1]))
        elif kind == _SESSION and content != session:
            session, plain = content, _json(content)
            stated.append(read_header(plain, source))
            counted["restarts"] += plain.get("because") == "restart"
            run += 1
        elif kind == _BOARD_INFO and isinstance(info := unpack(content), Info):
            stated.append(Header(info=info))
        elif kind == _END:
            counted.update({name: int(_json(content).get(name, 0)) for name in _FROM_THE_RECEIVER})
        elif kind == _CUT:
            truncated_bytes = len(content)
        elif not kind:
            counted[content.decode()] += 1
            damaged_at.append(at)
    header = _common_header(stated, counted["ok"], file.tell(), source)
    for n_bytes, bits, flags in sorted(shapes):
        _require_same_board(header.info, (n_bytes - _AROUND) / 2, bits, flags, source)
    dtype = np.dtype([("received_s", "<f8"), *packed_dtype(header.info.n_crossings).descr])
    columns = np.frombuffer(rows, dtype)
    arrivals = columns["received_s"].astype(np.float64)
    received_s = None if np.isnan(arrivals).any() else arrivals
    began, places = np.frombuffer(runs, "<u4"), tuple(damaged_at)
    return _recorded(header, columns, began, received_s, counted, truncated_bytes=truncated_bytes, damaged_at=places)


def _recorded(
    header: Header,
    columns: NDArray[np.void],
    began: NDArray[np.uint32],
    received_s: FloatArray | None,
    counts: Counter[str],
    **more: Any,
) -> Recording:
    """A recording of frames as columns, which began anew where `began` (n,) counts up; with what was counted."""
    sequence, device_us = columns["sequence"], columns["device_us"]
    restart = is_restart(sequence, device_us) & (np.diff(began) == 0)
    run = np.concatenate([[0], np.cumsum(restart | (np.diff(began) != 0))]).astype(np.uint32)
    missing = (np.diff(sequence) - np.uint16(1))[np.diff(run) == 0]
    counts.update({"restarts": int(restart.sum()), "lost": int(missing.sum()), "info": 1})
    native: dict[str, Any] = {name: columns[name].astype(columns[name].dtype.newbyteorder("=")) for name in OF_FRAMES}
    time_s, statistics = unwrapped_s(device_us, run, received_s), Statistics(**counts)
    return Recording(
        **vars(header), **native, run=run, received_s=received_s, time_s=time_s, statistics=statistics, **more
    )


def _common_header(stated: list[Header], n: int, size: int, source: str) -> Header:
    """The header that all sessions and INFO frames agree on."""
    if not stated:
        lack = f"{n} data frames but no INFO frame of protocol {PROTOCOL}, which says what the counts mean"
        raise FileFormatError(
            f"{source}: {lack if n else f'no valid frame in {size} bytes'}: give a recording, made at the right baud "
            "rate, with the answer to '?' first; of a log of plain numbers, rows= and cols= of them."
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
