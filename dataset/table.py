"""Samples as a table, a row a sample, a column a number: CSV, written and read whoever made it, and Parquet."""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dataset.leaves import LEAF
from dataset.variables import COORDINATES, LABELS, VARIABLES
from geometry.design_file import design_to_toml
from geometry.errors import FileFormatError, needing
from geometry.layout import FloatArray
from geometry.storage.files import replacing
from geometry.storage.text_file import why_unreadable

if TYPE_CHECKING:
    from dataset.samples import Samples
    from dataset.stored import StoredSamples

ROWS_AT_ONCE = 4 * LEAF  #: rows of a group of a Parquet file: 28 MB of forces and resistances of 36 units in float32
COLUMN = re.compile(r"(?:force|resistance)_(\d+)_(\d+)_[a-z]_(?:n|ohm)")
NAMES = "name columns force_0_0_x_n and resistance_0_0_z_ohm, by row, column and axis or pillar"


@dataclass(frozen=True, kw_only=True)
class Column:
    """One column of the table."""

    name: str  #: variable, row, col, labels and unit, such as force_0_5_z_n
    variable: str  #: of the data set
    place: dict[str, int | str]  #: row, col and labels; empty for a number a sample
    units: str
    note: str


def columns(names: Iterable[str], rows: int, cols: int) -> list[Column]:
    """The columns of some variables of an array, in their order.

    >>> [column.name for column in columns(["force_n", "resistance_ohm"], 1, 1)][2:4]
    ['force_0_0_z_n', 'resistance_0_0_z_ohm']
    """
    found = []
    labels: dict[str, Sequence[int | str]] = {"row": range(rows), "col": range(cols), **COORDINATES}
    for variable in names:
        dims, notes, _ = VARIABLES[variable]
        quantity, *unit = variable.rsplit("_", 1) if len(dims) > 1 else [variable]
        for place in product(*(labels[dim] for dim in dims[1:])):
            found.append(
                Column(
                    name="_".join([quantity, *(str(label).lower() for label in place), *unit]),
                    variable=variable,
                    place=dict(zip(dims[1:], place, strict=True)),
                    units=notes.get("units", "1"),
                    note=notes["note"],
                )
            )
    return found


def columns_of(data: "Samples | StoredSamples") -> list[Column]:
    """The columns of a data set, in the order of its variables."""
    return columns(data[:1].arrays(), *data.shape)


def write_table(
    data: "Samples | StoredSamples", path: Path, counted: Callable[[int], None] = lambda samples: None
) -> None:
    """Write samples as a table, whole or not at all: Parquet or CSV, as the path ends; of each block `counted` is told.

    Parquet holds units and meaning of each column in its field's metadata, and in the schema's ``tripillar`` the
    design (TOML), the hash of the content, attributes and a dictionary of the columns (JSON). CSV has the header alone.

    Raises
    ------
    FileFormatError, NotWrittenError
        If the path ends otherwise, or cannot be written to.
    MissingPackageError
        If pyarrow is not installed.
    """
    path = Path(path)
    if path.suffix not in (".parquet", ".csv"):
        raise FileFormatError(f"{path}: no form of a table: end the name in .parquet or .csv.")
    form = _parquet if path.suffix == ".parquet" else _csv
    with replacing(path) as temporary, form(data, temporary) as write:
        for block in data.blocks(ROWS_AT_ONCE):
            numbers = [values.reshape(len(block), -1) for values in block.arrays().values()]
            write(np.concatenate(numbers, axis=1).astype(data.dtype, copy=False))
            counted(len(block))


def read_csv(path: Path) -> dict[str, FloatArray]:
    """Forces [N] and resistances [Ω] of a table, each (n, rows, cols, 3); other columns are left out.

    Numbers between semicolons may have a decimal comma.

    Raises
    ------
    FileFormatError
        If the file is missing, lacks a column, or something in it is no number; the message says which.
    """
    import pandas as pd

    header, separator = _header_of(path)
    units = [(int(place[1]), int(place[2])) for place in map(COLUMN.fullmatch, header) if place]
    rows, cols = (max(count) + 1 for count in zip(*units, strict=True)) if units else (1, 1)
    wanted = {name: [column.name for column in columns([name], rows, cols)] for name in LABELS}
    missing = [column for names in wanted.values() for column in names if column not in header]
    if missing:
        size = f" of {rows} × {cols} units" if units else ""
        raise FileFormatError(f"{path}: has no column {missing[0]}{size}: {NAMES}.")
    try:
        decimal = "," if separator == ";" else "."
        table = pd.read_csv(path, sep=separator, decimal=decimal, header=0, names=header, encoding="utf-8-sig")
        arrays = {name: table[names].to_numpy(np.float64) for name, names in wanted.items()}
    except (ValueError, TypeError) as error:  # of pandas, too
        raise FileFormatError(f"{path}: {str(error).splitlines()[0]}: give numbers alone, a row a sample.") from None
    if table.empty:
        raise FileFormatError(f"{path}: has no rows, expected at least one sample.")
    return {name: values.reshape(len(table), rows, cols, -1) for name, values in arrays.items()}


def holds_samples(path: Path) -> bool:
    """Whether a file is a CSV table of samples, by the names of its columns."""
    return Path(path).suffix == ".csv" and any(COLUMN.fullmatch(name) for name in _header_of(path)[0])


def _header_of(path: Path) -> tuple[list[str], str]:
    """Names of a table's columns, and what stands between them: a comma, a semicolon or a tab."""
    try:
        with Path(path).open(encoding="utf-8-sig") as opened:
            line = opened.readline().rstrip("\r\n")
    except (OSError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path}: {why_unreadable(error)}: give a CSV table.") from None
    separator = max(",;\t", key=line.count)
    return [name.strip().strip('"') for name in line.split(separator)], separator


@contextmanager
def _parquet(data: "Samples | StoredSamples", path: Path) -> Iterator[Callable[[FloatArray], None]]:
    """An open file: a function that writes numbers (n, n_columns) into it."""
    with needing("Parquet", "parquet"):
        import pyarrow as pa
        from pyarrow.parquet import ParquetWriter
    told = {
        "design": None if data.design is None else design_to_toml(data.design),
        "content_hash": data.content_hash,
        "noise": data.noise,
        "bits": data.bits,
        "made_from": data.made_from,
        "columns": {column.name: asdict(column) for column in columns_of(data)},
    }
    fields = [
        pa.field(column.name, getattr(pa, str(data.dtype))(), metadata={"units": column.units, "note": column.note})
        for column in columns_of(data)
    ]
    schema = pa.schema(fields, metadata={"tripillar": json.dumps(told, default=_plain)})
    with ParquetWriter(path, schema, compression="zstd") as writer:
        yield lambda rows: writer.write_batch(
            pa.record_batch([pa.array(column) for column in np.ascontiguousarray(rows.T)], schema=schema)
        )


@contextmanager
def _csv(data: "Samples | StoredSamples", path: Path) -> Iterator[Callable[[FloatArray], None]]:
    """The same of CSV, with the digits that give back each number."""
    written = "{:.9g}".format if data.dtype == np.float32 else repr
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(column.name for column in columns_of(data)) + "\n")
        yield lambda rows: file.writelines(",".join(map(written, row.tolist())) + "\n" for row in rows)


def _plain(value: Any) -> Any:
    """Numbers and arrays of numpy as JSON has them."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else str(value)
