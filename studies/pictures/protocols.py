"""Pictures of how the protocols load the array, by Matplotlib."""

from pathlib import Path

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np

from dataset.protocols import NORMAL_MPA, PROTOCOLS, TANGENTIAL_MPA
from geometry.design import SensorDesign
from geometry.layout import unit_centres
from geometry.storage.files import replacing


def draw_protocols(design: SensorDesign, path: Path, seed: int = 1) -> None:
    """Draw the first loads of each of the first six protocols: pressure in colour, shear as arrows; write a PNG."""
    figure, panels = plt.subplots(2, 3, figsize=(10, 6.6), layout="constrained")
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
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=110)
    plt.close(figure)
