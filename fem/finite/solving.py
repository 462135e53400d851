"""Scenes at finite strain: grids, probes and the estimate of their error. Open this file first."""

from itertools import pairwise

import numpy as np

from fem.discretization.grid import Attractor, Grid, graded_lines
from fem.discretization.lagrange import line_values
from fem.discretization.richardson import richardson_factor
from fem.finite.newton import Equilibrium, UnreachableLoadError, find_equilibrium
from fem.finite.rubber_body import RubberBody
from fem.finite.system import FiniteSystem
from fem.scene.checks import SceneError
from fem.scene.scene import Probe, Scene
from fem.scene.solution import FiniteSolution, Probes, Stopwatch, largest_error
from geometry.layout import FloatArray

RATE = 1.6  #: power of the level by which probes converge, assumed in the estimate: plates' edges are singular
LEVELS = (1, 2, 3, 4)  #: of refinement
MAX_UNKNOWNS = 100_000  #: of a grid that is still solved: about a minute and 2 GB
EDGE, SIDE, BASE, TOP = 1.0, 0.5, 1.0, 1.5  #: weights of the attractors of lines: loads' edges and the body's faces


def solve_finite(scene: Scene) -> FiniteSolution:
    """Displacement of a scene's probes at finite strain, its rubber neo-Hookean.

    Parameters
    ----------
    scene : Scene
        A body of one rubber, whatever its model; its loads, its probes and its tolerance.

    Returns
    -------
    FiniteSolution
        Refined until the estimate meets the tolerance, a finer grid would pass `MAX_UNKNOWNS`, or a finer grid's
        elements collapse at a singular edge: look at the estimate.

    Raises
    ------
    SceneError
        If the body has more than one rubber.
    UnreachableLoadError
        If there is no equilibrium at the full load, with the load that was reached.
    """
    if any(material != scene.material for _, material in scene.regions):
        raise SceneError("finite strain takes bodies of one rubber so far: give pillars and inclusions the matrix's.")
    watch = Stopwatch()
    found: list[Probes] = []
    steps: list[str] = []
    estimate = np.inf
    last: tuple[Equilibrium, int] | None = None
    for before, level in pairwise((0, *LEVELS)):
        body = RubberBody(finite_grid(scene, level), [scene.material])
        if last is not None and 3 * body.n_nodes > MAX_UNKNOWNS:
            break
        system = FiniteSystem(body, list(scene.loads))
        watch.spent("assemble")
        try:
            equilibrium = find_equilibrium(system)
        except UnreachableLoadError as error:
            if not np.isfinite(estimate):  # with one grid or none there is no estimate to give
                raise
            steps.append(f"level {level}: {error} The answer is that of the grid before.")
            break
        watch.spent("solve")
        last = equilibrium, system.n_unknowns
        found.append(probes_of(scene, body, equilibrium.state.u))
        if before:
            estimate = richardson_factor(before, level, RATE) * largest_error(found[-2], found[-1])
        steps.append(
            f"level {level}: {system.n_unknowns} unknowns, {equilibrium.iterations} iterations in {equilibrium.steps} "
            f"steps, smallest J {equilibrium.least_j:.3g}; estimated error {estimate:.1e}"
        )
        if estimate <= scene.tolerance:
            break
    assert last is not None
    equilibrium, unknowns = last
    return FiniteSolution(
        probes=found[-1],
        energy_mj=equilibrium.stored_mj,
        work_mj=equilibrium.work_mj,
        residual=equilibrium.residual,
        least_j=equilibrium.least_j,
        iterations=equilibrium.iterations,
        load_steps=equilibrium.steps,
        unknowns=unknowns,
        error_estimate=estimate,
        seconds=watch.seconds,
        steps=tuple(steps),
    )


def finite_grid(scene: Scene, level: int) -> Grid:
    """Grid with lines along the loads' edges, crowding there and at the body's faces."""
    outline, height = scene.outline, scene.height_mm
    lean = (float(outline.lean[0]), float(outline.lean[1]))
    rectangles = np.array([load.rectangle for load in scene.loads]).reshape(-1, 4)
    lines = []
    sizes = [*rectangles[:, 2] - rectangles[:, 0], *rectangles[:, 3] - rectangles[:, 1]]
    length = float(min([height, *outline.section_mm, *sizes]))
    for axis in (0, 1):
        low = outline.base_mm[axis] - outline.section_mm[axis] / 2
        high = outline.base_mm[axis] + outline.section_mm[axis] / 2
        edges = np.unique(np.clip(rectangles[:, axis::2] - lean[axis] * height, low, high).round(9))
        inner = [edge for edge in edges.tolist() if low < edge < high]
        attractors = [Attractor(edge, length, EDGE) for edge in inner]
        attractors += [Attractor(low, length, SIDE), Attractor(high, length, SIDE)]
        lines.append(graded_lines([low, high, *inner], attractors, level))
    z = graded_lines([0.0, height], [Attractor(height, length, TOP), Attractor(0.0, length, BASE)], level)
    return Grid(x=lines[0], y=lines[1], z=z, lean=lean)


def probes_of(scene: Scene, body: RubberBody, u: FloatArray) -> Probes:
    """Displacement of a scene's probes in a state (n_nodes, 3)."""
    return {probe.name: _seen(probe, body, u) for probe in scene.probes}


def _seen(probe: Probe, body: RubberBody, u: FloatArray) -> FloatArray:
    if probe.kind == "mean":
        integral = body.basis.patch_integrals(np.array([probe.rectangle]))
        return np.asarray(integral @ u)[0] / integral.sum()
    x, y, z = probe.position_mm or (0.0, 0.0, 0.0)
    place = (x - body.grid.lean[0] * z, y - body.grid.lean[1] * z, z)
    X, Y, Z = (
        line_values(line, 2, np.clip(np.array([at]), line[0], line[-1]))[0]
        for line, at in zip(body.grid.lines, place, strict=True)
    )
    return np.einsum("i,j,k,ijkc->c", X, Y, Z, u.reshape(len(X), len(Y), len(Z), 3), optimize=True)
