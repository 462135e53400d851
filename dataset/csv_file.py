"""Samples of a CSV table, whoever made it: a row a sample, a column a number, named as `dataset.table` names them."""

import re
from pathlib import Path

import numpy as np

from dataset.variables import COORDINATES
from geometry.errors import FileFormatError
from geometry.layout import FloatArray
from geometry.storage.text_file import why_unreadable

#: columns that must be there, by the variable that they hold, and the labels of its last axis
COLUMNS = {"force_n": ("force_{}_{}_{}_n", "axis"), "resistance_ohm": ("resistance_{}_{}_{}_ohm", "pillar")}
COLUMN = re.compile(r"(?:force|resistance)_(\d+)_(\d+)_[a-z]_(?:n|ohm)")
NAMES = "name columns force_0_0_x_n and resistance_0_0_z_ohm, by row, column and axis or pillar"


def header_of(path: Path) -> tuple[list[str], str]:
    """Names of a table's columns, and what stands between them: a comma, a semicolon or a tab.

    Raises
    ------
    FileFormatError
        If the file is missing or no text.
    """
    try:
        with Path(path).open(encoding="utf-8-sig") as opened:
            line = opened.readline().rstrip("\r\n")
    except (OSError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path}: {why_unreadable(error)}: give a CSV table.") from None
    separator = max(",;\t", key=line.count)
    return [name.strip().strip('"') for name in line.split(separator)], separator


def holds_samples(path: Path) -> bool:
    """Whether a file is a CSV table of samples, by the names of its columns."""
    return Path(path).suffix == ".csv" and any(COLUMN.fullmatch(name) for name in header_of(path)[0])


def read_csv(path: Path) -> dict[str, FloatArray]:
    """Forces [N] and resistances [Ω] of a table, each (n, rows, cols, 3); other columns are left out.

    Numbers between semicolons may have a decimal comma.

    Raises
    ------
    FileFormatError
        If the file is missing, lacks a column, or something in it is no number; the message says which.
    """
    import pandas as pd

    header, separator = header_of(path)
    units = [(int(place[1]), int(place[2])) for place in map(COLUMN.fullmatch, header) if place]
    rows, cols = (max(count) + 1 for count in zip(*units, strict=True)) if units else (1, 1)
    wanted = {
        name: [form.format(row, col, label) for row in range(rows) for col in range(cols) for label in COORDINATES[dim]]
        for name, (form, dim) in COLUMNS.items()
    }
    missing = [column for columns in wanted.values() for column in columns if column not in header]
    if missing:
        size = f" of {rows} × {cols} units" if units else ""
        raise FileFormatError(f"{path}: has no column {missing[0]}{size}: {NAMES}.")
    try:
        decimal = "," if separator == ";" else "."
        table = pd.read_csv(path, sep=separator, decimal=decimal, header=0, names=header, encoding="utf-8-sig")
        if table.empty:
            raise FileFormatError(f"{path}: has no rows, expected at least one sample.")
        return {
            name: table[columns].to_numpy(np.float64).reshape(len(table), rows, cols, -1)
            for name, columns in wanted.items()
        }
    except (ValueError, TypeError) as error:  # of pandas, too
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"{path}: {str(error).splitlines()[0]}: give numbers alone, a row a sample.") from None
