"""Tables for people, by rich."""

from rich.console import Console
from rich.table import Table


def show(table: Table) -> None:
    """Print a table on stdout, as wide as it needs where stdout is no terminal."""
    console = Console()
    console.print(table) if console.is_terminal else Console(width=140).print(table)
