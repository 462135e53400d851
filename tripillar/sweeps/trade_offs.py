"""The results of a sweep for people: a table of the best designs, and pictures of error against range and size."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.markup import escape
from rich.table import Table

from common.storage.files import replacing
from geometry.layout import FloatArray
from tripillar.sweeps.rows import Row, column
from tripillar.sweeps.sweep_file import Sweep
from tripillar.sweeps.variables import Variable

#: metrics of the table, beside what is minimised and bounded
SHOWN = (
    *("touch_net_pct", "touch_place_mm", "error_n", "error_pct", "range_n", "crosstalk_1", "condition", "area_cm2"),
    *("channels", "rate_hz", "conductive_cm3", "wall_mm", "undercut_mm"),
)
GREY, FRONT = "#9a9a9a", "#d55e00"  #: designs out of bounds, and the front
#: metrics of the Pareto picture, and whether more is better
AGAINST = (("range_n", True), ("area_cm2", False), ("channels", False))
COUNTS = ("channels",)  #: those of whole numbers
BESIDE = 5  #: designs to a table
DIGITS = 4  #: of a number in pictures: what differs by less is the same
WIDE = 20.0  #: smallest ratio of the largest to the least value on a logarithmic axis


def ranked(rows: Sequence[Row], sweep: Sweep) -> list[Row]:
    """Rows within the sweep's bounds whose minimised metric is known, the best first."""
    sound = [row for row in told(rows, sweep) if not sweep.excess(row.metrics)]
    return sorted(sound, key=lambda row: row.metric(sweep.least))


def told(rows: Sequence[Row], sweep: Sweep) -> list[Row]:
    """Rows whose minimised metric is known."""
    return [row for row in rows if row.metrics.get(sweep.least) is not None]


def best_tables(rows: Sequence[Row], sweep: Sweep, count: int) -> list[Table]:
    """The best designs within the bounds, a column each, `BESIDE` to a table."""
    best = ranked(rows, sweep)
    failed = sum(row.failed for row in rows)
    sound, known = len(rows) - failed, len(told(rows, sweep))
    least = escape(sweep.metrics[sweep.least].label)
    outside = f", {known - len(best)} out of bounds" if sweep.bounds else ""
    outside += f", {sound - known} that do not tell it" if known < sound else ""
    title = f"The {min(count, len(best))} designs of least {least} of {sound}{outside}; {failed} failed"
    shown = [
        name for name in dict.fromkeys((sweep.least, *sweep.bounds, *SHOWN)) if any(name in row.metrics for row in best)
    ]
    tables = []
    for first in range(0, max(min(count, len(best)), 1), BESIDE):
        part = best[first : min(first + BESIDE, count)]
        table = Table(title="" if first else title)
        table.add_column("design")
        for number, _ in enumerate(part, first + 1):
            table.add_column(str(number), justify="right", overflow="fold")
        for variable in sweep.variables:
            values = (row.values[variable.name] for row in part)
            words = (escape(value) if isinstance(value, str) else f"{value:.4g}" for value in values)
            table.add_row(escape(variable.label), *words)
        table.add_section()
        for name in shown:
            table.add_row(escape(sweep.metrics[name].label), *(_number(row.metrics.get(name)) for row in part))
        tables.append(table)
    return tables


def _number(value: float | None) -> str:
    """A metric to three digits, a large one to its last."""
    return "–" if value is None else f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"


def reasons(rows: Sequence[Row]) -> dict[str, list[str]]:
    """Why designs failed, a reason a design, by the kind of the error."""
    found: dict[str, list[str]] = {}
    for row in rows:
        if row.failed:
            found.setdefault(row.reason.split(":")[0], []).append(row.reason)
    return found


def untold(rows: Sequence[Row], sweep: Sweep) -> list[str]:
    """Why designs lack the minimised metric, bounded ones or those of a touch, a line a reason."""
    found: dict[str, tuple[list[str], int]] = {}
    for row in rows:
        for reason, names in row.lacking().items():
            told = [name for name in names if name in (sweep.least, *sweep.bounds) or name.startswith("touch_")]
            if told:
                found[reason] = told, found.get(reason, (told, 0))[1] + 1
    return [f"{count} without {', '.join(names)}: {reason}" for reason, (names, count) in found.items()]


def draw_pareto(rows: Sequence[Row], sweep: Sweep, path: Path) -> None:
    """Write a PNG: error against force range, size and channels, with the designs that no other one beats in both."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm, Normalize
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    sound = told(rows, sweep)
    within = np.array([not sweep.excess(row.metrics) for row in sound])
    error, range_n = _drawn(sound, sweep.least), column(sound, "range_n")
    lost = (error > range_n) if sweep.least == "error_n" else np.zeros(len(error), dtype=bool)  # pillars tell nothing
    error = np.where(lost, np.max(range_n, initial=0.0, where=np.isfinite(range_n)), error)
    variable = telling_variable(sound, sweep)
    shade = _shades(sound, variable)
    norm: Normalize = LogNorm() if _is_wide(shade) else Normalize()
    if variable.changes:
        norm = Normalize(0.0, max(len(variable.values) - 1, 1))
    against = [pair for pair in AGAINST if np.ptp(_drawn(sound, pair[0])) > 0] or [AGAINST[0]]
    figure = Figure(figsize=(4.5 + 3.5 * len(against), 5.2), dpi=120, layout="constrained")
    panels = figure.subplots(1, len(against), sharey=True, squeeze=False)[0]
    for axes, (name, more) in zip(panels, against, strict=True):
        other = _drawn(sound, name)
        if not within.all():
            outside = {"s": 26, "facecolors": "none", "edgecolors": GREY, "label": "out of bounds"}
            axes.scatter(other[~within], error[~within], **outside)
        points = {"s": 42, "cmap": "viridis", "norm": norm, "edgecolors": "white", "linewidths": 0.6, "zorder": 3}
        axes.scatter(other[within & ~lost], error[within & ~lost], c=shade[within & ~lost], **points)
        if (within & lost).any():
            points |= {"marker": "^", "label": "errs by more than its range"}
            axes.scatter(other[within & lost], error[within & lost], c=shade[within & lost], **points)
        front = pareto(np.where(within, error, np.inf), -other if more else other)
        order = front[np.argsort(other[front])]
        line = {"color": FRONT, "linewidth": 1.6, "zorder": 2, "label": "beaten by no other design in both"}
        axes.step(other[order], error[order], where="pre" if more else "post", **line)
        axes.scatter(other[order], error[order], s=95, facecolors="none", edgecolors=FRONT, linewidths=1.6, zorder=4)
        if name in COUNTS:
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set(xlabel=f"{sweep.metrics[name].label}, {'more' if more else 'less'} is better")
        axes.set(**{f"{axis}scale": "log" for axis, values in (("x", other), ("y", error)) if _is_wide(values)})
        axes.grid(visible=True, which="major", alpha=0.25)
    figure.axes[0].set_ylabel(f"{sweep.metrics[sweep.least].label}, less is better")
    shades = ScalarMappable(norm=norm, cmap="viridis")
    if variable.changes:
        for number, text in enumerate(variable.values):
            panels[-1].scatter([], [], s=42, color=shades.to_rgba(np.array([number])), label=str(text))
    else:
        figure.colorbar(shades, ax=figure.axes, label=variable.label, pad=0.01)
    title = variable.label if variable.changes else None
    figure.legend(*panels[-1].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=9, title=title)
    failed = sum(row.failed for row in rows)
    others = {"failed": failed, "do not tell it": len(rows) - len(sound) - failed}
    said = "".join(f"; {count} more {what}" for what, count in others.items() if count)
    figure.suptitle(f"{len(sound)} designs{said}", fontsize=12)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png")


def pareto(first: FloatArray, second: FloatArray) -> np.ndarray:
    """Numbers of the points that no other one is below in both coordinates.

    >>> pareto(np.array([1.0, 2.0, 3.0]), np.array([3.0, 1.0, 2.0])).tolist()
    [0, 1]
    """
    beaten = [
        bool(((first <= a) & (second <= b) & ((first < a) | (second < b))).any())
        for a, b in zip(first, second, strict=True)
    ]
    return np.flatnonzero(~np.array(beaten) & np.isfinite(first) & np.isfinite(second))


def telling_variable(rows: Sequence[Row], sweep: Sweep) -> Variable:
    """The variable of the strongest rank correlation with the minimised metric; a choice's by mean ranks."""
    from scipy.stats import rankdata, spearmanr

    error = rankdata(column(rows, sweep.least))

    def agreement(variable: Variable) -> float:
        values = _shades(rows, variable)
        if variable.changes:
            values = np.array([error[values == value].mean() for value in values])
        if len(np.unique(values)) < 2 or len(np.unique(error)) < 2:
            return 0.0
        return abs(float(spearmanr(values, error).statistic))

    return max(sweep.variables, key=agreement)


def _drawn(rows: Sequence[Row], name: str) -> FloatArray:
    """A metric of all rows as pictures have it, to `DIGITS`."""
    return np.array([float(f"{value:.{DIGITS}g}") for value in column(rows, name)])


def _shades(rows: Sequence[Row], variable: Variable) -> FloatArray:
    """A variable's value in each row; of a choice the number of its text."""
    values = [row.values[variable.name] for row in rows]
    return np.array([variable.values.index(value) if isinstance(value, str) else value for value in values])


def _is_wide(values: FloatArray) -> bool:
    """Whether values are so far apart that their axis is logarithmic."""
    finite = values[np.isfinite(values)]
    return bool(len(finite) and finite.min() > 0 and finite.max() > WIDE * finite.min())
