"""Scenes of arrays whose pillars are of another rubber, or with a plate on every unit, by copies of one cell."""

from time import perf_counter

import numpy as np

from fem.array.coupled_cells import CoupledArray
from fem.array.substructured import GRID_RATE, LEVEL_ERROR, RATE, cell_stages, condensed_cell
from fem.levels import richardson_factor
from fem.methods.plan import Plan
from fem.scene.cells import Share, design_of_cells, forces_on_cells, split_by_cells
from fem.scene.checks import SceneError
from fem.scene.loads import Rectangle
from fem.scene.scene import Scene, Sensor
from fem.scene.solution import Solution, Stopwatch, largest_error
from geometry.layout import FloatArray


def solve_by_cells(scene: Scene, plan: Plan) -> Solution:
    """Solve a scene of an array with loads and mean probes anywhere on its top, at two levels of one cell.

    Rectangles that lie on several cells are split among them. The error is estimated from the two levels and from the
    highest degree of the port modes, as in `substructured.response_by_cells`; grids, of one rubber, are extrapolated.

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

    seconds = Stopwatch().seconds
    steps: list[str] = []
    for coarse, fine, degree in cell_stages(design, scene.tolerance):
        found, meshing, start = [], 0.0, perf_counter()
        for level in (coarse, fine):
            cell, meshed = condensed_cell(design, level, degree, rectangles)
            meshing += meshed
            found.append(cell)
        seconds["mesh"] += meshing
        seconds["factor"] += perf_counter() - start - meshing
        start = perf_counter()
        answers = []
        for each in (*found, found[-1].of_degree(degree - 1)):
            moved, residual = CoupledArray(each, design.array.rows, design.array.cols).moved(forces)
            moved = moved.reshape(design.n_units, -1, 3)
            means = {p.name: _gathered(moved, shares) for p, shares in zip(scene.probes, probes, strict=True)}
            answers.append((means, float((moved.ravel() * forces.ravel()).sum()) / 2, residual))
        seconds["solve"] += perf_counter() - start
        (one, _, _), (two, energy, residual), (lower, _, _) = answers
        of_ports = largest_error(lower, two)
        if design.is_homogeneous:
            factor = richardson_factor(coarse, fine, GRID_RATE[design.pad.kind])
            of_levels = LEVEL_ERROR[design.pad.kind] * factor * largest_error(one, two)
            two = {name: mean + factor * (mean - one[name]) for name, mean in two.items()}
        else:
            of_levels = richardson_factor(coarse, fine, RATE) * largest_error(one, two)
        estimate = of_levels + of_ports
        steps.append(f"cells of level {fine:g}, ports of degree {degree}: estimated error {estimate:.1e}")
        if estimate <= scene.tolerance:
            break
    return Solution(
        probes=two,
        energy_mj=energy,
        residual=max(residual, found[-1].residual),
        unknowns=found[-1].unknowns,
        error_estimate=estimate,
        seconds=seconds,
        steps=tuple(steps),
    )


def _gathered(moved: FloatArray, shares: list[Share]) -> FloatArray:
    """Mean displacement of a rectangle from those of its parts, shape (3,)."""
    return np.sum([share * moved[unit, rectangle] for unit, rectangle, share in shares], axis=0)
