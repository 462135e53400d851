"""A picture of a contact: forces on the units, and pressure, shear, stick and slip on the grid."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from common.storage.files import replacing
from fem.contact.indentation import OPEN, STICK, Contact
from geometry.layout import electrode_squares, pad_squares, unit_centres

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.quiver import Quiver

ARROWS = 14  #: of shear along the longer side of the contact
BLUE, ORANGE, PINK, INK, GREY = "#0072b2", "#ff8c5a", "#e0218a", "#222222", "#9a9a9a"
SHARE = 0.9  #: of the pitch: the longest arrow of a unit's tangential force
AS_DRAWN: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0}
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
        _draw_plates(axes, contact)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncol=2, fontsize=8, frameon=False)
        axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    fx, fy, fz = contact.net_force_n.round(2) + 0.0  # no −0.00
    x, y = contact.centre_mm.round(2) + 0.0
    figure.suptitle(
        f"{contact.depth_mm:g} mm deep, friction {contact.friction:g}: net force {fx:.2f}, {fy:.2f}, {fz:.2f} N, "
        f"centre of pressure {x:.2f}, {y:.2f} mm",
        fontsize=11,
    )
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png")


def _draw_units(axes: "Axes", contact: Contact) -> None:
    design = contact.design
    wide, deep, _ = design.slab_mm
    pitch = design.array.pitch_mm
    box: Any = (-wide / 2, wide / 2, -deep / 2, deep / 2)
    shown = axes.imshow(contact.force_n[..., 2], origin="lower", extent=box, cmap="Reds", vmin=0.0)
    axes.figure.colorbar(shown, ax=axes, label="normal force on a unit [N]", shrink=0.85)
    for border in np.arange(1, design.array.cols) * pitch - wide / 2:
        axes.axvline(border, color="white", linewidth=1.0)
    for border in np.arange(1, design.array.rows) * pitch - deep / 2:
        axes.axhline(border, color="white", linewidth=1.0)
    for x0, y0, x1, y1 in electrode_squares(design):
        axes.fill([x0, x1, x1, x0], [y0, y0, y1, y1], facecolor="none", edgecolor=GREY, linewidth=0.8)
    x, y = unit_centres(design).T
    shear = contact.force_n.reshape(-1, 3)[:, :2]
    largest = float(np.hypot(*shear.T).max())
    if contact.friction and largest > 0:
        arrows = (shear / largest * SHARE * pitch).T
        large = np.hypot(*arrows) > MIN_ARROW * pitch
        drawn = axes.quiver(x[large], y[large], *arrows[:, large], **AS_DRAWN, color=BLUE, width=0.006)
        _explain(axes, drawn, SHARE * pitch, f"tangential force of {largest:.3g} N")
    x0, y0, x1, y1 = *contact.patch.low_mm, *contact.patch.high_mm
    frame: dict[str, Any] = {"color": INK, "linewidth": 1.0, "linestyle": "--", "label": "shown beside"}
    axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], **frame)
    axes.set(xlim=box[:2], ylim=box[2:])
    axes.set_title("forces on the units", pad=26)


def _draw_plates(axes: "Axes", contact: Contact) -> None:
    """Outlines of stiff pads, where the axes show them."""
    if not contact.surface.has_plates:
        return
    limits = axes.axis()
    for x0, y0, x1, y1 in pad_squares(contact.design):
        axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color=BLUE, linewidth=1.2)
    axes.plot([], [], color=BLUE, linewidth=1.2, label="plates")
    axes.axis(limits)


def _draw_patch(axes: "Axes", contact: Contact) -> None:
    patch, state = contact.patch, contact.state
    box: Any = (patch.low_mm[0], patch.high_mm[0], patch.low_mm[1], patch.high_mm[1])
    pressure = np.where(state == OPEN, np.nan, contact.pressure_mpa)
    shown = axes.imshow(pressure, origin="lower", extent=box, cmap="viridis", vmin=0.0)
    axes.figure.colorbar(shown, ax=axes, label="pressure [MPa]", shrink=0.85)
    axes.contour(patch.x_mm, patch.y_mm, state != OPEN, levels=[0.5], colors=[INK], linewidths=1.2)
    axes.plot([], [], color=INK, label="edge of the contact")
    if contact.friction:
        sticks = state == STICK
        if sticks.any() and not sticks.all():
            axes.contour(patch.x_mm, patch.y_mm, sticks, levels=[0.5], colors=[PINK], linewidths=2.0)
            axes.plot([], [], color=PINK, linewidth=2.0, label="sticks inside, slips outside")
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
