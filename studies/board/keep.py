"""A board's scans into a recording."""

import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

from hardware.calibration import SensorCalibration
from hardware.frames import Statistics
from hardware.recording import recorder_for
from hardware.recording.mcap_recorder import McapRecorder
from hardware.scanner import Scanner, ScannerStatistics
from studies.board.session import Session, hashes_of, scans

TOLD_S = 1.0  #: between two words on the progress

Advance = Callable[[float, int, str | None], None]  #: seconds, scans, trouble


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """What came of it."""

    scans: int
    statistics: ScannerStatistics


def record_scans(
    scanner: Scanner,
    path: Path,
    seconds: float,
    calibration: SensorCalibration | None = None,
    reading: Session | None = None,
    append: bool = False,
    advance: Advance | None = None,
) -> Recorded:
    """Record for some seconds, or until Ctrl-C or the end of what is played.

    Parameters
    ----------
    calibration : SensorCalibration, optional
        Kept with the counts.
    reading : Session, optional
        Its model's hash is kept; in MCAP its forces and deviations, too.
    append : bool
        Continue a recording of the same board, model and calibration.
    advance : callable, optional
        Told every second how it goes.

    Raises
    ------
    FileFormatError, RecordingError
        As `FrameRecorder` does.
    """
    unix_s = time.time() - time.perf_counter()
    start = told = time.monotonic()
    n = 0
    text = "" if calibration is None else calibration.to_json()
    hashes = {} if reading is None else hashes_of(reading.model)
    with recorder_for(path, scanner.info, text, hashes, append) as recorder:
        for scan in scans(scanner, seconds):
            if scan is None:
                recorder.append([], time.time())
            else:
                n += 1
                received_s = unix_s + scan.received_s
                recorder.append(scan.frame, received_s)
                if reading is not None and isinstance(recorder, McapRecorder):
                    found = reading.forces(scan)
                    axes, deviation_n = reading.model.component.axes, reading.deviations(found)
                    recorder.append_forces(received_s, found.force_n[0], axes, deviation_n)
            now = time.monotonic()
            if advance and now - told > TOLD_S:
                told = now
                advance(now - start, n, scanner.trouble)
        statistics = scanner.stats
        known = {spec.name for spec in fields(Statistics)}
        recorder.close(Statistics(**{name: value for name, value in vars(statistics).items() if name in known}))
    return Recorded(scans=n, statistics=statistics)
