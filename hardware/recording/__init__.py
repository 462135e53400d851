"""Recordings: raw counts as they came, kept by `Recorder`, read by `read_recording`, given other forms by `convert`.

Resistances and forces are computed from them, by
`hardware.readout.replaying`. `docs/recordings.md` has the format; `recorder.py`
and `reader.py` are its two ends, `recorded.py` says what a recording is.
"""

from hardware.recording.byte_stream import recording_bytes, recording_from_resistances, write_recording
from hardware.recording.convert import convert
from hardware.recording.reader import parse_recording, read_recording
from hardware.recording.recorded import Recording
from hardware.recording.recorder import Recorder, RecordingError

__all__ = [
    "Recorder",
    "Recording",
    "RecordingError",
    "convert",
    "parse_recording",
    "read_recording",
    "recording_bytes",
    "recording_from_resistances",
    "write_recording",
]
