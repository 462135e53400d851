"""Solve and show: the response of an array, any scene, pictures."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from geometry.design import SensorDesign

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse
    from fem.scene.scene import Scene
    from fem.scene.solution import Solution
    from tripillar.viewer.showing import Camera, Colour, LoadKind


def response(
    design: SensorDesign | None = None,
    *,
    tolerance: float | None = None,
    method: Literal["cells", "layer"] = "cells",
) -> "ArrayResponse":
    """Compute how far a newton on each pad moves each electrode; from the cache if it is there.

    Parameters
    ----------
    design : SensorDesign, optional
        Default: the paper's sensor.
    tolerance : float, optional
        Relative error wanted; default: 1e-3, or 1e-2 with pillars of another rubber than the matrix.
    method : str
        ``cells`` couples copies of one condensed cell; ``layer`` is an approximate closed form.

    Returns
    -------
    ArrayResponse
        ``influence_mm_per_n``, shape (rows, cols, 2, 3, rows, cols, 3): unit, electrode U1 or U2, axis of the
        displacement; unit and axis of the load. ``error_estimate`` is relative.

    Examples
    --------
    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> tp.response(design).influence_mm_per_n.shape
    (1, 2, 2, 3, 1, 2, 3)
    """
    from fem.array.solving import ResponseSettings, array_response

    settings = ResponseSettings(method=method, tolerance=tolerance)
    return array_response(SensorDesign() if design is None else design, settings)[0]


def solve(scene: "Scene | Path | str", *, tolerance: float | None = None) -> "Solution":
    """Solve a scene: a block, pillar, unit or array under loads.

    Parameters
    ----------
    scene : Scene or path
        A scene, or its file (TOML).
    tolerance : float, optional
        Relative error wanted of the probes; default: the scene's.

    Returns
    -------
    Solution
        ``probes`` has the displacement [mm] along x, y, z by the name of the probe; ``error_estimate`` is relative.

    Examples
    --------
    A column without lateral strain shortens by σ h / E:

    >>> import tripillar as tp
    >>> from fem.scene.scene_file import scene_from_dict
    >>> top = {"center_mm": [2.0, 2.0], "size_mm": [4.0, 4.0]}
    >>> scene = {
    ...     "body": {"kind": "block", "size_mm": [4.0, 4.0, 10.0]},
    ...     "material": {"young_mpa": 5.0, "poisson": 0.0},
    ...     "load": [{**top, "traction_mpa": [0.0, 0.0, -1.0]}],
    ...     "probe": [{**top, "name": "top", "kind": "mean"}],
    ... }
    >>> round(float(tp.solve(scene_from_dict(scene)).probes["top"][2]), 6)
    -2.0
    """
    from fem.methods.solving import solve_scene
    from fem.scene.scene_file import read_scene

    asked = read_scene(Path(scene)) if isinstance(scene, str | Path) else scene
    return solve_scene(asked if tolerance is None else replace(asked, tolerance=tolerance))[0]


def view(
    body: "SensorDesign | Scene | Path | str | None" = None,
    save: Path | str | None = None,
    *,
    pressure_mpa: float | Sequence[float] = 3.0,
    load: "LoadKind" = "indenter",
    colour: "Colour" = "displacement",
    scale: float | None = 1.0,
    camera: "Camera" = "iso",
) -> dict[str, float]:
    """Show a sensor or a scene deformed: in a window, or as a file.

    Parameters
    ----------
    body : SensorDesign, Scene or path, optional
        What is shown, or its file (TOML); default: the paper's sensor.
    save : path, optional
        File to write: .png, .html, .mp4 or .vtm; default: open a window.
    pressure_mpa : float or sequence of float
        Pressure at the indenter's middle or on every pad; of several each gets a picture. A scene has its own loads.
    load : str
        ``indenter``, a round one over the middle of the array, or ``uniform``, all pads alike.
    colour : str
        Quantity shown as colour: displacement, vertical, mises or pressure.
    scale : float, optional
        Factor of the displacement as drawn; None chooses one that shows it well.
    camera : str
        Direction to look from: iso, top, front or side.

    Returns
    -------
    dict of float
        Largest displacement [mm] by the name of the picture.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> list(tp.view(design, Path(mkdtemp()) / "pressed.vtm", pressure_mpa=2.0))
    ["2 MPa at the indenter's middle"]
    """
    from tripillar.terminal.progress import Bars
    from tripillar.viewer.showing import show_deformed
    from tripillar.viewer.sights import largest_mm, read_body

    shown = read_body(Path(body)) if isinstance(body, str | Path) else body or SensorDesign()
    pressures = (pressure_mpa,) if isinstance(pressure_mpa, int | float) else tuple(pressure_mpa)
    target = None if save is None else Path(save)
    panels, _ = show_deformed(shown, target, pressures, load, colour, scale, camera, Bars(quiet=True))
    return {name: max(largest_mm(part.displacement_mm) for part in parts.values()) for name, parts in panels.items()}
