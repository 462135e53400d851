"""The panels of a picture: a design under pressures, or a scene under its own loads."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from common.errors import DesignError
from common.storage.text_file import read_text, tables_of
from dataset.resistance import pillar_lengths, pillar_strains
from fem.methods.solving import LARGE_SHARE
from fem.pictures.arrays import PAD_LOADS, WHERE, pressed_sensor, solve_array_field
from fem.pictures.parts import AROUND, Parts, sensor_parts, solve_scene_parts
from fem.pictures.pressed import Watch
from fem.scene.scene import Scene
from fem.scene.scene_file import scene_from_dict
from geometry.design import SensorDesign
from geometry.design_file import whole_design
from geometry.layout import FloatArray

AUTO = 0.2  #: of the body's height: the largest displacement as drawn at the automatic scale
ROUND = (1.0, 2.0, 5.0)
LINEAR_UP_TO = 0.1  #: strain beyond which pictures of linear rubber say so


def read_body(path: Path) -> SensorDesign | Scene:
    """Read a scene if the file has a table [body], else a design; errors as of their readers."""
    text = read_text(path, "give a scene or a design", DesignError)
    tables = tables_of(text, path, DesignError)
    return scene_from_dict(tables, str(path)) if "body" in tables else whole_design(text, path)


def panels_of(
    body: SensorDesign | Scene,
    pressures_mpa: Sequence[float],
    load: str,
    stress: bool,
    watch: Watch | None = None,
    share: float = 1.0,
) -> dict[str, Parts]:
    """Solve for the panels, by name of the load: one for each pressure of a design, one for a scene.

    Bodies at finite strain may be under a share of the load, and under less where `watch` stops the search.
    """
    watch = watch or Watch()
    scenes = {"the scene's load": body} if isinstance(body, Scene) else {}
    if isinstance(body, SensorDesign) and not is_linear(body):
        scenes = {f"{mpa:g} MPa {WHERE[load]}": pressed_sensor(body, load, mpa) for mpa in pressures_mpa}
    panels = dict[str, Parts]()
    for name, scene in scenes.items():
        parts = solve_scene_parts(scene.under(share), stress, watch)
        panels[f"{watch.load_factor:.0%} of {name}" if watch.load_factor < 1.0 else name] = parts
        if watch.is_stopped():
            break
    if isinstance(body, Scene) or panels:
        return panels
    field = solve_array_field(body, watch.progress)
    watch.progress("pads")
    one = sensor_parts(field, field.state(PAD_LOADS[load](body, 1.0)), stress)
    return {
        f"{pressure:g} MPa {WHERE[load]}": {name: part.times(pressure) for name, part in one.items()}
        for pressure in pressures_mpa
    }


def is_linear(body: SensorDesign | Scene) -> bool:
    """True of linear rubber."""
    return (body.material if isinstance(body, Scene) else body.matrix_material).model == "linear"


def require_drawable(body: SensorDesign | Scene, panels: dict[str, Parts], pressures_mpa: Sequence[float]) -> None:
    """Refuse pictures of linear rubber that moves farther than it is high: nothing about them is right."""
    if not is_linear(body):
        return
    moved = max(map(moved_share, panels.values()))
    if moved <= 1.0:
        return
    most = f"{1 / moved:.2g} of the load"
    if pressures_mpa:
        mpa = max(pressures_mpa) / moved
        step = 10.0 ** (np.floor(np.log10(mpa)) - 1)
        most = f"{np.floor(mpa / step) * step:.3g} MPa"
    raise DesignError(
        f"linear rubber would move by {moved:.3g} times its height there: draw at most {most}, or write model = "
        "'neo-hookean' in the rubbers for finite strain."
    )


def linear_note(body: SensorDesign | Scene, panels: dict[str, Parts]) -> str:
    """Warning that linear rubber is drawn beyond `LINEAR_UP_TO`; empty elsewhere.

    A sensor is judged by the largest strain of a pillar and, as scenes that are solved, by the largest displacement
    over its height; a scene's picture by that alone.
    """
    if not is_linear(body):
        return ""
    moved = max(map(moved_share, panels.values()))
    if isinstance(body, SensorDesign):
        return beyond_linear(max(pillar_strain(body, panel) for panel in panels.values()), moved)
    return f"linear, though it moves by {moved:.0%} of its height" if moved > LINEAR_UP_TO else ""


def moved_share(parts: Parts) -> float:
    """Largest displacement over the body's height."""
    height_mm = max(float(np.ptp(part.points_mm[:, 2])) for part in parts.values())
    return max(largest_mm(part.displacement_mm) for part in parts.values()) / height_mm


def beyond_linear(strain: float, moved: float = 0.0) -> str:
    """Warning of the largest strain of a pillar beyond `LINEAR_UP_TO`, or of a displacement over the height beyond
    `LARGE_SHARE`; empty up to these."""
    said = [f"a pillar is strained by {strain:.0%}"] if strain > LINEAR_UP_TO else []
    said += [f"the top moves by {moved:.0%} of the height"] if moved > LARGE_SHARE else []
    return f"linear, though {' and '.join(said)}" if said else ""


def pillar_strain(design: SensorDesign, parts: Parts) -> float:
    """Largest |l − l₀|/l₀ of a pillar between the mean places of its electrodes, as data sets and the page state it."""
    moved = parts["electrodes"].displacement_mm.reshape(design.n_units, -1, AROUND + 1, AROUND + 1, 3)
    upper = moved[:, : len(design.unit.layout.upper)]
    even = np.full(AROUND + 1, 1.0 / AROUND)
    even[[0, -1]] /= 2
    upper_mm = np.einsum("nejka,j,k->nea", upper, even, even)
    return float(pillar_strains(upper_mm, pillar_lengths(upper_mm, design.unit), design.unit).max())


def suited_scale(panels: dict[str, Parts]) -> float:
    """A round factor that makes the largest displacement a fifth of the body's height.

    1, 2 or 5 times a power of ten; 1 where nothing moves.
    """
    largest = max(map(moved_share, panels.values()))
    if largest == 0.0:
        return 1.0
    wanted = AUTO / largest
    tens = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step * tens for step in ROUND if step * tens <= wanted * (1 + 1e-9)))


def largest_mm(displacement_mm: FloatArray) -> float:
    """Length of the largest of displacements (n, 3)."""
    return float(np.linalg.norm(displacement_mm, axis=1).max(initial=0.0))
