"""From a board's bytes to forces, live or recorded.

In: a port with a board on it, or a recording of one, and a trained model. Out: forces over time. `live` does it all;
the names below follow the data: `link` makes scans of bytes, `recording` keeps them, `readout` makes resistances and
forces of them, and `session` is what is done with a connected board. `firmware/` is the board's program, `boards` are
boards that are not there. Open `session.py` first.
"""

from typing import TYPE_CHECKING

from common.lazy import lazily

if TYPE_CHECKING:
    from hardware.link.frames import Frame, FrameDecoder, Info, ScanMode
    from hardware.link.scanner import Scanner, ScannerError
    from hardware.link.serial_ports import PortError
    from hardware.readout.calibration import SensorCalibration, read_calibration, write_calibration
    from hardware.readout.crossbar import Crossbar
    from hardware.readout.forces import ForceReader, Forces, replay
    from hardware.recording import Recorder, Recording, read_recording
    from hardware.session import live
    from hardware.streams.files import convert, write_forces

__all__ = [
    "Crossbar",
    "ForceReader",
    "Forces",
    "Frame",
    "FrameDecoder",
    "Info",
    "PortError",
    "Recorder",
    "Recording",
    "ScanMode",
    "Scanner",
    "ScannerError",
    "SensorCalibration",
    "convert",
    "live",
    "read_calibration",
    "read_recording",
    "replay",
    "write_calibration",
    "write_forces",
]

__getattr__ = lazily(__name__)
