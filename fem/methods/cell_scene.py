"""Scenes of arrays whose pillars are of another rubber, or with a plate on every unit, by copies of one cell."""

import numpy as np

from fem.array.cell import CondensedCell
from fem.array.coupled_cells import CoupledArray
from fem.array.meshed import DesignCell, pad_plate
from fem.array.substructured import cell_of_stage, cell_stages
from fem.methods.plan import Plan
from fem.scene.cells import Share, design_of_cells, forces_on_cells, split_by_cells
from fem.scene.checks import SceneError
from fem.scene.loads import Rectangle
from fem.scene.scene import Scene, Sensor
from fem.scene.solution import Solution, Stopwatch, largest_error
from geometry.layout import FloatArray


def solve_by_cells(scene: Scene, plan: Plan) -> Solution:
    """Solve a scene of an array with loads and mean probes anywhere on its top, by copies of one cell.

    Rectangles that lie on several cells are split among them. The error is estimated as of responses, see
    `substructured.cell_of_stage`.

    Raises
    ------
    SceneError
        If the body is not an array, or a probe is a point: that needs the whole mesh.
    SolverError
        If an answer cannot be trusted.
    """
    if not isinstance(scene.body, Sensor) or any(probe.kind == "point" for probe in scene.probes):
        raise SceneError("cells answer mean probes of arrays only: switch the saving 'substructuring' off.")
    design = design_of_cells(scene, scene.body)
    local: dict[Rectangle, int] = {}
    probes = [split_by_cells(probe.rectangle, scene.body, local) for probe in scene.probes]
    newtons = forces_on_cells(scene, scene.body, local)
    rectangles = np.array(list(local))
    forces = newtons.reshape(design.n_units, -1, 1)

    seconds = {"mesh": 0.0, "condense": 0.0, "couple": 0.0}
    source = DesignCell(design, rectangles, pad_plate(design))

    def answer(cell: CondensedCell) -> tuple[dict[str, FloatArray], float, float]:
        """Means of the probes, the energy and the residual."""
        moved, residual = CoupledArray(cell, design.array.rows, design.array.cols).moved(forces)
        moved = moved.reshape(design.n_units, -1, 3)
        means = {p.name: _gathered(moved, shares) for p, shares in zip(scene.probes, probes, strict=True)}
        return means, float((moved.ravel() * forces.ravel()).sum()) / 2, residual

    steps: list[str] = []
    for stage in cell_stages(design, scene.tolerance):
        cell, (means, energy, residual), errors = cell_of_stage(
            source, stage, answer, lambda one, other: largest_error(one[0], other[0]), seconds
        )
        estimate = sum(errors)
        steps.append(f"cells of level {stage[1]:g}, ports of degree {stage[2]}: estimated error {estimate:.1e}")
        if estimate <= scene.tolerance:
            break
    spent = {"mesh": seconds["mesh"], "factor": seconds["condense"], "solve": seconds["couple"]}
    return Solution(
        probes=means,
        energy_mj=energy,
        residual=max(residual, cell.residual),
        unknowns=cell.unknowns,
        error_estimate=estimate,
        seconds=Stopwatch().seconds | spent,
        steps=tuple(steps),
    )


def _gathered(moved: FloatArray, shares: list[Share]) -> FloatArray:
    """Mean displacement of a rectangle from those of its parts, shape (3,)."""
    return np.sum([share * moved[unit, rectangle] for unit, rectangle, share in shares], axis=0)
