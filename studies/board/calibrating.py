"""Gain and offset of every pillar from known loads: what the sensor shows under them, and what its design would."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from decoupler.components import component_named, force_columns
from decoupler.forward_model import ForwardModel
from geometry.design import SensorDesign
from geometry.errors import FileFormatError
from geometry.files import digest
from geometry.layout import FloatArray
from hardware.calibration import Electronics, SensorCalibration
from hardware.frames import Info
from hardware.loads import KnownLoad, read_loads, weight
from hardware.recording import read_recording
from studies.board.session import averaged, board_on, mean_resistances

if TYPE_CHECKING:
    from fem.response import ArrayResponse


MOST_MISSED = 0.2  #: of a resistance, root mean square: beyond, loads and sensor have nothing to do with each other


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredLoads:
    """Known loads and what a sensor showed under them; n of them."""

    names: list[str]
    force_n: FloatArray  #: (n, rows, cols, 3)
    measured_ohm: FloatArray  #: (n, rows, cols, 3): as the crossbar gives them; NaN where open
    noise: float  #: of a mean resistance, relative
    serial: int  #: of the board


def measured_live(
    port: str, loads: Path | None, design: SensorDesign, electronics: Electronics, seconds: float, **settings: Any
) -> MeasuredLoads:
    """Ask for one load after another, of a table or as typed weights, and measure each for some seconds."""
    with board_on(port, **settings) as (scanner, _):
        _require_design(design, scanner.info)
        rows, cols = scanner.info.rows, scanner.info.cols
        asked = _typed(rows, cols) if loads is None else iter(read_loads(loads, rows, cols))
        taken = []
        for load in asked:
            if loads is not None:
                _ask(f"put on load '{load.name}', then press Enter: ")
            taken.append((load, *mean_resistances(scanner, electronics, seconds)))
    return _collected(taken, scanner.info.serial)


def measured_in_recording(path: Path, loads: Path, design: SensorDesign, electronics: Electronics) -> MeasuredLoads:
    """Find the loads of a table in a recording, by their times since its first frame."""
    recording = read_recording(path)
    info = recording.info
    _require_design(design, info)
    crossbar = electronics.crossbar(info)
    since_s = recording.time_s - recording.time_s[0]
    taken = []
    for load in read_loads(loads, info.rows, info.cols):
        if load.from_s is None or load.to_s is None:
            raise FileFormatError(f"{loads}: load '{load.name}' has no from_s and to_s: say when it is in {path}.")
        within = (since_s >= load.from_s) & (since_s <= load.to_s)
        if not within.any():
            raise FileFormatError(
                f"{path} lasts {since_s[-1]:.1f} s, no frame lies in load '{load.name}' from {load.from_s:g} s to "
                f"{load.to_s:g} s: correct its times."
            )
        taken.append((load, *averaged(recording.counts[within], crossbar)))
    return _collected(taken, info.serial)


def calibrated(
    pairs: MeasuredLoads, response: "ArrayResponse", electronics: Electronics, noise: float | None
) -> tuple[SensorCalibration, float]:
    """The most probable calibration, and what it leaves: the relative root mean square of resistances it misses by."""
    everything = component_named("all")
    forward = ForwardModel.of(response, everything)
    forces = force_columns(pairs.force_n, everything)
    modelled = forward.resistances(forces).reshape(pairs.measured_ohm.shape)
    found = SensorCalibration.fitted(pairs.measured_ohm, modelled, pairs.noise if noise is None else noise, electronics)
    missed = (found.gain * modelled + found.offset_ohm) / pairs.measured_ohm - 1.0
    residual = float(np.sqrt(np.nanmean(missed**2)))
    if not residual < MOST_MISSED:
        raise FileFormatError(
            f"these loads do not explain what the sensor shows, resistances are missed by {100 * residual:.3g} %: "
            "check their units (newtons, or grams for weights), rows and columns, and the design."
        )
    story = found.made_from | {"design_hash": digest(response.design)}
    return replace(found, serial=pairs.serial, made_from=story), residual


def _require_design(design: SensorDesign, info: Info) -> None:
    if (design.array.rows, design.array.cols) != (info.rows, info.cols):
        raise FileFormatError(
            f"the board has {info.rows} × {info.cols} units, the design {design.array.rows} × {design.array.cols}: "
            "give --design of this sensor."
        )


def _typed(rows: int, cols: int) -> "Any":
    yield KnownLoad(name="nothing", force_n=_nothing(rows, cols))
    while line := _ask("row column grams, once they lie there (nothing to end): ").strip():
        try:
            yield weight(line, rows, cols)
        except FileFormatError as error:
            print(error, file=sys.stderr)


def _nothing(rows: int, cols: int) -> FloatArray:
    _ask("take everything off the sensor, then press Enter: ")
    return np.zeros((rows, cols, 3))


def _ask(question: str) -> str:
    """A line that was typed.

    Raises
    ------
    FileFormatError
        At the end of the input: nobody is there to put loads on.
    """
    print(question, end="", file=sys.stderr, flush=True)
    line = sys.stdin.readline() if sys.stdin else ""
    if not line:
        print(file=sys.stderr)
        raise FileFormatError("the input ended before the last load: answer every question; an empty line is enough.")
    return line


def _collected(taken: list[tuple[KnownLoad, FloatArray, float]], serial: int) -> MeasuredLoads:
    loads, ohms, noises = zip(*taken, strict=True)
    return MeasuredLoads(
        names=[load.name for load in loads],
        force_n=np.stack([load.force_n for load in loads]),
        measured_ohm=np.stack(ohms),
        noise=float(np.median(noises)),
        serial=serial,
    )
