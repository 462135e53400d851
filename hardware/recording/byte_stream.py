"""A recording as the bytes that a board sends: an INFO frame and data frames, as `docs/frames.md` has them."""

from pathlib import Path

import numpy as np

from geometry import files
from geometry.errors import FileFormatError
from geometry.layout import FloatArray
from hardware.calibration import Electronics
from hardware.frames import PROTOCOL, Frame, FrameDecoder, Info, encode
from hardware.recording.recorded import Recording, frames_of, require_same_board, skipped, unwrapped_s

_STEP = 2**20  # bytes handed to the decoder at a time, lest the pieces it cuts them into fill the memory


def recording_bytes(recording: Recording) -> bytes:
    """The recording as its board would have sent it: an INFO frame, then every data frame."""
    return encode(recording.info) + b"".join(encode(frame) for frame in frames_of(recording))


def write_recording(stream: bytes, path: Path) -> None:
    """Write a stream of bytes, whole or not at all."""
    with files.replacing(path) as temporary:
        temporary.write_bytes(stream)


def parse_recording(stream: bytes, source: str = "recording") -> Recording:
    """Decode a recorded stream of bytes.

    Damaged frames are left out and counted. A truncated last frame is normal and only reported.

    Raises
    ------
    FileFormatError
        If `stream` is empty, holds no frame, no INFO frame or no data frame, if two INFO frames disagree, or
        if a data frame disagrees with the INFO frame. The message names `source`.

    Notes
    -----
    Time is unwrapped under the assumption that no pause between two frames reaches 2³² µs (71.6 min) and that
    the board did not restart. A restart shows in ``statistics.restarts``; there, time jumps forward.
    """
    decoder = FrameDecoder()
    frames: list[Frame] = []
    infos: list[Info] = []
    for start in range(0, len(stream), _STEP):
        for received in decoder.feed(stream[start : start + _STEP]):
            if isinstance(received, Info):
                infos.append(received)
            elif isinstance(received, Frame):
                frames.append(received)
    _require_complete(stream, frames, infos, source)
    _require_consistent(frames, infos, source)
    device_us = np.array([frame.device_us for frame in frames], dtype=np.uint32)
    overrun_counts = np.array([frame.overruns for frame in frames], dtype=np.uint8)
    return Recording(
        info=infos[0],
        counts=np.stack([frame.counts for frame in frames]),
        sequence=np.array([frame.sequence for frame in frames], dtype=np.uint16),
        device_us=device_us,
        time_s=unwrapped_s(device_us),
        flags=np.array([frame.flags for frame in frames], dtype=np.uint8),
        overrun_counts=overrun_counts,
        overruns=skipped(overrun_counts),
        statistics=decoder.statistics,
        truncated_bytes=decoder.pending,
    )


def _require_complete(stream: bytes, frames: list[Frame], infos: list[Info], source: str) -> None:
    if not stream:
        raise FileFormatError(f"{source}: the file is empty: record again.")
    if not frames and not infos:
        raise FileFormatError(
            f"{source}: no valid frame in {len(stream)} bytes: give a recording, made at the right baud rate."
        )
    if not infos:
        raise FileFormatError(
            f"{source}: {len(frames)} data frames but no INFO frame of protocol {PROTOCOL}, which says what "
            "the counts mean: record again, with the answer to '?' first."
        )
    if not frames:
        raise FileFormatError(f"{source}: an INFO frame but no data frame: record for longer.")


def _require_consistent(frames: list[Frame], infos: list[Info], source: str) -> None:
    info = infos[0]
    for other in infos:
        if other != info:
            raise FileFormatError(
                f"{source}: two INFO frames that differ, {info} and {other}: "
                "keep one board with one setting to a recording."
            )
    for k, frame in enumerate(frames):
        require_same_board(frame, info, source, f"data frame {k}")


def recording_from_resistances(
    resistance_ohm: FloatArray,
    info: Info,
    first_sequence: int = 0,
    first_us: int = 0,
    electronics: Electronics | None = None,
) -> bytes:
    """The recording that a board without noise would make of known resistances, crosstalk included.

    Parameters
    ----------
    resistance_ohm : array, shape (n, rows, cols, 3)
        Pillars z, x, y [Ω] of n scans, `info.rate_hz` a second.
    info : Info
        The board: its converter's bits and sense resistor set the counts.
    first_sequence, first_us : int
        Sequence number and device time [µs] of the first frame.
    electronics : Electronics, optional
        Switches, wires and amplifiers; default: the usual ones.

    Returns
    -------
    bytes
        An INFO frame and n data frames.

    Examples
    --------
    >>> info = Info(rows=1, cols=2, bits=12)
    >>> parse_recording(recording_from_resistances(np.full((5, 1, 2, 3), 10e3), info)).counts.shape
    (5, 6)
    """
    counts = (electronics or Electronics()).crossbar(info).counts(resistance_ohm)
    saturated = (counts % (2**info.bits - 1) == 0).any(axis=1)  # 0 or full scale
    frames = [
        Frame(
            sequence=(first_sequence + k) % 2**16,
            device_us=(first_us + round(k * 1e6 / info.rate_hz)) % 2**32,
            bits=info.bits,
            counts=counts[k],
            saturated=bool(saturated[k]),
            scan_mode=info.scan_mode,
        )
        for k in range(len(counts))
    ]
    return encode(info) + b"".join(encode(frame) for frame in frames)
