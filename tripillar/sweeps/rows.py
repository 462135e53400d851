"""Rows of a sweep: the metrics of one design each, as small files while it runs and as tables at its end.

A row is written as soon as it is known, so that nothing is lost; a Parquet file holds all rows. Definitions of the
metrics with their equations are in docs/results.md.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from common.storage.files import write_bytes
from geometry.layout import AXES, FloatArray

DISTANCES = (1, 2, 3)  #: pitches to the neighbours of the crosstalk

#: what rows hold: name for tables and pictures, unit, meaning; those with {pillar} for each pillar of a unit
METRICS = {
    "error_n": (
        "error of pad forces", "N", "noise-limited error of a force, root mean square over axes, units and loads"
    ),
    "error_pct": ("error of pad forces", "%", "the same in % of range_n"),
    **{f"error_{axis}_n": (f"error of F{axis}", "N", f"the same of F{axis} alone") for axis in AXES},
    "range_n": ("range", "N", "force along z that every pad bears, alone or all together: strain, sinking below cap"),
    "pressure_one_mpa": (
        "pressure on one pad", "MPa", "largest pressure on one pad alone below the strain cap, of the weakest pad"
    ),
    "pressure_all_mpa": (
        "pressure on all pads", "MPa", "largest pressure on all pads at once below the strain cap"
    ),
    "sensitivity_{pillar}_pct_per_n": (
        "sensitivity of {pillar} pillars", "%/N", "change of a {pillar} pillar by its own force, mean over units"
    ),
    "sensitivity_least_pct_per_n": ("least sensitivity", "%/N", "the same of the least sensitive of all pillars"),
    **{
        f"crosstalk_{d}": (f"crosstalk at {d} × pitch", "1", f"worst response {d} pitches away over the loaded unit's")
        for d in DISTANCES
    },
    "crosstalk_{pillar}_{distance}": (
        "crosstalk of {pillar} pillars at {distance} × pitch", "1", "the same of {pillar} pillars, {distance} away"
    ),
    "condition": (
        "condition number", "1", "condition number of the map from forces to relative resistances, at rest"
    ),
    "touch_net_pct": (
        "error of a touch's net force", "%", "least deviation of the normal force of a touch of touch_n, median"
    ),
    "touch_place_mm": ("error of a touch's place", "mm", "least deviation of its centre of pressure, median"),
    "area_cm2": ("area", "cm²", "footprint of the slab"),
    "volume_cm3": ("volume", "cm³", "volume of the slab"),
    "conductive_cm3": ("conductive rubber", "cm³", "volume of all pillars"),
    "channels": ("channels", "1", "pillars that are read, each at a crossing of its own"),
    "wires": ("wires", "1", "row and column wires of the array"),
    "rate_hz": ("scan rate", "Hz", "scans a second that the firmware has time for"),
    "wall_mm": ("wall", "mm", "smallest wall between troughs of the mould, or of rubber to the slab's side"),
    "undercut_mm": ("undercut", "mm", "how far a heel juts out under the wall of its trough"),
    "demould_deg": ("demoulding angle", "°", "least angle of a slanted face to the vertical"),
    "error_estimate": ("error of the response", "1", "estimated relative error of the response"),
    "unknowns": ("unknowns", "1", "unknowns of the largest system solved"),
    "seconds": ("time", "s", "time spent on the design, whatever was taken from the cache left out"),
    "seconds_mesh": ("meshing", "s", "of which meshing its cell"),
    "seconds_condense": ("condensing", "s", "of which condensing it"),
    "seconds_couple": ("coupling", "s", "of which coupling the array"),
}  # fmt: skip


class Metric(NamedTuple):
    """What a number of a row is."""

    words: str  #: its name in tables and pictures
    unit: str
    meaning: str

    @property
    def label(self) -> str:
        """Its name with its unit.

        >>> Metric("area", "cm²", "").label, Metric("condition number", "1", "").label
        ('area [cm²]', 'condition number')
        """
        return self.words if self.unit == "1" else f"{self.words} [{self.unit}]"


def metrics_for(pillars: Iterable[str]) -> dict[str, Metric]:
    """The metrics of a row by name, some of them for each pillar of a unit.

    >>> [name for name in metrics_for(["z2"]) if "_z2_" in name]
    ['sensitivity_z2_pct_per_n', 'crosstalk_z2_1', 'crosstalk_z2_2', 'crosstalk_z2_3']
    """
    pairs, found = list(product(pillars, DISTANCES)), {}
    for name, texts in METRICS.items():
        for pillar, distance in pairs if "{" in name else [("", 0)]:
            filled = [text.format(pillar=pillar, distance=distance) for text in (name, *texts)]
            found[filled[0]] = Metric(*filled[1:])
    return found


Metrics = dict[str, float | None]


@dataclass(frozen=True, kw_only=True)
class Row:
    """The metrics of one design, or why it has none."""

    cache_key: str  #: hash of the design and of how it was judged
    values: dict[str, float | str]  #: of the varied keys
    design: str | None  #: as a design file; None if the numbers make no design
    metrics: Metrics = field(default_factory=dict)  #: by the names of `metrics_for`
    reason: str = ""  #: why it failed
    untold: dict[str, str] = field(default_factory=dict)  #: why it lacks a metric, by its name

    @property
    def failed(self) -> bool:
        """Whether the design could not be judged."""
        return bool(self.reason)

    def metric(self, name: str) -> float:
        """A metric of the row; infinite if it is missing, so that the row comes last."""
        value = self.metrics.get(name)
        return float("inf") if value is None else value

    def lacking(self) -> dict[str, list[str]]:
        """Names of the metrics that it lacks, by the reason."""
        found: dict[str, list[str]] = {}
        for name, reason in self.untold.items():
            found.setdefault(reason, []).append(name)
        return found

    def flat(self, metrics: Iterable[str]) -> dict[str, Any]:
        """The row as one line of a table: values of the varied keys, these metrics, and the design's text."""
        return {
            "recipe": self.cache_key,
            **self.values,
            "failed": self.failed,
            "reason": self.reason,
            "untold": "; ".join(f"{', '.join(names)}: {reason}" for reason, names in self.lacking().items()),
            **{name: self.metrics.get(name) for name in metrics},
            "design": self.design,
        }


def column(rows: Sequence[Row], name: str) -> FloatArray:
    """A metric of all rows; NaN where it is missing."""
    return np.array([np.nan if (value := row.metrics.get(name)) is None else value for row in rows])


def write_parquet(rows: Sequence[Row], metrics: Mapping[str, Metric], path: Path) -> None:
    """Write rows as a Parquet table, whole or not at all; its metrics have their units and meaning as metadata."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    texts = [name for row in rows for name, value in row.values.items() if isinstance(value, str)]
    types = dict.fromkeys(("recipe", "reason", "untold", "design", *texts), pa.string()) | {"failed": pa.bool_()}
    notes = {name: {"units": metric.unit, "meaning": metric.meaning} for name, metric in metrics.items()}
    lines = [row.flat(metrics) for row in rows]
    schema = pa.schema([pa.field(name, types.get(name, pa.float64()), metadata=notes.get(name)) for name in lines[0]])
    content = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pylist(lines, schema=schema), content)
    write_bytes(path, content.getvalue().to_pybytes())
