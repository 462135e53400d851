"""Work-precision pictures: run time against error, and peak memory beside it."""

from pathlib import Path

from studies.bench.work_precision import Measurement
from studies.charts import save

COLOURS = {  # of families; those of ours stand out
    "TriPillar": "#c1272d",
    "contrast": "#e59a6f",
    "closed form": "#7a7a7a",
    "scikit-fem": "#0081a7",
    "NGSolve": "#3a5a40",
    "CalculiX": "#6a4c93",
}
MARKERS = "osD^vP*X<>"


def draw_work_precision(scene: str, measurements: list[Measurement], path: Path) -> None:
    """Write a PNG: run time against the error of the loaded and of the worst probe, and peak memory beside them."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(17, 6), dpi=120, layout="constrained")
    panels = figure.subplots(1, 3)
    count: dict[str, int] = {}
    for name in dict.fromkeys(one.contender for one in measurements):
        mine = [one for one in measurements if one.contender == name and not one.failure]
        if not mine:
            continue
        family = mine[0].family
        number = count.setdefault(family, 0)
        count[family] += 1
        loaded, worst = [100 * one.first_error for one in mine], [100 * one.worst_error for one in mine]
        seconds, peak = [one.seconds for one in mine], [one.peak_mib for one in mine]
        for axes, x, y in zip(panels, (loaded, worst, worst), (seconds, seconds, peak), strict=True):
            axes.plot(
                x,
                y,
                color=COLOURS.get(family, "black"),
                marker=MARKERS[number % len(MARKERS)],
                markersize=5,
                linewidth=3 if name == "TriPillar" else 1,
                label=name,
            )
    titles = (
        ("error of the loaded probe [%]", "run time [s]"),
        ("error of the worst probe [%]", "run time [s]"),
        ("error of the worst probe [%]", "peak memory of the process [MiB]"),
    )
    for axes, (x_label, y_label) in zip(panels, titles, strict=True):
        axes.set(xscale="log", yscale="log", xlabel=x_label, ylabel=y_label)
        axes.grid(visible=True, which="both", alpha=0.2)
        axes.invert_xaxis()  # better answers to the right
    figure.suptitle(f"{scene}: run time without imports; further right and lower is better")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right upper", fontsize=8)
    save(figure, path)
