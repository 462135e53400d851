"""Recordings: raw counts as they came, with their times of arrival. Forces are computed from them.

`Recorder` keeps them in the format `.frames`, `read_recording` reads this and the bytes of a board, `PlaybackPort`
plays them in place of a board. Open `recorded.py` for what a recording is, `frames_file.py` for the format.
"""

from hardware.recording.frames_file import Recorder, RecordingError, parse_recording, read_recording
from hardware.recording.playback import PlaybackPort
from hardware.recording.recorded import Recording

__all__ = ["PlaybackPort", "Recorder", "Recording", "RecordingError", "parse_recording", "read_recording"]
