"""The paper's figures 9, 10 and 11 with its numbers as marks beside ours."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from studies.charts import BLACK, BLUE, GREEN, ORANGE, PURPLE, save
from studies.paper.experiments import COMPONENTS, FIGURE_9, FLOOR, INFORMED, LOADS, PAPERS, SKIP, TABLE_2
from studies.paper.results import Results, ShownForces
from tripillar.pipeline.printed import MEAN_OVER_WIDTHS
from tripillar.pipeline.printed import TABLE_2 as PRINTED_TABLE_2

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (BLUE, ORANGE)  #: of the first and the second cap or set
FILLS: tuple[dict[str, Any], ...] = (
    {"marker": "o", "markersize": 4},
    {"marker": "s", "markersize": 7, "fillstyle": "none"},
)
TITLES = {"contact": "contact loads: 1 to 3 broad indenters", "independent": "independent loads: every pad its own"}
ERROR_LABEL = "relative error, eq. 17 [%]"


def draw_figure_9(results: Results, path: Path) -> None:
    """Write a PNG: error of the paper's network by width, its PCA floor, the paper's means and our network."""
    figure, panels = _panels("Figure 9: the paper's network (plain, resistances in, Levenberg-Marquardt) by width")
    for (loads, component), axes in panels.items():
        words = []
        for cap, colour, fill in zip(MEAN_OVER_WIDTHS, COLOURS, FILLS, strict=True):
            wanted = {"experiment": FIGURE_9, "loads": loads, "component": component, "cap": cap}
            widths, errors = _by_width(results, network=PAPERS, **wanted)
            axes.plot(widths, errors, color=colour, linewidth=1, label=f"paper's network, strain ≤ {cap:.0%}", **fill)
            floor = _by_width(results, network=FLOOR, **wanted)
            axes.plot(*floor, color=colour, linewidth=1.5, linestyle="--", label=f"its PCA floor, strain ≤ {cap:.0%}")
            axes.axhline(
                MEAN_OVER_WIDTHS[cap][component],
                color=colour,
                linestyle=":",
                linewidth=1.5,
                label=f"paper's mean over widths, strain ≤ {cap:.0%}",
            )
            nodes, ours = _by_width(results, network=INFORMED, **wanted)
            label = f"ours, strain ≤ {cap:.0%}: skip + response"
            axes.plot(nodes, ours, color=GREEN, linestyle="", clip_on=False, label=label, **fill)
            words.append(f"{ours[0]:.2g} %")
        axes.annotate(
            f"ours: {' and '.join(words)}",
            (nodes[0], 0),
            (-25, 34),  # clear of every line
            textcoords="offset points",
            color=GREEN,
            ha="right",
            arrowprops={"arrowstyle": "-", "color": GREEN, "linewidth": 0.8, "shrinkB": 5},
        )
        axes.set_xticks(widths)
        axes.set_ylim(bottom=0)
    _finish(figure, panels, "hidden nodes", path)


def draw_figure_10(results: Results, path: Path) -> None:
    """Write a PNG: table 2, every fold of every network on the large and the small set, the paper's beside."""
    figure, panels = _panels("Table 2 and figure 10: cross-validation, strain ≤ 30 %, fold by fold")
    for (loads, component), axes in panels.items():
        for size, fill, line in zip(PRINTED_TABLE_2, FILLS, ("-", "--"), strict=True):
            wanted = {"experiment": TABLE_2, "loads": loads, "component": component, "samples": size}
            printed = PRINTED_TABLE_2[size][component]
            shared: dict[str, Any] = {"linewidth": 1, "linestyle": line, **fill}
            axes.plot(range(1, len(printed) + 1), printed, color=BLACK, label=f"the paper, {size} samples", **shared)
            for network, colour, name in (
                (PAPERS, BLUE, "paper's network on our data"),
                (SKIP, ORANGE, "ours: skip"),
                (INFORMED, GREEN, "ours: skip + response"),
            ):
                found = results.chosen(network=network, **wanted)
                folds, errors = [one.trial.fold for one in found], [100 * one.rel_err for one in found]
                axes.plot(folds, errors, color=colour, label=f"{name}, {size} samples", **shared)
            floor = results.percent(network=FLOOR, **wanted)
            axes.axhline(floor, color=PURPLE, linewidth=2, linestyle=line, zorder=1, label=f"PCA floor, {size} samples")
        axes.set(xticks=folds, yscale="log")
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    _finish(figure, panels, "fold", path)


def draw_figure_11(results: Results, path: Path) -> None:
    """Write a PNG: actual and decoupled forces of random test samples, unit by unit."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(16, 11), dpi=90, layout="constrained")
    for axes, shown in zip(figure.subplots(len(results.shown), 1), results.shown, strict=True):
        numbers = range(1, len(shown.actual_n) + 1)
        axes.plot(numbers, shown.actual_n, "o", color=BLUE, markersize=7, fillstyle="none", label="actual")
        axes.plot(numbers, shown.decoupled_n, "*", color=ORANGE, markersize=5, label="decoupled")
        edges = range(0, len(numbers) + 1, len(numbers) // len(shown.samples))
        for edge in edges:
            axes.axvline(edge + 0.5, color=BLACK, alpha=0.3, linewidth=0.8)
        axes.set(
            title=f"{TITLES[shown.loads]}; {_described(shown)}",
            ylabel="Fz [N]",
            xlim=(0, len(numbers) + 1),
            xticks=edges,
        )
        axes.set_ylim(bottom=0)
        axes.grid(visible=True, axis="y", alpha=0.2)
    axes.set_xlabel("number of the force: unit by unit, sample after sample")
    figure.suptitle(f"Figure 11: {len(numbers)} forces Fz of random test samples, strain ≤ 30 %")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, markerscale=1.5)
    save(figure, path)


def _described(shown: ShownForces) -> str:
    name = "the paper's network" if shown.network == PAPERS else f"ours, {shown.network}"
    return f"{name}, {shown.hidden} nodes"


def _panels(title: str) -> "tuple[Figure, dict[tuple[str, str], Axes]]":
    """A figure with a panel for each kind of loads and component."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 9.5), dpi=100, layout="constrained")
    figure.suptitle(title)
    grid = figure.subplots(len(LOADS), len(COMPONENTS), sharex=True, sharey="row")
    kinds = [(loads, component) for loads in LOADS for component in COMPONENTS]
    return figure, dict(zip(kinds, grid.flat, strict=True))


def _by_width(results: Results, **wanted: object) -> tuple[list[int], list[float]]:
    found = results.chosen(**wanted)
    return [one.trial.hidden for one in found], [100 * one.rel_err for one in found]


def _finish(figure: "Figure", panels: "dict[tuple[str, str], Axes]", x_label: str, path: Path) -> None:
    for (loads, component), axes in panels.items():
        axes.grid(visible=True, alpha=0.25)
        axes.set(title=f"{component.capitalize()}, {TITLES[loads]}")
        axes.set(xlabel=x_label if loads == LOADS[-1] else "", ylabel=ERROR_LABEL if component == COMPONENTS[0] else "")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=9)
    save(figure, path)
