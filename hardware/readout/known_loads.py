"""Known loads, from a CSV table or as weights on pads, and the calibration that follows from readings under them."""

import csv
import math
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from decoupler.data.columns import component_named, force_columns
from decoupler.inverse.forward_model import ForwardModel
from geometry.errors import FileFormatError
from geometry.layout import AXES, FloatArray
from geometry.storage.files import digest
from geometry.storage.text_file import why_unreadable
from hardware.readout.calibration import Electronics, SensorCalibration

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

COLUMNS = ("load", "row", "col", "fx_n", "fy_n", "fz_n")  #: of the table; `fx_n` and `fy_n` may be left out
TIMES = ("from_s", "to_s")  #: optional: when the load was on, since the recording's first scan
STANDARD_GRAVITY = 9.80665  # m/s²
MAX_MISSED = 0.2  #: largest relative misfit of resistances, root mean square; above, the loads were not on this sensor
MAX_TIMES = 2.0  #: largest ratio to the design, or its inverse; real sensors differ by less, wrong units by more
MAX_UNSURE = 0.2  #: largest relative standard deviation of a load as the sensor shows it; above, it cannot be judged


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownLoad:
    """Forces on an array that were measured otherwise, and when they acted."""

    name: str
    force_n: FloatArray  #: (rows, cols, 3) along x, y, z; Fz positive in compression [N]
    from_s: float | None = None
    to_s: float | None = None


def weight(text: str, rows: int, cols: int) -> KnownLoad:
    """A mass in grams on the pad of one unit, typed as "row col grams".

    >>> weight("2 3 500", 6, 6).force_n[2, 3].round(3).tolist()
    [0.0, 0.0, 4.903]
    """
    try:
        row, col, grams = text.replace(",", " ").split()
        place, newtons = (int(row), int(col)), 1e-3 * float(grams) * STANDARD_GRAVITY
        if not math.isfinite(newtons):
            raise ValueError(grams)
    except ValueError:
        raise FileFormatError(f"{text!r} is no weight: type row, column and grams, such as 2 3 500.") from None
    return KnownLoad(name=text, force_n=_forces([(place, [0.0, 0.0, newtons])], rows, cols, f"{text!r}"))


def read_loads(path: Path, rows: int, cols: int) -> list[KnownLoad]:
    """Known loads of a CSV table, in its order.

    Parameters
    ----------
    path : Path
        With a header and the columns `COLUMNS`, one line for each loaded pad; lines of the same `load` act together.
        `TIMES` say when, if the loads are to be found in a recording.
    rows, cols : int
        Of the array.

    Raises
    ------
    FileFormatError
        If the file or a column is missing, or a line makes no sense; it names the line.
    """
    try:
        with Path(path).open(newline="", encoding="utf-8-sig") as opened:
            lines = list(csv.DictReader(opened, skipinitialspace=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FileFormatError(f"{path}: {why_unreadable(error)}: give a CSV table.") from None
    wanted = {"load", "row", "col", "fz_n"}
    if not lines or not wanted <= lines[0].keys():
        raise FileFormatError(
            f"{path}: needs a header and lines with the columns {', '.join(COLUMNS)} and, for a recording, "
            f"{' and '.join(TIMES)}; it has {', '.join(map(str, lines[0])) if lines else 'no lines'}."
        )
    grouped: dict[str, list[tuple[int, dict[str, str]]]] = {}
    for number, line in enumerate(lines, start=2):
        grouped.setdefault((line["load"] or "").strip(), []).append((number, line))
    return [_load(path, name, numbered, rows, cols) for name, numbered in grouped.items()]


def _load(path: Path, name: str, numbered: list[tuple[int, dict[str, str]]], rows: int, cols: int) -> KnownLoad:
    pads, times = [], set()
    for number, line in numbered:
        source = f"{path}, line {number}"
        pad = _whole(line, "row", source), _whole(line, "col", source)
        pads.append((pad, [_number(line, f"f{axis}_n", source, default=0.0) for axis in AXES]))
        times.add(tuple(_number(line, column, source) if line.get(column) else None for column in TIMES))
    first, *others = times
    if others:
        raise FileFormatError(f"{path}: load '{name}' has lines with different times: give all of them the same.")
    from_s, to_s = first
    if (from_s is None) != (to_s is None) or (from_s is not None and to_s is not None and not from_s < to_s):
        raise FileFormatError(f"{path}: load '{name}' acts from {from_s} s to {to_s} s: give both, the later one last.")
    return KnownLoad(name=name, force_n=_forces(pads, rows, cols, f"{path}, load '{name}'"), from_s=from_s, to_s=to_s)


def _number(line: dict[str, str], column: str, source: str, default: float | None = None) -> float:
    text = (line.get(column) or "").strip()
    if not text and default is not None:
        return default
    with suppress(ValueError):
        if math.isfinite(value := float(text)):
            return value
    raise FileFormatError(f"{source}: {column} is {text!r}, must be a number.")


def _whole(line: dict[str, str], column: str, source: str) -> int:
    text = (line.get(column) or "").strip()
    with suppress(ValueError):
        return int(text)
    raise FileFormatError(f"{source}: {column} is {text!r}, must be a whole number.")


def _forces(pads: list[tuple[tuple[int, int], list[float]]], rows: int, cols: int, source: str) -> FloatArray:
    force_n = np.zeros((rows, cols, len(AXES)))
    for (row, col), newtons in pads:
        if not (0 <= row < rows and 0 <= col < cols):
            raise FileFormatError(
                f"{source}: the array has no unit in row {row}, col {col}; rows are 0 to {rows - 1}, columns 0 to "
                f"{cols - 1}."
            )
        force_n[row, col] += newtons
    return force_n


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredLoads:
    """n known loads, and the resistances of a sensor under them."""

    names: list[str]
    force_n: FloatArray  #: (n, rows, cols, 3)
    measured_ohm: FloatArray  #: (n, rows, cols, 3): as the crossbar gives them; NaN where open
    noise: float  #: of a mean resistance, relative
    serial: int  #: of the board


def calibrated(
    pairs: MeasuredLoads, response: "ArrayResponse", electronics: Electronics, noise: float | None, force: bool = False
) -> tuple[SensorCalibration, float]:
    """The most probable calibration, and the relative root mean square of its residuals.

    Raises
    ------
    FileFormatError
        If the loads cannot have acted on this sensor as stated, or determine too little. `force` takes them anyway.
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
    """Say if the resistances are of another size than the design's, as with a wrong unit."""
    times = float(np.nanmedian(pairs.measured_ohm / modelled_ohm))
    if 1.0 / MAX_TIMES < times < MAX_TIMES:
        return None
    unit = "; a factor of 1000 is kΩ for Ω" if 300 < max(times, 1.0 / times) < 3000 else ""
    return (
        f"the sensor's resistances are {times:.3g} times those of the design: check the board's SENSE_OHM and the "
        f"design's resistivity{unit}."
    )


def _strange_changes(pairs: MeasuredLoads, modelled_ohm: FloatArray) -> str | None:
    """Say if a load did not change the resistances as it should have.

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
