"""Show a sensor or a scene deformed: in a window, or as a file."""

import os
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from geometry.design import SensorDesign
from geometry.errors import DesignError, FileFormatError
from geometry.storage.files import require_file

if TYPE_CHECKING:
    from fem.pictures.parts import Parts
    from fem.scene.scene import Scene
    from tripillar.terminal.progress import Bars

FILM_STEPS = 5  #: loads solved for a film at finite strain, between which it interpolates
Colour = Literal["displacement", "vertical", "mises", "pressure"]
Camera = Literal["iso", "top", "front", "side"]
LoadKind = Literal["indenter", "uniform"]
#: kinds of files, with the pip extra and the packages that each needs
NEEDS: dict[str, tuple[str, tuple[str, ...]]] = {
    ".png": ("", ()),
    ".html": ("page", ("trame", "trame_vtk", "trame_pyvista")),
    ".mp4": ("film", ("imageio", "imageio_ffmpeg")),
    ".vtm": ("", ()),
}


def show_deformed(
    body: "SensorDesign | Scene",
    save: Path | None,
    pressures_mpa: Sequence[float],
    load: LoadKind,
    colour: Colour,
    scale: float | None,
    camera: Camera,
    bars: "Bars",
) -> "tuple[dict[str, Parts], float]":
    """Solve for what is shown, and show it in a window or write it to a file, of which `require_shown` approves.

    Parameters
    ----------
    body : SensorDesign or Scene
    save : Path, optional
        None opens a window, and returns when it is closed.
    pressures_mpa, load : sequence of float, str
        Of a design, one picture each; a scene has its own loads.
    colour, camera : str
    scale : float, optional
        Factor of the displacement as drawn; None chooses one that shows it well.
    bars : Bars

    Returns
    -------
    dict of Parts, float
        The deformed parts by the name of their picture, and the scale.
    """
    from fem.pictures.deformation import DeformedPicture
    from fem.pictures.scenery import QUANTITIES
    from tripillar.viewer.saving import FRAMES, SAVERS, save_blocks
    from tripillar.viewer.sights import is_linear, linear_note, panels_of, suited_scale

    kind = "" if save is None else save.suffix
    advance = bars.begin("fields", total=4)
    stress = kind == ".vtm" or QUANTITIES[colour].of_stress
    panels = panels_of(body, pressures_mpa, load, stress, lambda step: advance(1, step))
    factor = suited_scale(panels) if scale is None else scale
    warning = linear_note(body, panels)
    steps = 1 if kind != ".mp4" or is_linear(body) else FILM_STEPS
    before = [panels_of(body, pressures_mpa, load, stress, share=step / steps) for step in range(1, steps)]
    advance(1, "")
    if save is None:
        DeformedPicture(panels, colour, factor, camera, "window", warning=warning).plotter.show()
        return panels, factor
    drawn = bars.begin("picture", total=FRAMES if kind == ".mp4" else 1)
    if kind == ".vtm":
        save_blocks(panels, save)
    else:
        medium, write = SAVERS[kind]
        write(
            DeformedPicture(panels, colour, factor, camera, medium, warning=warning, before=before),
            save,
            lambda: drawn(1, ""),
        )
    return panels, factor


def require_shown(save: Path | None) -> None:
    """Refuse a window without a display, or a file that cannot be written, before anything is computed."""
    if save is None:
        if sys.platform == "linux" and not os.environ.get("DISPLAY"):
            raise DesignError("there is no display to open a window on: give --save FILE.png, .html, .mp4 or .vtm.")
        return
    if save.suffix not in NEEDS:
        raise DesignError(f"--save {save} must end in {', '.join(NEEDS)}.")
    require_file(save)
    if save.suffix == ".vtm" and save.with_suffix("").exists() and not save.exists():
        raise FileFormatError(
            f"{save.with_suffix('')} exists, but no {save.name} that it belongs to: give another name."
        )
    extra, packages = NEEDS[save.suffix]
    missing = [package for package in packages if find_spec(package) is None]
    if missing:
        raise DesignError(f"{save.suffix} needs {', '.join(missing)}, not installed: pip install 'tripillar[{extra}]'.")
