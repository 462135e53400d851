"""The card of a data set: Markdown under a head in YAML, as hubs of data sets read it."""

import json
import re
from pathlib import Path
from typing import Any

from dataset.samples import Samples
from dataset.stored import StoredSamples
from dataset.table import columns_of
from dataset.variables import VARIABLES
from geometry.design_file import design_to_toml
from geometry.errors import DesignError

LICENSE = re.compile(r"[a-z0-9][a-z0-9.+-]*")
UNSTATED = "unknown"  #: licence where none is given
#: attributes that options of `tripillar dataset` set, with the values that need no option
OPTIONS = {
    "protocol": None, "samples": None, "seed": 0, "cap": 0.3, "noise": 0.0, "bits": None, "drift": 0.0,
    "drift_tilt": 0.0, "drift_pillar": 0.0, "drift_offset_ohm": 0.0, "gain_spread": 0.0, "offset_ohm": 0.0,
    "specimen": 0, "strain": None,
}  # fmt: skip
#: attributes that no option sets; where there are others, these options do not make the data again
FOUND = ("summary", "redrawn", "unsolved", "recipe", "response_hash", "mesh_hash", "residual")
#: JSON strings are YAML strings
CARD = """\
---
pretty_name: {title_json}
license: {license}
tags:
- tactile
- robotics
- tabular
{simulation}task_categories:
- tabular-regression
size_categories:
- {size}
configs:
- config_name: default
  data_files: {parquet}
dataset_info:
  features:
{features}
---

# {title}

{samples:,} samples of a three-axis tactile sensor of {rows} × {cols} pads: the forces on each pad and the \
resistances of its three pillars.
{summary}
## How it was made

{command}{made}

## Variables

{variables}

Rows run along y, columns along x, from 0 on; axes are x, y, z, pillars z, x, y, electrodes U1, U2. Columns of tables \
are named by variable, row, column, label and unit: `{column}`.

## Files

{files}

`tripillar export {name} --to parquet` writes the table that the head of this page describes.

```python
import tripillar as tp

samples = tp.read_samples({name_json})
print(len(samples), samples[:5].force_n.shape)
```

## Licence

{licence}
{design}"""


def card_text(data: Samples | StoredSamples, path: Path, license: str = UNSTATED) -> str:
    """The card of a data set that lies at a path.

    The licence is an identifier as of SPDX in lower case, such as cc-by-4.0; another is a `DesignError`.
    """
    if not LICENSE.fullmatch(license):
        raise DesignError(f"license={license!r} must be an identifier such as cc-by-4.0, cc0-1.0, mit or other.")
    rows, cols = data.shape
    told = {"samples": len(data), **data.made_from, "noise": data.noise, "bits": data.bits}
    made = {name: value for name, value in told.items() if value is not None}
    columns = columns_of(data)
    variables = list(dict.fromkeys(column.variable for column in columns))
    protocol = made.get("protocol")
    title = f"{'Three-axis tactile array' if protocol is None else f'TriPillar {protocol}'}, {rows} × {cols} pads"
    command = _command(made, variables, str(data.dtype), path)
    size = sum(part.stat().st_size for part in ([path] if path.is_file() else path.rglob("*")) if part.is_file())
    files = {"name": path.name, "bytes": f"{size:,}", "content_hash": data.content_hash}
    return CARD.format(
        title=title,
        title_json=json.dumps(title, ensure_ascii=False),
        license=license,
        licence="Not stated." if license == UNSTATED else f"{license}.",
        simulation="" if protocol is None else "- simulation\n",
        size=size_category(len(data)),
        parquet=json.dumps(path.with_suffix(".parquet").name, ensure_ascii=False),
        features="\n".join(f"  - {{name: {column.name}, dtype: {data.dtype}}}" for column in columns),
        samples=len(data),
        rows=rows,
        cols=cols,
        summary=str(made["summary"]).rstrip(".").capitalize() + ".\n" if "summary" in made else "",
        command=f"    {command}\n\n" if command else "",
        made=_table(["attribute", "value"], made.items()),
        variables=_table(
            ["variable", "dims", "unit", "type", "meaning"],
            [
                (f"`{name}`", ", ".join(dims), notes.get("units", ""), data.dtype, notes["note"])
                for name in variables
                for dims, notes, _ in [VARIABLES[name]]
            ],
        ),
        column=columns[0].name,
        files=_table(["", ""], files.items()),
        name=path.name,
        name_json=json.dumps(path.name, ensure_ascii=False),
        design="" if data.design is None else f"\n## Design\n\n```toml\n{design_to_toml(data.design).strip()}\n```\n",
    )


def size_category(samples: int) -> str:
    """The class of a number of samples, as hubs name it.

    >>> size_category(999), size_category(1_000_000)
    ('n<1K', '1M<n<10M')
    """
    names = ["1", "1K", "10K", "100K", "1M", "10M", "100M", "1B", "10B"]
    place = max(len(str(samples)) - 3, 0)
    return "n<1K" if place == 0 else f"{names[place]}<n<{names[place + 1]}"


def _command(made: dict[str, Any], variables: list[str], dtype: str, path: Path) -> str:
    """The command that makes such samples of the design below; nothing where options alone do not say it."""
    if not {"protocol", "seed"} <= made.keys() <= {*OPTIONS, *FOUND}:
        return ""
    asked = {name: made[name] for name, usual in OPTIONS.items() if name in made and made[name] != usual}
    options = [f"--{name.removesuffix('_ohm').replace('_', '-')} {value}" for name, value in asked.items()]
    if not {"traction_mpa", "displacement_mm", "length_mm"} <= set(variables):
        options.append(f"--only {','.join(name.rsplit('_', 1)[0] for name in variables)}")
    options += [] if dtype == "float64" else [f"--dtype {dtype}"]
    return " ".join(["tripillar dataset", *options, "--design sensor.toml --out", path.name])


def _table(head: list[str], rows: Any) -> str:
    """A table in Markdown, a row for each tuple of values."""
    cells = [head, ["---"] * len(head)]
    cells += [[str(value).replace("|", "\\|").replace("\n", " ") for value in row] for row in rows]
    return "\n".join(f"| {' | '.join(row)} |" for row in cells)
