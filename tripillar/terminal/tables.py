"""Tables for people, by rich."""

from typing import Any

from rich.console import Console
from rich.table import Table


def show(table: Table) -> None:
    """Print a table on stdout, as wide as it needs where stdout is no terminal."""
    console = Console()
    console.print(table) if console.is_terminal else Console(width=140).print(table)


def plain_table(title: str, row: dict[str, Any]) -> Table:
    """A row of values under their names, numbers to three digits."""
    table = Table(title=title)
    for header, value in row.items():
        table.add_column(header, justify="left" if isinstance(value, str) else "right")
    table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values()))
    return table
