"""The card of a data set: Markdown under a head in YAML, as hubs of data sets read it."""

import json
import re
from pathlib import Path
from typing import Any

from dataset.leaves import KNOWN
from dataset.samples import Samples
from dataset.stored import StoredSamples
from dataset.table import columns_of, number_type
from dataset.variables import VARIABLES
from geometry.design_file import design_to_toml
from geometry.errors import DesignError

LICENSE = re.compile(r"[a-z0-9][a-z0-9.+-]*")
UNSTATED = "unknown"  #: licence where none is given
#: options of `tripillar dataset` by the attributes that they set, and the values that need no option
OPTIONS = {
    "protocol": ("--protocol", None),
    "samples": ("--samples", None),
    "seed": ("--seed", 0),
    "cap": ("--cap", 0.3),
    "noise": ("--noise", 0.0),
    "bits": ("--bits", None),
    "drift": ("--drift", 0.0),
    "drift_tilt": ("--drift-tilt", 0.0),
    "drift_pillar": ("--drift-pillar", 0.0),
    "drift_offset_ohm": ("--drift-offset", 0.0),
    "gain_spread": ("--gain-spread", 0.0),
    "offset_ohm": ("--offset", 0.0),
    "specimen": ("--specimen", 0),
    "strain": ("--strain", None),
}
#: attributes that no option sets; where there are others, these options do not make the data again
FOUND = ("summary", "redrawn", "unsolved", "recipe", "response_hash", "mesh_hash", "residual")


def card_text(data: Samples | StoredSamples, path: Path, license: str = UNSTATED) -> str:
    """The card of a data set.

    Parameters
    ----------
    data : Samples or StoredSamples
    path : Path
        Where it lies.
    license : str
        Identifier as of SPDX in lower case, such as cc-by-4.0.

    Raises
    ------
    DesignError
        If the licence is no identifier.
    """
    if not LICENSE.fullmatch(license):
        raise DesignError(f"license={license!r} must be an identifier such as cc-by-4.0, cc0-1.0, mit or other.")
    rows, cols = data.shape
    protocol = data.made_from.get("protocol")
    title = f"{'Three-axis tactile array' if protocol is None else f'TriPillar {protocol}'}, {rows} × {cols} pads"
    return "\n".join([*_head(data, path, license, title), *_body(data, path, license, title), ""])


def size_category(samples: int) -> str:
    """The class of a number of samples, as hubs name it.

    >>> size_category(999), size_category(1_000_000)
    ('n<1K', '1M<n<10M')
    """
    names = ["1", "1K", "10K", "100K", "1M", "10M", "100M", "1B", "10B"]
    place = max(len(str(samples)) - 3, 0)
    return "n<1K" if place == 0 else f"{names[place]}<n<{names[place + 1]}"


def _head(data: Samples | StoredSamples, path: Path, license: str, title: str) -> list[str]:
    """JSON strings are YAML strings."""
    tags = ["tactile", "robotics", "tabular", *(["simulation"] if "protocol" in data.made_from else [])]
    features = [f"  - {{name: {column.name}, dtype: {number_type(data)}}}" for column in columns_of(data)]
    return [
        "---",
        f"pretty_name: {json.dumps(title, ensure_ascii=False)}",
        f"license: {license}",
        "tags:",
        *(f"- {tag}" for tag in tags),
        "task_categories:",
        "- tabular-regression",
        "size_categories:",
        f"- {size_category(len(data))}",
        "configs:",
        "- config_name: default",
        f"  data_files: {json.dumps(path.with_suffix('.parquet').name, ensure_ascii=False)}",
        "dataset_info:",
        "  features:",
        *features,
        "---",
    ]


def _body(data: Samples | StoredSamples, path: Path, license: str, title: str) -> list[str]:
    rows, cols = data.shape
    told = {"samples": len(data), **data.made_from, "noise": data.noise, "bits": data.bits}
    made = {name: value for name, value in told.items() if value is not None}
    variables = dict.fromkeys(column.variable for column in columns_of(data))
    dtype = number_type(data)
    command = _command(made, list(variables), dtype, path)
    return [
        "",
        f"# {title}",
        "",
        f"{len(data):,} samples of a three-axis tactile sensor of {rows} × {cols} pads: the forces on each pad and the "
        "resistances of its three pillars.",
        *([str(made["summary"]).rstrip(".").capitalize() + "."] if "summary" in made else []),
        "",
        "## How it was made",
        "",
        *(["    " + command, ""] if command else []),
        *_rows("attribute", "value", made.items()),
        "",
        "## Variables",
        "",
        "| variable | dims | unit | type | meaning |",
        "| --- | --- | --- | --- | --- |",
        *(
            f"| `{name}` | {', '.join(KNOWN[name][0])} | {KNOWN[name][1].get('units', '')} | {dtype} | "
            f"{_cell(KNOWN[name][1]['note'])} |"
            for name in variables
        ),
        "",
        "Rows run along y, columns along x, from 0 on; axes are x, y, z, pillars z, x, y, electrodes U1, U2. Columns "
        f"of tables are named by variable, row, column, label and unit: `{columns_of(data)[0].name}`.",
        "",
        "## Files",
        "",
        *_rows("", "", [("name", path.name), ("bytes", f"{_bytes(path):,}"), ("content_hash", data.content_hash)]),
        "",
        f"`tripillar export {path.name} --to parquet` writes the table that the head of this page describes.",
        "",
        "```python",
        "import tripillar as tp",
        "",
        f"samples = tp.read_samples({json.dumps(path.name, ensure_ascii=False)})",
        "print(len(samples), samples[:5].force_n.shape)",
        "```",
        "",
        "## Licence",
        "",
        "Not stated." if license == UNSTATED else f"{license}.",
        *([] if data.design is None else ["", "## Design", "", "```toml", design_to_toml(data.design).strip(), "```"]),
    ]


def _command(made: dict[str, Any], variables: list[str], dtype: str, path: Path) -> str:
    """The command that makes such samples of the design below; nothing where options alone do not say it."""
    if not {"protocol", "seed"} <= made.keys() <= {*OPTIONS, *FOUND}:
        return ""
    options = [
        f"{option} {made[name]}" for name, (option, usual) in OPTIONS.items() if name in made and made[name] != usual
    ]
    if not set(VARIABLES) <= set(variables):
        options.append(f"--only {','.join(name.rsplit('_', 1)[0] for name in variables)}")
    options += [] if dtype == "float64" else [f"--dtype {dtype}"]
    return " ".join(["tripillar dataset", *options, "--design sensor.toml --out", path.name])


def _rows(first: str, second: str, pairs: Any) -> list[str]:
    return [
        f"| {first} | {second} |",
        "| --- | --- |",
        *(f"| {name} | {_cell(value)} |" for name, value in pairs),
    ]


def _cell(value: object) -> str:
    return str(value).replace("|", "\\|").replace("\n", " ")


def _bytes(path: Path) -> int:
    """Size of a file, or of all files of a folder."""
    return sum(part.stat().st_size for part in ([path] if path.is_file() else path.rglob("*")) if part.is_file())
