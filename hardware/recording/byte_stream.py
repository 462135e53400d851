"""Recordings as a board would have sent them: an INFO frame and data frames, as `docs/frames.md` has them."""

from pathlib import Path

from geometry.layout import FloatArray
from geometry.storage import files
from hardware.link.frames import Frame, Info, encode
from hardware.readout.calibration import Electronics
from hardware.recording.recorded import Recording, frames_of


def recording_bytes(recording: Recording) -> bytes:
    """The recording as its board would have sent it: an INFO frame, then every data frame."""
    return encode(recording.info) + b"".join(encode(frame) for frame in frames_of(recording))


def write_recording(stream: bytes, path: Path) -> None:
    """Write a stream of bytes, whole or not at all."""
    with files.replacing(path) as temporary:
        temporary.write_bytes(stream)


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
    >>> import numpy as np
    >>> from hardware.recording import parse_recording
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
