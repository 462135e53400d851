"""Picture of a rubber: measured and modelled, what the law misses, and what memory does to a press and release."""

from pathlib import Path

import numpy as np

from common.storage.files import replacing
from decoupler.rubber.check import resistance_from_strain
from decoupler.rubber.law import Rubber, log_ratio
from decoupler.rubber.series import Series

BLUE, ORANGE, GREY, INK = "#0072b2", "#ff8c5a", "#9a9a9a", "#222222"
DRAWS = 100
PRESS_S, HOLD_S, REST_S = 2.0, 60.0, 180.0


def draw_rubber(rubber: Rubber, series: Series, path: Path) -> None:
    """Write a PNG; the bands hold 95 % of the rubbers that the series leaves possible."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 9.0), dpi=110, layout="constrained")
    grid = figure.add_gridspec(3, 2)
    top, middle = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, :])
    modelled, time_s = resistance_from_strain(rubber, series), np.r_[0.0, np.cumsum(np.minimum(series.seconds, REST_S))]
    top.plot(time_s, series.resistance_ohm, color=INK, lw=0.8, label="measured")
    top.plot(time_s, modelled, color=ORANGE, lw=0.8, label="from strain by the law")
    top.set(ylabel="resistance [Ω]")
    top.legend(loc="upper right", fontsize=8, frameon=False)
    middle.plot(time_s, 100 * np.log(modelled / series.resistance_ohm), color=BLUE, lw=0.8)
    middle.axhspan(-196 * rubber.noise, 196 * rubber.noise, color=GREY, alpha=0.25, lw=0)
    middle.set(xlabel="time [s]", ylabel="law less measured,\nln R [%]")
    most = max(rubber.max_strain, rubber.min_strain, key=abs)
    corners = np.cumsum([0.0, 5.0, PRESS_S, HOLD_S, PRESS_S, REST_S])
    times = np.unique(np.r_[np.arange(0.0, corners[-1], 0.25), corners])
    strain = np.interp(times, corners, [0.0, 0.0, most, most, 0.0, 0.0])
    seconds = np.diff(times)
    electric, forced = figure.add_subplot(grid[2, 0]), figure.add_subplot(grid[2, 1])
    drawn = rubber.memories(DRAWS, np.random.default_rng(0))
    ratios = np.exp([log_ratio(strain, seconds, memory) for memory in drawn])
    electric.fill_between(times, *np.quantile(ratios, [0.025, 0.975], axis=0), color=ORANGE, alpha=0.3, lw=0)
    electric.plot(times, np.exp(log_ratio(strain, seconds, rubber.memory)), color=ORANGE, label="with memory")
    electric.plot(times, (1 + strain) ** 2, color=INK, ls=":", label="eq. 1")
    electric.set(xlabel="time [s]", ylabel="R / R at rest", title=f"a strain of {most:.3g}, held and let go")
    settled = rubber.elastic.force(strain, seconds)
    forced.plot(times, settled, color=BLUE, label=f"{rubber.elastic.model}, relaxing")
    forced.set(xlabel="time [s]", ylabel="force [N]")
    for axes in (electric, forced):
        axes.legend(fontsize=8, frameon=False)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png")
