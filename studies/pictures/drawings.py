"""The documentation's drawings that need no solver: ``python -m studies draw-drawings docs``.

`build.png` is one unit with its electrodes and the wires that read it, `protocols.png` one load of each protocol.
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from dataset.loads import NORMAL_MPA, TANGENTIAL_MPA
from dataset.protocols import PROTOCOLS
from geometry.design import SensorDesign, Unit
from geometry.layout import AXES, FloatArray, electrode_centres, unit_centres
from geometry.prism import Prism, unit_prisms
from geometry.wiring import crossings, pillar_of_crossing, wires
from studies.charts import new_figure, save
from tripillar.sweeps.judge import own_axes

COLOURS = {"z": "#c0504d", "x": "#4f81bd", "y": "#77933c"}  #: of a pillar, by the force it senses
GREY, COPPER, PAD = "#7f7f7f", "#c98a4b", "#7030a0"


def draw(folder: Path) -> None:
    """Draw the unit with its wiring, and one load of each protocol."""
    draw_build(SensorDesign(), folder / "build.png")
    draw_protocols(SensorDesign(), folder / "protocols.png")


def draw_build(design: SensorDesign, path: Path) -> None:
    """Draw one unit of a design and the wiring of a 2 × 2 array, and write a PNG."""
    figure = new_figure(11, 4.6, dpi=130, layout=None)
    _unit(figure.add_axes((0.01, 0.015, 0.47, 0.92), projection="3d", computed_zorder=False), design)
    _wiring(figure.add_axes((0.61, 0.24, 0.38, 0.68)), design.unit, rows=2, cols=2)
    save(figure, path)


def _unit(axes: Axes3D, design: SensorDesign) -> None:
    """The pillars of a unit in its part of the slab, its pad, and its electrodes with their names."""
    pad, pitch, unit = design.pad, design.array.pitch_mm, design.unit.body
    layout, sensed, h = unit.layout, [AXES[axis] for axis in own_axes(unit)], unit.height_mm
    slab = Prism(base_mm=(0.0, 0.0, 0.0), top_mm=(0.0, 0.0, h), section_mm=(pitch, pitch))
    axes.add_collection3d(Poly3DCollection(prism_faces(slab), facecolor="#a9c4d8", edgecolor=GREY, alpha=0.12, lw=0.7))
    for name, axis, pillar in zip(layout.pillar_names, sensed, unit_prisms(unit), strict=True):
        depth = float(np.mean([pillar.base_mm[1], pillar.top_mm[1]])) / (10 * pitch)
        axes.add_collection3d(
            Poly3DCollection(prism_faces(pillar), color=COLOURS[axis], alpha=0.75, lw=0, zorder=3 - depth)
        )
        axes.plot([], [], lw=6, color=COLOURS[axis], label=f"{name} pillar, senses F{axis}")
    for number, (name, at) in enumerate(zip(layout.terminals, electrode_centres(unit), strict=True)):
        axes.add_collection3d(
            Poly3DCollection([_square(at, unit.electrode_mm)], facecolor=COPPER, edgecolor="black", lw=0.8, zorder=5)
        )
        out = np.array([0.0, 0.0, 0.16 * h if number < len(layout.upper) else -0.16 * h])
        axes.text(*(at + out), name, ha="center", va="center", weight="bold", zorder=9)
    middle = np.array([pad.offset_x_mm, pad.offset_y_mm, h])
    axes.plot(*np.vstack([_square(middle, pad.size_mm), _square(middle, pad.size_mm)[:1]]).T, color=PAD, lw=2, zorder=4)
    axes.plot([], [], lw=2, color=PAD, label=f"pad, {pad.size_mm:g} mm wide")
    axes.plot([], [], "s", color=COPPER, markeredgecolor="black", label="electrodes")
    axes.plot([], [], lw=6, color="#a9c4d8", alpha=0.5, label=f"slab, {pitch:g} mm a unit, {h:g} mm high")
    corner = np.array([0.62 * pitch, -0.42 * pitch, 0.0])
    for axis, along in zip(AXES, np.eye(3) * 0.25 * pitch, strict=True):
        axes.quiver(*corner, *along, color="black", lw=1.2, arrow_length_ratio=0.25)
        axes.text(*(corner + 1.25 * along), axis, ha="center", va="center")
    axes.set(xlim=(-pitch / 2, pitch / 2), ylim=(-pitch / 2, pitch / 2), zlim=(0, h))
    axes.set_box_aspect((pitch, pitch, h), zoom=1.02)
    axes.set_axis_off()
    axes.view_init(elev=24, azim=-58)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.06), ncols=3, fontsize=8, handlelength=1, frameon=False)


def _square(centre: FloatArray, side: float) -> FloatArray:
    """Corners (4, 3) of a level square."""
    return centre + side / 2 * np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])


def prism_faces(prism: Prism) -> list[FloatArray]:
    """The faces of a pillar, corners (n, 3) each [mm]: both ends and its sides."""
    bottom, top = np.split(prism.corners(), 2)
    sides = [np.array([bottom[k], bottom[k - 1], top[k - 1], top[k]]) for k in range(len(bottom))]
    return [bottom, top, *sides]


def _wiring(axes: Axes, unit: Unit, rows: int, cols: int) -> None:
    """Row and column wires, and at each crossing the pillar that it reads."""
    layout, (n_rows, n_columns), n_upper = unit.layout, wires(rows, cols, unit.layout), len(unit.layout.upper)
    of_row, of_column = (
        [[name for name, own in zip(names, each, strict=True) if own == wire] for wire in range(max(each) + 1)]
        for names, each in ((layout.upper_names, layout.row_wires), (layout.terminals[n_upper:], layout.column_wires))
    )
    for wire in range(n_rows):
        i, own = divmod(wire, len(of_row))
        axes.axhline(wire, color=GREY, lw=1)
        axes.text(-0.7, wire, f"row wire {wire}: {', '.join(of_row[own])} of row {i}", ha="right", va="center")
    for wire in range(n_columns):
        j, own = divmod(wire, len(of_column))
        axes.axvline(wire, color=GREY, lw=1)
        label = f"column wire {wire}:\n{', '.join(of_column[own])} of column {j}"
        axes.text(wire, -0.7, label, ha="center", va="top", rotation=90, linespacing=1.3)
    pillars, sensed = pillar_of_crossing(rows, cols, layout) % len(layout.pillars), own_axes(unit)
    for (row, column), pillar in zip(crossings(rows, cols, layout), pillars, strict=True):
        axes.plot(column, row, "o", ms=17, color=COLOURS[AXES[sensed[pillar]]])
        name = layout.pillar_names[pillar]
        axes.text(column, row, name, color="white", ha="center", va="center", weight="bold")
    axes.set(xlim=(-0.6, n_columns - 0.4), ylim=(-0.6, n_rows - 0.4), aspect="equal")
    axes.axis("off")
    axes.set_title(f"wiring of a {rows} × {cols} array", fontsize=10)


def draw_protocols(design: SensorDesign, path: Path, seed: int = 1) -> None:
    """Draw the first loads of each of the first six protocols: pressure in colour, shear as arrows; write a PNG."""
    figure = new_figure(10, 6.6, dpi=110)
    panels = figure.subplots(2, 3)
    x, y = unit_centres(design).T
    extent = np.array([-1, 1, -1, 1]) / 2 * np.repeat(design.slab_mm[:2], 2)
    for axes, (name, protocol) in zip(panels.flat, PROTOCOLS.items(), strict=False):  # light ones would not be seen
        shear_x, shear_y, push = protocol.draw(np.random.default_rng(seed), 1, design)[0].T
        pressure = -push.reshape(design.array.rows, design.array.cols)
        image = axes.imshow(
            pressure, origin="lower", extent=extent, cmap="Reds", vmin=0, vmax=NORMAL_MPA[1], interpolation="nearest"
        )
        longest = design.array.pitch_mm / TANGENTIAL_MPA[1]  # arrows end where the next pad's begin
        axes.quiver(x, y, shear_x * longest, shear_y * longest, angles="xy", scale_units="xy", scale=1, pivot="mid")
        axes.set_title(name)
    for axes in panels[:, 0]:
        axes.set_ylabel("y [mm]")
    for axes in panels[-1]:
        axes.set_xlabel("x [mm]")
    figure.colorbar(image, ax=panels, label="pressure [MPa]", shrink=0.7)
    figure.suptitle(f"one sample of each protocol; an arrow of a pitch is {TANGENTIAL_MPA[1]:g} MPa of shear")
    save(figure, path)
