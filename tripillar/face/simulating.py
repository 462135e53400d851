"""A board that is not there: a simulated sensor that is pressed, behind a port that sends what a real one would."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from dataset.imperfections import Imperfections
from geometry.design import SensorDesign
from geometry.errors import DesignError
from tripillar.face.caller import current
from tripillar.face.inputs import DesignLike, File, Options, design_of, given, to_write

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse
    from hardware.link.frames import Info

    SensorLike = DesignLike | ArrayResponse
else:
    SensorLike = Path

OFFSET = Annotated[float, Parameter(name="--offset")]
SPECIMEN = Options(Imperfections, "gain_spread", "offset_ohm", "specimen", offset_ohm=OFFSET)


@contextmanager
def board(
    design: SensorLike | None = None,
    *,
    chip: Annotated[Literal["auto", "atmega328p", "atmega2560", "python"], Parameter(name="--board")] = "auto",
    link: File | None = None,
    pressure_mpa: float = 3.0,
    period_s: float = 6.0,
    mode: Literal["zero-potential", "grounded", "divider"] = "zero-potential",
    rate_hz: int = 150,
    sense_ohm: int | None = None,
    switch_ohm: float | None = None,
    line_ohm: float | None = None,
    noise: float = 0.0,
    bits: int = 10,
    serial: int = 0,
    truth: File | None = None,
    **specimen: Annotated[Any, SPECIMEN],
) -> Iterator[str]:
    """Simulate a board: a port that sends what a real one would.

    Where simavr is installed, the very firmware runs on a simulated chip. The port is a pseudo-terminal.

    Parameters
    ----------
    design : SensorDesign, ArrayResponse or path, optional
        Design file (TOML); default: the paper's sensor.
    chip : str
        Board to be: the firmware on a simulated chip, or the same frames from Python.
    link : path, optional
        Link of this name to the port, to be kept while it runs.
    pressure_mpa : float
        Largest pressure of an indenter that comes down on a corner, slides to the opposite one, and lifts [MPa]; 0: at
        rest.
    period_s : float
        Period of the press and slide [s].
    mode : str
        Circuit that reads the array.
    rate_hz : int
        Number of scans a second.
    sense_ohm : int, optional
        Sense or feedback resistor [Ω]; default: one that suits 10 kΩ.
    switch_ohm, line_ohm
        As of `taring.tare`.
    noise : float
        Standard deviation of a reading, as a fraction of full scale.
    bits : int
        Bits of the converter; chips have 10.
    serial : int
        Serial number of the board.
    truth : path, optional
        NetCDF file to write: the true forces of one period.
    **specimen
        The fields gain_spread, offset_ohm and specimen of `dataset.Imperfections`.

    Yields
    ------
    str
        The port's name, for `live` and `record`, as long as the with block lasts.

    Examples
    --------
    >>> import tripillar as tp
    >>> from geometry import Array
    >>> design = tp.SensorDesign(array=Array(rows=1, cols=2))
    >>> model = tp.train(tp.dataset(design, samples=200, noise=0.001, bits=10), hidden=4)
    >>> with tp.board(design, chip="python") as port, tp.live(port, model) as scans:
    ...     scan = next(iter(scans))
    >>> scan.force_n.shape, scan.deviation_n.shape
    ((1, 2, 3), (1, 2, 3))
    """
    caller = current()
    written = to_write("truth", truth, ".nc")
    kept = None if link is None else Path(link)
    if kept is not None and kept.exists() and not kept.is_symlink():
        raise DesignError(f"link={kept} exists and is no link: give another name for the link to the port.")
    if not 0.1 <= period_s <= 600:
        raise DesignError(f"period_s={period_s:g} must be from 0.1 to 600 s.")
    if sys.platform == "win32":
        from hardware.boards.virtual_board import NO_TERMINALS

        raise DesignError(NO_TERMINALS)
    from hardware.link.serial_ports import claimed

    with claimed(kept):  # what follows takes seconds to load and to solve
        from hardware.boards.simulated import (
            PressAndSlide,
            counts_over_time,
            press_and_slide,
            run_board,
            suited_kind,
            write_truth,
        )
        from hardware.readout.calibration import Electronics
        from tripillar.pipeline.run import respond

        told = info_of(mode, sense_ohm, bits=bits, rate_hz=rate_hz, serial=serial)
        electronics = Electronics(**given(switch_ohm=switch_ohm, line_ohm=line_ohm))
        replace(electronics.crossbar(told), noise=noise)  # refuses nonsense before anything takes time
        own = Imperfections(**specimen)
        script = PressAndSlide(peak_mpa=pressure_mpa, seconds=period_s)
        if design is None or isinstance(design, SensorDesign | Path | str):
            _, response = respond(design_of(design), caller.bars)
        else:
            response = design
        motion = press_and_slide(response, script)
        rows, cols = motion.resistance_ohm.shape[1:3]
        told = replace(told, rows=rows, cols=cols)
        suited, why = suited_kind(told) if chip == "auto" else (chip, "")
        caller.say(why)
        counts = counts_over_time(motion, replace(electronics.crossbar(told), noise=noise), own)
        if written is not None:
            write_truth(motion, written)
        with run_board(suited, told, counts, kept) as running:
            port = str(link or running.port)
            caller.answer(lambda: {"port": port, "board": suited}, f"{suited} on {port}; Ctrl-C ends it", written)
            yield port


def info_of(mode: str = "zero-potential", sense_ohm: int | None = None, **told: Any) -> "Info":
    """INFO frame of a simulated board; its sense resistor suits pillars of 10 kΩ unless another is given."""
    from hardware.link.frames import Info
    from hardware.readout.crossbar import SUITED_SENSE_OHM, scan_mode_named

    scan_mode = scan_mode_named(mode)
    sense = round(SUITED_SENSE_OHM[scan_mode]) if sense_ohm is None else sense_ohm
    return Info(scan_mode=scan_mode, sense_ohm=sense, **told)
