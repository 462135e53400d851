"""Fit what is known of one sensor: gain and offset of its pillars, its state at rest."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from geometry.errors import DesignError
from tripillar.cli.board.options import (
    BAUD,
    TIMEOUT_S,
    BaudOption,
    CalibrationOption,
    ForceOption,
    LineOption,
    PortArgument,
    SwitchOption,
    TimeoutOption,
    electronics_of,
    require_positive,
    require_unused,
)
from tripillar.terminal.console import (
    DesignOption,
    JsonOption,
    VerbosityOption,
    answer,
    chosen,
    output_file,
    progress_bars,
)


def tare(
    port: PortArgument,
    out: Annotated[Path, typer.Option("--out", "-o", callback=output_file, help="Calibration file to write (JSON).")],
    calibration: CalibrationOption = None,
    switch_ohm: SwitchOption = None,
    line_ohm: LineOption = None,
    seconds: Annotated[float, typer.Option(help="Time to average over [s].")] = 2.0,
    baud: BaudOption = BAUD,
    timeout: TimeoutOption = TIMEOUT_S,
    force: ForceOption = False,
    json_: JsonOption = False,
) -> None:
    """Zero a sensor: take what it shows now, with nothing on it, as its rest."""
    import numpy as np

    from hardware.readout.averaging import averaged, require_still
    from hardware.readout.calibration import write_calibration
    from hardware.session import connect, counts_within

    require_positive(seconds=seconds, timeout=timeout)
    require_unused(out, calibration)
    with connect(port, calibration, baud=baud, timeout=timeout) as (scanner, known):
        electronics = electronics_of(known.electronics, switch_ohm, line_ohm)
        crossbar, counts = electronics.crossbar(scanner.info), counts_within(scanner, seconds)
        if not force:
            require_still(counts, crossbar, scanner.info.rate_hz, seconds)
        measured_ohm, noise = averaged(counts, crossbar)
        tared = replace(known, electronics=electronics, serial=scanner.info.serial).tared(measured_ohm)
    write_calibration(tared, out)
    rest_ohm = measured_ohm.astype(object)
    rest_ohm[np.isnan(measured_ohm)] = None  # JSON knows no NaN
    least, most = np.nanmin(measured_ohm), np.nanmax(measured_ohm)
    text = f"pillars rest at {least:.0f} to {most:.0f} Ω, known to {100 * noise:.2f} %"
    answer(json_, {"file": str(out), "noise": noise, "rest_ohm": rest_ohm.tolist()}, text, out)


def calibrate(
    port: PortArgument,
    out: Annotated[Path, typer.Option("--out", "-o", callback=output_file, help="Calibration file to write (JSON).")],
    loads: Annotated[
        Path | None,
        typer.Option(help="CSV file of known loads: load,row,col,fz_n and more; in a recording with from_s,to_s, too."),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(help="Calibration file to take switches and wires from; gains and tare are made anew."),
    ] = None,
    keep: Annotated[
        Path | None,
        typer.Option(help="Table (CSV) to which each pair is added once measured; one that is there is continued."),
    ] = None,
    weights: Annotated[
        bool, typer.Option("--weights", help="Ask for each weight, in grams, as you put it on.")
    ] = False,
    design: DesignOption = None,
    switch_ohm: SwitchOption = None,
    line_ohm: LineOption = None,
    noise: Annotated[float | None, typer.Option(help="Relative noise of a resistance; default: as measured.")] = None,
    seconds: Annotated[float, typer.Option(help="Time to average over under each load [s].")] = 1.0,
    baud: BaudOption = BAUD,
    timeout: TimeoutOption = TIMEOUT_S,
    force: ForceOption = False,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Find gain and offset of every pillar from known loads.

    One of the loads should be none at all. Gains suit models of the sensor as designed; identify finds more.
    """
    from hardware.readout.calibration import read_calibration, write_calibration
    from hardware.readout.known_loads import calibrated
    from tripillar.cli.board.measured_loads import measured_in_recording, measured_live
    from tripillar.pipeline.run import respond

    require_positive(seconds=seconds, timeout=timeout)
    require_unused(out, calibration)
    if (loads is None) != weights:
        raise DesignError("give either --loads FILE or --weights.")
    if noise is not None and not 0 < noise < 1:
        raise DesignError(f"--noise {noise:g} must be above 0 and below 1; 0.001 is 0.1 % of a resistance.")
    sensor = chosen(design)
    known = None if calibration is None else read_calibration(calibration).electronics
    electronics = electronics_of(known, switch_ohm, line_ohm)
    if not Path(port).is_file():
        pairs, serial = measured_live(
            port, loads, sensor, electronics, seconds, force, keep, baud=baud, timeout=timeout
        )
    elif keep is not None:
        raise DesignError("--keep is for a board: pairs of a recording are kept already.")
    elif loads is not None:
        pairs, serial = measured_in_recording(Path(port), loads, sensor, electronics, force)
    else:
        raise DesignError("a recording needs --loads FILE with the columns from_s and to_s.")
    with progress_bars(verbosity) as bars:
        _, solved = respond(sensor, bars)
    found, residual = calibrated(pairs, solved, electronics, serial, noise, force)
    write_calibration(found, out)
    result = {
        "file": str(out),
        "loads": len(pairs),
        "noise": found.made_from["noise"],
        "gain": [float(found.gain.min()), float(found.gain.max())],
        "offset_ohm": [float(found.offset_ohm.min()), float(found.offset_ohm.max())],
        "residual": residual,
    }
    text = (
        f"{len(pairs)} loads: gains {found.gain.min():.3f} to {found.gain.max():.3f}, offsets "
        f"{found.offset_ohm.min():.0f} to {found.offset_ohm.max():.0f} Ω; what is left: {100 * residual:.2f} %"
    )
    answer(json_, result, text, out)
