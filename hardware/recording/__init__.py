"""Recordings of every kind: what was recorded is read by its content, what is to be recorded is named by its suffix.

Raw counts are what is kept. Resistances and forces are computed from them, by `hardware.replay`. `docs/recordings.md`
compares the kinds; `recorded.py` holds what they have in common, and each has a file of its own.
"""

from pathlib import Path

from geometry.errors import FileFormatError
from hardware.frames import Info
from hardware.recording.byte_stream import parse_recording, recording_bytes, recording_from_resistances, write_recording
from hardware.recording.mcap_reader import MAGIC as _MCAP
from hardware.recording.mcap_reader import read_mcap_recording
from hardware.recording.mcap_recorder import McapRecorder
from hardware.recording.netcdf import Recorder, read_netcdf_recording
from hardware.recording.recorded import Recording

__all__ = [
    "Recording",
    "parse_recording",
    "read_recording",
    "recorder_for",
    "recording_bytes",
    "recording_from_resistances",
    "write_recording",
]

_CDF, _HDF5 = b"CDF", b"\x89HDF\r\n\x1a\n"
_RECORDERS: dict[str, type[Recorder] | type[McapRecorder]] = {".nc": Recorder, ".mcap": McapRecorder}


def read_recording(path: Path) -> Recording:
    """Read a recording, whatever its name: NetCDF, MCAP or the bytes that the board sent.

    Of a recording that was killed, the last frame or half a second of them is not there.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged, or no recording.
    """
    try:
        with Path(path).open("rb") as file:
            start = file.read(len(_MCAP))
        if start.startswith(_CDF) or start == _HDF5:
            return read_netcdf_recording(path)
        if start == _MCAP:
            return read_mcap_recording(path)
        stream = Path(path).read_bytes()
    except OSError as error:
        raise FileFormatError(f"{path}: {error.strerror}: give a recording.") from error
    return parse_recording(stream, source=str(path))


def recorder_for(
    path: Path,
    info: Info,
    calibration: str = "",
    made_from: dict[str, str] | None = None,
    append: bool = False,
) -> Recorder | McapRecorder:
    """The recorder for a file's suffix, ``.nc`` or ``.mcap``; `FrameRecorder` says the rest."""
    kind = _RECORDERS.get(Path(path).suffix.lower())
    if kind is None:
        raise FileFormatError(f"{path}: no kind of recording: end the name in {' or '.join(_RECORDERS)}.")
    return kind(path, info, calibration, made_from, append)
