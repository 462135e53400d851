"""Work-precision pictures of training: error against time."""

from itertools import accumulate
from pathlib import Path

from studies.bench.training.race import Run
from studies.bench.training.trace import GOALS
from studies.charts import save

OURS = ("#7f1d3a", "#c1272d", "#e07b39", "#e6b35a")  #: reds stand out
PEERS = ("#0081a7", "#3a5a40", "#6a4c93", "#7a7a7a")


def draw_race(title: str, runs: list[Run], path: Path) -> None:
    """Write a PNG: mean squared error of the scaled training outputs against seconds, a line each."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 6.5), dpi=120, layout="constrained")
    axes = figure.subplots()
    colours = {True: iter(OURS), False: iter(PEERS)}
    for run in runs:
        colour = next(colours[run.ours])
        if run.failure:
            continue
        _, seconds, mse = zip(*run.trace, strict=True)
        lowest = list(accumulate(mse, min))
        axes.plot(
            seconds,
            lowest,
            color=colour,
            marker="o" if run.iterations < 100 else "",
            markersize=3.5,
            linewidth=2.5 if run.ours else 1.4,
            drawstyle="steps-post",  # a step counts once it is done
            label=run.contender,
        )
        axes.plot(seconds[-1], lowest[-1], color=colour, marker="s", markersize=7)
    for goal in GOALS.values():
        axes.axhline(goal, color="black", linewidth=0.6, linestyle=":")
    axes.set(xscale="log", yscale="log", xlabel="seconds since the start of the training, one thread")
    axes.set_ylabel("mean squared error of the scaled training outputs, lowest so far")
    axes.set_title(f"{title}: lower and further left is better; squares mark the end")
    axes.grid(visible=True, which="major", alpha=0.25)
    axes.legend(loc="lower left", fontsize=9)
    save(figure, path)
