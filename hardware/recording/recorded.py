"""What a recording says, as arrays: the same, whichever kind of file held it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.errors import FileFormatError
from geometry.layout import FloatArray
from hardware.frames import Frame, Info, Statistics


@dataclass(frozen=True, kw_only=True)
class Recording:
    """The frames of a recording in the order received; n of them."""

    info: Info
    counts: NDArray[np.uint16]  #: (n, rows·cols·3), in the order of `geometry.wiring.crossings`
    sequence: NDArray[np.uint16]  #: (n,), modulo 2¹⁶; gaps are lost frames
    device_us: NDArray[np.uint32]  #: (n,), the board's clock as sent [µs], modulo 2³²
    time_s: FloatArray  #: (n,), the board's clock with its rollover every 2³² µs undone
    flags: NDArray[np.uint8]  #: (n,), as sent: bit 0 saturation, bits 1 and 2 the scan mode
    overrun_counts: NDArray[np.uint8]  #: (n,), the board's counter as sent, modulo 2⁸
    overruns: int  #: scans the board skipped between the first and the last frame
    statistics: Statistics
    truncated_bytes: int  #: of an unfinished end, as a killed recorder leaves it
    received_s: FloatArray | None = None  #: (n,), host's Unix time of arrival [s]; a stream of bytes has none
    calibration: str = ""  #: JSON text, as given to the recorder
    made_from: Mapping[str, str] = field(default_factory=dict)  #: hashes of what the recorder worked with


def assemble(
    info: Info,
    columns: Mapping[str, NDArray[Any]],
    source: str,
    damage: Mapping[str, int],
    truncated_bytes: int,
    **more: Any,
) -> Recording:
    """A recording from the columns of a file, with what follows from them.

    Parameters
    ----------
    info : Info
        The board.
    columns : mapping
        ``counts``, ``sequence``, ``device_us``, ``flags``, ``overruns`` and ``received_s``, n rows each.
    source : str
        Named in the message of a refusal.
    damage : mapping
        The fields ``bad_*`` of `Statistics` as far as they are known; the others are counted here.
    truncated_bytes : int
        Of an unfinished end.
    **more
        ``calibration`` and ``made_from``.

    Raises
    ------
    FileFormatError
        If there is no frame, or a column holds what no frame of this board does.
    """
    n = len(columns["sequence"])
    if not n:
        raise FileFormatError(f"{source}: an INFO frame but no data frame: record for longer.")
    counts, flags = columns["counts"].astype(np.uint16), columns["flags"].astype(np.uint8)
    if counts.shape != (n, info.n_crossings):
        raise FileFormatError(
            f"{source}: counts has shape {counts.shape}, but {n} frames of {info.rows} × {info.cols} units make "
            f"{(n, info.n_crossings)}: keep one board to a recording."
        )
    foreign = (flags >> 1 != info.scan_mode) | (counts >> info.bits).any(axis=1)
    if foreign.any():
        k = int(foreign.argmax())
        raise FileFormatError(
            f"{source}: data frame {k} has flags {flags[k]} and counts up to {counts[k].max()}, but the board has "
            f"{info.bits} bits in scan mode {info.scan_mode.name}: the file was damaged or edited, record again."
        )
    sequence, device_us = columns["sequence"].astype(np.uint16), columns["device_us"].astype(np.uint32)
    lost, restarts = _gaps(sequence, device_us)
    overrun_counts = columns["overruns"].astype(np.uint8)
    return Recording(
        info=info,
        counts=counts,
        sequence=sequence,
        device_us=device_us,
        time_s=unwrapped_s(device_us),
        flags=flags,
        overrun_counts=overrun_counts,
        overruns=skipped(overrun_counts),
        statistics=Statistics(ok=n, info=1, lost=lost, restarts=restarts, **damage),
        truncated_bytes=truncated_bytes,
        received_s=columns["received_s"].astype(np.float64),
        **more,
    )


def unwrapped_s(device_us: NDArray[np.uint32]) -> FloatArray:
    """The board's clock [s] with its rollover undone, under the assumption that no pause reaches 2³² µs.

    >>> unwrapped_s(np.array([2**32 - 1_000_000, 1_000_000], np.uint32)).round(6).tolist()
    [4293.967296, 4295.967296]
    """
    steps_us = np.diff(device_us, prepend=device_us[:1])  # u32 differences wrap as the board's clock does
    return (device_us[0] + np.cumsum(steps_us, dtype=np.float64)) * 1e-6


def skipped(overrun_counts: NDArray[np.uint8]) -> int:
    """Scans skipped from the first frame to the last."""
    return int(np.diff(overrun_counts).sum())  # u8 differences wrap as the board's counter does


def is_restart(sequence: NDArray[np.uint16], device_us: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Where the board stepped back between a frame and the one before it, shape (n - 1,); as `FrameDecoder` has it."""
    return (np.diff(sequence) - np.uint16(1) >= 2**15) | (np.diff(device_us) >= 2**31)


def _gaps(sequence: NDArray[np.uint16], device_us: NDArray[np.uint32]) -> tuple[int, int]:
    """Frames lost and restarts, counted as `FrameDecoder` does."""
    restart = is_restart(sequence, device_us)
    missing = np.diff(sequence) - np.uint16(1)
    return int(missing[~restart].sum()), int(restart.sum())


def frames_of(recording: Recording) -> Iterator[Frame]:
    """The frames of a recording as the board sent them."""
    info = recording.info
    for k in range(len(recording.counts)):
        yield Frame(
            sequence=int(recording.sequence[k]),
            device_us=int(recording.device_us[k]),
            bits=info.bits,
            counts=recording.counts[k],
            saturated=bool(recording.flags[k] & 1),
            scan_mode=info.scan_mode,
            overruns=int(recording.overrun_counts[k]),
        )


def require_same_board(frame: Frame, info: Info, source: str, name: str = "a data frame") -> None:
    """Refuse a frame that a board with this INFO does not send."""
    if frame.counts.size != info.n_crossings:
        raise FileFormatError(
            f"{source}: {name} has {frame.counts.size} counts, but the INFO frame's "
            f"{info.rows} × {info.cols} units make {info.n_crossings}: keep one board to a recording."
        )
    if frame.bits != info.bits or frame.scan_mode != info.scan_mode:
        raise FileFormatError(
            f"{source}: {name} has {frame.bits} bits in scan mode {frame.scan_mode.name}, the "
            f"INFO frame {info.bits} bits in {info.scan_mode.name}: keep one setting to a recording."
        )
