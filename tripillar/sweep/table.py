"""The best designs of a sweep as a table for people."""

from collections.abc import Sequence

from rich.markup import escape
from rich.table import Table

from tripillar.sweep.merits import figure_label
from tripillar.sweep.rows import Row
from tripillar.sweep.sweep_file import Sweep

SHOWN = ("error_n", "error_pct", "range_n", "area_cm2", "crosstalk_1", "condition")  #: figures of the table


def ranked(rows: Sequence[Row], sweep: Sweep) -> list[Row]:
    """Rows within the sweep's bounds, the best first."""
    sound = [row for row in rows if not row.failed and not sweep.excess(row.figures)]
    return sorted(sound, key=lambda row: figure(row, sweep.least))


def figure(row: Row, name: str) -> float:
    """A figure of a row; infinite where it has none, so that it comes last."""
    value = row.figures.get(name)
    return float("inf") if value is None else value


def best_table(rows: Sequence[Row], sweep: Sweep, count: int) -> Table:
    """The best designs within the bounds, a line each."""
    best = ranked(rows, sweep)
    failed = sum(row.failed for row in rows)
    sound = len(rows) - failed
    least = escape(figure_label(sweep.least))
    outside = f", {sound - len(best)} out of bounds" if sweep.bounds else ""
    table = Table(
        title=f"The {min(count, len(best))} designs of least {least} of {sound}{outside}; {failed} failed",
    )
    for label in (*(variable.label for variable in sweep.variables), *map(figure_label, SHOWN)):
        table.add_column(escape(label.replace(" ", "\n")), justify="right", vertical="bottom")
    for row in best[:count]:
        cells = [f"{figure(row, name):.3g}" for name in SHOWN]
        table.add_row(*(f"{row.values[variable.name]:.4g}" for variable in sweep.variables), *cells)
    return table


def reasons(rows: Sequence[Row]) -> dict[str, list[str]]:
    """Why designs failed, a reason a design, by the kind of the error."""
    found: dict[str, list[str]] = {}
    for row in rows:
        if row.failed:
            found.setdefault(row.reason.split(":")[0], []).append(row.reason)
    return found
