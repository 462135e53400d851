"""Figures 6, 7 and 8: the grid of electrodes at rest and loaded, and the array under three pressures.

pyvista and matplotlib are imported where they are needed: they take a second each.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fem.array.response import ArrayResponse
from geometry.design import SensorDesign
from geometry.layout import FloatArray, unit_centres, upper_electrodes
from geometry.storage.files import replacing
from studies.paper.deformation import PressedSample, one_pad
from tripillar.pipeline.printed import PRESSURES_MPA


def draw_figure_6(response: ArrayResponse, path: Path) -> None:
    """Write a PNG: the electrodes "2" at rest."""
    draw_electrode_grid(response, None, path)


def draw_figure_7(design: SensorDesign, path: Path) -> None:
    """Write a PNG: three by three of a design's units under 1, 3 and 5 MPa on the middle pad, true scale.

    They stand below each other: side by side they would be too small on a page.
    """
    from fem.fields.array_field import solve_array_field
    from fem.fields.deformed import sensor_parts
    from fem.pictures.deformation import DeformedPicture

    nine = replace(design, array=replace(design.array, rows=3, cols=3))
    field = solve_array_field(nine)
    loads = {f"{pressure:g} MPa": one_pad(nine, pressure) for pressure in PRESSURES_MPA}
    panels = {name: sensor_parts(field, field.state(traction), stress=False) for name, traction in loads.items()}
    picture = DeformedPicture(panels, columns=1)
    with replacing(path) as temporary:
        picture.plotter.screenshot(temporary)
    picture.plotter.close()


def draw_figure_8(response: ArrayResponse, sample: PressedSample, path: Path) -> None:
    """Write a PNG: the same electrodes under a sample of our data."""
    draw_electrode_grid(response, np.array(sample.traction_mpa), path)


def draw_electrode_grid(response: ArrayResponse, traction_mpa: FloatArray | None, path: Path) -> None:
    """Write a PNG of the grid of upper electrodes U1, as the paper's figures 6 and 8.

    Circles are the electrodes at rest; loaded, a net joins where they have moved to, coloured by how far.

    Parameters
    ----------
    response : ArrayResponse
    traction_mpa : array, shape (n_units, 3), optional
        Traction on each pad, z negative pushing down [MPa]; None: the grid at rest (figure 6).
    path : Path
        PNG file to write.
    """
    from matplotlib.figure import Figure

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
    figure = Figure(figsize=(wide, 5.4))
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
        figure.legend(loc="upper left", title="electrodes U1", frameon=False, fontsize=12, title_fontsize=13)
    reach = np.abs(np.concatenate([rest, now])[..., :2]).max() * 1.05
    low = min(0.0, float(now[..., 2].min()))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(low, max(height, float(now[..., 2].max())) * 1.1))
    axes.set_zticks([0, height / 2, height])
    axes.set_xlabel("x [mm]", fontsize=13, labelpad=14)
    axes.set_ylabel("y [mm]", fontsize=13, labelpad=10)
    axes.set_zlabel("z [mm]", fontsize=13, labelpad=2)
    axes.tick_params(labelsize=12)
    axes.set_box_aspect((1, 1, 0.35), zoom=0.97)
    axes.view_init(elev=30, azim=-58)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=160)
