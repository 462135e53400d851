"""A board that is not there: a simulated sensor that is pressed, behind a port that sends what a real one would."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from common.errors import DesignError
from dataset.imperfections import Imperfections
from geometry.design import SensorDesign
from tripillar.face import stages
from tripillar.face.caller import current
from tripillar.face.inputs import BROKEN, WIRES, Circuit, DesignLike, File, Flag, Options, design_of, imperfections, job

if TYPE_CHECKING:
    SensorLike = DesignLike | stages.ArrayResponse
else:
    SensorLike = Path

OFFSET = Annotated[float, Flag(name=("--offset",))]
KNOWN = ("gain_spread", "offset_ohm", "specimen", "memory_spread", "temperature_rise")  #: of a specimen
SPECIMEN = Options(Imperfections, *KNOWN, *BROKEN, offset_ohm=OFFSET, **BROKEN)


@job(link=None, truth=".nc")
@contextmanager
def board(
    design: SensorLike | None = None,
    *,
    chip: Annotated[Literal["auto", "atmega328p", "atmega2560", "python"], Flag(name=("--board",))] = "auto",
    link: File | None = None,
    pressure_mpa: float | None = None,
    period_s: float = 6.0,
    mode: Circuit = "zero-potential",
    rate_hz: int | None = None,
    sense_ohm: int | None = None,
    noise: float = 0.0,
    bits: int = 10,
    serial: int = 0,
    truth: File | None = None,
    **more: Annotated[Any, SPECIMEN, WIRES],
) -> Iterator[str]:
    """Simulate a board: a port that sends what a real one would.

    Where simavr is installed, the very firmware runs on a simulated chip. The port is a pseudo-terminal.

    Parameters
    ----------
    design : SensorDesign, ArrayResponse or path, optional
        Design file (TOML); default: the paper's sensor.
    chip : str
        Board to simulate: the firmware on a simulated chip, or the same frames from Python.
    link : path, optional
        Name of a link to the port, kept while it runs.
    pressure_mpa : float, optional
        Largest pressure of an indenter that comes down on a corner, slides to the opposite one, and lifts [MPa]; 0: at
        rest; default: 3, or the middle of what the design bears.
    period_s : float
        Period of the press and slide [s].
    mode : str
        Circuit that reads the array.
    rate_hz : int, optional
        Number of scans a second; default: 150, or as many as a chip has time for.
    sense_ohm : int, optional
        Sense or feedback resistor [Ω]; default: one that suits 10 kΩ.
    noise : float
        Standard deviation of a reading, as a fraction of full scale.
    bits : int
        Bits of the converter; chips have 10.
    serial : int
        Serial number of the board.
    truth : path, optional
        NetCDF file to write: the true forces of one period.
    **more
        The fields gain_spread, offset_ohm, specimen, memory_spread, temperature_rise, dead_pillars, dead_rows and
        dead_cols of `dataset.Imperfections`, and those of `inputs.Wires`.

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
    caller, place = current(), None if link is None else Path(link)
    stages.require_symlink(place)
    if not 0.1 <= period_s <= 600:
        raise DesignError(f"period_s={period_s:g} must be from 0.1 to 600 s.")
    if sys.platform == "win32":
        raise DesignError(stages.NO_TERMINALS)
    scan_mode = stages.scan_mode_named(mode)
    sense_ohm = round(stages.SUITED_SENSE_OHM[scan_mode]) if sense_ohm is None else sense_ohm
    asked: dict[str, Any] = {} if rate_hz is None else {"rate_hz": rate_hz}
    info = stages.Info(scan_mode=scan_mode, sense_ohm=sense_ohm, bits=bits, serial=serial, **asked)
    electronics = stages.Electronics(**WIRES.of(more))
    replace(electronics.crossbar(info), noise=noise)  # refuses nonsense before anything takes time
    own = Imperfections(**imperfections(SPECIMEN.of(more)))
    asked_mpa = {} if pressure_mpa is None else {"pressure_mpa": pressure_mpa}
    script = stages.PressAndSlide(seconds=period_s, **asked_mpa)
    if design is None or isinstance(design, SensorDesign | Path | str):
        response = stages.respond(design_of(design), caller.bars)[1]
    else:
        response = design
    if pressure_mpa is None and (loads := stages.loads_of(response)) != stages.PAPERS:
        script = replace(script, pressure_mpa=loads.middle_mpa)
        caller.say(f"the design does not bear the paper's loads; the indenter presses with {loads.middle_mpa:.3g} MPa")
    seen = replace(response, design=stages.seen_by(electronics.crossbar(info), response.design))
    motion, shunts = stages.press_and_slide(seen, script, own), stages.shunts_of(seen.design)
    rows, cols = motion.resistance_ohm.shape[1:3]
    info = replace(info, rows=rows, cols=cols, layout=seen.design.unit.layout)
    info = replace(info, **{"rate_hz": stages.usual_rate(info.n_crossings)} | asked)
    suited, why = stages.suited_kind(info) if chip == "auto" else (chip, "")
    caller.say(why)
    crossbar = replace(electronics.crossbar(info), noise=noise, shunt_siemens=shunts)
    counts = stages.counts_over_time(motion.resistance_ohm, crossbar, own, seen.design.electrics)
    if truth is not None:
        stages.write_truth(motion, Path(truth))
    with stages.run_board(suited, info, counts) as running, stages.symlinked(place, running.port) as port:
        caller.answer(lambda: {"port": port, "board": suited}, f"{suited} on {port}; Ctrl-C ends it", truth)
        yield port
