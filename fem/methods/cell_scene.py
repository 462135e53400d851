"""Scenes of arrays by copies of one cell: loads, probes and plates in the cell's own coordinates, and the solution."""

import numpy as np

from fem.array.coupled_cells import CoupledArray, Kinds
from fem.array.meshed import DesignCell, pad_plate
from fem.array.substructured import any_cell, cell_stages, cells_of_stage
from fem.kernel.loads import Rectangle
from fem.scene.on_cells import Share, design_of_cells, forces_on_cells, split_by_cells
from fem.scene.scene import Scene, Sensor
from fem.scene.solution import Solution, Stopwatch, largest_error
from geometry.layout import FloatArray


def solve_by_cells(scene: Scene) -> Solution:
    """Solve a scene of an array with loads and mean probes anywhere on its top, by copies of one cell.

    Rectangles that lie on several cells are split among them. The error is estimated as of responses, see
    `substructured.cells_of_stage`. `SolverError` if an answer cannot be trusted.
    """
    assert isinstance(scene.body, Sensor)  # the plan takes cells for arrays and mean probes only
    design = design_of_cells(scene, scene.body)
    local: dict[Rectangle, int] = {}
    probes = [split_by_cells(probe.rectangle, scene.body, local) for probe in scene.probes]
    newtons = forces_on_cells(scene, scene.body, local)
    rectangles = np.array(list(local))
    forces = newtons.reshape(design.n_units, -1, 1)

    source = DesignCell(design, rectangles, pad_plate(design))

    residuals: list[float] = []

    def answer(cells: Kinds) -> FloatArray:
        """Means of the probes, and the energy in a row of its own, (n_probes + 1, 3)."""
        moved, residual = CoupledArray(cells, design.array.rows, design.array.cols).moved(forces)
        residuals.append(residual)
        energy = float((moved.ravel() * forces.ravel()).sum()) / 2
        moved = moved.reshape(design.n_units, -1, 3)
        return np.array([*(_gathered(moved, shares) for shares in probes), [energy, 0.0, 0.0]])

    def named(found: FloatArray) -> dict[str, FloatArray]:
        return {probe.name: mean for probe, mean in zip(scene.probes, found[:-1], strict=True)}

    steps: list[str] = []
    for stage in cell_stages(source, scene.tolerance):
        cells, found, errors = cells_of_stage(
            source, stage, answer, lambda one, other: largest_error(named(one), named(other))
        )
        estimate = sum(errors)
        steps.append(f"cells of level {stage[1]:g}, ports of degree {stage[2]}: estimated error {estimate:.1e}")
        if estimate <= scene.tolerance:
            break
    residuals += [cell.residual for _, kinds in cells for cell in kinds.values()]
    spent = dict(zip(("mesh", "condense", "solve"), source.seconds.values(), strict=True))
    return Solution(
        probes=named(found),
        energy_mj=float(found[-1, 0]),
        residual=max(residuals),
        unknowns=any_cell(cells).unknowns,
        error_estimate=estimate,
        seconds=Stopwatch().seconds | spent,
        steps=tuple(steps),
    )


def _gathered(moved: FloatArray, shares: list[Share]) -> FloatArray:
    """Mean displacement of a rectangle from those of its parts, shape (3,)."""
    return np.sum([share * moved[unit, rectangle] for unit, rectangle, share in shares], axis=0)
