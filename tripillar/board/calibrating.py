"""Gain and offset of every pillar from known loads: what the sensor shows under them, and what its design would."""

import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from decoupler.data.components import component_named, force_columns
from decoupler.inverse.forward_model import ForwardModel
from geometry.design import SensorDesign
from geometry.errors import FileFormatError
from geometry.layout import FloatArray
from geometry.storage.files import digest
from hardware.link.frames import Info
from hardware.readout.calibration import Electronics, SensorCalibration
from hardware.readout.loads import KnownLoad, read_loads, weight
from hardware.recording import read_recording
from tripillar.board.session import averaged, board_on, counts_within
from tripillar.board.stillness import movement

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse


MAX_MISSED = 0.2  #: of a resistance, root mean square: beyond, loads and sensor have nothing to do with each other
MAX_TIMES = 2.0  #: as large or as small as designed: sensors as made differ by less, units by more
MAX_UNSURE = 0.2  #: standard deviation of a load, as the sensor tells it, relative: beyond, it cannot be judged


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredLoads:
    """Known loads and what a sensor showed under them; n of them."""

    names: list[str]
    force_n: FloatArray  #: (n, rows, cols, 3)
    measured_ohm: FloatArray  #: (n, rows, cols, 3): as the crossbar gives them; NaN where open
    noise: float  #: of a mean resistance, relative
    serial: int  #: of the board


def measured_live(
    port: str,
    loads: Path | None,
    design: SensorDesign,
    electronics: Electronics,
    seconds: float,
    force: bool = False,
    **settings: Any,
) -> MeasuredLoads:
    """Ask for one load after another, of a table or as typed weights, and measure each for some seconds.

    What moves meanwhile is measured again, unless `force` takes it as it is.
    """
    with board_on(port, **settings) as (scanner, _):
        _require_design(design, scanner.info)
        rows, cols = scanner.info.rows, scanner.info.cols
        asked = _typed(rows, cols) if loads is None else iter(read_loads(loads, rows, cols))
        taken, crossbar = [], electronics.crossbar(scanner.info)
        for load in asked:
            if loads is not None:
                _ask(f"put on load '{load.name}', then press Enter: ")
            counts = counts_within(scanner, seconds)
            while not force and (moved := movement(counts, crossbar, scanner.info.rate_hz)):
                _ask(f"the sensor moves: {moved} within {seconds:g} s; let it come to rest, then press Enter: ")
                counts = counts_within(scanner, seconds)
            taken.append((load, *averaged(counts, crossbar)))
    return _collected(taken, scanner.info.serial)


def measured_in_recording(
    path: Path, loads: Path, design: SensorDesign, electronics: Electronics, force: bool = False
) -> MeasuredLoads:
    """Find the loads of a table in a recording, by their times since its first frame.

    Raises
    ------
    FileFormatError
        If a load's time is missing or not in the recording, or if the sensor moves within it and `force` is not set.
    """
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
        if not force and (moved := movement(recording.counts[within], crossbar, info.rate_hz)):
            raise FileFormatError(
                f"{path}: the sensor moves under load '{load.name}', from {load.from_s:g} s to {load.to_s:g} s: "
                f"{moved}: correct its times, or take it as it is with --force."
            )
        taken.append((load, *averaged(recording.counts[within], crossbar)))
    return _collected(taken, info.serial)


def calibrated(
    pairs: MeasuredLoads, response: "ArrayResponse", electronics: Electronics, noise: float | None, force: bool = False
) -> tuple[SensorCalibration, float]:
    """The most probable calibration, and what it leaves: the relative root mean square of resistances it misses by.

    Raises
    ------
    FileFormatError
        If the loads cannot have been on this sensor as they are told, or tell too little; not with `force`.
    """
    everything = component_named("all")
    forward = ForwardModel.of(response, everything)
    forces = force_columns(pairs.force_n, everything)
    modelled = forward.resistances(forces).reshape(pairs.measured_ohm.shape)
    found = SensorCalibration.fitted(pairs.measured_ohm, modelled, pairs.noise if noise is None else noise, electronics)
    missed = (found.gain * modelled + found.offset_ohm) / pairs.measured_ohm - 1.0
    residual = float(np.sqrt(np.nanmean(missed**2)))
    doubt = _few_loads(pairs) or _strange_size(pairs, modelled) or _strange_changes(pairs, modelled)
    if not doubt and not residual < MAX_MISSED:
        doubt = (
            f"these loads do not explain what the sensor shows, resistances are missed by {100 * residual:.3g} %: "
            "check their units (newtons, or grams for weights), rows and columns, and the design."
        )
    if doubt and not force:
        raise FileFormatError(f"{doubt} Or write it as it is with --force.")
    story = found.made_from | {"design_hash": digest(response.design)}
    return replace(found, serial=pairs.serial, made_from=story), residual


def _few_loads(pairs: MeasuredLoads) -> str | None:
    if (pairs.force_n != pairs.force_n[0]).any():
        return None
    return (
        f"{len(pairs.names)} measured, all of the same forces, which cannot tell a pillar's gain from its offset: "
        "measure at least two loads that differ, one of them nothing at all."
    )


def _strange_size(pairs: MeasuredLoads, modelled_ohm: FloatArray) -> str | None:
    """Whether the resistances are of another size than the design's: their unit, or that of what they follow from."""
    times = float(np.nanmedian(pairs.measured_ohm / modelled_ohm))
    if 1.0 / MAX_TIMES < times < MAX_TIMES:
        return None
    unit = "; a factor of 1000 is kΩ for Ω" if 300 < max(times, 1.0 / times) < 3000 else ""
    return (
        f"the sensor's resistances are {times:.3g} times those of the design: check the board's SENSE_OHM and the "
        f"design's resistivity{unit}."
    )


def _strange_changes(pairs: MeasuredLoads, modelled_ohm: FloatArray) -> str | None:
    """Whether what the loads changed is not what they should have changed.

    Each load's relative changes of all resistances, from those with nothing on the sensor (or the mean of all loads),
    are fitted by a multiple of the modelled ones: 1 if all is as told, 0 if no load was put on.
    """
    acts = pairs.force_n.any(axis=(1, 2, 3))
    is_reference = np.ones_like(acts) if acts.all() else ~acts
    change, expected = (
        (ohms / ohms[is_reference].mean(axis=0) - 1.0)[acts] for ohms in (pairs.measured_ohm, modelled_ohm)
    )
    expected = np.where(np.isnan(change), 0.0, expected)
    size = np.sqrt((expected**2).sum(axis=(1, 2, 3)))
    is_told = math.sqrt(2.0) * pairs.noise < MAX_UNSURE * size
    if not is_told.any():
        times = math.sqrt(2.0) * pairs.noise / (MAX_UNSURE * float(size.max()))
        return (
            f"no load is large enough to be told from the noise of {100 * pairs.noise:.2g} %: take {times:.2g} times "
            "as much, or measure longer (--seconds); loads are in newtons, weights in grams."
        )
    multiple = np.nansum(change * expected, axis=(1, 2, 3))[is_told] / size[is_told] ** 2
    off = np.abs(np.log(np.maximum(multiple, 1e-9)))
    if off.max() < math.log(MAX_TIMES):
        return None
    worst = int(off.argmax())
    name = pairs.names[int(np.flatnonzero(acts)[is_told][worst])]
    return (
        f"load '{name}' changed the resistances by {100 * max(multiple[worst], 0.0):.0f} % of what it should: is it on "
        "the sensor, on that pad, and in newtons (grams for a weight)?"
    )


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
