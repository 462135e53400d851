"""Bench series: time, strain, force and resistance of one specimen, read from a table, checked and mended.

Whatever is mended is said in a note; what cannot be mended safely is refused with what to do.
"""

import csv
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from common.bounded import counted, require_regular
from common.errors import FileFormatError
from common.storage.text_file import why_unreadable
from geometry.layout import FloatArray

#: columns of each quantity that a table may have, and how much of its unit theirs is
COLUMNS = {
    "time_s": {"time_s": 1.0, "time_ms": 1e-3, "time_min": 60.0},
    "strain": {"strain": 1.0, "strain_pct": 0.01, "displacement_mm": 1.0},
    "force_n": {"force_n": 1.0, "force_mn": 1e-3, "force_g": 9.80665e-3},
    "resistance_ohm": {"resistance_ohm": 1.0, "resistance_kohm": 1e3, "resistance_mohm": 1e6},
}
TWO_WIRES = {"two_wire_ohm": 1.0, "two_wire_kohm": 1e3}  #: may stand beside those of four wires
NAMED = "columns={0}=NAME names another one, as in displacement_mm=x,time_ms=t"
MIN_ROWS = 100
MAX_ROWS, MOST_ROWS = 15_000, 2_000_000  #: more are averaged, or refused
MAX_STEP_S, MAX_DAYS = 5.0, 3.0  #: between rows, and of all: no bench is so slow, milliseconds look so
LARGEST = 1e12  #: of a reading
MIN_OHM = 50.0  #: no strip of filled silicone has less; kΩ look so
MIN_STRAIN, MAX_STRAIN = 5e-3, 3.0  #: range of a series that tells something, and that is believed
GAP_S, GAP_STEPS = 5.0, 20.0  #: between rows, and over their usual distance
STILL = 0.02  #: of the range: strain that has hardly moved
STRAINED = 0.05  #: of the range: a first strain that is none of rest
GLITCH_ROWS, JUMP = 5, 0.04  #: longest glitch of a position, and the least of the range
MANY_GLITCHES = 0.3  #: of the rows: what jumps so often is no position of the specimen
FOLLOWED = 0.4  #: of what a strain does to the force: less, and the specimen did not move
RUN, SWING = 16, 0.01  #: readings in a row that go up and down by so much: a meter that alternates
MANY = 0.05  #: share of rows that do before all are averaged in pairs
JITTER, MAX_DETOUR = 5.0, 1.1  #: deviations of noise that strain may turn within; way with it over that without
QUIET = 100  #: rows of a part that may be at rest
MIN_KEPT = 0.5  #: of a series with gaps that its longest part must be


@dataclass(frozen=True, kw_only=True, eq=False)
class Series:
    """Readings of one specimen over time (n,); strain is positive where it lengthens, and force where it pulls."""

    time_s: FloatArray
    strain: FloatArray
    force_n: FloatArray
    resistance_ohm: FloatArray
    notes: tuple[str, ...] = ()  #: what was found and mended, a line each
    settled: bool = True  #: whether it begins at rest and unstrained
    two_wire_ohm: FloatArray | None = None  #: the whole specimen with its contacts, where it was read, too

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def seconds(self) -> FloatArray:
        """Times between readings (n − 1,) [s]."""
        return np.diff(self.time_s)

    @property
    def _arrays(self) -> dict[str, Any]:
        found = {name: getattr(self, name) for name in COLUMNS}
        return found if self.two_wire_ohm is None else found | {"two_wire_ohm": self.two_wire_ohm}

    def part(self, rows: slice | NDArray, note: str = "") -> Self:
        """Some of its rows, and what is to be said of that."""
        arrays = {name: values[rows] for name, values in self._arrays.items()}
        return replace(self, **arrays, notes=self.notes + (note,) * bool(note))

    def averaged(self, count: int, note: str) -> Self:
        """Means of so many rows each."""
        n = len(self) // count * count
        arrays = {name: values[:n].reshape(-1, count).mean(axis=1) for name, values in self._arrays.items()}
        return replace(self, **arrays, notes=(*self.notes, note))


def read_series(
    path: Path, columns: Mapping[str, str] | None = None, length_mm: float | None = None, as_given: bool = False
) -> Series:
    """A bench series of a CSV table with the columns time_s, strain, force_n, resistance_ohm; others may stand beside.

    Instead there may be time_ms, strain_pct, displacement_mm with the specimen's length, force_g, resistance_kohm and
    so on; `columns` says under which names a table has them. With `as_given` units are believed.

    `FileFormatError` if a column is missing, a unit looks wrong, strain stays where it is, or too little is left.
    """
    table, path = _columns(Path(path), columns or {}), Path(path)
    if "displacement_mm" in table["strain"]:
        if length_mm is None:
            raise FileFormatError(
                f"{path}: displacement_mm needs the specimen's length between its clamps: length_mm=."
            )
        table["strain"] = {"displacement_mm": table["strain"]["displacement_mm"] / length_mm}
    ((time, time_s), (strained, strain), (_, force_n), (resisted, ohm), *beside) = (
        next(iter(column.items())) for column in table.values()
    )
    rows = np.stack([time_s, strain, force_n, ohm, *(values for _, values in beside)])
    read = np.isfinite(rows).all(axis=0) & (ohm != 0)
    notes = []
    if not read.all():
        notes.append(f"{(~read).sum()} rows without all readings left out")
    order = np.argsort(rows[0, read], kind="stable")
    if (order != np.arange(len(order))).any():
        notes.append("rows put in the order of time")
    time_s, strain, force_n, ohm, *two_wires = rows[:, read][:, order]
    later = np.r_[True, np.diff(time_s) > 0][: len(time_s)]
    if not later.all():
        notes.append(f"{(~later).sum()} rows of the same time left out")
    if (ohm < 0).any():
        notes.append(f"{resisted} is negative in {(ohm < 0).mean():.0%} of the rows: its sign was dropped")
    found = Series(
        time_s=time_s, strain=strain, force_n=force_n, resistance_ohm=np.abs(ohm), notes=tuple(notes),
        two_wire_ohm=np.abs(two_wires[0]) if two_wires else None,
    )  # fmt: skip
    found = found.part(later)
    _require_sense(path, found, time, strained, resisted, as_given)
    return _mended(path, found)


def _columns(path: Path, named: Mapping[str, str]) -> dict[str, dict[str, FloatArray]]:
    """Of each quantity the column that the table has, by its name in `COLUMNS`, in the quantity's unit."""
    known = [name for units in (*COLUMNS.values(), TWO_WIRES) for name in units]
    if wrong := [name for name in named if name not in known]:
        raise FileFormatError(f"columns={wrong[0]}=... names no quantity; there are {', '.join(known)}.")
    require_regular(path, "give a CSV table")
    try:
        with path.open(newline="", encoding="utf-8-sig") as opened:
            reader = csv.reader(opened, skipinitialspace=True)
            header = [name.strip() for name in next(reader, [])]
            lines = [line for line in counted(reader, MOST_ROWS, path, "give fewer, such as every tenth") if line]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FileFormatError(f"{path}: {why_unreadable(error)}: give a CSV table.") from None
    found: dict[str, dict[str, FloatArray]] = {}
    for quantity, units in (*COLUMNS.items(), ("two_wire_ohm", TWO_WIRES)):
        names = {unit: named.get(unit, unit) for unit in units}
        there = [unit for unit in units if names[unit] in header]
        there = [unit for unit in there if unit in named] or there
        if not there and units is TWO_WIRES:
            continue
        if not there:
            raise FileFormatError(
                f"{path}: the column {names[quantity]} is missing (or {', '.join(list(units)[1:])}); "
                f"it has {', '.join(header[:12]) or 'no lines'}: {NAMED.format(quantity)}."
            )
        place, unit = header.index(names[there[0]]), there[0]
        found[quantity] = {unit: units[unit] * np.array([_number(line, place) for line in lines])}
    return found


def _number(line: list[str], place: int) -> float:
    try:
        return float(line[place])
    except (ValueError, IndexError):
        return float("nan")


def _require_sense(path: Path, series: Series, time: str, strained: str, resisted: str, as_given: bool) -> None:
    """Refuse what tells nothing, or is in another unit than its column says."""
    n, said = len(series), ""
    if n < MIN_ROWS:
        raise FileFormatError(f"{path}: has {n} rows with all readings, a series needs at least {MIN_ROWS}.")
    step_s, most = float(np.median(series.seconds)), float(np.abs(series.strain).max())
    ohm, span = float(np.median(series.resistance_ohm)), float(np.ptp(series.strain))
    if step_s > MAX_STEP_S or np.ptp(series.time_s) > MAX_DAYS * 86400:
        said = f"its rows are {step_s:.4g} s apart, {np.ptp(series.time_s):.3g} s in all, as if {time} were "
        said += "milliseconds: name the column time_ms"
    elif most > MAX_STRAIN:
        said = f"{strained} goes up to {most:.4g}, as if it were percent or millimetres: name it strain_pct, or "
        said += "displacement_mm with length_mm="
    elif ohm < MIN_OHM:
        said = f"{resisted} is {ohm:.3g} Ω, as if it were kΩ: name the column resistance_kohm"
    if said and not as_given:
        raise FileFormatError(f"{path}: {said}; if it is right, add force=True.")
    if span < MIN_STRAIN:
        raise FileFormatError(
            f"{path}: {strained} stays within {span:.2g}: nothing can be told of a specimen that is not stretched; "
            "take a test that next_test= proposes."
        )
    if (series.strain <= -0.95).any():
        raise FileFormatError(f"{path}: {strained} falls to {series.strain.min():.3g}: nothing is shorter than -0.95.")
    for name, values in ((resisted, series.resistance_ohm), ("force_n", series.force_n)):
        if np.ptp(values) <= 1e-9 * np.abs(values).max():
            raise FileFormatError(f"{path}: {name} stays {values[0]:.6g}: was its meter connected?")
        if np.abs(values).max() > LARGEST:
            raise FileFormatError(f"{path}: {name} goes up to {np.abs(values).max():.3g}: leave such rows out.")


def _mended(path: Path, series: Series) -> Series:
    """The series without glitches, gaps and alternating readings; the signs agree."""
    series = _without_gaps(path, _without_glitches(path, series))
    if (n := swinging(series.resistance_ohm)) > MANY:
        series = series.averaged(2, f"readings alternate in {n:.0%} of the rows: averaged in pairs")
    series = _without_jitter(series)
    if len(series) > MAX_ROWS:
        count = -(-len(series) // MAX_ROWS)
        series = series.averaged(count, f"averaged over {count} rows each")
    series = _signs_agree(series)
    if abs(series.strain[0]) > STRAINED * np.ptp(series.strain):
        note = f"begins at a strain of {series.strain[0]:.3g}: what it remembers of before is found with the rest"
        series = replace(series, settled=False, notes=(*series.notes, note))
    return series


def _without_glitches(path: Path, series: Series) -> Series:
    """Positions that jump away and soon come back while the force stays are put between their neighbours."""
    t, f, strain, bad = series.time_s, series.force_n, series.strain, np.zeros(len(series), dtype=bool)
    for _ in range(2):  # some hide behind others
        bad |= _glitches(t, strain, f)
        strain = np.interp(t, t[~bad], series.strain[~bad])
    if bad.mean() > MANY_GLITCHES:
        raise FileFormatError(
            f"{path}: position jumps away and back in {bad.mean():.0%} of the rows while the force stays: is it that "
            "of the specimen, at the same time?"
        )
    note = f"position jumps away and back in {bad.sum()} rows, the force does not: put between their neighbours"
    return replace(series, strain=strain, notes=(*series.notes, note)) if bad.any() else series


def _glitches(t: FloatArray, x: FloatArray, f: FloatArray) -> NDArray[np.bool_]:
    """Which of the positions x (n,) at times t are far from those around while the force f is not."""
    from scipy.ndimage import label, median_filter

    usual, pull = median_filter(x, 2 * GLITCH_ROWS + 1, mode="nearest"), float(np.polyfit(x, f, 1)[0])
    runs, count = label(np.abs(x - usual) > JUMP * np.ptp(x))
    bad = np.zeros(len(x), dtype=bool)
    for number in range(1, count + 1):
        run = np.flatnonzero(runs == number)
        ends = [max(run[0] - 1, 0), min(run[-1] + 1, len(x) - 1)]
        away, pulled = (v[run] - np.interp(t[run], t[ends], v[ends]) for v in (x, f))
        stayed = pull * (pulled @ away) < FOLLOWED * pull**2 * (away @ away)
        bad[run] = stayed and np.abs(away).max() > JUMP * np.ptp(x)
    return bad


def _signs_agree(series: Series) -> Series:
    """Strain and force that rise together; where they do not, the resistance tells which of them is turned."""
    if np.corrcoef(series.strain, series.force_n)[0, 1] >= 0:
        return series
    if np.corrcoef(series.strain, series.resistance_ohm)[0, 1] < 0:  # it rises in tension
        note = "force_n and the resistance rise as strain falls: taken for tension, strain's sign was turned"
        return replace(series, strain=-series.strain, notes=(*series.notes, note))
    note = "force_n falls as strain rises, the resistance does not: force_n's sign was turned"
    return replace(series, force_n=-series.force_n, notes=(*series.notes, note))


def _without_jitter(series: Series) -> Series:
    """Strain whose noise adds to the way that it goes, which breaks contacts, without what turns within the noise."""
    bend = np.abs(np.diff(series.strain, 2))
    quiet = np.median(bend[: len(bend) // QUIET * QUIET].reshape(-1, QUIET), axis=1)
    noise = 1.4826 * float(np.quantile(quiet, 0.25)) / np.sqrt(6)  # of one reading, where the specimen moves least
    way = np.abs(np.diff(series.strain)).sum()
    there, back = _followed(series.strain, JITTER * noise), _followed(series.strain[::-1], JITTER * noise)[::-1]
    strain = (there + back) / 2  # each lags by as much
    if way < MAX_DETOUR * np.abs(np.diff(strain)).sum():
        return series
    note = f"strain jitters by {noise:.2g}, which would break contacts in the law: what turns within that was left out"
    return replace(series, strain=strain, notes=(*series.notes, note))


def _followed(values: FloatArray, slack: float) -> FloatArray:
    """Values (n,) as something follows them that is pulled along with some slack."""
    found, place = np.empty_like(values), values[0]
    for k, value in enumerate(values.tolist()):
        place = min(max(place, value - slack), value + slack)
        found[k] = place
    return found


def _without_gaps(path: Path, series: Series) -> Series:
    """The longest part between gaps in which the specimen moved; others are bridged."""
    apart = series.seconds
    gaps = np.flatnonzero(apart > max(GAP_S, GAP_STEPS * float(np.median(apart))))
    if not len(gaps):
        return series
    longest = gaps[np.argmax(apart[gaps])]
    said = (
        f"{len(gaps)} gap{'s' * (len(gaps) > 1)}, the longest {apart[longest]:.3g} s at {series.time_s[longest]:.4g} s"
    )
    moved = gaps[np.abs(np.diff(series.strain)[gaps]) > STILL * np.ptp(series.strain)]
    if not len(moved):
        return replace(series, notes=(*series.notes, f"{said}, in which strain stayed: bridged"))
    ends = np.r_[0, moved + 1, len(series)]
    times = [series.time_s[b - 1] - series.time_s[a] for a, b in pairwise(ends)]
    best = int(np.argmax(times))
    kept = series.part(slice(ends[best], ends[best + 1]), f"{said}: only the longest part without is used")
    if times[best] < MIN_KEPT * float(np.ptp(series.time_s)) or len(kept) < MIN_ROWS:
        raise FileFormatError(f"{path}: {said}, and strain moved meanwhile: record it again without gaps.")
    return kept


def swinging(resistance_ohm: FloatArray) -> float:
    """Share of readings (n,) that go up and down in turn for long: such a meter alternates about what it measures."""
    bend = resistance_ohm[:-2] - 2 * resistance_ohm[1:-1] + resistance_ohm[2:]
    turns = (bend[1:] * bend[:-1] < 0) & (
        np.minimum(np.abs(bend[1:]), np.abs(bend[:-1])) > SWING * resistance_ohm[1:-2]
    )
    if len(turns) < RUN:
        return 0.0
    whole = np.convolve(turns, np.ones(RUN), "valid") > RUN - 0.5
    return float(np.minimum(np.convolve(whole, np.ones(RUN), "full"), 1.0).mean())
