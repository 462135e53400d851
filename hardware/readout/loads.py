"""Known loads, as people write them down: a CSV table, or a weight on a pad."""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geometry.errors import FileFormatError
from geometry.layout import AXES, FloatArray
from geometry.storage.text_file import why_unreadable

COLUMNS = ("load", "row", "col", "fx_n", "fy_n", "fz_n")  #: of the table; `fx_n` and `fy_n` may be left out
TIMES = ("from_s", "to_s")  #: optional: when the load was on, since the recording's first scan
STANDARD_GRAVITY = 9.80665  # m/s²


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
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FileFormatError(f"{source}: {column} is {text!r}, must be a number.")
    return value


def _whole(line: dict[str, str], column: str, source: str) -> int:
    text = (line.get(column) or "").strip()
    try:
        return int(text)
    except ValueError:
        raise FileFormatError(f"{source}: {column} is {text!r}, must be a whole number.") from None


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
