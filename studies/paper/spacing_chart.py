"""A chart of the decay of influence with distance, of neighbours' readings by pitch, and of the lightest felt touch."""

from pathlib import Path

import numpy as np

from fem.array.closed_forms import layer_mean_compliance
from geometry.design import Material
from geometry.layout import FloatArray
from studies.charts import BLACK, BLUE, GREEN, ORANGE, PURPLE, save
from studies.paper.spacing import LOADS, PRESSED_N, RINGS, Spaced, Spacing
from tripillar.pipeline.printed import LARGEST_FORCE_N, SPACING_MM


def draw_spacing(found: Spacing, height_mm: float, material: Material, path: Path) -> None:
    """Write a PNG: decay of influence with distance, neighbours' share by pitch, and the lightest felt touch."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4.8), dpi=100, layout="constrained")
    decay, share, touch = figure.subplots(1, 3)

    fitting = found.fitting
    r, moved, on_rim = (
        np.concatenate([getattr(one, name) for one in fitting]) for name in ("distance_mm", "moved", "on_rim")
    )
    for chosen, colour, where in ((~on_rim, BLUE, "inside"), (on_rim, "0.65", "on the rim")):
        decay.plot(r[chosen], moved[chosen], ".", color=colour, markersize=3, label=f"electrodes {where}")
    decay.plot(*layer_curve(fitting[0], height_mm, material, r.max()), color=BLACK, linewidth=1, label="endless layer")
    far = np.linspace(found.asked.far * height_mm, r.max(), 50)
    law = np.exp(-far / found.fitted_mm) / np.sqrt(far)
    fitted = (r >= far[0]) & ~on_rim
    level = np.exp(np.mean(np.log(moved[fitted]) + r[fitted] / found.fitted_mm + np.log(r[fitted]) / 2))
    label = f"fit of exp(−r/λ)/√r: λ = {found.fitted_mm:.1f} mm"
    decay.plot(far, level * law, "--", color=ORANGE, linewidth=2, label=label)
    decay.set(yscale="log", xlabel="distance from the loaded pad [mm]", ylabel="displacement over the loaded unit's")
    decay.set(title=f"decay; theory: λ = {found.decay_mm:.2f} mm")

    pitches = [one.pitch_mm for one in found.spaced]
    for load, colour in zip(LOADS, (BLUE, ORANGE), strict=True):
        for k, marker in zip(RINGS, "os^", strict=True):
            values = [100 * one.reading_share[load][k - 1] for one in found.spaced]
            label = f"{load} load, {k} pitch{'es' if k > 1 else ''} away"
            share.plot(pitches, values, color=colour, marker=marker, markersize=4, linewidth=1, label=label)
        forces = [one.worst_n[load] for one in found.touches]
        wider = [one.pitch_mm for one in found.touches]
        touch.plot(wider, forces, color=colour, marker="o", markersize=4, linewidth=1, label=f"{load} touch")
    share.set(yscale="log", xlabel="pitch [mm]", ylabel="reading of a neighbour over the loaded unit's [%]")
    share.set(title="neighbours", ylim=(0.05, None))  # room for the legend
    touch.axhline(PRESSED_N, color=BLACK, linestyle=":", linewidth=1.2, label="1 MPa on 1 cm²")
    touch.axhline(LARGEST_FORCE_N, color=PURPLE, linestyle=":", linewidth=1.5, label="the paper's largest force")
    touch.set(yscale="log", xlabel="pitch [mm]", ylabel="lightest touch felt wherever it falls [N]", title="touches")
    for axes in (share, touch):
        axes.axvspan(*SPACING_MM, color=GREEN, alpha=0.08, label="the paper's 1 to 2 cm" if axes is touch else None)
        axes.axvspan(min(pitches), found.smallest_mm, facecolor="none", edgecolor="0.6", hatch="//", linewidth=0,
                     label="narrower units" if axes is touch else None)  # fmt: skip
    for axes in (decay, share, touch):
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.grid(visible=True, which="both", alpha=0.2)
        axes.legend(fontsize=7.5)
    figure.suptitle("Spacing: how far units disturb one another, and how light a touch they feel")
    save(figure, path)


def layer_curve(one: Spaced, height_mm: float, material: Material, reach_mm: float) -> tuple[FloatArray, FloatArray]:
    """Distances [mm] and displacements of 2 mm electrodes on an endless layer, over those of the loaded unit's own."""
    offsets_mm = np.linspace(0.0, reach_mm, 120)
    middles = np.array([[one.span_mm / 2, one.span_mm / 2], *([r, 0.0] for r in offsets_mm)])
    electrodes, half_mm = np.hstack([middles - 1.0, middles + 1.0]), one.pad_mm / 2
    pad = np.array([-half_mm, -half_mm, half_mm, half_mm])
    moved = np.linalg.norm(layer_mean_compliance(electrodes, pad, height_mm, material)[:, :, 2], axis=1)
    return offsets_mm, moved[1:] / moved[0]
