"""The race as tables for people."""

from collections.abc import Callable

from rich.table import Table

from studies.bench.training.contenders import LM, VARPRO
from studies.bench.training.race import Run
from studies.bench.training.trace import GOALS

NOT_REACHED = "–"


def time_table(title: str, runs: list[Run], step_difference: float) -> Table:
    """Every contender: its steps, its time to the goals, and where it ended."""
    caption = (
        "mse of all scaled training outputs, seconds to it; eq. 17 on test samples; MiB of the process (of training). "
        f"Structured LM step less that of the dense JᵀJ, same start and damping: {step_difference:.0e} of its length."
    )
    table = Table(title=f"{title}: training time against error", caption=caption, pad_edge=False)
    table.add_column("contender", no_wrap=True)
    table.add_column("steps", justify="right")
    table.add_column("a step", justify="right", no_wrap=True)
    for name in GOALS:
        table.add_column(f"s to\n{name}", justify="right")
    for header in ("final\nmse", "test\nerror", "peak MiB", "stopped by"):
        table.add_column(header, justify="right", no_wrap=True)
    for run in runs:
        if run.failure:
            table.add_row(run.contender, run.failure)
            continue
        table.add_row(
            run.contender,
            f"{run.iterations:,}",
            _number(run.seconds_per_iteration, lambda s: f"{1000 * s:.3g} ms" if s < 1 else f"{s:.3g} s"),
            *(_number(run.seconds_to[name], lambda s: f"{s:.2f}") for name in GOALS),
            _number(run.mse, lambda mse: f"{mse:.2e}"),
            _number(run.rel_err, lambda error: f"{error:.2%}"),
            f"{run.peak_mib:,.0f} (+{run.training_mib:,.0f})",
            run.reason,
        )
    return table


def ratio_table(title: str, runs: list[Run]) -> Table:
    """Times of every contender over those of structured LM and of VarPro."""
    table = Table(title=f"{title}: how many times the time of structured LM / of VarPro")
    table.add_column("contender")
    for header in ("a step", *(f"to mse {name}" for name in GOALS)):
        table.add_column(header, justify="right")
    done = {run.contender: run for run in runs if not run.failure}
    for name, run in done.items():
        own = [done[other] for other in (LM, VARPRO) if other in done]
        cells = [" / ".join(_ratio(run.seconds_per_iteration, other.seconds_per_iteration) for other in own)]
        for goal in GOALS:
            cells.append(" / ".join(_ratio_to(goal, run, other) for other in own))
        table.add_row(name, *cells)
    return table


def _number(value: float | None, shown: Callable[[float], str]) -> str:
    return NOT_REACHED if value is None else shown(value)


def _ratio(value: float | None, unit: float | None) -> str:
    return (
        NOT_REACHED
        if value is None or not unit
        else f"{value / unit:,.0f}×"
        if value >= 10 * unit
        else f"{value / unit:.2g}×"
    )


def _ratio_to(goal: str, run: Run, other: Run) -> str:
    """Ratio of times to a goal; a bound where only the other reached it."""
    own, unit = run.seconds_to[goal], other.seconds_to[goal]
    if own is None and unit and run.reason == "time":
        return f"> {_ratio(run.trace[-1][1], unit)}"
    return _ratio(own, unit)
