"""Scenes at finite strain: grids, probes and the estimate of their error. Open this file first."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from fem.kernel.elements import hexahedra
from fem.kernel.factor import FactorMemoryError
from fem.kernel.field import unfolded
from fem.kernel.mirrors import Mirror
from fem.kernel.newton import Equilibrium, UnreachableLoadError, find_equilibrium
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from fem.levels import Convergence
from fem.meshes.grid import Grid
from fem.meshes.lines import Attractor, graded_lines
from fem.scene.probes import displacements
from fem.scene.scene import Scene, regions_at
from fem.scene.solution import FiniteSolution, Stopwatch

#: least and greatest rate at which probes are taken to converge with the level: coarse levels show up to 3.1 under
#: tractions, but bent pillars end at 1.6 to 1.7; and 2.45 at small strain under plates, whose answers are extrapolated
RATES, RATES_UNDER_PLATES = (1.5, 2.0), (1.5, 2.5)
LEVELS = (1, 2, 3, 4)  #: of refinement
MAX_UNKNOWNS = 100_000  #: of a grid that is still solved: about a minute and 2 GB
ALWAYS, MAX_WORK = 2, 250_000  #: level from which on a finer grid's unknowns times the last iterations are limited
ORDER = 2  #: of the elements
EDGE, SIDE, BASE, TOP = 1.0, 0.5, 1.0, 1.5  #: weights of the attractors of lines: loads' edges and the body's faces


def solve_finite(scene: Scene, mirrors: Sequence[Mirror] = (), with_field: bool = False) -> FiniteSolution:
    """Displacement of a scene's probes at finite strain.

    Grids are refined until the estimate meets the scene's tolerance, a finer one would cost too much, or its elements
    collapse at a singular edge: look at the estimate. Only the part above mirrors is solved. `with_field` returns the
    displacement of the whole body, too. An `UnreachableLoadError` says which load was reached.

    The error is estimated from three grids by the rate at which they converge, see `fem.levels`. Under plates alone
    answers are the limit to which the last two grids tend.
    """
    watch = Stopwatch()
    is_extrapolated = len(scene.stiff_loads) == len(scene.loads)
    found = Convergence(RATES_UNDER_PLATES if is_extrapolated else RATES, is_extrapolated)
    steps: list[str] = []
    estimate = np.inf
    last: tuple[Equilibrium, System, Grid] | None = None
    for before, level in pairwise((0, *LEVELS)):
        grid = finite_grid(scene, level, mirrors)
        if min(grid.shape) < 2:  # one element across bends unlike two: no rate can be seen from it
            continue
        unknowns = 3 * int(np.prod([ORDER * count + 1 for count in grid.shape]))
        if last is not None and (
            unknowns > MAX_UNKNOWNS or (before > ALWAYS and unknowns * last[0].iterations > MAX_WORK)
        ):
            break
        system = System(finite_body(scene, grid), scene.loads, tuple(mirrors))
        watch.spent("assemble")
        try:
            equilibrium = find_equilibrium(system)
        except (UnreachableLoadError, FactorMemoryError) as error:
            # with one grid or none there is no estimate to give; and finer grids are right about what buckles
            if not np.isfinite(estimate) or getattr(error, "is_unstable", False):
                raise
            steps.append(f"level {level}: {error} The answer is that of the grid before.")
            break
        watch.spent("solve")
        last = equilibrium, system, grid
        found.add(level, displacements(scene.probes, grid, system, equilibrium.state.u))
        estimate = found.estimate
        steps.append(
            f"level {level}: {system.n_unknowns} unknowns, {equilibrium.iterations} iterations in {equilibrium.steps} "
            f"steps, smallest J {equilibrium.least_j:.3g}; estimated error {estimate:.1e}"
            + ("; stability not checked" if equilibrium.is_stable is None else "")
        )
        if estimate <= scene.tolerance:
            break
    assert last is not None
    equilibrium, system, grid = last
    return FiniteSolution(
        probes=dict(found.answer),
        energy_mj=system.copies * equilibrium.stored_mj,
        work_mj=system.copies * equilibrium.work_mj,
        residual=equilibrium.residual,
        least_j=equilibrium.least_j,
        iterations=equilibrium.iterations,
        load_steps=equilibrium.steps,
        unknowns=system.n_unknowns,
        error_estimate=estimate,
        seconds=watch.seconds,
        steps=tuple(steps),
        field=unfolded(grid, system.body, mirrors, [((1, 1), equilibrium.state.u)]) if with_field else None,
    )


def finite_grid(scene: Scene, level: int, mirrors: Sequence[Mirror] = ()) -> Grid:
    """Elements with lines along loads' edges and prisms of other rubber, crowding at the loads and the body's faces.

    It cannot follow the sides of prisms that lean. Of a scene with mirrors it has the part above their planes.
    """
    planes = {mirror.axis: mirror.position_mm for mirror in mirrors}
    outline, height = scene.outline, scene.height_mm
    lean = (float(outline.lean[0]), float(outline.lean[1]))
    rectangles = np.array([load.rectangle for load in scene.loads]).reshape(-1, 4)
    other = [prism for prism, rubber in scene.regions if rubber != scene.material]
    lines = []
    sizes = [*rectangles[:, 2] - rectangles[:, 0], *rectangles[:, 3] - rectangles[:, 1]]
    length = float(min([height, *outline.section_mm, *sizes]))
    for axis in (0, 1):
        low = outline.base_mm[axis] - outline.section_mm[axis] / 2
        high = outline.base_mm[axis] + outline.section_mm[axis] / 2
        edges = np.unique(np.clip(rectangles[:, axis::2] - lean[axis] * height, low, high).round(9))
        weights = {edge: EDGE for edge in edges.tolist() if low < edge < high} | {low: SIDE, high: SIDE}
        if axis in planes:
            low = planes[axis]
            weights = {place: weight for place, weight in weights.items() if place > low + scene.rounding_mm}
        attractors = [Attractor(place, length, weight) for place, weight in weights.items()]
        sides = [
            prism.base_mm[axis] + side * prism.section_mm[axis] / 2
            for prism in other
            if prism.is_upright and scene.outline.is_upright
            for side in (-1, 1)
        ]
        lines.append(graded_lines([low, *weights, *np.clip(sides, low, high)], attractors, level))
    ends = [place[2] for prism in other for place in (prism.base_mm, prism.top_mm)]
    attractors = [Attractor(height, length, TOP), Attractor(0.0, length, BASE)]
    z = graded_lines([0.0, height, *np.clip(ends, 0.0, height)], attractors, level)
    return Grid((*lines, z), lean)


def finite_body(scene: Scene, grid: Grid) -> Rubber:
    """A scene's rubbers in a grid, each element of the one in its middle."""
    inside = [(prism, rubber) for prism, rubber in scene.regions if rubber != scene.material]
    region = regions_at(grid.mesh.p[:, grid.mesh.t].mean(axis=1).T, inside)
    return Rubber.of(grid.mesh, hexahedra(ORDER), [scene.material, *(rubber for _, rubber in inside)], region)
