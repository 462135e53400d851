"""Bench series: time, strain, force and resistance of one specimen, read from a table, checked and mended.

Each rule takes a series and gives it back mended, which it says in a note, or refuses it with what to do.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from common.clean import form_of, read_table
from common.errors import FileFormatError
from common.storage.text_file import StrictTables
from dataset.memory import broken_contacts
from geometry.design import Memory
from geometry.layout import FloatArray

STRICT = StrictTables(FileFormatError)
SECONDS = {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0, "d": 86400.0, "us": 1e-6, "ns": 1e-9}
#: columns of each quantity that a table may have, and how much of its unit theirs is
COLUMNS = {
    "time_s": {f"time_{unit}": each for unit, each in SECONDS.items()},
    "strain": {"strain": 1.0, "strain_pct": 0.01, "displacement_mm": 1.0},
    "force_n": {"force_n": 1.0, "force_mn": 1e-3, "force_g": 9.80665e-3},
    "resistance_ohm": {"resistance_ohm": 1.0, "resistance_kohm": 1e3, "resistance_mohm": 1e6},
    "two_wire_ohm": {"two_wire_ohm": 1.0, "two_wire_kohm": 1e3},
}
BESIDE = ("resistance_ohm", "two_wire_ohm")  #: may be missing: of a mechanical test, and of one by four wires
NAMED = "columns={0}=NAME names another one, as in displacement_mm=x,time_ms=t"
MIN_ROWS = 100
MAX_ROWS, MOST_ROWS = 15_000, 2_000_000  #: more are averaged, or refused
STEPS_S, LENGTHS_S = (1e-4, 5.0), (20.0, 3 * 86400.0)  #: between rows, and of all, that benches have
USUAL_S = 0.2  #: between rows
APART_S = 1e5  #: between runs of which nothing is known in between: everything is forgotten
LARGEST = 1e12  #: of a reading
MIN_OHM = 50.0  #: no strip of filled silicone has less; kΩ look so
MIN_STRAIN, MAX_STRAIN = 5e-3, 3.0  #: range of a series that tells something, and that is believed
GAP_S, GAP_STEPS = 5.0, 20.0  #: between rows, forwards or back, and over their usual distance
SAME_TIME = 1e-6  #: of the usual step: rows that are nearer have one time
RESTARTS = 0.05  #: of the rows: a table whose clock steps back more often is in no order
STRAINED = 0.05  #: of the range: a first strain that is none of rest
GLITCH_ROWS, JUMP = 5, 0.04  #: longest glitch of a position, and the least of the range
MANY_GLITCHES = 0.3  #: of the rows: what jumps so often is no position of the specimen
FOLLOWED = 0.4  #: of what a strain does to the force: less, and the specimen did not move
RUN, SWING = 16, 0.01  #: readings in a row that go up and down by so much: a meter that alternates
MANY = 0.05  #: share of rows that do before all are averaged in pairs
JITTER, MAX_DETOUR = 5.0, 1.005  #: deviations of noise that strain may turn within; way with it over that without
COARSE, PARTS = 1.1, 8  #: the same where this may be motion, of rows too few for it; then parts of each step
CLEARLY = 0.95  #: of what is missed without: a law that is right misses half or less, one that is not by chance as much
QUIET = 100  #: rows of a part that may be at rest
USUAL, RATES = (1.5, 5.7, 9.0, 120.0), ([0.1, 1.0, 1.0, 30.0], [10.0, 30.0, 40.0, 500.0])  #: b, ratio of both, both τ
MIN_KEPT, MAX_RUNS = 0.5, 12  #: of rows with runs apart that are used, and runs at most: the longest


@dataclass(frozen=True, kw_only=True, eq=False)
class Series:
    """Readings of one specimen over time (n,); strain is positive where it lengthens, and force where it pulls."""

    time_s: FloatArray
    strain: FloatArray
    force_n: FloatArray
    resistance_ohm: Any = None  #: (n,); None of a mechanical test
    notes: tuple[str, ...] = ()  #: what was found and mended, a line each
    settled: bool = True  #: whether its first run begins at rest and unstrained
    parts: int = 1  #: of each step between rows, followed along a curve: 1, but where rows are few for the motion
    two_wire_ohm: FloatArray | None = None  #: the whole specimen with its contacts, where it was read, too

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def seconds(self) -> FloatArray:
        """Times between readings (n − 1,) [s]."""
        return np.diff(self.time_s)

    @property
    def unsettled(self) -> list[int]:
        """First rows of its runs that do not begin at rest, or of which nobody knows."""
        return [0] * (not self.settled) + [*(np.flatnonzero(self.seconds >= APART_S) + 1).tolist()]

    def broken(self, memory: Memory) -> FloatArray:
        """Shares of contacts (2, n) that strain has broken, from rest on."""
        strain, seconds = self.strain, self.seconds
        if self.parts > 1:
            from scipy.interpolate import CubicSpline

            rows = np.arange(len(self))
            fine = CubicSpline(rows, strain)(np.linspace(0, rows[-1], self.parts * rows[-1] + 1))
            strain, seconds = fine.clip(strain.min(), strain.max()), np.repeat(seconds / self.parts, self.parts)
        return broken_contacts(strain, seconds, memory)[:, :: self.parts]

    @property
    def arrays(self) -> dict[str, FloatArray]:
        """Its quantities (n,)."""
        return {name: values for name in COLUMNS if (values := getattr(self, name)) is not None}

    def mended(self, *notes: str, **changes: Any) -> Self:
        """The same with changes, and what is to be said of them; an empty note says nothing."""
        return replace(self, **changes, notes=self.notes + tuple(filter(None, notes)))

    def part(self, rows: Any, *notes: str) -> Self:
        """Some of its rows, or all in another order."""
        return self.mended(*notes, **{name: values[rows] for name, values in self.arrays.items()})

    def averaged(self, count: int, note: str = "") -> Self:
        """Means of so many rows each."""
        n = len(self) // count * count
        means = {name: values[:n].reshape(-1, count).mean(axis=1) for name, values in self.arrays.items()}
        return self.mended(note, **means)


def read_series(
    path: Path, columns: Mapping[str, str] | None = None, length_mm: float | None = None, as_given: bool = False
) -> Series:
    """A bench series of a CSV table with the columns time_s, strain, force_n, resistance_ohm; others may stand beside.

    Instead there may be time_ms, strain_pct, displacement_mm with the specimen's length, force_g, resistance_kohm and
    so on; `columns` says under which names a table has them. With `as_given` units are believed.

    `FileFormatError` if a column is missing, a unit looks wrong, strain stays where it is, or too little is left.
    """
    units, table = _columns(path := Path(path), columns or {})
    if units["strain"] == "displacement_mm":
        if length_mm is None:
            raise FileFormatError(
                f"{path}: displacement_mm needs the specimen's length between its clamps: length_mm=."
            )
        table["strain"] = table["strain"] / length_mm
    series, with_sense = Series(**table), partial(_with_sense, units=units, as_given=as_given)
    ordered = (_whole_rows, _spread, _runs_apart, _in_order, _unsigned, with_sense, _without_glitches)
    of_resistance = (_without_swings, _without_jitter) if series.resistance_ohm is not None else ()
    for rule in (*ordered, *of_resistance, _of_few_rows, _signs_agree, _begun):
        series = STRICT.made(str(path), rule, series=series)
    return series


def _columns(path: Path, named: Mapping[str, str]) -> tuple[dict[str, str], dict[str, Any]]:
    """Of each quantity which column of `COLUMNS` the table has, and its values in the quantity's unit."""
    known = [name for units in COLUMNS.values() for name in units]
    if wrong := [name for name in named if name not in known]:
        raise FileFormatError(f"columns={wrong[0]}=... names no quantity; there are {', '.join(known)}.")
    form = form_of(path, {*known, *named.values()}.__contains__)
    lines = read_table(path, form, MOST_ROWS, "give fewer, such as every tenth").values()
    header, found, table = form.header, {}, {}
    for quantity, units in COLUMNS.items():
        names = {unit: named.get(unit, unit) for unit in units}
        there = sorted((unit for unit in units if names[unit] in header), key=lambda unit: unit not in named)
        if there:
            unit, place = there[0], header.index(names[there[0]])
            said = form.units.get(names[unit], "").lower().replace("\u03a9", "ohm").replace("%", "pct")
            if (other := f"{unit.rpartition('_')[0] or unit}_{said}") in units and other != unit:
                raise FileFormatError(
                    f"{path}: the line of units says {said} of {names[unit]}: name it columns={other}={names[unit]}."
                )
            found[quantity] = unit
            table[quantity] = units[unit] * np.array([_number(cells, place) for cells in lines])
        elif quantity not in BESIDE:
            raise FileFormatError(
                f"{path}: the column {names[quantity]} is missing (or {', '.join(list(units)[1:])}); "
                f"it has {', '.join(header[:12]) or 'no lines'}: {NAMED.format(quantity)}."
            )
    if "two_wire_ohm" in found and "resistance_ohm" not in found:
        raise FileFormatError(f"{path}: two_wire_ohm stands beside four wires: of two alone name it resistance_ohm=.")
    return found, table


def _number(cells: list[str], place: int) -> float:
    try:
        return float(cells[place])
    except (ValueError, IndexError):
        return float("nan")


def _whole_rows(series: Series) -> Series:
    """Rows with all readings, none of them what meters say for none."""
    time_s, *others = np.abs(list(series.arrays.values()))
    read = np.isfinite(time_s) & (np.array(others) < LARGEST).all(axis=0)
    if series.resistance_ohm is not None:
        read &= series.resistance_ohm != 0
    return series.part(read, f"{(~read).sum()} rows without all readings left out" * (not read.all()))


def _spread(series: Series) -> Series:
    """Rows that share the time of a coarse clock between its ticks, as one after another."""
    ticks = np.flatnonzero(np.r_[len(series) > 0, series.seconds != 0])
    rows, place = np.diff(np.r_[ticks, len(series)]), np.arange(len(series))
    alike = [(np.diff(values)[series.seconds == 0] == 0).all() for values in series.arrays.values()]
    if len(ticks) < 2 or (usual := float(np.median(rows))) < 2 or all(alike):  # rows that are there twice
        return series
    step, many = np.diff(series.time_s[ticks]), np.maximum(rows, usual)
    tick_s, begins = float(np.median(np.abs(step))), np.r_[True, step < 0]
    first = np.where(begins, many - rows, 0) - ticks  # of the first tick the rows before are missing
    time_s = series.time_s + tick_s * np.repeat(1 / many, rows) * (place + np.repeat(first, rows))
    return series.mended(f"{usual:g} rows share each time: spread over {tick_s:.3g} s", time_s=time_s)


def _runs_apart(series: Series) -> Series:
    """Runs before and after gaps and restarts of the clock, so far apart that the rubber forgets; short ones left out.

    Where none would mingle by the order of time, rows are put in it.
    """
    breaks = np.flatnonzero(np.abs(series.seconds) > _gap_s(series)) + 1
    runs = np.split(np.arange(len(series)), breaks)
    ends_s = sorted((series.time_s[run].min(), series.time_s[run].max()) for run in runs if len(run))
    mingle = any(end_s > begin_s for (_, end_s), (begin_s, _) in pairwise(ends_s))
    if (series.seconds < 0).any() and (not mingle or len(breaks) > RESTARTS * len(series)):
        return _runs_apart(series.part(np.argsort(series.time_s, kind="stable"), "rows put in the order of time"))
    if not len(breaks):
        return series
    first_s, last_s = series.time_s[breaks[0] - 1 : breaks[0] + 1]
    said = f"its clock leaps {len(breaks)} time{'s' * (len(breaks) > 1)}, first from {first_s:.4g} s to {last_s:.4g} s"
    runs = sorted(sorted((run for run in runs if len(run) >= MIN_ROWS), key=len)[-MAX_RUNS:], key=min)
    if sum(map(len, runs)) < MIN_KEPT * len(series):
        raise FileFormatError(f"{said}, too few runs have {MIN_ROWS} rows: record it again in one go, without gaps.")
    kept = series.part(np.concatenate(runs))
    seconds = kept.seconds
    seconds[np.cumsum([*map(len, runs)])[:-1] - 1] = 2 * APART_S
    note = f"{said}: {len(runs)} run{'s' * (len(runs) > 1)} of {len(kept)} rows used, what each remembers found with it"
    time_s = kept.time_s[0] + np.r_[0.0, np.cumsum(seconds)]
    return kept.mended(note, time_s=time_s, settled=series.settled and runs[0][0] == 0)


def _in_order(series: Series) -> Series:
    """Rows in the order of time, one of each."""
    rows = np.argsort(series.time_s, kind="stable")
    seconds = np.diff(series.time_s[rows], prepend=-np.inf)
    rows = rows[seconds > SAME_TIME * np.median(np.r_[0.0, seconds[1:]])]
    late, same = (series.seconds < 0).any(), len(series) - len(rows)
    said = "rows put in the order of time" * bool(late), f"{same} rows of the same time left out" * (same > 0)
    return series.part(rows, *said)


def _unsigned(series: Series) -> Series:
    """Resistances above 0, of meters whose wires were swapped."""
    if series.resistance_ohm is None:
        return series
    turned = (series.resistance_ohm < 0).mean() if len(series) else 0.0
    note = f"the resistance is negative in {turned:.0%} of the rows: its sign was dropped" * bool(turned)
    return series.mended(note, **{name: np.abs(own) for name, own in series.arrays.items() if name.endswith("_ohm")})


def _with_sense(series: Series, units: Mapping[str, str], as_given: bool) -> Series:
    """The same; refused if it tells nothing, or is in another unit than its column says."""
    if len(series) < MIN_ROWS:
        raise FileFormatError(f"has {len(series)} rows with all readings, a series needs at least {MIN_ROWS}.")
    strain, ohm, seconds, most = series.strain, series.resistance_ohm, series.seconds, np.abs(series.strain).max()
    step_s, whole_s = float(np.median(seconds)), float(seconds[seconds <= _gap_s(series)].sum())
    said, unit = "", units["time_s"]
    if not (STEPS_S[0] <= step_s <= STEPS_S[1] and LENGTHS_S[0] <= whole_s <= LENGTHS_S[1]):
        said = f"its rows are {step_s:.4g} s apart, {whole_s:.3g} s in all, as no bench reads"
        sizes = {name: factor / SECONDS[unit[5:]] for name, factor in SECONDS.items()}
        other = min(sizes, key=lambda name: abs(np.log(max(step_s, 1e-15) * sizes[name] / USUAL_S)))
        if other != unit[5:] and LENGTHS_S[0] <= whole_s * sizes[other] <= LENGTHS_S[1]:
            said = f"{said.rpartition(',')[0]}, as if {unit} were in {other}: name the column time_{other}"
    elif most > MAX_STRAIN:
        said = f"{units['strain']} goes up to {most:.4g}, as if it were percent or millimetres: name it strain_pct, or "
        said += "displacement_mm with length_mm="
    elif ohm is not None and np.median(ohm) < MIN_OHM:
        said = f"{units['resistance_ohm']} is {np.median(ohm):.3g} Ω, as if it were kΩ: name the column resistance_kohm"
    elif series.two_wire_ohm is not None and np.median(series.two_wire_ohm / ohm) < 1:
        said = "two_wire_ohm is below the reading by four wires, which lacks contacts: are both exchanged, or in kΩ?"
    if said and not as_given:
        raise FileFormatError(f"{said}; if it is right, add force=True.")
    if np.ptp(strain) < MIN_STRAIN:
        raise FileFormatError(
            f"{units['strain']} stays within {np.ptp(strain):.2g}: nothing can be told of a specimen that is not "
            "stretched; take a test that next_test= proposes."
        )
    if (strain <= -0.95).any():
        raise FileFormatError(f"{units['strain']} falls to {strain.min():.3g}: nothing is shorter than -0.95.")
    for quantity in ("resistance_ohm", "force_n"):
        values = series.arrays.get(quantity, strain)
        if np.ptp(values) <= 1e-9 * np.abs(values).max():
            raise FileFormatError(f"{units[quantity]} stays {values[0]:.6g}: was its meter connected?")
    return series


def _without_glitches(series: Series) -> Series:
    """Positions that jump away and soon come back while the force stays are put between their neighbours."""
    t, f, strain, bad = series.time_s, series.force_n, series.strain, np.zeros(len(series), dtype=bool)
    for _ in range(2):  # some hide behind others
        bad |= _glitches(t, strain, f)
        strain = np.interp(t, t[~bad], series.strain[~bad])
    if bad.mean() > MANY_GLITCHES:
        raise FileFormatError(
            f"position jumps away and back in {bad.mean():.0%} of the rows while the force stays: is it that of the "
            "specimen, at the same time?"
        )
    note = f"position jumps away and back in {bad.sum()} rows, the force does not: put between their neighbours"
    return series.mended(note, strain=strain) if bad.any() else series


def _glitches(t: FloatArray, x: FloatArray, f: FloatArray) -> NDArray[np.bool_]:
    """Which of the positions x (n,) at times t are far from those around while the force f is not."""
    from scipy.ndimage import find_objects, label, median_filter

    usual, pull = median_filter(x, 2 * GLITCH_ROWS + 1, mode="nearest"), float(np.polyfit(x, f, 1)[0])
    bad = np.zeros(len(x), dtype=bool)
    for (run,) in find_objects(label(np.abs(x - usual) > JUMP * np.ptp(x))[0]):
        ends = [max(run.start - 1, 0), min(run.stop, len(x) - 1)]
        away, pulled = (v[run] - np.interp(t[run], t[ends], v[ends]) for v in (x, f))
        stayed = pull * (pulled @ away) < FOLLOWED * pull**2 * (away @ away)
        bad[run] = stayed and np.abs(away).max() > JUMP * np.ptp(x)
    return bad


def _gap_s(series: Series) -> float:
    """What is more than the usual time between rows, forwards or back."""
    return max(GAP_S, GAP_STEPS * float(np.median(np.abs(series.seconds)))) if len(series) > 1 else GAP_S


def _without_swings(series: Series) -> Series:
    """Means of pairs where readings go up and down in turn for long: such a meter alternates about what it measures."""
    from scipy.ndimage import binary_opening

    bend = np.diff(series.resistance_ohm, 2)
    size = np.minimum(np.abs(bend[1:]), np.abs(bend[:-1]))
    turns = (bend[1:] * bend[:-1] < 0) & (size > SWING * series.resistance_ohm[1:-2])
    if (share := binary_opening(turns, np.ones(RUN)).mean()) <= MANY:
        return series
    return series.averaged(2, f"readings alternate in {share:.0%} of the rows: averaged in pairs")


def _without_jitter(series: Series) -> Series:
    """Strain whose noise adds to the way that it goes, which breaks contacts, without what turns within the noise."""
    bend = np.abs(np.diff(series.strain, 2))
    rows = min(QUIET, len(bend))
    quiet = np.median(bend[: len(bend) // rows * rows].reshape(-1, rows), axis=1)
    noise = 1.4826 * float(np.quantile(quiet, 0.25)) / np.sqrt(6)  # of one reading, where the specimen moves least
    way = np.abs(np.diff(series.strain)).sum()
    there, back = _followed(series.strain, JITTER * noise), _followed(series.strain[::-1], JITTER * noise)[::-1]
    strain = (there + back) / 2  # each lags by as much
    detour = float(way / np.abs(np.diff(strain)).sum())
    if detour < MAX_DETOUR:
        return series
    note = f"strain jitters by {noise:.2g}, which would break contacts in the law: what turns within that was left out"
    curve = [replace(series, parts=PARTS)] * (detour > COARSE)
    best = min([series.mended(note, strain=strain), *curve], key=_missed)
    return best if _missed(best) < CLEARLY * _missed(series) else series


def _missed(series: Series) -> float:
    """Deviation of ln R from the law that meets it best."""
    from scipy.optimize import least_squares

    strain, rise = series.strain, np.log(series.resistance_ohm) - 2 * np.log1p(series.strain)

    def left(rates: FloatArray) -> FloatArray:
        b_lengthen, ratio, *tau_s = np.exp(rates)
        memory = Memory(b_lengthen=b_lengthen, b_shorten=ratio * b_lengthen, tau_s=tuple(tau_s))
        columns = np.stack([np.ones_like(strain), strain, strain**2, *series.broken(memory)], axis=1)
        return np.asarray(rise - columns @ np.linalg.lstsq(columns, rise)[0])

    return float(np.std(least_squares(left, np.log(USUAL), bounds=np.log(RATES), diff_step=1e-3, xtol=1e-3).fun))


def _followed(values: FloatArray, slack: float) -> FloatArray:
    """Values (n,) as something follows them that is pulled along with some slack."""
    found, place = np.empty_like(values), values[0]
    for k, value in enumerate(values.tolist()):
        place = min(max(place, value - slack), value + slack)
        found[k] = place
    return found


def _of_few_rows(series: Series) -> Series:
    """At most `MAX_ROWS` means."""
    count = -(-len(series) // MAX_ROWS)
    return series.averaged(count, f"averaged over {count} rows each" * (count > 1))


def _signs_agree(series: Series) -> Series:
    """Strain and force that rise together; where they do not, the resistance tells which of them is turned."""
    if np.corrcoef(series.strain, series.force_n)[0, 1] >= 0:
        return series
    ohm = series.resistance_ohm
    if ohm is not None and np.corrcoef(series.strain, ohm)[0, 1] < 0:  # it rises in tension
        note = "force_n and the resistance rise as strain falls: taken for tension, strain's sign was turned"
        return series.mended(note, strain=-series.strain)
    note = "force_n falls as strain rises, the resistance does not: force_n's sign was turned"
    return series.mended(note, force_n=-series.force_n)


def _begun(series: Series) -> Series:
    """The same, marked if it does not begin at rest and unstrained."""
    if series.settled and abs(series.strain[0]) <= STRAINED * np.ptp(series.strain):
        return series
    note = f"begins at a strain of {series.strain[0]:.3g}: what it remembers of before is found with the rest"
    return series.mended(note, settled=False)
