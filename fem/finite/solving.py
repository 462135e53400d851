"""Scenes at finite strain: grids, probes and the estimate of their error. Open this file first."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from fem.discretization.grid import Attractor, Grid, GridBasis, graded_lines, lattice_boxes
from fem.discretization.lagrange import line_values
from fem.discretization.mirrors import Mirror
from fem.discretization.richardson import richardson_factor
from fem.factor import FactorMemoryError
from fem.finite.mirrored import loads_above, unfolded
from fem.finite.newton import Equilibrium, UnreachableLoadError, find_equilibrium, solve_rest
from fem.finite.rubber_body import RubberBody
from fem.finite.system import FiniteSystem
from fem.scene.scene import Probe, Scene, regions_at
from fem.scene.solution import (
    TRIQUADRATIC_HEXAHEDRON,
    Field,
    FiniteSolution,
    Probes,
    Solution,
    Stopwatch,
    largest_error,
)
from geometry.layout import FloatArray

RATE = 2.0  #: power of the level by which probes under tractions converge, assumed in the estimate
#: the same under plates, whose edges are singular, measured at small strain on levels 2 to 5; answers are extrapolated
PLATE_RATE = 2.45
CAUTION_OF_TWO = 2.0  #: on the estimate of the first two grids under plates: 1.9 to 3 times too small at 1 to 3 MPa
LEVELS = (1, 2, 3, 4)  #: of refinement
MAX_UNKNOWNS = 100_000  #: of a grid that is still solved: about a minute and 2 GB
ALWAYS, MAX_WORK = 2, 300_000  #: level from which on a finer grid's unknowns times the last iterations are limited
EDGE, SIDE, BASE, TOP = 1.0, 0.5, 1.0, 1.5  #: weights of the attractors of lines: loads' edges and the body's faces


def solve_finite(
    scene: Scene, linear: Solution | None = None, mirrors: Sequence[Mirror] = (), with_field: bool = False
) -> FiniteSolution:
    """Displacement of a scene's probes at finite strain, its rubbers neo-Hookean.

    Parameters
    ----------
    scene : Scene
        A body, its loads, its probes and its tolerance, whatever the model of its rubbers.
    linear : Solution, optional
        The scene's answer at small strain, on a mesh that follows its prisms; wanted where these are of another rubber.
    mirrors : sequence of Mirror, optional
        Planes in which body and loads mirror themselves: only the part above them is solved.
    with_field : bool
        Also return the displacement of the whole body, of the finest grid.

    Returns
    -------
    FiniteSolution
        Refined until the estimate meets the tolerance, a finer grid would cost too much, or a finer grid's elements
        collapse at a singular edge: look at the estimate.

    Raises
    ------
    UnreachableLoadError
        If there is no equilibrium at the full load, with the load that was reached.

    Notes
    -----
    The grid does not follow prisms that lean: its Gauss points take the rubber of their place, and near such prisms
    coarse grids are some percent too stiff or too soft. With `linear` only the difference of finite and small strain
    is the grid's, u = u_linear + (u_finite − u_small)_grid, and it errs little. Its error is taken as its last change.

    Under plates alone answers are extrapolated from the last two grids. The error is then taken as what that added,
    or as what it changed since the grids before, whichever is less.
    """
    inside = [(prism, rubber) for prism, rubber in scene.regions if rubber != scene.material]
    watch = Stopwatch()
    loads, axes = loads_above(scene, mirrors), [mirror.axis for mirror in mirrors]
    copies = 2 ** len(mirrors)
    is_extrapolated = linear is None and len(scene.stiff_loads) == len(scene.loads)
    found: list[Probes] = []
    answers: list[Probes] = []
    steps: list[str] = []
    estimate, missing_mj = np.inf, 0.0
    last: tuple[Equilibrium, int] | None = None
    for before, level in pairwise((0, *LEVELS)):
        grid = finite_grid(scene, level, mirrors)
        unknowns = 3 * int(np.prod([2 * n + 1 for n in grid.shape]))
        if last is not None and (
            unknowns > MAX_UNKNOWNS or (before > ALWAYS and unknowns * last[0].iterations > MAX_WORK)
        ):
            break
        body = RubberBody(grid, [scene.material], inside)
        system = FiniteSystem(body, loads, axes)
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
        last = equilibrium, system.n_unknowns
        whole, u = unfolded(grid, equilibrium.state.u, mirrors)
        found.append(probes_of(scene, whole, u))
        if linear is not None:
            change = solve_rest(system, system.new_factor())
            moved = system.nodal_change(system.rest().rotation, change)
            small = probes_of(scene, *unfolded(grid, moved, mirrors))
            found[-1] = {name: linear.probes[name] + u - small[name] for name, u in found[-1].items()}
            missing_mj = linear.energy_mj - 0.5 * copies * float((system.loads_on(system.rest(), 1.0) * change).sum())
        answers.append(found[-1])
        if before and is_extrapolated:
            share = richardson_factor(before, level, PLATE_RATE)
            answers[-1] = {name: u + share * (u - found[-2][name]) for name, u in found[-1].items()}
            caution = CAUTION_OF_TWO if len(found) == 2 else 1.0
            changes = [caution * largest_error(found[-1], answers[-1])]
            changes += [largest_error(answers[-2], answers[-1])] if len(answers) > 2 else []
            estimate = min(changes)
        elif before:
            share = 1.0 if inside else richardson_factor(before, level, RATE)
            estimate = share * largest_error(found[-2], found[-1]) + (linear.error_estimate if linear else 0.0)
        steps.append(
            f"level {level}: {system.n_unknowns} unknowns, {equilibrium.iterations} iterations in {equilibrium.steps} "
            f"steps, smallest J {equilibrium.least_j:.3g}; estimated error {estimate:.1e}"
            + (f"; {equilibrium.stability}" if equilibrium.stability else "")
        )
        if estimate <= scene.tolerance:
            break
    assert last is not None
    equilibrium, unknowns = last
    return FiniteSolution(
        probes=answers[-1],
        energy_mj=copies * equilibrium.stored_mj + missing_mj,
        work_mj=copies * equilibrium.work_mj + missing_mj,
        residual=equilibrium.residual,
        least_j=equilibrium.least_j,
        iterations=equilibrium.iterations,
        load_steps=equilibrium.steps,
        unknowns=unknowns,
        error_estimate=estimate,
        seconds=watch.seconds,
        steps=tuple(steps),
        field=_field(scene, whole, u) if with_field else None,
    )


def _field(scene: Scene, grid: Grid, u: FloatArray) -> Field:
    """A state (n_nodes, 3) for pictures; cells count to the rubber at their middles."""
    regions = [(prism, rubber) for prism, rubber in scene.regions if rubber != scene.material]
    points, (_, cells) = GridBasis(grid).doflocs.T, lattice_boxes(grid.lines)
    return Field(
        points_mm=points,
        cells=cells,
        cell_type=TRIQUADRATIC_HEXAHEDRON,
        displacement_mm=u,
        region=regions_at(points[cells[:, -1]], regions),
        material=(scene.material, *(rubber for _, rubber in regions)),
    )


def finite_grid(scene: Scene, level: int, mirrors: Sequence[Mirror] = ()) -> Grid:
    """Grid with lines along the loads' edges, crowding there and at the body's faces, and along prisms of other rubber.

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
        inner = [edge for edge in edges.tolist() if low < edge < high]
        attractors = [Attractor(edge, length, EDGE) for edge in inner]
        attractors += [Attractor(low, length, SIDE), Attractor(high, length, SIDE)]
        if axis in planes:
            low = planes[axis]
            inner = [edge for edge in inner if edge > low + scene.rounding_mm]
            attractors = [attractor for attractor in attractors if attractor.position_mm > low + scene.rounding_mm]
        sides = [
            prism.base_mm[axis] + side * prism.section_mm[axis] / 2
            for prism in other
            if prism.is_upright and scene.outline.is_upright
            for side in (-1, 1)
        ]
        lines.append(graded_lines([low, high, *inner, *np.clip(sides, low, high)], attractors, level))
    ends = [place[2] for prism in other for place in (prism.base_mm, prism.top_mm)]
    attractors = [Attractor(height, length, TOP), Attractor(0.0, length, BASE)]
    z = graded_lines([0.0, height, *np.clip(ends, 0.0, height)], attractors, level)
    return Grid(x=lines[0], y=lines[1], z=z, lean=lean)


def probes_of(scene: Scene, grid: Grid, u: FloatArray) -> Probes:
    """Displacement of a scene's probes in a state (n_nodes, 3)."""
    return {probe.name: _seen(probe, grid, u) for probe in scene.probes}


def _seen(probe: Probe, grid: Grid, u: FloatArray) -> FloatArray:
    if probe.kind == "mean":
        integral = GridBasis(grid).patch_integrals(np.array([probe.rectangle]))
        return np.asarray(integral @ u)[0] / integral.sum()
    x, y, z = probe.position_mm or (0.0, 0.0, 0.0)
    place = (x - grid.lean[0] * z, y - grid.lean[1] * z, z)
    X, Y, Z = (
        line_values(line, 2, np.clip(np.array([at]), line[0], line[-1]))[0]
        for line, at in zip(grid.lines, place, strict=True)
    )
    return np.einsum("i,j,k,ijkc->c", X, Y, Z, u.reshape(len(X), len(Y), len(Z), 3), optimize=True)
