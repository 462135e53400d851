"""From a board's bytes to forces, live or recorded.

In: a port with a board on it (`Scanner`), or a recording of one (`read_recording`), and a trained model. Out: forces
over time (`ForceReader`, `replay`). Open `docs/frames.md` for what is on the wire, `scanner.py` for how it is read,
`crossbar.py` for what the array's wiring does to it, then `live.py`. `firmware/` is the board's program;
`virtual_board.py` and `simavr_board.py` are boards that are not there.
"""

from geometry.wiring import crossings, crossings_from_pillars, pillars_from_crossings
from hardware.boards.virtual_board import VirtualBoard
from hardware.link.frames import (
    PROTOCOL,
    Frame,
    FrameDecoder,
    FrameError,
    Info,
    ScanMode,
    Statistics,
    encode,
)
from hardware.link.scanner import Scanner, ScannerError
from hardware.link.serial_ports import PortError, list_ports, open_port
from hardware.readout.calibration import Electronics, SensorCalibration, read_calibration, write_calibration
from hardware.readout.crossbar import Crossbar
from hardware.readout.crossbar_readout import CrossbarReadout
from hardware.readout.live import ForceModel, ForceReader, Forces
from hardware.readout.replaying import Replay, replay, write_forces
from hardware.recording import (
    Recording,
    parse_recording,
    read_recording,
    recording_from_resistances,
    write_recording,
)

__all__ = [
    "PROTOCOL",
    "Crossbar",
    "CrossbarReadout",
    "Electronics",
    "ForceModel",
    "ForceReader",
    "Forces",
    "Frame",
    "FrameDecoder",
    "FrameError",
    "Info",
    "PortError",
    "Recording",
    "Replay",
    "ScanMode",
    "Scanner",
    "ScannerError",
    "SensorCalibration",
    "Statistics",
    "VirtualBoard",
    "crossings",
    "crossings_from_pillars",
    "encode",
    "list_ports",
    "open_port",
    "parse_recording",
    "pillars_from_crossings",
    "read_calibration",
    "read_recording",
    "recording_from_resistances",
    "replay",
    "write_calibration",
    "write_forces",
    "write_recording",
]
