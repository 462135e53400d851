"""One board, one model: scans from a port or a recording, and the forces of each."""

import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from decoupler.model.decoupler import Decoupler
from geometry.errors import FileFormatError
from geometry.layout import PILLARS, FloatArray
from hardware.link.scanner import Scanner, ScannerError
from hardware.readout.calibration import SensorCalibration, read_calibration
from hardware.readout.correction import Corrector
from hardware.readout.crossbar import Crossbar
from hardware.readout.live import ForceReader, Forces
from hardware.recording import read_recording
from hardware.recording.playback import PlaybackPort

if TYPE_CHECKING:
    from hardware.link.reception import Scan

BATCH_S = 0.1  #: longest wait for a scan, so that what else there is to do is done
MAX_FOR_NOISE = 200  #: scans that tell how much a resistance varies


@contextmanager
def board_on(
    port: str, calibration: Path | None = None, speed: float = 1.0, **settings: Any
) -> Iterator[tuple[Scanner, SensorCalibration]]:
    """A scanner on what `open_port` opens, or on a recording played at `speed` times its pace; and what is known of it.

    That is the calibration of a file, else the one that a recording holds, else that of a sensor as designed.

    Raises
    ------
    FileFormatError
        If the calibration is of another board.
    """
    source: Any = port
    known = None if calibration is None else read_calibration(calibration)
    if Path(port).is_file():
        recording = read_recording(Path(port))
        source = PlaybackPort(recording, speed=speed)
        settings = settings | {"queue": len(recording.counts)}  # a recording waits for its reader
        if known is None and recording.calibration:
            known = SensorCalibration.from_json(recording.calibration, f"the calibration in {port}")
    # one scan's matrices are too small for two BLAS threads to share
    with threadpool_limits(1, "blas"), Scanner(source, **settings) as scanner:
        info = scanner.info
        known = known or SensorCalibration.as_designed(info.rows, info.cols)
        known.require_for(info, str(calibration or port))
        yield scanner, known


class Session:
    """A model's forces of a board's scans.

    Raises
    ------
    FileFormatError
        If board, model and calibration do not belong together.
    """

    def __init__(self, scanner: Scanner, model: Decoupler, calibration: SensorCalibration) -> None:
        self.scanner, self.model = scanner, model
        self.reader = ForceReader(scanner.info, model, calibration)

    def forces(self, scan: "Scan") -> Forces:
        """Of one scan: arrays of length 1."""
        return self.reader.forces(scan.frame.counts[None])

    def deviations(self, found: Forces) -> FloatArray | None:
        """Half-widths that hold 68 % of errors, (rows, cols, k) [N]; None if the model knows no uncertainty."""
        deviation_n = self.reader.deviations(found)
        return None if deviation_n is None else deviation_n[0]


def hashes_of(model: Decoupler) -> dict[str, str]:
    """What a recording keeps of the model that it is meant for."""
    found = {"model_recipe": model.made_from.get("recipe"), "design_hash": model.design_hash}
    return {name: str(value) for name, value in found.items() if value}


def scans(scanner: Scanner, seconds: float = math.inf) -> Iterator["Scan | None"]:
    """Scans as they come, for some seconds, until a recording ends or Ctrl-C; None where none came for `BATCH_S`."""
    end_s = time.monotonic() + seconds
    with ended_by_signal() as is_ended:
        while not is_ended() and time.monotonic() < end_s:
            scan = scanner.get(timeout=min(BATCH_S, max(0.0, end_s - time.monotonic())))
            if scan is None and scanner.ended:
                return
            yield scan


@contextmanager
def ended_by_signal() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C or a termination has come, so that what is at hand can be finished; a second one interrupts."""
    came: list[int] = []

    def note(number: int, _: object) -> None:
        if came:
            raise KeyboardInterrupt
        came.append(number)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def counts_within(scanner: Scanner, seconds: float) -> NDArray[Any]:
    """Counts of the scans of some seconds from now, (n, n_crossings).

    Raises
    ------
    ScannerError
        If no scan comes, or the board is lost meanwhile.
    """
    while scanner.get(timeout=0.0):  # what was scanned before now
        pass
    taken, end_s = [], time.monotonic() + seconds
    while (left_s := end_s - time.monotonic()) > 0.0 and not scanner.ended:
        scan = scanner.get(timeout=min(BATCH_S, left_s))
        if scan is not None:
            taken.append(scan.frame.counts)
    if not taken or scanner.trouble:
        came = f"{len(taken)} scans" if taken else "no scan"
        raise ScannerError(f"{came} within {seconds:g} s: {scanner.trouble or 'is the board still connected?'}")
    return np.array(taken)


def averaged(counts: NDArray[Any], crossbar: Crossbar) -> tuple[FloatArray, float]:
    """Mean resistances of counts (n, n_crossings), and how far to trust them.

    Returns
    -------
    resistance_ohm : array, shape (rows, cols, 3)
        As the crossbar gives them [Ω]; NaN where a count is 0, open.
    noise : float
        Relative standard deviation of these: the median over pillars of scatter and converter's steps together.

    Raises
    ------
    FileFormatError
        If a pillar reads full scale: it lies below what the converter can tell.
    """
    readings, is_bound = crossbar.fractions(counts)
    is_open = crossbar.as_pillars(np.any(counts == 0, axis=0, keepdims=True))[0]
    is_short = crossbar.as_pillars(np.any(is_bound, axis=0, keepdims=True))[0] & ~is_open
    if is_short.any():
        row, col, pillar = np.argwhere(is_short)[0]
        raise FileFormatError(
            f"pillar {PILLARS[pillar]} of row {row}, col {col} reads full scale, so its resistance is unknown: "
            f"choose a smaller sense resistor than {crossbar.sense_ohm:g} Ω, or mend a short."
        )
    mean_ohm = Corrector(crossbar).correct(readings.mean(axis=0, keepdims=True))
    some = Corrector(crossbar).correct(readings[-MAX_FOR_NOISE:])
    scatter = some.std(axis=0) / mean_ohm[0] / math.sqrt(len(some))
    noise = np.hypot(scatter, crossbar.step_deviation(mean_ohm))
    return np.where(is_open, np.nan, mean_ohm[0]), float(np.median(noise[~is_open]))
