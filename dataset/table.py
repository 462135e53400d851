"""Samples as a table for other programs, a row a sample: Parquet or CSV, written block by block."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dataset.leaves import KNOWN, LEAF
from dataset.samples import Samples
from dataset.stored import StoredSamples
from dataset.variables import COORDINATES
from geometry.design_file import design_to_toml
from geometry.errors import FileFormatError, needing
from geometry.storage.files import replacing

if TYPE_CHECKING:
    import pyarrow as pa

ROWS_AT_ONCE = 4 * LEAF  #: rows of a group of a Parquet file: 28 MB of forces and resistances of 36 units in float32


@dataclass(frozen=True, kw_only=True)
class Column:
    """One column of the table."""

    name: str  #: variable, row, col, labels and unit, such as force_0_5_z_n
    variable: str  #: of the data set
    place: dict[str, int | str]  #: row, col and labels; empty for a number a sample
    units: str
    note: str


def columns_of(data: Samples | StoredSamples) -> list[Column]:
    """The columns of a data set, in the order of its variables.

    >>> samples = Samples(force_n=np.ones((5, 1, 1, 3)), resistance_ohm=np.full((5, 1, 1, 3), 1e4))
    >>> [column.name for column in columns_of(samples)][2:4]
    ['force_0_0_z_n', 'resistance_0_0_z_ohm']
    """
    columns, (rows, cols) = [], data.shape
    labels: dict[str, Sequence[int | str]] = {"row": range(rows), "col": range(cols), **COORDINATES}
    for variable in _held(data[:1]):
        dims, notes = KNOWN[variable]
        quantity, unit = variable.rsplit("_", 1) if len(dims) > 1 else (variable, "")
        for place in product(*(labels[dim] for dim in dims[1:])):
            columns.append(
                Column(
                    name="_".join([quantity, *(str(label).lower() for label in place), *([unit] if unit else [])]),
                    variable=variable,
                    place=dict(zip(dims[1:], place, strict=True)),
                    units=notes.get("units", "1"),
                    note=notes["note"],
                )
            )
    return columns


def number_type(data: Samples | StoredSamples) -> str:
    """Type of the numbers of a table: float32 where the data set stores no more, else float64."""
    return str(data.dtype) if isinstance(data, StoredSamples) and data.dtype == np.float32 else "float64"


def write_table(
    data: Samples | StoredSamples, path: Path, counted: Callable[[int], None] = lambda samples: None
) -> None:
    """Write samples as a table, whole or not at all: Parquet or CSV, as the path ends.

    Parquet holds units and meaning of each column in its field's metadata, and in the schema's ``tripillar`` the
    design (TOML), the hash of the content, attributes and a dictionary of the columns (JSON). CSV has the header alone.

    Parameters
    ----------
    data : Samples or StoredSamples
    path : Path
    counted : callable
        Called with the number of samples of each block.

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
    write = _write_parquet if path.suffix == ".parquet" else _write_csv
    write(data, path, counted)


def _write_parquet(data: Samples | StoredSamples, path: Path, counted: Callable[[int], None]) -> None:
    with needing("Parquet", "parquet"):
        import pyarrow as pa
        from pyarrow.parquet import ParquetWriter
    schema, dtype = _schema(data), number_type(data)
    with replacing(path) as temporary, ParquetWriter(temporary, schema, compression="zstd") as writer:
        for block in data.blocks(ROWS_AT_ONCE):
            columns = np.ascontiguousarray(_rows(block).T, dtype=dtype)
            writer.write_batch(pa.record_batch([pa.array(column) for column in columns], schema=schema))
            counted(len(block))


def _schema(data: Samples | StoredSamples) -> "pa.Schema":
    import pyarrow as pa

    columns = columns_of(data)
    told = {
        "design": None if data.design is None else design_to_toml(data.design),
        "content_hash": data.content_hash,
        "noise": data.noise,
        "bits": data.bits,
        "made_from": data.made_from,
        "columns": {column.name: asdict(column) for column in columns},
    }
    fields = [
        pa.field(column.name, getattr(pa, number_type(data))(), metadata={"units": column.units, "note": column.note})
        for column in columns
    ]
    return pa.schema(fields, metadata={"tripillar": json.dumps(told, default=_plain)})


def _write_csv(data: Samples | StoredSamples, path: Path, counted: Callable[[int], None]) -> None:
    written = "{:.9g}".format if number_type(data) == "float32" else repr  # digits that give back the same number
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(column.name for column in columns_of(data)) + "\n")
        for block in data.blocks(LEAF):
            file.writelines(",".join(map(written, row)) + "\n" for row in _rows(block).tolist())
            counted(len(block))


def _held(samples: Samples) -> list[str]:
    return [name for name in KNOWN if getattr(samples, name) is not None]


def _rows(block: Samples) -> np.ndarray:
    """Numbers of a block in the order of the columns, (n, n_columns)."""
    return np.concatenate([getattr(block, name).reshape(len(block), -1) for name in _held(block)], axis=1)


def _plain(value: Any) -> Any:
    """Numbers and arrays of numpy as JSON has them."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else str(value)
