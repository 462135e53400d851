"""A picture of a contact: forces on the units, and pressure, shear, stick and slip on the grid."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from common.storage.files import replacing
from fem.contact.indentation import OPEN, STICK, Contact
from geometry.layout import FloatArray, electrode_squares, pad_squares, unit_centres

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.contour import QuadContourSet
    from matplotlib.quiver import Quiver

ARROWS = 14  #: of shear along the longer side of the contact
BLUE, ORANGE, PINK, INK, GREY = "#0072b2", "#ff8c5a", "#e0218a", "#222222", "#9a9a9a"
SHARE = 0.9  #: of the pitch: the longest arrow of a unit's tangential force
AS_DRAWN: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0}
ROUNDED = 1.2  #: cells, over which edges of the contact and of what sticks are rounded
MIN_ARROW = 0.02  #: of the pitch: shorter ones are left out


def draw_contact(contact: Contact, path: Path) -> None:
    """Write a PNG: units coloured by their normal force on the left, the contact itself on the right."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    below_title = ConstrainedLayoutEngine(rect=(0.0, 0.04, 1.0, 0.92))  # legends hang a little below
    figure = Figure(figsize=(12.5, 6.0), dpi=120, layout=below_title)
    array, zoom = figure.subplots(1, 2)
    _draw_units(array, contact)
    _draw_patch(zoom, contact)
    for axes in (array, zoom):
        if contact.surface.has_plates:
            _outline(axes, pad_squares(contact.design), color=BLUE, linewidth=1.2, label="plates")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncol=2, fontsize=8, frameon=False)
        axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    fx, fy, fz = contact.net_force_n.round(2) + 0.0  # no −0.00
    x, y = contact.centre_mm.round(2) + 0.0
    figure.suptitle(
        f"{contact.depth_mm:g} mm deep, friction {contact.friction:g}: net force Fx {fx:.2f} N, Fy {fy:.2f} N, "
        f"Fz {fz:.2f} N; centre of pressure x {x:.2f} mm, y {y:.2f} mm",
        fontsize=11,
    )
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png")


def _draw_units(axes: "Axes", contact: Contact) -> None:
    design, pitch = contact.design, contact.design.array.pitch_mm
    x, y = (pitch * (np.arange(n + 1) - n / 2) for n in (design.array.cols, design.array.rows))
    shown = axes.pcolormesh(x, y, contact.force_n[..., 2], cmap="Reds", vmin=0.0, edgecolors="white", linewidth=1.0)
    axes.figure.colorbar(shown, ax=axes, label="normal force on a unit [N]", shrink=0.85)
    _outline(axes, electrode_squares(design), color=GREY, linewidth=0.8, label="upper electrodes")
    shear = contact.force_n.reshape(-1, 3)[:, :2]
    largest = float(np.hypot(*shear.T).max())
    if contact.friction and largest > 0:
        arrows = shear / largest * SHARE * pitch
        large = np.hypot(*arrows.T) > MIN_ARROW * pitch
        drawn = axes.quiver(*unit_centres(design)[large].T, *arrows[large].T, **AS_DRAWN, color=BLUE, width=0.006)
        _explain(axes, drawn, SHARE * pitch, f"tangential force of {largest:.3g} N")
    patch = np.array([[*contact.patch.low_mm, *contact.patch.high_mm]])
    _outline(axes, patch, color=INK, linewidth=1.0, linestyle="--", label="shown beside")
    axes.set_title("forces on the units, from above", pad=26)


def _outline(axes: "Axes", rectangles_mm: FloatArray, **look: Any) -> None:
    """Outlines of rectangles (k, 4), where the axes show them."""
    limits = axes.axis()
    corners = rectangles_mm[:, [[0, 1], [2, 1], [2, 3], [0, 3], [0, 1]]]
    apart = np.pad(corners, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan)
    axes.plot(*apart.reshape(-1, 2).T, **look)
    axes.axis(limits)


def _draw_patch(axes: "Axes", contact: Contact) -> None:
    patch, state = contact.patch, contact.state
    box: Any = (patch.low_mm[0], patch.high_mm[0], patch.low_mm[1], patch.high_mm[1])
    pressure = np.where(state == OPEN, 0.0, contact.pressure_mpa)
    shown = axes.imshow(pressure, origin="lower", extent=box, cmap="viridis", vmin=0.0, interpolation="bilinear")
    axes.figure.colorbar(shown, ax=axes, label="pressure [MPa]", shrink=0.85)

    def around(cells: NDArray[np.bool_], label: str, **look: Any) -> "QuadContourSet":
        """A closed line around cells, its corners rounded; where they end with what is shown, along that edge."""
        axes.plot([], [], **look, label=label)
        smooth = np.pad(gaussian_filter(cells.astype(float), ROUNDED), 1)
        x, y = (np.pad(at, 1, "reflect", reflect_type="odd") for at in (patch.x_mm, patch.y_mm))
        drawn = axes.contour(x, y, smooth, levels=[0.5], colors=[look["color"]], linewidths=look["linewidth"])
        axes.axis(box)
        return drawn

    edge = around(state != OPEN, "edge of the contact", color=INK, linewidth=1.2)
    shown.set_clip_path(edge.get_paths()[0], axes.transData)
    if contact.friction:
        sticks = state == STICK
        if sticks.any() and not sticks.all():
            around(sticks, "sticks inside, slips outside", color=PINK, linewidth=2.0)
        every = max(1, round(max(patch.nx, patch.ny) / ARROWS))
        some = np.s_[every // 2 :: every]
        shear = contact.shear_mpa[:, some, some]
        largest = float(np.hypot(*contact.shear_mpa).max())
        x, y = np.meshgrid(patch.x_mm[some], patch.y_mm[some])
        there = state[some, some] != OPEN
        if largest > 0:
            length = 1.5 * every * max(patch.cell_mm) / largest
            drawn = axes.quiver(x[there], y[there], *(shear[:, there] * length), **AS_DRAWN, color=ORANGE, width=0.005)
            _explain(axes, drawn, largest * length, f"shear on the sensor of {largest:.3g} MPa, the largest")
    axes.set_title(f"contact: {contact.area_mm2:.1f} mm², peak {contact.peak_mpa:.2f} MPa", pad=26)


def _explain(axes: "Axes", drawn: "Quiver", length: float, label: str) -> None:
    """Put an arrow of a length of the axes, with what it stands for, above the axes' corner."""
    low, high = axes.get_xlim()
    axes.quiverkey(drawn, 0.02 + length / (high - low), 1.03, length, label, labelpos="E", fontproperties={"size": 8})
