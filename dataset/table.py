"""Samples as a table, a row a sample, a column a number: CSV or Parquet as written, CSV read whoever made it."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from itertools import chain, product
from pathlib import Path
from typing import IO

import numpy as np

from common.bounded import require_memory
from common.clean import Form, form_of, read_table
from common.errors import FileFormatError, needing
from common.storage.files import replacing
from dataset.imperfections import OPEN_OHM
from dataset.samples import AnySamples
from dataset.variables import LABELS, VARIABLES, labels_of, layout_of
from geometry.design import MAX_UNITS
from geometry.layout import AXES, FloatArray, Layout

COLUMN = re.compile(r"(?:force|resistance)_(\d+)_(\d+)_(.+)_(n|ohm)")
SHORT = {r"f_(\d+)_(\d+)": r"force_\1_\2_z_n", r"r_(\d+)_(\d+)": r"resistance_\1_\2_z_ohm"}  #: of sensors of one axis
KNOWN = re.compile("|".join((COLUMN.pattern, *SHORT)))
NAMES = "name columns force_0_0_x_n and resistance_0_0_z_ohm, by row, column and axis or pillar; or f_0_0 and r_0_0"
TABLES = (".csv", ".parquet")  #: endings of tables that are written
LEAST_COUNT = 0.5  #: that a whole number of 0 stands for among readings that are counts


def columns_of(variables: Iterable[str], rows: int, cols: int, layout: Layout) -> list[str]:
    """Names of the columns of variables of an array: quantity, place and unit.

    >>> columns_of(["force_n", "resistance_ohm"], 1, 1, layout_of("xyz"))[2:4]
    ['force_0_0_z_n', 'resistance_0_0_z_ohm']
    """

    def named(variable: str) -> Iterator[str]:
        labels = {"row": range(rows), "col": range(cols), **labels_of(layout)}
        dims = VARIABLES[variable].dims[1:]
        quantity, *unit = variable.rsplit("_", 1) if dims else [variable]
        for place in product(*(labels[dim] for dim in dims)):
            yield "_".join([quantity, *(str(label).lower() for label in place), *unit])

    return [name for variable in variables for name in named(variable)]


def write_table(data: AnySamples, path: Path, counted: Callable[[int], None] = lambda samples: None) -> list[str]:
    """Write samples as CSV or Parquet (.parquet), whole or not at all, each number as it is; its columns.

    Of series each moment is a row, which begins with the number of its series and its time.
    `counted` is told the number of samples of each block. A path that ends otherwise, or that cannot be written to, is
    a `FileFormatError` or a `NotWrittenError`.
    """
    path = Path(path)
    if path.suffix not in TABLES:
        raise FileFormatError(f"{path}: no form of a table: end the name in {' or '.join(TABLES)}.")
    columns, first = columns_of(data.variables, *data.shape, data.layout), 0
    with replacing(path) as temporary, temporary.open("wb") as file, _appending(file, path.suffix) as append:
        for block in data.blocks(4 * data.leaf_size):
            flat = block.at_moments()
            numbers = [values.reshape(len(flat), -1) for values in flat.arrays().values()]
            rows = dict(zip(columns, np.concatenate(numbers, axis=1, dtype=data.dtype).T, strict=True))
            if data.time_s is not None:
                numbered = np.repeat(np.arange(first, first + len(block)), len(data.time_s))
                rows = {"series": numbered, "time_s": np.tile(data.time_s, len(block))} | rows
                first += len(block)
            append(rows)
            counted(len(block))
    return columns


@contextmanager
def _appending(file: IO[bytes], suffix: str) -> Iterator[Callable[[Mapping[str, FloatArray]], None]]:
    """What appends rows, by their columns, to an open table of this kind."""
    if suffix == ".csv":
        import pandas as pd

        yield lambda rows: pd.DataFrame(rows).to_csv(file, index=False, header=file.tell() == 0, lineterminator="\n")
        return
    with needing("Parquet", "sweep"):
        import pyarrow as pa
        import pyarrow.parquet as pq
    with ExitStack() as opened:  # ends a table that stays unfinished, too, which else its writer would do later
        writers: list[pq.ParquetWriter] = []

        def append(rows: Mapping[str, FloatArray]) -> None:
            table = pa.table(dict(rows))
            if not writers:
                writers.append(opened.enter_context(pq.ParquetWriter(file, table.schema)))
            writers[0].write_table(table)

        yield append


def read_csv(path: Path) -> tuple[dict[str, FloatArray], Layout]:
    """Forces (n, rows, cols, 3) [N] and resistances (n, rows, cols, n_pillars) [Ω] of a table, and its layout.

    Other columns are left out, forces along an axis without columns are 0, pillars beside a single one open. Numbers
    between semicolons may have a decimal comma. A file that is missing, lacks a column or holds what is no number is a
    `FileFormatError` that says which.
    """
    import pandas as pd

    path = Path(path)
    form = _form_of(path)
    require_memory(2 * path.stat().st_size, f"{path}: its samples", "give fewer, or a NetCDF file")
    header = form.header
    places = [place for place in map(COLUMN.fullmatch, header) if place]
    units = [(int(place[1][:9]), int(place[2][:9])) for place in places]
    pillars = {place[3] for place in places if place[4] == "ohm"}
    layout = layout_of(pillars)
    rows, cols = (max(count) + 1 for count in zip(*units, strict=True)) if units else (1, 1)
    if max(rows, cols) > MAX_UNITS:
        raise FileFormatError(f"{path}: names {rows} × {cols} units, at most {MAX_UNITS} each way: mend its header.")
    of_each = [columns_of([name], rows, cols, layout) for name in LABELS]
    axes = {f"{place[3]}_n" for place in places if place[4] == "n"} or {f"{axis}_n" for axis in AXES}
    alone = pillars if len(pillars) == 1 and pillars <= {*layout.pillar_names} else layout.pillar_names
    ends = (*(f"_{pillar}_ohm" for pillar in alone), *axes)
    expected = [name for name in chain(*of_each) if name.endswith(ends)]
    there = {name: at for at, name in enumerate(header)}
    if missing := next((name for name in expected if name not in there), ""):
        size = f" of {rows} × {cols} units" if units else ""
        raise FileFormatError(f"{path}: has no column {missing}{size}: {NAMES}.")
    try:
        decimal = "," if form.separator == ";" else "."
        options = {"sep": form.separator, "decimal": decimal, "encoding": form.encoding, "skiprows": form.above}
        table = pd.read_csv(path, header=None, names=range(len(header)), **options)
        if not isinstance(table.index, pd.RangeIndex):
            raise ValueError("rows have more values than the header has columns")
        if any(table.dtypes[there[name]].kind not in "iuf" for name in expected):  # marks of thousands, and the like
            lines = read_table(path, form, 1 << 40, "give fewer")
            filled = [(cells + [""] * len(header))[: len(header)] for cells in lines.values()]
            table = pd.DataFrame(filled).replace("", np.nan)
        table = table.set_axis(header, axis=1)[expected].dropna(how="all")
        arrays = {
            name: table.reindex(columns=names, fill_value=0.0 if name == "force_n" else OPEN_OHM).to_numpy(np.float64)
            for name, names in zip(LABELS, of_each, strict=True)
        }
    except (ValueError, TypeError) as error:  # of pandas, too
        raise FileFormatError(f"{path}: {str(error).splitlines()[0]}: give numbers alone, a row a sample.") from None
    if table.empty:
        raise FileFormatError(f"{path}: has no rows, expected at least one sample.")
    if (arrays["resistance_ohm"] == np.floor(arrays["resistance_ohm"])).all():
        arrays["resistance_ohm"] = np.where(arrays["resistance_ohm"] == 0, LEAST_COUNT, arrays["resistance_ohm"])
    return {name: values.reshape(len(table), rows, cols, -1) for name, values in arrays.items()}, layout


def holds_samples(path: Path) -> bool:
    """Whether a file is a CSV table of samples, by the names of its columns; one of known loads has readings, too."""
    header = _form_of(Path(path)).header if Path(path).suffix == ".csv" else []
    return any(place[4] == "n" or "load" not in header for place in map(COLUMN.fullmatch, header) if place)


def _form_of(path: Path) -> Form:
    """How a table is written, with the long names of its columns."""
    form = form_of(path, KNOWN.fullmatch)
    names = form.header
    for short, long in SHORT.items():
        names = [re.sub(f"^{short}$", long, name) for name in names]
    return form._replace(header=names)
