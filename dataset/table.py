"""Samples as a table, a row a sample, a column a number: CSV, written and read whoever made it, and Parquet."""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dataset.leaves import LEAF
from dataset.samples import AnySamples
from dataset.variables import COORDINATES, LABELS, VARIABLES
from geometry.errors import FileFormatError, needing
from geometry.layout import FloatArray
from geometry.storage.files import replacing
from geometry.storage.text_file import why_unreadable

if TYPE_CHECKING:
    import pandas as pd

ROWS_AT_ONCE = 4 * LEAF  #: rows of a group of a Parquet file: 28 MB of forces and resistances of 36 units in float32
COLUMN = re.compile(r"(?:force|resistance)_(\d+)_(\d+)_[a-z]_(?:n|ohm)")
NAMES = "name columns force_0_0_x_n and resistance_0_0_z_ohm, by row, column and axis or pillar"


def columns_of(data: AnySamples) -> dict[str, dict[str, str]]:
    """Columns of the table of some samples, by name: variable, place, unit and meaning of each.

    >>> from dataset.samples import Samples
    >>> samples = Samples(force_n=np.ones((5, 1, 1, 3)), resistance_ohm=np.full((5, 1, 1, 3), 1e4))
    >>> list(columns_of(samples))[2:4], columns_of(samples)["force_0_0_z_n"]["axis"]
    (['force_0_0_z_n', 'resistance_0_0_z_ohm'], 'z')
    """
    return _columns(data.variables, *data.shape)


def _columns(variables: Iterable[str], rows: int, cols: int) -> dict[str, dict[str, str]]:
    found = {}
    labels: dict[str, Sequence[int | str]] = {"row": range(rows), "col": range(cols), **COORDINATES}
    for variable in variables:
        dims, notes, _ = VARIABLES[variable]
        quantity, *unit = variable.rsplit("_", 1) if len(dims) > 1 else [variable]
        said = {"variable": variable, "units": notes.get("units", "1"), "note": notes["note"]}
        for place in product(*(map(str, labels[dim]) for dim in dims[1:])):
            name = "_".join([quantity, *map(str.lower, place), *unit])
            found[name] = said | dict(zip(dims[1:], place, strict=True))
    return found


def write_table(data: AnySamples, path: Path, counted: Callable[[int], None] = lambda samples: None) -> None:
    """Write samples as a table, whole or not at all: Parquet or CSV, as the path ends; of each block `counted` is told.

    Parquet holds in the metadata of each field what `columns_of` says of it, and in the schema's ``tripillar`` the hash
    of the content and the attributes of the data set (JSON). CSV has the header alone.

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
    import pandas as pd

    form = _parquet if path.suffix == ".parquet" else _csv
    columns = columns_of(data)
    with replacing(path) as temporary, form(data, columns, temporary) as write:
        for block in data.blocks(ROWS_AT_ONCE):
            numbers = [values.reshape(len(block), -1) for values in block.arrays().values()]
            write(pd.DataFrame(np.concatenate(numbers, axis=1, dtype=data.dtype), columns=list(columns)))
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
    expected = _columns(LABELS, rows, cols)
    missing = [name for name in expected if name not in header]
    if missing:
        size = f" of {rows} × {cols} units" if units else ""
        raise FileFormatError(f"{path}: has no column {missing[0]}{size}: {NAMES}.")
    try:
        decimal = "," if separator == ";" else "."
        table = pd.read_csv(path, sep=separator, decimal=decimal, header=0, names=header, encoding="utf-8-sig")
        arrays = dict(zip(LABELS, np.split(table[list(expected)].to_numpy(np.float64), 2, axis=1), strict=True))
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
def _parquet(data: AnySamples, columns: Mapping[str, Any], path: Path) -> Iterator[Callable[["pd.DataFrame"], None]]:
    """An open file: a function that writes rows into it."""
    with needing("Parquet", "parquet"):
        import pyarrow as pa
        from pyarrow.parquet import ParquetWriter
    told = json.dumps(data.attributes() | {"content_hash": data.content_hash}, default=lambda value: value.tolist())
    fields = [pa.field(name, getattr(pa, str(data.dtype))(), metadata=said) for name, said in columns.items()]
    schema = pa.schema(fields, metadata={"tripillar": told})
    with ParquetWriter(path, schema, compression="zstd") as writer:
        yield lambda rows: writer.write_table(pa.Table.from_pandas(rows, schema, preserve_index=False))


@contextmanager
def _csv(data: AnySamples, columns: Mapping[str, Any], path: Path) -> Iterator[Callable[["pd.DataFrame"], None]]:
    """The same of CSV, with the digits that give back each number."""
    with path.open("w", encoding="utf-8", newline="\n") as file:
        yield lambda rows: rows.to_csv(file, index=False, header=file.tell() == 0)
