"""The one way that studies report: tables of rows on the terminal, the same as JSON, what they were made on beside."""

import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from math import isfinite
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from rich.markup import escape
from rich.table import Table

from common.storage.files import write_json
from tripillar.terminal.entry import wrote
from tripillar.terminal.tables import show

Row = dict[str, Any]  #: cells by header
Tables = Mapping[str, Sequence[Row]]  #: rows by title
OUT = Path("out/studies")
Folder = Annotated[Path, Parameter(help="Folder to write into.")]
PACKAGES = ("numpy", "scipy", "scikit-fem", "pypardiso", "torch", "ngsolve")  #: whose versions are written down


def report(tables: Tables, out: Path, about: Mapping[str, Any] | None = None, more: Iterable[Path] = ()) -> None:
    """Print tables by their titles, write them as JSON, and say what was written, pictures `more` among it."""
    for title, rows in tables.items():
        show(table_of(title, rows))
    write_json(_plain({"about": {**measured_on(), **(about or {})}, "tables": tables}), out)
    wrote([*more, out])


def table_of(title: str, rows: Sequence[Row]) -> Table:
    """Rows as a table, numbers to three digits; a row may lack some columns."""
    table, headers = Table(title=escape(title)), list(dict.fromkeys(key for row in rows for key in row))
    for header in headers:
        is_text = any(isinstance(row.get(header), str) for row in rows)
        table.add_column(escape(header), justify="left" if is_text else "right")
    for row in rows:
        table.add_row(*(escape(shown(row.get(header, ""))) for header in headers))
    return table


def shown(value: Any) -> str:
    """A cell: a dash for None, three digits of a number, numbers of a list between slashes."""
    if isinstance(value, list | tuple):
        return " / ".join(map(shown, value))
    return "–" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


def measured_on() -> dict[str, object]:
    """Machine and versions, without which times mean little."""
    found: dict[str, object] = {
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
    }
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "absent"
    return found


def _plain(value: Any) -> Any:
    """The same for JSON: null stands for what is no number."""
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not isfinite(value) else value
