"""A board's scans into a recording."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path

from hardware.link.frames import Statistics
from hardware.link.scanner import Scanner, ScannerStatistics
from hardware.readout.calibration import SensorCalibration
from hardware.recording import Recorder
from tripillar.board.session import scans

TOLD_S = 1.0  #: between two words on the progress
QUEUE = 2**14  #: scans that may wait while a disk or a busy machine holds the recorder up; 109 s at 150 Hz

Advance = Callable[[float, int, str | None], None]  #: seconds, scans, trouble


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """What came of it."""

    scans: int
    statistics: ScannerStatistics  #: lost and restarts as in the file, from its first scan to its last


def record_scans(
    scanner: Scanner,
    path: Path,
    seconds: float,
    calibration: SensorCalibration | None = None,
    made_from: Mapping[str, str] | None = None,
    append: bool = False,
    advance: Advance | None = None,
) -> Recorded:
    """Record for some seconds, or until Ctrl-C or the end of what is played.

    Parameters
    ----------
    calibration : SensorCalibration, optional
        Kept with the counts.
    made_from : mapping, optional
        Hashes of the model that the recording is meant for.
    append : bool
        Continue a recording of the same board, model and calibration.
    advance : callable, optional
        Told every second how it goes.

    Raises
    ------
    FileFormatError, RecordingError
        As `Recorder` does.
    """
    unix_s = time.time() - time.perf_counter()
    start = told = time.monotonic()
    last = None
    text = "" if calibration is None else calibration.to_json()
    with Recorder(path, scanner.info, text, made_from, append) as recorder:
        for scan in scans(scanner, seconds):
            if scan is not None:
                if last is not None and scan.run > last.run:
                    recorder.begin_run("restart" if scan.restarts > last.restarts else "reconnect")
                last = scan
                recorder.append(scan.frame, unix_s + scan.received_s)
            now = time.monotonic()
            if advance and now - told > TOLD_S:
                told = now
                advance(now - start, recorder.frames, scanner.trouble)
        statistics = replace(scanner.stats, lost=recorder.lost, restarts=recorder.restarts)
        kept = {each.name: getattr(statistics, each.name) for each in fields(Statistics)}
        recorder.close(Statistics(**kept))
    return Recorded(scans=recorder.frames, statistics=statistics)


def met_beside(met: ScannerStatistics) -> list[str]:
    """What else there was to meet, in words."""
    damaged = met.bad_cobs + met.bad_crc + met.bad_form
    named = {
        "damaged": damaged,
        "repeated": met.repeated,
        "of another board": met.foreign,
        "restarts": met.restarts,
        "reconnects": met.reconnects,
        "of the lost because this computer was too slow": met.dropped,
    }
    return [f"{n} {what}" for what, n in named.items() if n]
