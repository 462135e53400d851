"""Reading recordings of every kind, which are told by their content."""

import json
from collections import Counter
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np

from geometry.errors import FileFormatError
from geometry.storage.text_file import why_unreadable
from hardware.link.frames import PROTOCOL, Info, packed_dtype, unpack
from hardware.recording.header import Header, read_header
from hardware.recording.mcap_file import MAGIC as MCAP
from hardware.recording.mcap_file import read_mcap
from hardware.recording.netcdf import MAGICS as NETCDF
from hardware.recording.netcdf import read_netcdf_recording
from hardware.recording.recorded import Recording, assemble
from hardware.recording.records import BOARD_FRAME, BOARD_INFO, CUT, END, FRAME, SESSION, records_in

_NO_TIME = np.float64(np.nan).tobytes()
_FROM_THE_RECEIVER = ("bad_cobs", "bad_crc", "bad_form", "repeated", "foreign")


def read_recording(path: Path) -> Recording:
    """Read a recording, whatever its name: a recorder's, the bytes that a board sent, or what was converted of these.

    Damaged frames are left out, counted, and named in `Recording.damaged_at`; so is the unfinished last one of a
    recorder that was killed.

    Raises
    ------
    FileFormatError
        If the file is missing, no recording, or holds no frame or those of two boards.
    """
    try:
        with Path(path).open("rb") as file:
            start = file.read(8)
            file.seek(0)
            if not start.startswith((*NETCDF, MCAP)):
                return _read(file, str(path))
    except OSError as error:
        raise FileFormatError(f"{path}: {why_unreadable(error)}: give a recording.") from error
    return read_mcap(path) if start.startswith(MCAP) else read_netcdf_recording(path)


def parse_recording(stream: bytes, source: str = "recording") -> Recording:
    """`read_recording` of bytes in memory, which `source` names in messages: a recorder's or a board's.

    Time is unwrapped under the assumption that no pause between two frames reaches 2³² µs (71.6 min), and goes on by
    the host's clock where a run ends.
    """
    return _read(BytesIO(stream), source)


def read_header_of(path: Path) -> Header:
    """What a recorder stated first; anything but its file is a FileFormatError."""
    with path.open("rb") as file:
        for _, kind, content in records_in(file):
            if kind == SESSION:
                return read_header(_json(content), str(path))
    raise FileFormatError(f"{path}: not made by a recorder: record to a new file.")


def _json(content: bytes) -> dict[str, Any]:
    try:
        plain = json.loads(content)
    except ValueError:
        plain = None
    return plain if isinstance(plain, dict) else {}


def _read(file: IO[bytes], source: str) -> Recording:
    stated: list[Header] = []
    session = frame = b""  # the last ones: a session stands twice, a frame should not
    rows, runs, run = bytearray(), bytearray(), 0
    sizes: dict[int, int] = {}  # bytes of a frame: the first one that has them
    counted: Counter[str] = Counter()
    damaged_at: list[int] = []
    n = truncated_bytes = 0
    for at, kind, content in records_in(file):
        if kind in (FRAME, BOARD_FRAME):
            row = content if kind == FRAME else _NO_TIME + content
            if row[8:] == frame:
                counted["repeated"] += 1
                continue
            frame = row[8:]
            sizes.setdefault(len(row), n)
            rows += row
            runs += run.to_bytes(4, "little")
            n += 1
        elif kind == SESSION and content != session:
            session, plain = content, _json(content)
            stated.append(read_header(plain, source))
            counted["restarts"] += plain.get("because") == "restart"
            run += 1
        elif kind == BOARD_INFO and isinstance(info := unpack(content), Info):
            stated.append(Header(info=info))
            counted["info"] += 1
        elif kind == END:
            counted.update({name: int(_json(content).get(name, 0)) for name in _FROM_THE_RECEIVER})
        elif kind == CUT:
            truncated_bytes = len(content)
        elif not kind:
            counted[content.decode()] += 1
            damaged_at.append(at)
    header = _the_one(stated, n, file.tell(), source)
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


def _the_one(stated: list[Header], n: int, size: int, source: str) -> Header:
    """What all headers and INFO frames agree on."""
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
