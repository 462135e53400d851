"""Work-precision pictures: run time against error, and peak memory beside it."""

from pathlib import Path

from geometry.files import replacing
from studies.bench.work_precision import Measurement

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
    """Write a PNG: run time and peak memory of every contender against the error of its worst probe."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 6), dpi=130, layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True)
    names = list(dict.fromkeys(one.contender for one in measurements))
    count: dict[str, int] = {}
    for name in names:
        mine = [one for one in measurements if one.contender == name and not one.failure]
        if not mine:
            continue
        family = mine[0].family
        marker = MARKERS[count.setdefault(family, 0) % len(MARKERS)]
        count[family] += 1
        style = {
            "color": COLOURS.get(family, "black"),
            "marker": marker,
            "markersize": 5.0,
            "linewidth": 2.5 if name == "TriPillar" else 1.0,
            "label": name,
        }
        errors = [100 * one.worst_error for one in mine]
        left.plot(errors, [one.seconds for one in mine], **style)
        right.plot(errors, [one.peak_mib for one in mine], **style)
    for axes, label in ((left, "run time [s]"), (right, "peak memory of the process [MiB]")):
        axes.set(xscale="log", yscale="log", xlabel="error of the worst probe [%]", ylabel=label)
        axes.grid(visible=True, which="both", alpha=0.2)
    left.invert_xaxis()  # shared: better answers to the right
    figure.suptitle(f"{scene}: whole run without imports, 2 threads; lower right is better")
    figure.legend(*left.get_legend_handles_labels(), loc="outside right upper", fontsize=8)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png")
