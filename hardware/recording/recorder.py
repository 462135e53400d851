"""Appending frames to a recording as they come: each is handed to the operating system at once, whole or not at all."""

import json
import os
import struct
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Self

from geometry.errors import FileFormatError, TriPillarError
from geometry.storage.files import FULL, require_file, uninterrupted
from hardware.link.frames import Frame, Info, Statistics, missing_between, pack
from hardware.recording.header import Header
from hardware.recording.reader import read_header_of
from hardware.recording.recorded import require_same_board
from hardware.recording.records import END, FRAME, SESSION, record

SUFFIX = ".frames"
_LATEST_S = 1e10  #: of Unix times; beyond, nanoseconds do not fit the 64 bits that MCAP has for them
_TIME = struct.Struct("<d")


class RecordingError(TriPillarError, OSError):
    """A disk that is full, gone or cannot be written. What was recorded before stays readable."""


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
    >>> from hardware.recording import read_recording
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "press.frames"
    ...     with Recorder(path, Info(rows=1, cols=1), made_from={"design_hash": "a1b2"}) as recorder:
    ...         recorder.append(Frame(sequence=7, device_us=0, bits=10, counts=np.array([1, 2, 3])), 1.8e9)
    ...     recording = read_recording(path)
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
            self._require_same_header(read_header_of(self.path))
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
            if not 0 <= arrival < _LATEST_S:
                raise ValueError(
                    f"received_s={arrival!r} must be a Unix time [s], 0 to {_LATEST_S:g}: give time.time()."
                )
        for frame, arrival in zip(batch, arrivals, strict=True):
            self._write_or_end(record(FRAME, _TIME.pack(arrival) + pack(frame)))
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
                self._write_or_end(record(END, json.dumps(asdict(statistics)).encode()))
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
        return record(SESSION, json.dumps(self.header.plain() | run).encode())

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

    def _require_same_header(self, there: Header) -> None:
        for name in ("info", "calibration", "made_from"):
            old, new = getattr(there, name), getattr(self.header, name)
            if old != new:
                raise FileFormatError(
                    f"{self.path}: recorded with {name} {old!r}, not {new!r}: give another file, "
                    "a recording has one board, one calibration and one model."
                )


def _reason(error: OSError) -> str:
    return f"the disk is full ({error.strerror})" if error.errno in FULL else str(error.strerror)
