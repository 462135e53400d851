"""Pictures of the study."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studies.charts import BLUE, GREEN, ORANGE, SERIES, finish, new_figure
from studies.robustness.study import ErrorRow
from studies.robustness.truths import TRUTHS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {"fx": BLUE, "fy": ORANGE, "fz": GREEN}
MARKERS = {"fx": "o", "fy": "s", "fz": "^"}
NETS = {"inverse": ("-", "full", "inverse net"), "root": ("--", "none", "root net")}  #: line, fill of markers, label
NONE = 0.5  #: where "no pairs" is on a logarithmic axis


def draw_readings(rows: list[ErrorRow], path: Path) -> None:
    """Write a PNG: error and limit of every force against the noise, and against the converter's bits."""
    figure = new_figure(13, 5.5)
    panels = figure.subplots(1, 2, sharey=True)
    labels = ("noise of a reading [%]", "bits of the converter, no other noise")
    for axes, part, label in zip(panels, ("noise", "converter"), labels, strict=True):
        chosen = [row for row in rows if row.part == part]
        _lines(axes, chosen)
        axes.set(xscale="log" if part == "noise" else "linear", yscale="log", xlabel=label)
        _ticks(axes, chosen)
    panels[0].set_ylabel("error [% of full scale]")
    figure.suptitle("Three-axis nets against the limit of their readings; lower is better")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right upper", fontsize=9)
    finish(figure, path)


def draw_pairs(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write a PNG: error on every truth, the mean square of its three axes, against the number of pairs."""
    protocols = sorted({row["protocol"] for row in rows})
    figure = new_figure(12, 6)
    panels = figure.subplots(1, len(protocols), sharey=True, squeeze=False)[0]
    for axes, protocol in zip(panels, protocols, strict=True):
        chosen = [row for row in rows if row["protocol"] == protocol]
        for truth, colour in zip(TRUTHS, SERIES, strict=False):
            mine = [(row["pairs"] or NONE, np.sqrt(np.mean(np.square(row["error_pct"])))) for row in chosen]
            mine = [point for point, row in zip(mine, chosen, strict=True) if row["truth"] == truth]
            if mine:
                axes.plot(*zip(*mine, strict=True), "o-", color=colour, label=TRUTHS[truth].said)
        axes.set(xscale="log", yscale="log", xlabel="measured pairs", title=f"{protocol} loads")
        counts = sorted({row["pairs"] for row in chosen})
        axes.set_xticks([count or NONE for count in counts], [str(count or "none") for count in counts])
        axes.minorticks_off()
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    panels[0].set_ylabel("error, root mean square of fx, fy, fz [% of full scale]")
    figure.suptitle("Error of a sensor that is not as designed, against pairs of known loads and readings")
    shown = {label: line for axes in panels for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=3, fontsize=9)
    finish(figure, path)


def _lines(axes: "Axes", rows: list[ErrorRow]) -> None:
    """Errors of every net and force against the number in their case, and the limits."""
    for force, colour in COLOURS.items():
        style: dict[str, Any] = {"color": colour, "marker": MARKERS[force]}
        for net, (line, fill, label) in NETS.items():
            mine = {_number(row): row.error_pct for row in rows if (row.net, row.force) == (net, force)}
            axes.plot(*zip(*mine.items(), strict=True), line, fillstyle=fill, label=f"{force}, {label}", **style)
        chosen = [row for row in rows if (row.net, row.force) == ("inverse", force)]
        limits = [(_number(row), row.limit_pct) for row in chosen if row.limit_pct is not None]
        axes.plot(*zip(*limits, strict=True), ":", color=colour, linewidth=2.5, label=f"{force}, limit")


def _number(row: ErrorRow) -> float:
    """Place of a case on the axis: its noise in %, its bits.

    >>> _number(ErrorRow(part="noise", case="noise 0.5%", net="root", force="fx", error_pct=1.0))
    0.5
    """
    found = re.search(r"[\d.]+", row.case)
    assert found is not None
    return float(found[0])


def _ticks(axes: "Axes", rows: list[ErrorRow]) -> None:
    places = sorted({_number(row) for row in rows})
    axes.set_xticks(places, [f"{place:g}" for place in places])
    axes.minorticks_off()
