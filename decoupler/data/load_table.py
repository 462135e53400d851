"""Tables of known loads, CSV: a line for each loaded pad, plate or air pressure, what is known of it and how well.

The table of `tripillar identify` and `calibrate`. The readings stand in the same lines, or in a recording, or are
taken live; docs/decoder.md says how to make each load.
"""

import csv
import math
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.clean import form_of, read_table
from common.errors import FileFormatError
from decoupler.data.pairs import Pairs
from geometry.design import SensorDesign
from geometry.layout import AXES, FloatArray, Layout

STANDARD_GRAVITY = 9.80665  # m/s²
#: that a force may be written in
UNITS_N = {"": 1.0, "n": 1.0, "kn": 1e3, "g": 1e-3 * STANDARD_GRAVITY, "kg": STANDARD_GRAVITY}
PLAIN = {"": 1.0}
SHARE = {"": 1.0, "%": 0.01}  #: units of what is relative
FORCE = "a number of newtons, or with a unit: N, kN, g, kg"
DEVIATION = "a number from 0 on, or a percentage such as 2 %"
KINDS = ("pad", "plate", "air", "nothing")
FORCES = tuple(f"f{axis}_n" for axis in AXES)
KNOWN = ("error", "tilt", "share")  #: columns that say how well a load is known
TIMES = ("from_s", "to_s")  #: when the load was on, since the recording's first scan
COLUMNS = ("load", "kind", "row", "col", *FORCES, "kpa", *KNOWN, *TIMES, "noise", "note")
MAX_LOADS = 20_000  #: lines of a table
ERROR = 0.01  #: standard deviation of a load's size where none is stated, relative
TILT = 0.01  #: of the force across the stated one, relative to it: 0.6 degrees
SHARES = {"plate": 0.3, "air": 0.02}  #: of each pad's share, relative to the mean share
RUBBED = 0.1  #: shear between a plate and its pads, relative to the mean pressing force, since pressed rubber spreads
NOISE = 1e-3  #: relative standard deviation of a reading where none is stated
MAX_MPA = 20.0  #: largest mean stress on a pad that is believed; the sensor's range ends at 5


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownLoad:
    """Forces on an array that were measured otherwise, how well they are known, and when they acted."""

    name: str
    force_n: FloatArray  #: (rows, cols, 3) along x, y, z; Fz positive in compression [N]
    unknown_n: FloatArray  #: (k, rows, cols, 3): independent errors of one standard deviation, as of `Pairs` [N]
    from_s: float | None = None
    to_s: float | None = None
    resistance_ohm: FloatArray | None = None  #: (rows, cols, n_pillars) [Ω]; NaN: not read; None if not in the table
    noise: float = NOISE  #: of these, relative
    lines: tuple[Mapping[str, str], ...] = ()  #: of its table, by column


def read_pairs(path: Path, design: SensorDesign) -> Pairs:
    """Measured pairs of a table of loads with readings; arguments and errors as of `read_loads`."""
    return as_pairs(read_loads(path, design), path, design.unit.layout)


def as_pairs(loads: list[KnownLoad], source: object, layout: Layout) -> Pairs:
    """Pairs of loads with readings; `source` is their file, for messages."""
    unread = [load.name for load in loads if load.resistance_ohm is None]
    if unread:
        raise FileFormatError(
            f"{source}: load '{unread[0]}' has no readings: give columns "
            f"{', '.join(reading_columns(1, 1, layout)[:2])} and so on [Ω], or the recording of these loads."
        )
    return Pairs(
        resistance_ohm=np.stack([load.resistance_ohm for load in loads if load.resistance_ohm is not None]),
        force_n=np.stack([load.force_n for load in loads]),
        unknown_n=tuple(load.unknown_n for load in loads),
        noise=float(np.median([load.noise for load in loads])),
        layout=layout,
        names=tuple(load.name for load in loads),
    )


def read_loads(path: Path, design: SensorDesign) -> list[KnownLoad]:
    """Known loads of a CSV table on the sensor of a design, in its order.

    It has a header and some of the columns `COLUMNS`; lines of the same `load` act together. `kind` is pad (the
    default), plate (the sum alone is known), air (the same pressure on every pad) or nothing. Of a pad `row` and `col`
    are one each, else a range such as 0-2, or empty for all. Forces are in newtons or with a unit, such as 500 g; of
    air, `kpa`. `error`, `tilt` and `share` are standard deviations, as 2 % of the load or in its unit. Readings stand
    in columns r_ROW_COL_PILLAR [Ω], r_ROW_COL of one pillar a unit, in one line of each load; `noise` is theirs,
    relative. A file or column that is missing, or a line that makes no sense, is a `FileFormatError` that names it.
    """
    path = Path(path)
    rows, cols = design.array.rows, design.array.cols
    readings = reading_columns(rows, cols, design.unit.layout)
    short = {name.rpartition("_")[0]: name for name in readings} if len(design.unit.layout.pillars) == 1 else {}
    form = form_of(path, {*COLUMNS, *readings, *short}.__contains__)
    form = form._replace(header=[short.get(name, name) for name in form.header])
    lines = read_table(path, form, MAX_LOADS, "give fewer loads, or samples, of which some are drawn")
    header = [name for name in form.header if name]
    unknown = [name for name in header if name not in COLUMNS and name not in readings]
    if wrong := next((name for name in unknown if name.startswith(tuple(f"{reading}_" for reading in readings))), None):
        raise FileFormatError(f"{path}: has a column '{wrong}': readings are in Ω, in columns such as {readings[0]}.")
    if given := _other_array(header, rows, cols, design.unit.layout):
        raise FileFormatError(
            f"{path}: has readings of {given}, the design has {rows} × {cols} with pillars "
            f"{', '.join(design.unit.layout.pillar_names)}: give the design of this array."
        )
    if not lines or "load" not in header or unknown or not {*FORCES, "kpa", "kind"} & {*header}:
        spare = f"; not {', '.join(map(repr, unknown[:3]))}" if unknown else ""
        raise FileFormatError(
            f"{path}: needs a header and lines with load, row, col and fz_n; it may have {', '.join(COLUMNS)}, and "
            f"{readings[0]} to {readings[-1]}{spare}; it has {', '.join(header[:12]) if lines else 'no lines'}."
        )
    grouped: dict[str, list[tuple[int, Mapping[str, str]]]] = {}
    for number, cells in lines.items():
        names = form.header + [""] * (len(cells) - len(form.header))
        if any(cell.strip() for name, cell in zip(names, cells, strict=False) if not name):
            raise FileFormatError(f"{path}, line {number}: has more values than the header has columns.")
        line = dict(zip(names, cells, strict=False))
        grouped.setdefault(line.get("load", "").strip(), []).append((number, line))
    return [_load(path, name, numbered, design, readings) for name, numbered in grouped.items()]


def keep_pair(path: Path, load: KnownLoad, layout: Layout) -> None:
    """Add a load with its readings to a table, which is begun if there is none; on disk when this returns.

    A table of other columns than this array's, or that cannot be written, is a `FileFormatError`.
    """
    assert load.resistance_ohm is not None
    rows, cols, _ = load.resistance_ohm.shape
    of_readings = reading_columns(rows, cols, layout)
    columns = [name for name in COLUMNS if name not in TIMES] + of_readings
    ohms = ["" if math.isnan(ohm) else f"{ohm:.8g}" for ohm in load.resistance_ohm.ravel()]
    readings = dict(zip(of_readings, ohms, strict=True)) | {"noise": f"{load.noise:.3g}"}
    try:
        with Path(path).open("a+", newline="", encoding="utf-8") as opened:
            opened.seek(0)
            header = opened.readline().rstrip("\r\n")
            if header and header != ",".join(columns):
                raise FileFormatError(f"{path}: has other columns than a table of this array's pairs: give a new name.")
            writer = csv.DictWriter(opened, columns, extrasaction="ignore", restval="")
            if not header:
                writer.writeheader()
            for number, line in enumerate(load.lines or ({"kind": "nothing"},)):
                stated = {name: line.get(name) or "" for name in COLUMNS} | {"load": load.name}
                writer.writerow(stated | (readings if number == 0 else {}))
            opened.flush()
            os.fsync(opened.fileno())
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be written: {error.strerror}.") from None


def reading_columns(rows: int, cols: int, layout: Layout) -> list[str]:
    """Names of the columns of readings, in the order of an array (rows, cols, n_pillars).

    >>> from dataset.imperfections import PAPERS
    >>> reading_columns(1, 1, PAPERS)
    ['r_0_0_z', 'r_0_0_x', 'r_0_0_y']
    """
    return [f"r_{row}_{col}_{pillar}" for row in range(rows) for col in range(cols) for pillar in layout.pillar_names]


def _other_array(header: list[str], rows: int, cols: int, layout: Layout) -> str | None:
    """Size of the array of a table's readings, or a pillar among them, as text, if the design has no such."""
    places = [place for name in header if (place := re.fullmatch(r"r_(\d+)_(\d+)_(\w+)", name))]
    units = [(int(place[1][:9]) + 1, int(place[2][:9]) + 1) for place in places]
    if any(row > rows or col > cols for row, col in units):
        return " × ".join(str(max(counts)) for counts in zip(*units, strict=True)) + " units"
    return next((f"a pillar {place[3]}" for place in places if place[3] not in layout.pillar_names), None)


def _load(
    path: Path, name: str, numbered: list[tuple[int, Mapping[str, str]]], design: SensorDesign, columns: list[str]
) -> KnownLoad:
    rows, cols, pad_mm2 = design.array.rows, design.array.cols, design.pad.size_mm**2
    lines = [_Line(values, f"{path}, line {number}") for number, values in numbered]
    parts = [known_forces(line.texts, rows, cols, pad_mm2, line.source) for line in lines]
    times = {tuple(line.number(column) if line.text(column) else None for column in TIMES) for line in lines}
    if len(times) > 1:
        raise FileFormatError(f"{path}: load '{name}' has lines with different times: give all of them the same.")
    ((from_s, to_s),) = times
    if (from_s is None) != (to_s is None) or (from_s is not None and to_s is not None and not from_s < to_s):
        raise FileFormatError(f"{path}: load '{name}' acts from {from_s} s to {to_s} s: give both, the later one last.")
    read = [line for line in lines if any(map(line.text, columns))]
    if len(read) > 1:
        raise FileFormatError(f"{read[1].source}: load '{name}' has readings in two lines: give them in one.")
    ohms = [line.number(column, default=math.nan) for line in read for column in columns]
    noises = [line.number("noise", SHARE, NOISE, DEVIATION) for line in lines if line.text("noise")]
    return KnownLoad(
        name=name,
        force_n=np.sum([force_n for force_n, _ in parts], axis=0),
        unknown_n=np.concatenate([unknown_n for _, unknown_n in parts]),
        from_s=from_s,
        to_s=to_s,
        resistance_ohm=np.reshape(ohms, (rows, cols, -1)) if ohms else None,
        noise=noises[-1] if noises else NOISE,
        lines=tuple(values for _, values in numbered),
    )


def known_forces(
    line: Mapping[str, str], rows: int, cols: int, pad_mm2: float, source: str
) -> tuple[FloatArray, FloatArray]:
    """Expected forces (rows, cols, 3) [N] of a line of a table, and their independent errors (k, rows, cols, 3).

    Notes
    -----
    Along each axis a force has an error of `error` of itself and of `tilt` of the forces across it. A plate's pads
    share the sum: shares have an error of `share` of the mean one, sum 0, and so do the shears that hold the rubber as
    it spreads, `RUBBED` of the mean pressing force. Air has an error common to all pads, and of each pad `share`.
    """
    given = _Line(line, source)
    kind = given.text("kind") or "pad"
    if kind not in KINDS:
        raise FileFormatError(f"{source}: kind is {kind!r}, must be one of {', '.join(KINDS)}.")
    allowed = {"air": ["kpa"], "nothing": []}.get(kind, list(FORCES))
    if wrong := [name for name in (*FORCES, "kpa") if given.text(name) not in ("", "0") and name not in allowed]:
        raise FileFormatError(
            f"{source}: {wrong[0]} is no part of kind {kind}; it takes {', '.join(allowed) or 'none'}."
        )
    if kind == "nothing":
        return np.zeros((rows, cols, 3)), np.zeros((0, rows, cols, 3))
    share = given.number("share", SHARE, SHARES.get(kind, 0.0), DEVIATION)
    if share and kind == "pad":
        raise FileFormatError(f"{source}: share is {line['share']!r}, but one pad takes all: leave it out.")
    pads = given.pads(rows, cols, one=kind == "pad")
    n = int(pads.sum())
    if kind == "air":
        units_n = dict.fromkeys(("", "kpa"), 1e-3 * pad_mm2 * n)
        mean_n = np.array([0.0, 0.0, 1e-3 * given.number("kpa") * pad_mm2])
    else:
        units_n = UNITS_N
        mean_n = np.array([given.number(column, UNITS_N, 0.0, FORCE) for column in FORCES]) / n
    if (mpa := float(np.abs(mean_n).max()) / pad_mm2) > MAX_MPA:
        raise FileFormatError(
            f"{source}: {np.abs(mean_n).max():g} N on a pad is {mpa:.3g} MPa, more than {MAX_MPA:g}: forces are in "
            "newtons; write grams as '500 g', and pressures in kpa."
        )
    sum_n, shared_n = n * np.abs(mean_n), share * np.abs(mean_n)
    if kind == "air":
        across_n, apart = np.zeros(3), np.eye(n)
    else:
        across_n = np.sqrt((sum_n**2).sum() - sum_n**2)
        shared_n[:2] = np.hypot(shared_n[:2], RUBBED * abs(mean_n[2]))
        k = np.arange(1, n)[:, None]
        apart = np.sqrt(2.0 / n) * np.cos(np.pi * k * (np.arange(n) + 0.5) / n)  # orthonormal rows of sum 0
    error_n, tilt_n = (
        [given.number(name, units_n | {"%": 0.01 * f}, usual * f, DEVIATION) if f else 0.0 for f in of_n]
        for name, usual, of_n in (("error", ERROR, sum_n), ("tilt", TILT, across_n))
    )
    alike = np.repeat(np.diag(np.hypot(error_n, tilt_n) / n)[:, None], n, axis=1)
    shares = (apart[:, None, :, None] * np.diag(shared_n)[None, :, None, :]).reshape(-1, n, 3)
    directions = np.concatenate([alike, shares])
    directions = directions[directions.any(axis=(1, 2))]
    placed = np.zeros((1 + len(directions), rows, cols, 3))
    placed[:, pads] = np.concatenate([np.broadcast_to(mean_n, (1, n, 3)), directions])
    return placed[0], placed[1:]


@dataclass(frozen=True)
class _Line:
    """A line of a table: its texts by column, and where it stands, for messages."""

    texts: Mapping[str, str]
    source: str

    def text(self, column: str) -> str:
        return (self.texts.get(column) or "").strip()

    def number(
        self,
        column: str,
        units: Mapping[str, float] = PLAIN,
        default: float | None = None,
        must: str = "a number",
    ) -> float:
        """The number of a column, in one of the units; the default where there is none, if there may be none."""
        text = self.text(column)
        if not text and default is not None:
            return default
        if (value := quantity_of(text, units)) is None or (must == DEVIATION and value < 0):
            raise FileFormatError(f"{self.source}: {column} is {text!r}, must be {must}.")
        return value

    def pads(self, rows: int, cols: int, one: bool) -> NDArray[np.bool_]:
        """The pads that it loads, (rows, cols): one, or those in ranges of rows and columns, which may be left out."""
        within = []
        for name, count in (("row", rows), ("col", cols)):
            text = self.text(name)
            found = re.fullmatch(r"(-?\d{1,9})" if one else r"(?:(\d{1,9})(?:\s*-\s*(\d{1,9}))?)?", text)
            if found is None:
                no_pad = "" if text else "; of a line without a load write kind nothing"
                raise FileFormatError(f"{self.source}: {name} is {text[:20]!r}, must be a whole number{no_pad}.")
            ends = [int(end) for end in found.groups() if end] or [0, count - 1]
            if not 0 <= ends[0] <= ends[-1] < count:
                raise FileFormatError(
                    f"{self.source}: the array has no unit in {name} {text}; rows are 0 to {rows - 1}, columns 0 to "
                    f"{cols - 1}."
                )
            within.append((ends[0] <= np.arange(count)) & (np.arange(count) <= ends[-1]))
        return np.logical_and.outer(*within)


def quantity_of(text: str, units: Mapping[str, float]) -> float | None:
    """The value of a number with one of the units; None if it is none."""
    if (parts := re.fullmatch(r"([-+.\d]+(?:[eE][-+]?\d+)?)\s*([A-Za-z%]*)", text)) is None:
        return None
    with suppress(ValueError, KeyError):
        if math.isfinite(value := float(parts[1]) * units[parts[2].lower()]):
            return value
    return None
