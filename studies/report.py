"""Tables for people: rich renderings of what the studies return."""

from collections.abc import Mapping

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from decoupler.metrics import ForceErrors
from fem.solution import Solution
from geometry.layout import AXES
from studies.comparison import Comparison
from studies.pipeline import CAP, SPLITS, Stage


def show(table: Table) -> None:
    """Print a table on stdout, as wide as it needs where stdout is no terminal."""
    console = Console()
    console.print(table) if console.is_terminal else Console(width=120).print(table)


def comparison_table(comparisons: list[Comparison]) -> Table:
    """Errors of every decoupler on every protocol's test samples, beside the paper's."""
    (training, _), (test, _) = SPLITS["train"], SPLITS["test"]
    table = Table(title=f"Decoupling errors on {test} test samples ({training} for training, strain ≤ {CAP:.0%})")
    table.add_column("data")
    table.add_column("decoupler")
    for header in ("relative error", "RMSE [N]", "% of full scale"):
        table.add_column(header, justify="right")
    for comparison in comparisons:
        title = f"{comparison.protocol}, {comparison.component.capitalize()}"
        table.add_row(title, "paper's figure (its own data)", f"{comparison.paper_rel_err:.2%}", "", "")
        for entry in comparison.entries:
            table.add_row("", entry.decoupler, *_error_cells(entry.errors))
        floor = f"PCA floor of {comparison.floor_hidden} nodes"
        table.add_row("", floor, *_error_cells(comparison.plain_floor), style="dim", end_section=True)
    return table


def stage_table(stages: list[Stage]) -> Table:
    """Time of every stage, and what was reused."""
    table = Table(title="Stages")
    table.add_column("stage")
    table.add_column("seconds", justify="right")
    table.add_column("")
    for stage in stages:
        table.add_row(stage.name, f"{stage.seconds:.1f}", "reused, nothing changed" if stage.reused else stage.note)
    table.add_row("all", f"{sum(stage.seconds for stage in stages):.1f}", "")
    return table


def errors_table(errors: Mapping[str, ForceErrors]) -> Table:
    """Errors of one model on one dataset."""
    table = Table()
    for header in ("force", "relative error", "RMSE [N]", "% of full scale"):
        table.add_column(header, justify="right")
    for name, values in errors.items():
        table.add_row(name, *_error_cells(values))
    return table


def solution_table(solution: Solution) -> Table:
    """Displacement of every probe of a scene, with how far to trust it below."""
    seconds = sum(solution.seconds.values())
    table = Table(
        min_width=100,
        caption=f"estimated error {solution.error_estimate:.1e}, energy {solution.energy_mj:.5g} mJ, "
        f"{solution.unknowns} unknowns, residual {solution.residual:.0e}, {seconds:.2f} s",
    )
    table.add_column("probe")
    for axis in AXES:
        table.add_column(escape(f"u{axis} [mm]"), justify="right")  # else rich takes [mm] for a style
    for name, displacement in solution.probes.items():
        table.add_row(escape(name), *(f"{u:.6g}" for u in displacement))
    return table


def _error_cells(errors: ForceErrors) -> tuple[str, str, str]:
    relative = "–" if errors.rel_err is None else f"{errors.rel_err:.2%}"
    share = "–" if errors.full_scale_pct is None else f"{errors.full_scale_pct:.3f}"
    return relative, f"{errors.rmse_n:.3f}", share
