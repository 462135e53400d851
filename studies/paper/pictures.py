"""Figures 6 to 11 from our data, with the paper's numbers as marks where it prints any, and the chart of spacing."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fem.array.closed_forms import layer_mean_compliance
from fem.array.response import ArrayResponse
from fem.pictures.arrays import solve_array_field
from fem.pictures.deformation import DeformedPicture
from fem.pictures.parts import sensor_parts
from geometry.design import SensorDesign
from geometry.layout import FloatArray, unit_centres, upper_electrodes
from studies.charts import BLACK, BLUE, GREEN, ORANGE, PURPLE, finish, new_figure, save, save_screen
from studies.paper import spacing
from studies.paper.deformation import one_pad
from studies.paper.experiments import COMPONENTS, FIGURE_9, FLOOR, INFORMED, LOADS, PAPERS, SKIP, TABLE_2
from studies.paper.printed import LARGEST_FORCE_N, MEAN_OVER_WIDTHS, PRESSURES_MPA, SPACING_MM
from studies.paper.printed import TABLE_2 as PRINTED_TABLE_2
from studies.paper.results import Results

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


def draw_figure_7(design: SensorDesign, path: Path) -> None:
    """Write a PNG: three by three of a design's units under 1, 3 and 5 MPa on the middle pad, true scale.

    They stand below each other: side by side they would be too small on a page.
    """
    nine = replace(design, array=replace(design.array, rows=3, cols=3))
    field = solve_array_field(nine)
    loads = {f"{pressure:g} MPa": one_pad(nine, pressure) for pressure in PRESSURES_MPA}
    panels = {name: sensor_parts(field, field.state(traction), stress=False) for name, traction in loads.items()}
    picture = DeformedPicture(panels, columns=1)
    save_screen(picture, path)


def draw_electrode_grid(response: ArrayResponse, traction_mpa: FloatArray | None, path: Path) -> None:
    """Write a PNG of the grid of each unit's first upper electrode, as the paper's figures 6 and 8.

    Circles are the electrodes at rest; a net joins where tractions (n_units, 3) [MPa] on the pads, if there are any,
    have moved them to, coloured by how far.
    """
    design = response.design
    shape = (design.array.rows, design.array.cols, 3)
    height = design.unit.height_mm
    rest = (np.pad(unit_centres(design), ((0, 0), (0, 1))) + upper_electrodes(design.unit)[0]).reshape(shape)
    moved = np.zeros(shape)
    if traction_mpa is not None:
        force = (np.asarray(traction_mpa) * design.pad.size_mm**2).reshape(shape)
        moved = np.tensordot(response.influence_mm_per_n[:, :, 0], force, axes=3)
    now, far = rest + moved, np.linalg.norm(moved, axis=2)
    wide = 7.6 if traction_mpa is None else 9.2  # inches, with room for the colour bar
    figure = new_figure(wide, 5.4, dpi=160, layout=None)
    axes: Any = figure.add_axes((0.0, -0.12, 7.0 / wide, 1.26), projection="3d", computed_zorder=False)
    for at in rest.reshape(-1, 3):  # a stem down to the base shows how high each one is
        axes.plot(*np.array([at, at * (1, 1, 0)]).T, color="#b9c2ca", linewidth=0.8, zorder=1)
    for lines in (now, now.swapaxes(0, 1)):
        for line in lines:
            axes.plot(*line.T, color="#33658a", linewidth=1.6, zorder=2)
    axes.scatter(
        *rest.reshape(-1, 3).T, s=52, facecolors="white", edgecolors="black", linewidths=1.4, label="at rest",
        depthshade=False, zorder=3,
    )  # fmt: skip
    if traction_mpa is not None:
        dots = axes.scatter(
            *now.reshape(-1, 3).T, c=far.ravel(), s=52, cmap="viridis", vmin=0.0, label="loaded", depthshade=False,
            zorder=4,
        )  # fmt: skip
        bar = figure.colorbar(dots, cax=figure.add_axes((0.86, 0.22, 0.025, 0.6)))
        bar.set_label("displacement of the electrode [mm]", fontsize=13)
        bar.ax.tick_params(labelsize=12)
        figure.legend(
            loc="upper left",
            title=f"electrodes {design.unit.layout.upper_names[0]}",
            frameon=False,
            fontsize=12,
            title_fontsize=13,
        )
    reach = np.abs(np.concatenate([rest, now])[..., :2]).max() * 1.05
    low = min(0.0, float(now[..., 2].min()))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(low, max(height, float(now[..., 2].max())) * 1.1))
    axes.set_zticks([0, height / 2, height])
    for name, pad in {"x": 14, "y": 10, "z": 2}.items():
        getattr(axes, f"set_{name}label")(f"{name} [mm]", fontsize=13, labelpad=pad)
    axes.tick_params(labelsize=12)
    axes.set_box_aspect((1, 1, 0.35), zoom=0.97)
    axes.view_init(elev=30, azim=-58)
    save(figure, path)


def draw_figure_9(results: Results, path: Path) -> None:
    """Write a PNG: error of the paper's network by width, its PCA floor, the paper's means and our network."""
    figure, panels = _panels("Figure 9: the paper's network (plain, resistances in, Levenberg-Marquardt) by width")
    for (loads, component), axes in panels.items():
        words, drawn = list[str](), list[float]()
        for cap, colour, fill in zip(MEAN_OVER_WIDTHS, COLOURS, FILLS, strict=True):
            wanted = {"experiment": FIGURE_9, "loads": loads, "component": component, "cap": cap}
            if not results.chosen(**wanted):
                continue  # no such loads
            mean, label = MEAN_OVER_WIDTHS[cap][component], f"paper's mean over widths, strain ≤ {cap:.0%}"
            axes.axhline(mean, color=colour, linestyle=":", linewidth=1.5, label=label)
            widths, errors = _by_width(results, network=PAPERS, **wanted)
            if errors == drawn:
                axes.set_xlabel(
                    f"drawn once: no sample strains a pillar beyond {cap:.0%}, so both caps have the same", fontsize=9
                )
                continue
            drawn = errors
            axes.plot(widths, errors, color=colour, linewidth=1, label=f"paper's network, strain ≤ {cap:.0%}", **fill)
            floor = _by_width(results, network=FLOOR, **wanted)
            axes.plot(*floor, color=colour, linewidth=1.5, linestyle="--", label=f"its PCA floor, strain ≤ {cap:.0%}")
            nodes, ours = _by_width(results, network=INFORMED, **wanted)
            label = f"ours, strain ≤ {cap:.0%}: skip + response"
            axes.plot(nodes, ours, color=GREEN, linestyle="", clip_on=False, label=label, **fill)
            words.append(f"{ours[0]:.2g} %")
        arrow = {"arrowstyle": "-", "color": GREEN, "linewidth": 0.8, "shrinkB": 5}
        axes.annotate(
            f"ours: {' and '.join(words)}", (nodes[0], 0), (-25, 34), textcoords="offset points", color=GREEN,
            ha="right", arrowprops=arrow,
        )  # fmt: skip
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
    figure = new_figure(16, 11, dpi=90)
    for axes, shown in zip(figure.subplots(len(results.shown), 1), results.shown, strict=True):
        numbers = range(1, len(shown.actual_n) + 1)
        axes.plot(numbers, shown.actual_n, "o", color=BLUE, markersize=7, fillstyle="none", label="actual")
        axes.plot(numbers, shown.decoupled_n, "*", color=ORANGE, markersize=5, label="decoupled")
        edges = range(0, len(numbers) + 1, len(numbers) // len(shown.samples))
        for edge in edges:
            axes.axvline(edge + 0.5, color=BLACK, alpha=0.3, linewidth=0.8)
        name = "the paper's network" if shown.network == PAPERS else f"ours, {shown.network}"
        axes.set(title=f"{TITLES[shown.loads]}; {name}, {shown.hidden} nodes", ylabel="Fz [N]", ylim=(0, None))
        axes.set(xlim=(0, len(numbers) + 1), xticks=edges)
        axes.grid(visible=True, axis="y", alpha=0.2)
    axes.set_xlabel("number of the force: unit by unit, sample after sample")
    figure.suptitle(f"Figure 11: {len(numbers)} forces Fz of random test samples, strain ≤ 30 %")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, markerscale=1.5)
    save(figure, path)


def _panels(title: str) -> "tuple[Figure, dict[tuple[str, str], Axes]]":
    """A figure with a panel for each kind of loads and component."""
    figure = new_figure(12, 9.5, dpi=100)
    figure.suptitle(title)
    grid = figure.subplots(len(LOADS), len(COMPONENTS), sharex=True, sharey="row")
    kinds = [(loads, component) for loads in LOADS for component in COMPONENTS]
    return figure, dict(zip(kinds, grid.flat, strict=True))


def _by_width(results: Results, **wanted: object) -> tuple[list[int], list[float]]:
    found = results.chosen(**wanted)
    return [one.trial.hidden for one in found], [100 * one.rel_err for one in found]


def _finish(figure: "Figure", panels: "dict[tuple[str, str], Axes]", x_label: str, path: Path) -> None:
    for (loads, component), axes in panels.items():
        axes.set(title=f"{component.capitalize()}, {TITLES[loads]}")
        if loads == LOADS[-1]:
            axes.set_xlabel("\n".join(filter(None, (x_label, axes.get_xlabel()))))
        axes.set(ylabel=ERROR_LABEL if component == COMPONENTS[0] else "")
    first = next(iter(panels.values()))
    figure.legend(*first.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=9)
    finish(figure, path)


def draw_spacing(found: spacing.Spacing, design: SensorDesign, path: Path) -> None:
    """Write a PNG: decay of influence with distance, neighbours' share by pitch, and the lightest felt touch."""
    figure = new_figure(13, 4.8, dpi=100)
    decay, share, touch = figure.subplots(1, 3)

    fitting = found.fitting
    r, moved, on_rim = (
        np.concatenate([getattr(one, name) for one in fitting]) for name in ("distance_mm", "moved", "on_rim")
    )
    layer = "endless layer" if design.pad.kind == "soft" else "endless layer under a soft pad"
    for chosen, colour, where in ((~on_rim, BLUE, "inside"), (on_rim, "0.65", "on the rim")):
        decay.plot(r[chosen], moved[chosen], ".", color=colour, markersize=3, label=f"electrodes {where}")
    decay.plot(*layer_curve(fitting[0], design, r.max()), color=BLACK, linewidth=1, label=layer)
    far = np.linspace(found.asked.far * design.unit.height_mm, r.max(), 50)
    law = np.exp(-far / found.fitted_mm) / np.sqrt(far)
    fitted = (r >= far[0]) & ~on_rim
    level = np.exp(np.mean(np.log(moved[fitted]) + r[fitted] / found.fitted_mm + np.log(r[fitted]) / 2))
    label = f"fit of exp(−r/λ)/√r: λ = {found.fitted_mm:.1f} mm"
    decay.plot(far, level * law, "--", color=ORANGE, linewidth=2, label=label)
    decay.set(yscale="log", xlabel="distance from the loaded pad [mm]", ylabel="displacement over the loaded unit's")
    decay.set(title=f"decay; theory: λ = {found.decay_mm:.2f} mm")

    pitches = [one.pitch_mm for one in found.spaced]
    for load, colour in zip(spacing.LOADS, (BLUE, ORANGE), strict=True):
        for k, marker in zip(spacing.RINGS, "os^", strict=True):
            values = [100 * one.reading_share[load][k - 1] for one in found.spaced]
            label = f"{load} load, {k} pitch{'es' if k > 1 else ''} away"
            share.plot(pitches, values, color=colour, marker=marker, markersize=4, linewidth=1, label=label)
        forces = [one.worst_n[load] for one in found.touches]
        wider = [one.pitch_mm for one in found.touches]
        touch.plot(wider, forces, color=colour, marker="o", markersize=4, linewidth=1, label=f"{load} touch")
    share.set(yscale="log", xlabel="pitch [mm]", ylabel="reading of a neighbour over the loaded unit's [%]")
    share.set(title="neighbours", ylim=(0.05, None))  # room for the legend
    touch.axhline(spacing.PRESSED_N, color=BLACK, linestyle=":", linewidth=1.2, label="1 MPa on 1 cm²")
    touch.axhline(LARGEST_FORCE_N, color=PURPLE, linestyle=":", linewidth=1.5, label="the paper's largest force")
    touch.set(yscale="log", xlabel="pitch [mm]", ylabel="lightest touch felt wherever it falls [N]", title="touches")
    for axes in (share, touch):
        axes.axvspan(*SPACING_MM, color=GREEN, alpha=0.08, label="the paper's 1 to 2 cm" if axes is touch else None)
        axes.axvspan(min(pitches), found.smallest_mm, facecolor="none", edgecolor="0.6", hatch="//", linewidth=0,
                     label="narrower units" if axes is touch else None)  # fmt: skip
    for axes in (decay, share, touch):
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.legend(fontsize=7.5)
    figure.suptitle("Spacing: how far units disturb one another, and how light a touch they feel")
    finish(figure, path)


def layer_curve(one: spacing.Spaced, design: SensorDesign, reach_mm: float) -> tuple[FloatArray, FloatArray]:
    """Distances [mm] and displacements of 2 mm electrodes on an endless layer, over those of the loaded unit's own."""
    offsets_mm = np.linspace(0.0, reach_mm, 120)
    middles = np.array([[one.span_mm / 2, one.span_mm / 2], *([r, 0.0] for r in offsets_mm)])
    electrodes, pad = np.hstack([middles - 1.0, middles + 1.0]), np.array([-1, -1, 1, 1]) * one.pad_mm / 2
    compliance = layer_mean_compliance(electrodes, pad, design.unit.height_mm, design.matrix_material)
    moved = np.linalg.norm(compliance[:, :, 2], axis=1)
    return offsets_mm, moved[1:] / moved[0]
