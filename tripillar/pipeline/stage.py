"""A stage of the pipeline as people see it; those that commands run alone, too."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fem.array.response import ArrayResponse
from fem.array.solving import ResponseSettings, array_response
from geometry.design import SensorDesign
from geometry.mesh import sensor_mesh, smallest_dihedral_deg
from tripillar.terminal.progress import Bars


@dataclass(frozen=True, kw_only=True)
class Stage:
    """Result of one stage: its time, its files, and whether they were there already."""

    name: str
    seconds: float
    reused: bool
    files: tuple[Path, ...]
    note: str = ""


def meshed(design: SensorDesign, bars: Bars) -> Stage:
    """Mesh the sensor and judge the mesh."""
    advance = bars.begin("mesh", total=1)
    mesh, path, reused = sensor_mesh(design, needed=True)
    note = f"{len(mesh.cells)} tetrahedra, dihedral angles from {smallest_dihedral_deg(mesh):.0f}°"
    advance(1, "reused" if reused else note)
    return Stage(name="mesh", seconds=bars.seconds(), reused=reused, files=(path,), note=note)


def respond(design: SensorDesign, bars: Bars, settings: ResponseSettings | None = None) -> tuple[Stage, ArrayResponse]:
    """Solve for the array's response, and say so where it is the tangent of another law. No array is ever meshed."""
    if (model := design.matrix_material.model) != "linear":
        bars.say(f"the response of {model} rubber is its tangent at rest: linear rubber of the same E and ν")
    advance = bars.begin("response", total=1)
    response, path, reused = array_response(design, settings, lambda step: advance(0, step))
    note = response_note(response)
    advance(1, "reused" if reused else note)
    kept = (path,) if path.exists() else ()
    return Stage(name="response", seconds=bars.seconds(), reused=reused, files=kept, note=note), response


def response_note(response: ArrayResponse) -> str:
    """Method, size, residual and estimated error of a response, in a line."""
    if not response.unknowns:
        return f"closed form, method {response.method}"
    note = f"{response.unknowns} unknowns, residual {response.residual:.0e}"
    judged = "" if np.isnan(response.error_estimate) else f", estimated error {response.error_estimate:.1e}"
    return f"method {response.method}: {note}{judged}"
