"""Read a sensor on the table, its recordings, or a board that is not there."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geometry.design import SensorDesign
from tripillar.face.bodies import response

if TYPE_CHECKING:
    from decoupler.model.decoupler import Decoupler
    from fem.array.response import ArrayResponse
    from hardware.link.frames import Info
    from hardware.readout.forces import Forces


@contextmanager
def simulated_board(
    sensor: "SensorDesign | ArrayResponse | None" = None,
    *,
    pressure_mpa: float = 3.0,
    period_s: float = 6.0,
    rate_hz: int = 150,
    bits: int = 10,
    link: Path | str | None = None,
) -> Iterator[str]:
    """Press a simulated sensor again and again, behind a port that sends what a board would send.

    Parameters
    ----------
    sensor : SensorDesign or ArrayResponse, optional
        Default: the paper's sensor.
    pressure_mpa : float
        Largest pressure of an indenter that comes down on a corner, slides to the opposite one, and lifts; 0: at rest.
    period_s : float
        Time from one press to the next [s].
    rate_hz : int
        Scans a second.
    bits : int
        Bits of the converter.
    link : path, optional
        Link of this name to the port.

    Yields
    ------
    str
        The port's name, for `live` and `record`, as long as the with block lasts.

    Examples
    --------
    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> model = tp.train(tp.simulate(design, samples=200, noise=0.001, bits=10), hidden=4)
    >>> with tp.simulated_board(design) as port, tp.live(port, model) as scans:
    ...     scan = next(iter(scans))
    >>> scan.force_n.shape, scan.deviation_n.shape
    ((1, 2, 3), (1, 2, 3))
    """
    from dataset.imperfections import Imperfections
    from hardware.boards.simulated import PressAndSlide, counts_over_time, press_and_slide, run_board
    from hardware.readout.calibration import Electronics

    solved = response(sensor) if sensor is None or isinstance(sensor, SensorDesign) else sensor
    rows, cols = solved.design.array.rows, solved.design.array.cols
    info = info_of(rows=rows, cols=cols, bits=bits, rate_hz=rate_hz)
    motion = press_and_slide(solved, PressAndSlide(peak_mpa=pressure_mpa, seconds=period_s))
    counts = counts_over_time(motion, Electronics().crossbar(info), Imperfections())
    with run_board("python", info, counts, None if link is None else Path(link)) as board:
        yield str(link or board.port)


def info_of(mode: str = "zero-potential", sense_ohm: int | None = None, **told: Any) -> "Info":
    """INFO frame of a simulated board; its sense resistor suits pillars of 10 kΩ unless another is given."""
    from hardware.link.frames import Info
    from hardware.readout.crossbar import SUITED_SENSE_OHM, scan_mode_named

    scan_mode = scan_mode_named(mode)
    sense = round(SUITED_SENSE_OHM[scan_mode]) if sense_ohm is None else sense_ohm
    return Info(scan_mode=scan_mode, sense_ohm=sense, **told)


def record(
    port: str,
    path: Path | str,
    seconds: float,
    *,
    calibration: Path | str | None = None,
    append: bool = False,
    **settings: Any,
) -> int:
    """Record what a board sends, raw, as it comes; a killed recording loses one scan.

    Parameters
    ----------
    port : str
        As of `live`.
    path : path
        File to write; it ends in .frames.
    seconds : float
        Time to record for [s]; `math.inf`: until Ctrl-C.
    calibration : path, optional
        Calibration file of this sensor, which is kept with the scans.
    append : bool
        True continues the recording, of the same board.
    **settings
        Of `hardware.Scanner`, such as baud.

    Returns
    -------
    int
        Scans recorded.

    Examples
    --------
    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> with tp.simulated_board(design) as port:
    ...     scans = tp.record(port, Path(mkdtemp()) / "press.frames", 0.2)
    >>> scans > 0
    True
    """
    from hardware.session import RECORDING_QUEUE, connect, record_scans

    stated = None if calibration is None else Path(calibration)
    with connect(port, stated, queue=RECORDING_QUEUE, **settings) as (scanner, known):
        return record_scans(scanner, Path(path), seconds, known if calibration else None, append=append)[0]


def replay(
    recording: Path | str,
    model: "Decoupler | Path | str",
    *,
    calibration: Path | str | None = None,
) -> "Forces":
    """Forces of every scan of a recording.

    Parameters
    ----------
    recording : path
        File of `record`, or what `tripillar convert` made of one.
    model : Decoupler or path
        Trained for this array, or its file.
    calibration : path, optional
        Calibration file in place of the one that the recording holds.

    Returns
    -------
    Forces
        ``time_s`` (n,), ``force_n`` and ``deviation_n`` (n, rows, cols, axes) [N]: forces and the half-widths that hold
        68 % of their errors, and `wrench`, the net load; computed when first asked for, twenty times as long as forces.

    Examples
    --------
    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> design, file = tp.SensorDesign(), Path(mkdtemp()) / "press.frames"
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> with tp.simulated_board(design) as port:
    ...     scans = tp.record(port, file, 0.2)
    >>> model = tp.train(tp.simulate(design, samples=200, noise=0.001, bits=10), hidden=4)
    >>> tp.replay(file, model).force_n.shape == (scans, 1, 2, 3)
    True
    """
    from decoupler.model.model_file import read_model
    from hardware.readout.calibration import read_calibration
    from hardware.readout.forces import replay
    from hardware.recording import read_recording

    trained = read_model(Path(model)) if isinstance(model, Path | str) else model
    known = None if calibration is None else read_calibration(Path(calibration))
    return replay(read_recording(Path(recording)), trained, known)
