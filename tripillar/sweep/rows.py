"""Rows of a sweep: one small file each while it runs, so that nothing is lost; Parquet and NetCDF of all at its end."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry.layout import AXES, PILLARS
from geometry.storage.files import replacing, write_bytes
from geometry.storage.netcdf import write_netcdf
from geometry.storage.seal import opened_json, say_made_anew, sealed_json
from tripillar.sweep.merits import DISTANCES, FIGURES

if TYPE_CHECKING:
    import xarray as xr

Figures = dict[str, float | None]


@dataclass(frozen=True, kw_only=True)
class Row:
    """What is known of one design."""

    recipe: str  #: hash of the design and of how it was judged
    values: dict[str, float]  #: of the varied keys
    design: str | None  #: as a design file; None if the numbers make no design
    figures: Figures = field(default_factory=dict)  #: by the names of `FIGURES`; none if it failed
    sensitivity_per_n: list[list[list[float]]] | None = None  #: (rows, cols, 3): of every pillar by its own force
    reason: str = ""  #: why it failed
    note: str = ""  #: why the trained net is missing

    @property
    def failed(self) -> bool:
        return bool(self.reason)


def row_path(folder: Path, recipe: str) -> Path:
    return folder / f"{recipe}.json"


def write_row(row: Row, folder: Path) -> None:
    """Write a row as a file of its own with its hash, whole or not at all."""
    with replacing(row_path(folder, row.recipe)) as temporary:
        temporary.write_text(sealed_json(asdict(row)) + "\n", encoding="utf-8")


def read_row(folder: Path, recipe: str) -> Row | None:
    """The row of a recipe; None if it is missing or damaged, which is said: its design is judged again."""
    path = row_path(folder, recipe)
    try:
        row = Row(**opened_json(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        say_made_anew(path)
        return None
    return row if row.recipe == recipe else None


def flat(row: Row) -> dict[str, Any]:
    """A row as one line of a table: numbers of the varied keys, every figure, and the design's text."""
    return {
        "recipe": row.recipe,
        **row.values,
        "failed": row.failed,
        "reason": row.reason,
        "note": row.note,
        **{name: row.figures.get(name) for name in FIGURES},
        "design": row.design,
    }


def write_parquet(rows: Sequence[Row], path: Path) -> None:
    """Write rows as a Parquet table, whole or not at all."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    texts, flags = ("recipe", "reason", "note", "design"), ("failed",)
    types = {name: pa.string() for name in texts} | {name: pa.bool_() for name in flags}
    schema = pa.schema(
        [pa.field(name, types.get(name, pa.float64()), metadata=_column_notes(name)) for name in flat(rows[0])]
    )
    content = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pylist([flat(row) for row in rows], schema=schema), content)
    write_bytes(path, content.getvalue().to_pybytes())


def _column_notes(name: str) -> dict[str, str]:
    _, units, meaning = FIGURES.get(name, ("", "", ""))
    return {"units": units, "meaning": meaning} if meaning else {}


def write_rows_netcdf(rows: Sequence[Row], path: Path) -> None:
    """Write rows as NetCDF: figures over designs, sensitivities over rows, columns and pillars as well."""
    write_netcdf(to_xarray(rows), path)


def to_xarray(rows: Sequence[Row]) -> "xr.Dataset":
    """Rows as a dataset; NaN where a design failed, or its array is smaller than the largest."""
    import xarray as xr

    def column(name: str) -> np.ndarray:
        return np.array([_or_nan(row.figures.get(name)) for row in rows])

    split = [f"error_{axis}_n" for axis in AXES] + [f"trained_{axis}_n" for axis in AXES]
    split += [f"sensitivity_{p}_pct_per_n" for p in PILLARS] + [
        f"crosstalk_{p}_{d}" for p in PILLARS for d in DISTANCES
    ]
    split += [f"crosstalk_{d}" for d in DISTANCES]
    variables: dict[str, Any] = {
        name: ("sample", column(name), {"units": units, "meaning": meaning})
        for name, (_, units, meaning) in FIGURES.items()
        if name not in split
    }
    for kind, of in (("error", "noise-limited error"), ("trained", "error of the trained joint net")):
        errors = np.stack([column(f"{kind}_{axis}_n") for axis in AXES], axis=1)
        variables[f"{kind}_by_axis_n"] = (("sample", "axis"), errors, {"units": "N", "meaning": of})
    talk = [[column(f"crosstalk_{pillar}_{d}") for d in DISTANCES] for pillar in PILLARS]
    variables["crosstalk"] = (
        ("sample", "pillar", "distance"),
        np.array(talk).transpose(2, 0, 1),
        {"units": "1", "meaning": "response of the same pillar so many pitches away over the loaded unit's"},
    )
    variables["sensitivity_per_n"] = (
        ("sample", "row", "col", "pillar"),
        _padded([row.sensitivity_per_n for row in rows]),
        {"units": "1/N", "meaning": "relative resistance change of each pillar by its own force, at rest"},
    )
    for key in rows[0].values:
        variables[key.replace(".", "_")] = ("sample", np.array([row.values[key] for row in rows]), {"key": key})
    for name in ("recipe", "reason", "note"):
        variables[name] = ("sample", np.array([getattr(row, name) for row in rows], dtype=object))
    variables["design"] = ("sample", np.array([row.design or "" for row in rows], dtype=object))
    return xr.Dataset(variables, coords={"axis": list(AXES), "pillar": list(PILLARS), "distance": list(DISTANCES)})


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value


def _padded(arrays: Sequence[Any]) -> np.ndarray:
    """Arrays (rows, cols, 3) of several sizes in one, (n, most rows, most cols, 3), NaN elsewhere."""
    known = {number: np.array(array) for number, array in enumerate(arrays) if array is not None}
    rows, cols = (max((array.shape[axis] for array in known.values()), default=0) for axis in (0, 1))
    padded = np.full((len(arrays), rows, cols, len(PILLARS)), np.nan)
    for number, array in known.items():
        padded[number, : array.shape[0], : array.shape[1]] = array
    return padded
