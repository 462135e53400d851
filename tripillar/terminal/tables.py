"""Tables for people, by rich."""

from typing import Any

from rich.console import Console
from rich.table import Table


def show(table: Table) -> None:
    """Print a table on stdout, as wide as it needs where stdout is no terminal."""
    console = Console()
    console.print(table) if console.is_terminal else Console(width=140).print(table)


def plain_table(title: str, rows: list[dict[str, Any]]) -> Table:
    """Rows of the same keys, numbers to three digits."""
    table = Table(title=title)
    for header, value in rows[0].items():
        table.add_column(header, justify="left" if isinstance(value, str) else "right")
    for row in rows:
        table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values()))
    return table
