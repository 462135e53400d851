"""The card of a data set: Markdown under a head in YAML, as hubs of data sets read it."""

import json
import re
from pathlib import Path

from dataset.samples import AnySamples
from geometry.design_file import design_to_toml
from geometry.errors import DesignError

LICENSE = re.compile(r"[a-z0-9][a-z0-9.+-]*")
UNSTATED = "unknown"  #: licence where none is given
#: JSON strings are YAML strings
CARD = """\
---
pretty_name: {title_json}
license: {license}
tags: [tactile, robotics, tabular]
task_categories: [tabular-regression]
configs:
- config_name: default
  data_files: {parquet}
---

# {title}

The forces on each pad of a three-axis tactile sensor and the resistances of its pillars. Rows run along y, columns
along x, from 0 on; axes are x, y, z, pillars z, x, y, electrodes U1, U2.

| | |
| --- | --- |
{rows}

`tripillar export {name} --to parquet` writes the table that the head of this page names; in Python
`tripillar.read_samples({name_json})` reads the data. Licence: {license}.
{design}"""


def card_text(data: AnySamples, path: Path, license: str = UNSTATED) -> str:
    """The card of a data set that lies at a path.

    The licence is an identifier as of SPDX in lower case, such as cc-by-4.0; another is a `DesignError`.
    """
    if not LICENSE.fullmatch(license):
        raise DesignError(f"license={license!r} must be an identifier such as cc-by-4.0, cc0-1.0, mit or other.")
    told = {**data.described(), "content_hash": data.content_hash}
    cells = {name: value.replace("|", "\\|").replace("\n", " ") for name, value in told.items()}
    return CARD.format(
        title=data.title,
        title_json=json.dumps(data.title, ensure_ascii=False),
        license=license,
        parquet=json.dumps(path.with_suffix(".parquet").name, ensure_ascii=False),
        rows="\n".join(f"| `{name}` | {value} |" for name, value in cells.items()),
        name=path.name,
        name_json=json.dumps(path.name, ensure_ascii=False),
        design="" if data.design is None else f"\n## Design\n\n```toml\n{design_to_toml(data.design).strip()}\n```\n",
    )
