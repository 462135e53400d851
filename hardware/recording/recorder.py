"""What every recorder does: gather frames, write them out twice a second, and stop in one clear line.

A kind of file adds how it is opened, written and ended (`netcdf.Recorder`, `mcap_recorder.McapRecorder`).
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from geometry.errors import FileFormatError, TriPillarError
from geometry.files import uninterrupted
from hardware.frames import Frame, Info, Statistics
from hardware.recording.header import Header
from hardware.recording.recorded import require_same_board

FLUSH_S = 0.5  #: frames wait no longer than this for the disk, as long as `append` is called
STALL_S = 10.0  #: a disk that takes longer for half a second of frames is given up
_MOST = 4096  #: frames that wait at most, lest fast ones fill the memory
_LATEST_S = 1e10  #: of Unix times; beyond, nanoseconds do not fit the 64 bits that MCAP has for them


class RecordingError(TriPillarError, OSError):
    """A disk that is full, gone or too slow. What was flushed before stays readable."""


class FrameRecorder(ABC):
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
        Continue `path` if it exists. It must be of the same kind, with the same info, calibration and made_from.

    Raises
    ------
    FileFormatError
        If the file exists (without `append`), or is another board's or no recording of this kind (with it).
    RecordingError
        If the file cannot be made.

    Notes
    -----
    Frames reach the operating system 0.5 s after they came at the latest, and on `close`. There is no thread:
    `append` writes when it is time. Where frames may stop, go on calling it with none: ``append([], now)``. A killed
    process thus loses less than a second; a computer that loses its power may lose what the system had not yet
    written, 30 s on a usual Linux.
    """

    def __init__(
        self,
        path: Path,
        info: Info,
        calibration: str = "",
        made_from: dict[str, str] | None = None,
        append: bool = False,
    ) -> None:
        self.path = Path(path)
        self.header = Header(info=info, calibration=calibration, made_from=made_from or {})
        self.frames = 0  #: on disk, written by this recorder
        self._waiting: list[tuple[Frame, float]] = []
        self._is_open = False
        exists = self.path.exists()
        if exists and not append:
            raise FileFormatError(f"{path}: the file exists: give another name, or continue it by --append.")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with uninterrupted():
                self._continue() if exists else self._create()
        except FileFormatError:
            raise
        except (OSError, RuntimeError) as error:
            with suppress(OSError, RuntimeError, AttributeError):  # the last if there is nothing to close yet
                self._abandon()
            raise RecordingError(f"{path}: {_reason(error)}: give a file on a disk that can be written.") from None
        self._is_open = True
        self._flushed_at = time.monotonic()

    @abstractmethod
    def _create(self) -> None:
        """Make the file, `header` in it and on its way to the disk."""

    @abstractmethod
    def _continue(self) -> None:
        """Open the file of an earlier recorder, after `_require_same_header`."""

    @abstractmethod
    def _write(self, frames: Sequence[Frame], received_s: Sequence[float]) -> None:
        """Hand frames, perhaps none, and all that waits beside them to the operating system."""

    @abstractmethod
    def _end(self, statistics: Statistics | None) -> None:
        """Write what comes last and close the file."""

    @abstractmethod
    def _abandon(self) -> None:
        """Close the file after a failure; errors are dropped by the caller."""

    def append(self, frames: Frame | Iterable[Frame], received_s: float | Sequence[float]) -> None:
        """Add frames, one, several or none, and write out what waits if it is time.

        Parameters
        ----------
        frames : Frame or several
            As decoded.
        received_s : float, or one a frame
            Host's Unix time of arrival [s].
        """
        batch = [frames] if isinstance(frames, Frame) else list(frames)
        arrivals = [received_s] * len(batch) if isinstance(received_s, int | float) else list(received_s)
        self._require_open()
        for frame, arrival in zip(batch, arrivals, strict=True):
            require_same_board(frame, self.header.info, str(self.path))
            self._require_time(arrival)
        self._waiting.extend(zip(batch, arrivals, strict=True))
        self._flush_if_due()

    def flush(self) -> None:
        """Hand all that waits to the operating system."""
        self._require_open()
        with uninterrupted():
            self._write_out()

    def close(self, statistics: Statistics | None = None) -> None:
        """Write what waits, then the decoder's statistics if they are given, and close; a second time does nothing."""
        if not self._is_open:
            return
        with uninterrupted():
            self._write_out()
            self._is_open = False
            try:
                self._end(statistics)
            except (OSError, RuntimeError) as error:
                raise self._failed(_reason(error)) from None

    def _write_out(self) -> None:
        waiting, self._waiting = self._waiting, []
        started = time.monotonic()
        try:
            self._write([frame for frame, _ in waiting], [arrival for _, arrival in waiting])
        except (OSError, RuntimeError) as error:
            raise self._failed(_reason(error)) from None
        self.frames += len(waiting)
        self._flushed_at = time.monotonic()
        if self._flushed_at - started > STALL_S:
            raise self._failed(f"the disk stalled for {self._flushed_at - started:.0f} s")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _flush_if_due(self) -> None:
        if len(self._waiting) >= _MOST or time.monotonic() - self._flushed_at >= FLUSH_S:
            self.flush()

    def _require_open(self) -> None:
        if not self._is_open:
            raise RecordingError(f"{self.path}: the recorder is closed: make a new one, with append to continue.")

    def _require_time(self, received_s: float) -> None:
        if not 0 <= received_s < _LATEST_S:
            raise ValueError(
                f"received_s={received_s!r} must be a Unix time [s], 0 to {_LATEST_S:g}: give time.time()."
            )

    def _require_same_header(self, there: Header) -> None:
        for name in ("info", "calibration", "made_from"):
            old, new = getattr(there, name), getattr(self.header, name)
            if old != new:
                raise FileFormatError(
                    f"{self.path}: recorded with {name} {old!r}, not {new!r}: give another file, "
                    "a recording has one board, one calibration and one model."
                )

    def _failed(self, reason: str) -> RecordingError:
        self._is_open = False
        with suppress(OSError, RuntimeError):
            self._abandon()
        return RecordingError(
            f"{self.path}: {reason}: recording ended, its first {self.frames} frames are kept: "
            "make room or take another disk."
        )


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
