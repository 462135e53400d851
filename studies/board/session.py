"""One board, one model: scans from a port or a recording, and the forces of each."""

import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from decoupler.decoupler import Decoupler
from decoupler.model_file import read_model
from geometry.files import digest
from geometry.layout import FloatArray
from hardware.calibration import SensorCalibration, read_calibration
from hardware.frames import Info
from hardware.live import ForceReader
from hardware.recording import read_recording
from hardware.recording.playback import PlaybackPort
from hardware.scanner import Scanner, ScannerError

if TYPE_CHECKING:
    from hardware.reception import Scan

BATCH_S = 0.1  #: longest wait for a scan, so that what else there is to do is done
REHEARSED_S = 1.2e-3  #: before a scan is due; less gets in its way when it comes early, more is forgotten
MOST_FOR_NOISE = 200  #: scans that tell how much a resistance varies


@contextmanager
def scanner_on(port: str, speed: float = 1.0, **settings: Any) -> Iterator[Scanner]:
    """A scanner on what `open_port` opens, or on a recording, played at `speed` times its pace."""
    source: Any = port
    if Path(port).is_file():
        source = PlaybackPort(read_recording(Path(port)), speed=speed)
    # one scan's matrices are too small for two BLAS threads to share
    with threadpool_limits(1, "blas"), Scanner(source, **settings) as scanner:
        yield scanner


@dataclass(frozen=True, kw_only=True, eq=False)
class LiveForces:
    """Forces of one scan; k components as the model gives them."""

    force_n: FloatArray  #: (rows, cols, k)
    resistance_ohm: FloatArray  #: (1, rows, cols, 3): as the model saw them
    n_saturated: int  #: pillars whose counts are at an end of the converter's range


class Session:
    """A model's forces of a board's scans.

    Parameters
    ----------
    scanner : Scanner
        Entered.
    model : Decoupler
    calibration : SensorCalibration, optional

    Raises
    ------
    FileFormatError
        If board, model and calibration do not belong together.
    """

    def __init__(self, scanner: Scanner, model: Decoupler, calibration: SensorCalibration | None = None) -> None:
        self.scanner, self.model = scanner, model
        self.reader = ForceReader(scanner.info, model, calibration)

    def forces(self, scan: "Scan") -> LiveForces:
        """Of one scan."""
        found = self.reader.forces(scan.frame.counts[None])
        return LiveForces(
            force_n=found.force_n[0], resistance_ohm=found.resistance_ohm, n_saturated=int(found.saturated.sum())
        )

    def deviations(self, found: LiveForces) -> FloatArray | None:
        """Half-widths that hold 68 % of errors, (rows, cols, k) [N]; None if the model knows no uncertainty."""
        return None if self.model.uncertainty is None else self.model.deviations(found.resistance_ohm)[0][0]


def session(scanner: Scanner, model: Path, calibration: Path | None) -> Session:
    """Of the files of a model and of a calibration."""
    return Session(
        scanner, read_model(model), None if calibration is None else chosen_calibration(calibration, scanner)
    )


def chosen_calibration(path: Path | None, scanner: Scanner) -> SensorCalibration:
    """The calibration of a file; as designed without one."""
    info = scanner.info
    if path is None:
        return SensorCalibration.as_designed(info.rows, info.cols)
    calibration = read_calibration(path)
    calibration.require_for(info, str(path))
    return calibration


def hashes_of(model: Decoupler) -> dict[str, str]:
    """What a recording keeps of the model that it is meant for."""
    found = {"model_recipe": model.made_from.get("recipe"), "design_hash": model.design and digest(model.design)}
    return {name: str(value) for name, value in found.items() if value}


def scans(
    scanner: Scanner, seconds: float = math.inf, rehearse: Callable[["Scan"], object] | None = None
) -> Iterator["Scan | None"]:
    """Scans as they come, for some seconds, until a recording ends or Ctrl-C; None where none came for `BATCH_S`.

    `rehearse` is given the last scan once more a little before the next is due. What it touches is then still in the
    processor's caches when the next scan is worked on, which 6 ms of waiting would empty: without a rehearsal forces
    take 0.44 ms, with it 0.29.
    """
    end_s = time.monotonic() + seconds
    ahead_s = 1.0 / scanner.info.rate_hz - REHEARSED_S
    with ended_by_signal() as is_ended:
        scan = None
        while not is_ended() and time.monotonic() < end_s:
            last, scan = scan, None
            if rehearse and last and ahead_s > 0.0:
                scan = scanner.get(timeout=max(0.0, last.received_s + ahead_s - time.perf_counter()))
                if scan is None:
                    rehearse(last)
            if scan is None:
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


def mean_resistances(scanner: Scanner, calibration: SensorCalibration, seconds: float) -> tuple[FloatArray, float]:
    """What the crossbar gives, (rows, cols, 3) [Ω], averaged over some seconds from now, and the readings' noise.

    Returns
    -------
    resistance_ohm : array, shape (rows, cols, 3)
    noise : float
        Relative standard deviation of a resistance from one scan to the next: the median over pillars.

    Raises
    ------
    ScannerError
        If no scan comes.
    """
    while scanner.get(timeout=0.0):  # what was scanned before now
        pass
    taken = [scan.frame.counts for scan in scans(scanner, seconds) if scan is not None]
    if not taken:
        raise ScannerError(f"no scan within {seconds:g} s: {scanner.trouble or 'is the board still connected?'}")
    return averaged(np.array(taken), scanner.info, calibration)


def averaged(counts: NDArray[Any], info: Info, calibration: SensorCalibration) -> tuple[FloatArray, float]:
    """Mean resistances (rows, cols, 3) [Ω] of counts (n, n_crossings) and their noise, as `mean_resistances` gives."""
    crossbar = calibration.electronics.crossbar(info)
    readings, _ = crossbar.fractions(counts.mean(axis=0, keepdims=True))
    mean_ohm = crossbar.correct(readings)[0]
    some = crossbar.correct(crossbar.fractions(counts[-MOST_FOR_NOISE:])[0])
    return mean_ohm, float(np.median(some.std(axis=0) / mean_ohm))
