"""Rows of a sweep: the metrics of one design each, as small files while it runs and as tables at its end.

A row is written as soon as it is known, so that nothing is lost; Parquet and NetCDF files hold all rows. Definitions of
the metrics with their equations are in docs/results.md.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry.layout import AXES, PILLARS, FloatArray
from geometry.storage.files import write_bytes, write_text
from geometry.storage.netcdf import write_netcdf
from geometry.storage.seal import opened_json, say_made_anew, sealed_json

if TYPE_CHECKING:
    import xarray as xr

DISTANCES = (1, 2, 3)  #: pitches to the neighbours of the crosstalk
#: the metrics of a row: name for tables and pictures, unit, meaning
METRICS = {
    "error_n": ("error", "N", "noise-limited error of a force component, root mean square over axes, units and loads"),
    "error_pct": ("error", "%", "the same in % of range_n"),
    **{f"error_{axis}_n": (f"error of F{axis}", "N", f"the same of F{axis} alone") for axis in AXES},
    "range_n": ("range", "N", "force along z that every pad can carry, alone or all together, below the strain cap"),
    "pressure_one_mpa": (
        "pressure on one pad", "MPa", "largest pressure on one pad alone below the strain cap, of the weakest pad"
    ),
    "pressure_all_mpa": (
        "pressure on all pads", "MPa", "largest pressure on all pads at once below the strain cap"
    ),
    **{
        f"sensitivity_{pillar}_pct_per_n": (
            f"sensitivity of {pillar} pillars", "%/N", f"change of a {pillar} pillar by its own force, mean over units"
        )
        for pillar in PILLARS
    },
    "sensitivity_least_pct_per_n": ("least sensitivity", "%/N", "the same of the least sensitive of all pillars"),
    **{
        f"crosstalk_{d}": (f"crosstalk at {d} × pitch", "1", f"worst response {d} pitches away over the loaded unit's")
        for d in DISTANCES
    },
    **{
        f"crosstalk_{pillar}_{d}": (
            f"crosstalk of {pillar} pillars at {d} × pitch", "1", f"the same of {pillar} pillars alone, {d} away"
        )
        for pillar in PILLARS
        for d in DISTANCES
    },
    "condition": (
        "condition number", "1", "condition number of the map from forces to relative resistances, at rest"
    ),
    "area_cm2": ("area", "cm²", "footprint of the slab"),
    "volume_cm3": ("volume", "cm³", "volume of the slab"),
    "error_estimate": ("error of the response", "1", "estimated relative error of the response"),
    "unknowns": ("unknowns", "1", "unknowns of the largest system solved"),
    "seconds": ("time", "s", "time spent on the design, whatever was taken from the cache left out"),
    "seconds_mesh": ("meshing", "s", "of which meshing its cell"),
    "seconds_condense": ("condensing", "s", "of which condensing it"),
    "seconds_couple": ("coupling", "s", "of which coupling the array"),
    "peak_mib": ("memory", "MiB", "largest memory of the worker so far"),
    **{
        f"trained_{axis}_n": (
            f"trained error of F{axis}", "N", f"error of the trained joint net in F{axis}, root mean square"
        )
        for axis in AXES
    },
}  # fmt: skip

STORED_AS = {"cache_key": "recipe", "metrics": "figures"}  #: names of fields in the files

Metrics = dict[str, float | None]


@dataclass(frozen=True, kw_only=True)
class Row:
    """The metrics of one design, or why it has none."""

    cache_key: str  #: hash of the design and of how it was judged
    values: dict[str, float]  #: of the varied keys
    design: str | None  #: as a design file; None if the numbers make no design
    metrics: Metrics = field(default_factory=dict)  #: by the names of `METRICS`; costs alone if the design failed
    sensitivity_per_n: list[list[list[float]]] | None = None  #: (rows, cols, 3): of every pillar by its own force
    reason: str = ""  #: why it failed
    note: str = ""  #: why the trained net is missing

    @property
    def failed(self) -> bool:
        """Whether the design could not be judged."""
        return bool(self.reason)

    def metric(self, name: str) -> float:
        """A metric of the row; infinite if it is missing, so that the row comes last."""
        value = self.metrics.get(name)
        return float("inf") if value is None else value

    def flat(self) -> dict[str, Any]:
        """The row as one line of a table: numbers of the varied keys, every metric, and the design's text."""
        return {
            "recipe": self.cache_key,
            **self.values,
            "failed": self.failed,
            "reason": self.reason,
            "note": self.note,
            **{name: self.metrics.get(name) for name in METRICS},
            "design": self.design,
        }


def column(rows: Sequence[Row], name: str) -> FloatArray:
    """A metric of all rows; NaN where it is missing."""
    return np.array([np.nan if (value := row.metrics.get(name)) is None else value for row in rows])


def metric_label(name: str) -> str:
    """The name of a metric with its unit, for tables and pictures.

    >>> metric_label("area_cm2"), metric_label("condition")
    ('area [cm²]', 'condition number')
    """
    label, unit, _ = METRICS[name]
    return label if unit == "1" else f"{label} [{unit}]"


def write_row(row: Row, folder: Path) -> None:
    """Write a row as a file of its own with its hash, whole or not at all."""
    stored = {STORED_AS.get(name, name): value for name, value in asdict(row).items()}
    write_text(sealed_json(stored) + "\n", folder / f"{row.cache_key}.json")


def read_row(folder: Path, cache_key: str) -> Row | None:
    """The row of a cache key; None if it is missing or damaged, which is said: its design is judged again."""
    path = folder / f"{cache_key}.json"
    names = {stored: name for name, stored in STORED_AS.items()}
    try:
        stored = opened_json(path.read_text(encoding="utf-8"))
        row = Row(**{names.get(name, name): value for name, value in stored.items()})
    except (OSError, ValueError, TypeError, AttributeError):
        say_made_anew(path)
        return None
    return row if row.cache_key == cache_key else None


def write_parquet(rows: Sequence[Row], path: Path) -> None:
    """Write rows as a Parquet table, whole or not at all."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    types = dict.fromkeys(("recipe", "reason", "note", "design"), pa.string()) | {"failed": pa.bool_()}
    notes = {name: {"units": units, "meaning": meaning} for name, (_, units, meaning) in METRICS.items()}
    lines = [row.flat() for row in rows]
    schema = pa.schema([pa.field(name, types.get(name, pa.float64()), metadata=notes.get(name)) for name in lines[0]])
    content = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pylist(lines, schema=schema), content)
    write_bytes(path, content.getvalue().to_pybytes())


def write_rows_netcdf(rows: Sequence[Row], path: Path) -> None:
    """Write rows as NetCDF: metrics over designs, sensitivities over rows, columns and pillars as well."""
    write_netcdf(to_xarray(rows), path)


def to_xarray(rows: Sequence[Row]) -> "xr.Dataset":
    """Rows as a dataset; NaN where a design failed, or its array is smaller than the largest."""
    import xarray as xr

    errors = {kind: [f"{kind}_{axis}_n" for axis in AXES] for kind in ("error", "trained")}
    talks = [[f"crosstalk_{pillar}_{d}" for d in DISTANCES] for pillar in PILLARS]
    apart = {*chain(*errors.values(), *talks), *(f"crosstalk_{d}" for d in DISTANCES)}
    apart |= {f"sensitivity_{pillar}_pct_per_n" for pillar in PILLARS}
    variables: dict[str, Any] = {
        name: ("sample", column(rows, name), {"units": units, "meaning": meaning})
        for name, (_, units, meaning) in METRICS.items()
        if name not in apart
    }
    for kind, meaning in (("error", "noise-limited error"), ("trained", "error of the trained joint net")):
        by_axis = np.stack([column(rows, name) for name in errors[kind]], axis=1)
        variables[f"{kind}_by_axis_n"] = (("sample", "axis"), by_axis, {"units": "N", "meaning": meaning})
    talk = np.array([[column(rows, name) for name in names] for names in talks]).transpose(2, 0, 1)
    meaning = "response of the same pillar so many pitches away over the loaded unit's"
    variables["crosstalk"] = (("sample", "pillar", "distance"), talk, {"units": "1", "meaning": meaning})
    variables["sensitivity_per_n"] = (
        ("sample", "row", "col", "pillar"),
        _padded([row.sensitivity_per_n for row in rows]),
        {"units": "1/N", "meaning": "relative resistance change of each pillar by its own force, at rest"},
    )
    for key in rows[0].values:
        variables[key.replace(".", "_")] = ("sample", np.array([row.values[key] for row in rows]), {"key": key})
    for name in ("recipe", "reason", "note", "design"):
        variables[name] = ("sample", np.array([row.flat()[name] or "" for row in rows], dtype=object))
    return xr.Dataset(variables, coords={"axis": list(AXES), "pillar": list(PILLARS), "distance": list(DISTANCES)})


def _padded(arrays: Sequence[Any]) -> np.ndarray:
    """Arrays (rows, cols, 3) of several sizes in one, (n, most rows, most cols, 3), NaN elsewhere."""
    known = {number: np.array(array) for number, array in enumerate(arrays) if array is not None}
    rows, cols = (max((array.shape[axis] for array in known.values()), default=0) for axis in (0, 1))
    padded = np.full((len(arrays), rows, cols, len(PILLARS)), np.nan)
    for number, array in known.items():
        padded[number, : array.shape[0], : array.shape[1]] = array
    return padded
