"""A connected board and what is done with it: watch its forces, average it, record it, measure its link.

`connect` opens a port or plays a recording; `live` adds a model, and gives the forces of each scan.
"""

import logging
import math
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from common.threads import one_blas_thread
from geometry.design import Memory
from geometry.layout import FloatArray
from hardware.link.frames import Statistics
from hardware.link.lines import MATRIX, matrix_info
from hardware.link.protocols import spoken_on
from hardware.link.reception import LinkStatistics, Scan
from hardware.link.scanner import Scanner, ScannerError
from hardware.link.serial_ports import is_beginning, no_such_port
from hardware.readout.averaging import min_scans
from hardware.readout.calibration import SensorCalibration, read_calibration
from hardware.readout.forces import LiveSensor
from hardware.recording import PlaybackPort, Recorder, read_recording

if TYPE_CHECKING:
    from decoupler.model.decoder import Decoder
    from decoupler.rubber.belief import SensorFilter

APPEARS_S = 10.0  #: longest wait for a port that is about to appear
LOOK_S = 0.05  #: between two looks for it
RECORDED = (".frames", ".nc", ".mcap", ".csv", ".txt", ".log")  #: endings of files, which do not appear by themselves
BATCH_S = 0.1  #: longest wait for a scan; then the caller may do other work
REPORT_S = 1.0  #: between two reports of a recording's progress
noted_signals = [0]  #: by `ended_by_signal`, so that who watches for signals leaves these alone
RECORDING_QUEUE = 2**14  #: scans that may wait while disk or machine hold the recorder up; 109 s at 150 Hz


@contextmanager
def connect(
    port: str, calibration: Path | str | None = None, speed: float = 1.0, **settings: Any
) -> Iterator[tuple[Scanner, SensorCalibration]]:
    """Scan a board, or a recording that is played, as long as the with block lasts; raises and parameters as of `live`.

    A device that is not there is waited for up to `APPEARS_S`.
    """
    source: Any = port
    known = None if calibration is None else read_calibration(Path(calibration))
    stated = matrix_info(**{name: settings.pop(name) for name in MATRIX if name in settings})
    _await(spoken_on(port, stated)[1])
    if Path(port).is_file() or (Path(port).suffix in RECORDED and not Path(port).exists()):
        recording = read_recording(Path(port), stated)
        source = PlaybackPort(recording, speed=speed)
        settings = settings | {"queue": len(recording.counts)}  # a recording waits for its reader
        if known is None and recording.calibration:
            known = SensorCalibration.from_json(recording.calibration, f"the calibration in {port}")
    # one scan's matrices are too small for two BLAS threads to share
    with one_blas_thread(), Scanner(source, stated=stated, **settings) as scanner:
        info = scanner.info
        known = known or SensorCalibration.as_designed(info.rows, info.cols, layout=info.layout)
        known.require_for(info, str(calibration or port))
        yield scanner, known


def _await(port: str) -> None:
    """Wait for a device, or the link to one: a board that begins, or up to `APPEARS_S` for one that is plugged in.

    It is said that it is waited for; where no port can appear, such as in a folder that is missing, nothing is.
    """
    is_file = "://" in port or Path(port).suffix in RECORDED
    may_appear = sys.platform != "win32" and port and not is_file and Path(port).parent.is_dir()
    end_s, is_said = time.monotonic() + APPEARS_S * bool(may_appear), False
    while not Path(port).exists() and (time.monotonic() < end_s or (may_appear and is_beginning(port))):
        if not is_said:
            is_said = True
            logging.getLogger("tripillar").warning("%s: %s; waiting %g s for it", port, no_such_port(), APPEARS_S)
        time.sleep(LOOK_S)


@contextmanager
def live(
    port: str,
    model: "Decoder | Path | str",
    calibration: Path | str | None = None,
    speed: float = 1.0,
    rubber: Path | str | None = None,
    **settings: Any,
) -> Iterator[LiveSensor]:
    """Read forces from a board, or from a recording that is played, as long as the with block lasts.

    Parameters
    ----------
    port : str
        Serial port (/dev/ttyACM0, COM3), ``socket://host:port``, or the path of a recording.
    model : Decoupler or Path
        A trained model or its file.
    calibration : Path, optional
        Calibration file. Default: the one that a recording holds, else the sensor is taken to be as designed.
    speed : float
        Pace of a recording: 1 is as recorded, `math.inf` as fast as it is read.
    rubber : Path, optional
        Rubber file of `tripillar rubber`, whose memory is taken out of the readings once they have tested it, in a hold
        or a rest. Default: the memory of the model's design, if any, from the first scan on.
    **settings
        As of `Scanner`, and of `matrix_info` for what sends lines of numbers.

    Yields
    ------
    LiveSensor
        Iterate over it for the `Forces` of each scan. Its `scanner` has the board's `info`, `stats` and `trouble`.

    Raises
    ------
    FileFormatError
        If board, model and calibration do not belong together.
    PortError, ScannerError
        If the port cannot be opened, or no board answers.

    Examples
    --------
    ::

        with live("/dev/ttyACM0", "model.safetensors") as scans:
            for scan in scans:
                print(scan.time_s, scan.force_n[2, 3], scan.deviation_n[2, 3])
    """
    from decoupler.model_file import read_model

    decoder = read_model(Path(model)) if isinstance(model, Path | str) else model
    causal = follows(decoder, rubber)
    with connect(port, calibration, speed, **settings) as (scanner, known):
        yield LiveSensor(scanner, decoder, known, causal)


def follows(model: "Decoder", rubber: Path | str | None = None) -> "SensorFilter | None":
    """What follows the memory of a rubber file, or of the model's design; None if there is none to follow.

    A design says what its sensor is; that the sensor is of a file's rubber its readings have to show first.
    """
    from decoupler.rubber.belief import SensorFilter
    from decoupler.rubber.rubber_file import read_rubber

    if rubber is not None:
        return SensorFilter.of_rubber(read_rubber(Path(rubber)))
    memory = Memory() if model.design is None else model.design.pillar_material.memory
    return None if memory == Memory() else SensorFilter(memory=memory, is_tested=True)


def scans_within(
    scanner: Scanner, seconds: float = math.inf, ends_by_signal: bool = True, least: int = 0
) -> Iterator[Scan | None]:
    """Scans as they come, for some seconds, until a recording ends or Ctrl-C; None where none came for `BATCH_S`.

    While fewer than `least` have come, of a slow board or to a busy computer, it goes on until the scanner has trouble.
    """
    end_s, n = time.monotonic() + seconds, 0
    with ended_by_signal() if ends_by_signal else nullcontext(lambda: 0) as is_ended:
        while not is_ended() and (time.monotonic() < end_s or (n < least and not scanner.trouble)):
            scan = scanner.get(timeout=min(BATCH_S, max(end_s - time.monotonic(), LOOK_S)))
            n += scan is not None
            if scan is None and scanner.ended:
                return
            yield scan


@contextmanager
def ended_by_signal() -> Iterator[Callable[[], int]]:
    """Note Ctrl-C or a termination instead of ending at once; a second one interrupts. Yields: its number, 0 before."""
    came: list[int] = []

    def note(number: int, _: object) -> None:
        if came:
            raise KeyboardInterrupt
        came.append(number)
        noted_signals[0] += 1

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: came[0] if came else 0
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def counts_within(scanner: Scanner, seconds: float) -> NDArray[Any]:
    """Counts of the scans of some seconds from now, (n, n_crossings).

    Where fewer come than the board's rate promises, to a busy computer, it goes on until they tell motion from noise.

    Raises
    ------
    ScannerError
        If no scan comes, or the board is lost meanwhile.
    """
    while scanner.get(timeout=0.0):  # what was scanned before now
        pass
    rate_hz = scanner.info.rate_hz
    least = max(1, min(min_scans(rate_hz), int(seconds * rate_hz)))
    counts = [scan.frame.counts for scan in scans_within(scanner, seconds, ends_by_signal=False, least=least) if scan]
    if not counts or scanner.trouble:
        came = f"{len(counts)} scans" if counts else "no scan"
        raise ScannerError(f"{came} within {seconds:g} s: {scanner.trouble or 'is the board still connected?'}")
    return np.array(counts)


def hashes_of(model: "Decoder") -> dict[str, str]:
    """Hashes of the model and its design, which a recording keeps."""
    hashes = {"model_recipe": model.made_from.get("recipe"), "design_hash": model.design_hash}
    return {name: str(value) for name, value in hashes.items() if value}


def record_scans(
    scanner: Scanner,
    path: Path,
    seconds: float = math.inf,
    calibration: SensorCalibration | None = None,
    made_from: Mapping[str, str] | None = None,
    append: bool = False,
    advance: Callable[[float, int, str | None], None] | None = None,
) -> tuple[int, LinkStatistics]:
    """Record for some seconds, or until Ctrl-C or the end of what is played.

    Calibration and hashes of the model (`hashes_of`) are kept with the counts; `append` continues a recording of the
    same. `advance` is called every second with the seconds, the scans so far and the scanner's trouble. Returns the
    scans recorded and what the scanner met; raises as `Recorder`.
    """
    unix_s = time.time() - time.perf_counter()
    start = reported_s = time.monotonic()
    last = None
    text = "" if calibration is None else calibration.to_json()
    with Recorder(path, scanner.info, text, made_from, append) as recorder:
        for scan in scans_within(scanner, seconds, least=1):
            if scan is not None:
                if last is not None and scan.run > last.run:
                    recorder.begin_run("restart" if scan.restarts > last.restarts else "reconnect")
                last = scan
                recorder.append(scan.frame, unix_s + scan.received_s)
            now = time.monotonic()
            if advance and now - reported_s > REPORT_S:
                reported_s = now
                advance(now - start, recorder.frames, scanner.trouble)
        statistics = scanner.stats
        recorder.close(Statistics(**{each.name: getattr(statistics, each.name) for each in fields(Statistics)}))
    return recorder.frames, statistics


def measure_link(scanner: Scanner, sensor: LiveSensor | None, seconds: float) -> dict[str, Any]:
    """Read a board for some seconds, with the forces of every scan if there is a sensor.

    Returns
    -------
    dict
        ``seconds``, ``scans``, the ``rate_hz`` of scans received by the host's clock and the ``device_rate_hz`` of
        scans made by the board's, ``jitter_us`` (standard deviation of arrivals about the board's clock),
        ``latency_ms`` of a sensor (last byte read -> forces: median, p99, worst) and the link's ``statistics``.

    Raises
    ------
    ScannerError
        If fewer than three scans come.
    """
    arrivals, device_us, latencies = [], [], []
    for scan in scans_within(scanner, seconds, least=3):
        if scan is None:
            continue
        if sensor is not None:
            sensor.forces(scan)
            latencies.append(time.perf_counter() - scan.received_s)
        arrivals.append(scan.received_s)
        device_us.append(scan.frame.device_us)
    if len(arrivals) < 3:
        raise ScannerError(
            f"{len(arrivals)} scans within {seconds:g} s are too few: {scanner.trouble or 'wait longer'}."
        )
    ticks_us = np.array(device_us, dtype=np.uint32)
    steps_s = 1e-6 * (ticks_us[1:] - ticks_us[:-1])  # u32 differences wrap as the board's clock does
    waits_s = np.diff(arrivals)
    return {
        "seconds": arrivals[-1] - arrivals[0],
        "scans": len(arrivals),
        "rate_hz": float(1.0 / waits_s.mean()),
        "device_rate_hz": float(1.0 / steps_s.mean()) if steps_s.any() else 0.0,
        "jitter_us": float(1e6 * (waits_s - steps_s).std() / np.sqrt(2.0)),
        "latency_ms": None if sensor is None else milliseconds(np.array(latencies)),
        "statistics": asdict(scanner.stats),
    }


def milliseconds(latency_s: FloatArray) -> dict[str, float]:
    """Median, 99th percentile and worst of some latencies [s], in ms."""
    median, p99, worst = 1e3 * np.quantile(latency_s, [0.5, 0.99, 1.0])
    return {"median": float(median), "p99": float(p99), "worst": float(worst)}
