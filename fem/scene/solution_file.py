"""Solutions as files: the contract's JSON object, and the displaced body as VTU for pictures."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fem.scene.solution import Field, Solution
from geometry.storage.files import write_bytes
from geometry.storage.vtk_file import vtk_content


def solution_as_plain(solution: Solution, plan_lines: Sequence[str]) -> dict[str, Any]:
    """A solution as the object that `tripillar solve --json` prints; an error that nobody could estimate is null."""
    return {
        "probes": {name: [float(u) for u in displacement] for name, displacement in solution.probes.items()},
        "energy_mj": float(solution.energy_mj),
        "residual": float(solution.residual),
        "dofs": int(solution.unknowns),
        "error_estimate": float(solution.error_estimate) if math.isfinite(solution.error_estimate) else None,
        "seconds": {step: float(seconds) for step, seconds in solution.seconds.items()},
        "plan": [*plan_lines, *solution.steps],
    }


def write_field(field: Field, path: Path) -> None:
    """Write the displacement of the whole body as VTU, whole or not at all."""
    import pyvista as pv

    grid = pv.UnstructuredGrid({pv.CellType(field.cell_type): field.cells}, field.points_mm)
    grid.point_data["displacement_mm"] = field.displacement_mm
    grid.cell_data["region"] = field.region
    write_bytes(path, vtk_content(grid))
