"""From a board's bytes to forces.

In: a recording (`read_recording`), the bytes a board sent. Out: `replay` gives the forces over time that a
trained model finds in it. Without a board, `recording_from_resistances` makes one. Open `docs/frames.md` for
what is on the wire, then `frames.py` (the codec), `geometry.wiring` (which crossing reads which pillar),
`recording.py` and `replay.py`.
"""

from geometry.wiring import crossings, crossings_from_pillars, pillars_from_crossings
from hardware.frames import (
    PROTOCOL,
    Frame,
    FrameDecoder,
    FrameError,
    Info,
    ScanMode,
    Statistics,
    encode,
)
from hardware.recording import (
    Recording,
    parse_recording,
    read_recording,
    recording_from_resistances,
    write_recording,
)
from hardware.replay import ForceModel, Replay, replay, resistances, write_forces

__all__ = [
    "PROTOCOL",
    "ForceModel",
    "Frame",
    "FrameDecoder",
    "FrameError",
    "Info",
    "Recording",
    "Replay",
    "ScanMode",
    "Statistics",
    "crossings",
    "crossings_from_pillars",
    "encode",
    "parse_recording",
    "pillars_from_crossings",
    "read_recording",
    "recording_from_resistances",
    "replay",
    "resistances",
    "write_forces",
    "write_recording",
]
