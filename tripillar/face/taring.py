"""Zero a sensor: what it shows with nothing on it is its rest."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.errors import FileFormatError
from tripillar.face.boards import BAUD, TIMEOUT_S
from tripillar.face.caller import current
from tripillar.face.inputs import File, given, require_above_0, to_write

if TYPE_CHECKING:
    from hardware.readout.calibration import SensorCalibration


def tare(
    port: str,
    /,
    *,
    out: File,
    calibration: File | None = None,
    switch_ohm: float | None = None,
    line_ohm: float | None = None,
    seconds: float = 2.0,
    baud: int = BAUD,
    timeout: float = TIMEOUT_S,
    force: bool = False,
) -> "SensorCalibration":
    """Zero a sensor: take what it shows now, with nothing on it, as its rest.

    `identify --help` says when to identify it instead.

    Parameters
    ----------
    port : str
        Serial port, socket://host:port, or a recording.
    out : path
        Calibration file to write (.json).
    calibration : path, optional
        Calibration file of this sensor to build on; default: as designed, switches of 25 Ω.
    switch_ohm : float, optional
        Resistance of a closed switch [Ω]; default: 25.
    line_ohm : float, optional
        Resistance of a wire to the pillars [Ω]; default: 0.
    seconds : float
        Time to average over [s].
    baud, timeout
        As of `boards.info`.
    force : bool
        Write the file even if the readings cannot be what they should be.

    Returns
    -------
    SensorCalibration
        What was known of the sensor, and its rest.
    """
    caller, path = current(), to_write("out", out)
    assert path is not None
    require_above_0(seconds=seconds, timeout=timeout)
    if path.exists() and (calibration is None or path.resolve() != Path(calibration).resolve()):
        raise FileFormatError(f"{path}: the file exists: build on it by calibration={path}, or give another name.")
    import numpy as np

    from hardware.readout.averaging import averaged, require_still
    from hardware.readout.calibration import write_calibration
    from hardware.session import connect, counts_within

    with connect(port, calibration, baud=baud, timeout=timeout) as (scanner, known):
        electronics = replace(known.electronics, **given(switch_ohm=switch_ohm, line_ohm=line_ohm))
        crossbar, counts = electronics.crossbar(scanner.info), counts_within(scanner, seconds)
        if not force:
            require_still(counts, crossbar, scanner.info.rate_hz, seconds)
        measured_ohm, noise = averaged(counts, crossbar)
        tared = replace(known, electronics=electronics, serial=scanner.info.serial).tared(measured_ohm)
    write_calibration(tared, path)
    rest_ohm = measured_ohm.astype(object)
    rest_ohm[np.isnan(measured_ohm)] = None  # JSON knows no NaN
    least, most = np.nanmin(measured_ohm), np.nanmax(measured_ohm)
    text = f"pillars rest at {least:.0f} to {most:.0f} Ω, known to {100 * noise:.2f} %"
    caller.answer(lambda: {"file": str(path), "noise": noise, "rest_ohm": rest_ohm.tolist()}, text, path)
    return tared
