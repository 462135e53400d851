"""Scenes of boxes on structured grids of hexahedra, refined until the probes are as accurate as asked.

Grids of rising level contain each other, and their errors fall together, as a power of the level: so two or three
answers tell how far the last one is from the limit, and which level the tolerance needs.
"""

from dataclasses import dataclass
from itertools import pairwise
from time import perf_counter

import numpy as np
import scipy.sparse as sp

from fem.discretization.elasticity import ElasticBody
from fem.discretization.grid import Attractor, Grid, graded_lines
from fem.discretization.hexahedra import GridBasis, HexElement, grid_body, grid_stiffness
from fem.discretization.mirrors import Mirror, Parity, flipped_points, flipped_rectangle, images, parities
from fem.discretization.patch import patch_means
from fem.linear.linear_solver import SolverError, checked_solve, factorized, solver_plan
from fem.linear.multigrid import rigid_body_modes
from fem.methods.plan import Plan
from fem.methods.richardson import error_after, next_level
from fem.scene.scene import Probe, Rectangle, Scene
from fem.scene.solution import QUADRATIC_HEXAHEDRON, TRIQUADRATIC_HEXAHEDRON, Field, Solution, relative_errors
from geometry.layout import FloatArray

COARSE = 5e-3  #: tolerance from which the first grid is of level 1; otherwise of level 2
HIGHEST_LEVEL = 24
ENOUGH = 0.8  #: of the tolerance: an estimate below it ends the refinement
MAX_UNKNOWNS = 450_000  #: beyond, a grid takes longer than anyone waits for a scene
EDGE_OF_LOAD, EDGE_OF_REGION, EDGE_OF_PROBE = 1.0, 0.7, 0.3  #: weights of attractors, tuned on the validation scenes
TOP_AT_EDGES, TOP = 1.5, 0.5  #: of the top, where loads end on it and where they cover all of it
BASE, BASE_BY_SIDE = 0.25, 2.0  #: of the clamped base: far from all sides, and by one that is felt
SIDE_BY_LOAD, SIDE_BY_PROBE = 1.0, 0.5  #: of the body's sides, for a load or a probe right beside them


@dataclass(frozen=True)
class Answer:
    """What one grid says."""

    probes: dict[str, FloatArray]
    energy_mj: float
    residual: float
    unknowns: int


def solve_on_grid(scene: Scene, plan: Plan, with_field: bool = False) -> Solution:
    """Solve a scene whose every region is a box (or the same sheared box) on grids of rising level.

    Parameters
    ----------
    scene : Scene
    plan : Plan
        Of method "grid".
    with_field : bool
        Also hand back the displacement of the whole body, unfolded from its mirrored part.

    Raises
    ------
    SolverError
        If an answer cannot be trusted.
    """
    seconds = dict.fromkeys(("mesh", "assemble", "factor", "solve"), 0.0)
    levels, answers, steps = [], [], []
    level: int | None = 1 if scene.tolerance >= COARSE else 2
    estimate = np.inf
    field = None
    while level is not None:
        grid = scene_grid(scene, plan, level)
        answer, field = _answer(scene, plan, grid, seconds, with_field)
        levels.append(level)
        answers.append(answer)
        estimate = _estimate(levels, answers)
        steps.append(
            f"grid of {' × '.join(map(str, grid.shape))} boxes (level {level}): {answer.unknowns} unknowns"
            + (f", estimated error {estimate:.1e}" if len(levels) > 1 else "")
        )
        level = _next(scene, levels, answers, estimate)
    last = answers[-1]
    return Solution(
        probes=last.probes,
        energy_mj=last.energy_mj,
        residual=last.residual,
        unknowns=last.unknowns,
        error_estimate=estimate,
        seconds=seconds,
        steps=tuple(steps),
        field=field,
    )


def scene_grid(scene: Scene, plan: Plan, level: int) -> Grid:
    """The grid of a level: lines at the edges of loads and regions, crowding there; of mirrored bodies only a part."""
    outline = scene.outline
    height = outline.height_mm
    lean = tuple((top - base) / height for base, top in zip(outline.base_mm[:2], outline.top_mm[:2], strict=True))
    loads = [load.rectangle for load in scene.loads]
    # elsewhere than under a load the displacement is smooth, so that a probe's edges need no lines
    means = [probe.rectangle for probe in scene.probes if probe.kind == "mean"]
    probes = [mean for mean in means if any(_touch(mean, load) for load in loads)]
    sizes = [side for load in scene.loads for side in load.size_mm]
    length = min([height, *outline.section_mm, *sizes])
    mirrored = {mirror.axis: mirror.position_mm for mirror in plan.mirrors}

    axes, exposed, top = [], 0.0, TOP
    for axis in (0, 1):
        middle, half = outline.base_mm[axis], outline.section_mm[axis] / 2
        low, high = middle - half, middle + half
        shift = lean[axis] * height  # from the base, where lines are stated, to the top, where the loads are
        load_edges = [rectangle[side] - shift for rectangle in loads for side in (axis, axis + 2)]
        probe_edges = [rectangle[side] - shift for rectangle in probes for side in (axis, axis + 2)]
        if any(low < edge < high for edge in load_edges):
            top = TOP_AT_EDGES
        region_edges = [
            prism.base_mm[axis] + sign * prism.section_mm[axis] / 2 for prism, _ in plan.regions for sign in (-1, 1)
        ]
        beside = max(
            SIDE_BY_LOAD * _nearness(loads, axis, low + shift, high + shift, length),
            SIDE_BY_PROBE * _nearness(means, axis, low + shift, high + shift, length),
        )
        exposed = max(exposed, beside)
        places = (
            [(e, EDGE_OF_LOAD) for e in load_edges]
            + [(e, EDGE_OF_REGION) for e in region_edges]
            + [(e, EDGE_OF_PROBE) for e in probe_edges]
            + [(low, beside), (high, beside)]
        )
        stops = [low, high, *load_edges, *region_edges]
        if axis in mirrored:
            places += [(2 * middle - place, weight) for place, weight in places]
            stops = [middle + abs(stop - middle) for stop in stops] + [middle]
        attractors = _unique(places, length)
        stops = [stop for stop in stops if low <= stop <= high]
        axes.append(graded_lines(_apart(stops, scene.rounding_mm), attractors, level))
    levels_of_regions = [z for prism, _ in plan.regions for z in (prism.base_mm[2], prism.top_mm[2])]
    upright = _unique(
        [(height, top), (0.0, max(BASE, BASE_BY_SIDE * exposed))] + [(z, EDGE_OF_REGION) for z in levels_of_regions],
        length,
    )
    z = graded_lines(_apart([0.0, height, *levels_of_regions], scene.rounding_mm), upright, level)
    grid = Grid(x=axes[0], y=axes[1], z=z, lean=(lean[0], lean[1]))
    return Grid(x=grid.x, y=grid.y, z=grid.z, lean=grid.lean, region=material_numbers(grid, plan))


def _nearness(rectangles: list[Rectangle], axis: int, low: float, high: float, length: float) -> float:
    """How much of what happens on the nearest of the rectangles is felt at a side: exp(−gap/length), 0 without any."""
    gaps = [min(rectangle[axis] - low, high - rectangle[axis + 2]) for rectangle in rectangles]
    return float(np.exp(-min(gaps) / length)) if gaps else 0.0


def _touch(one: Rectangle, other: Rectangle) -> bool:
    return all(one[axis] <= other[axis + 2] and other[axis] <= one[axis + 2] for axis in (0, 1))


def _unique(places: list[tuple[float, float]], length: float) -> list[Attractor]:
    """One attractor a place, with the greatest weight it was given."""
    weights: dict[float, float] = {}
    for place, weight in places:
        key = round(place, 9)
        weights[key] = max(weight, weights.get(key, 0.0))
    return [Attractor(place, length, weight) for place, weight in weights.items()]


def _apart(stops: list[float], slack: float) -> list[float]:
    """Stops without those that only rounding tells from the one before."""
    kept: list[float] = []
    for stop in sorted(stops):
        if not kept or stop - kept[-1] > slack:
            kept.append(stop)
    return kept


def material_numbers(grid: Grid, plan: Plan) -> np.ndarray:
    """Material number of every box: 0 the body, k the k-th region."""
    region = np.zeros(grid.shape, dtype=np.int64)
    centres = [(lines[1:] + lines[:-1]) / 2 for lines in (grid.x, grid.y, grid.z)]
    points = np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1).reshape(-1, 3)
    for number, (prism, _) in enumerate(plan.regions, start=1):
        region.reshape(-1)[prism.holds(points)] = number
    return region


def _answer(
    scene: Scene, plan: Plan, grid: Grid, seconds: dict[str, float], with_field: bool
) -> tuple[Answer, Field | None]:
    start = perf_counter()

    def spent(step: str) -> None:
        nonlocal start
        now = perf_counter()
        seconds[step] += now - start
        start = now

    element: HexElement = "S2" if plan.element == "S2" else "Q2"
    basis = GridBasis(grid, element)
    if basis.N * 3 > 2 * MAX_UNKNOWNS:
        raise SolverError(
            f"a grid of {' × '.join(map(str, grid.shape))} boxes has {basis.N * 3} unknowns, the limit is "
            f"{2 * MAX_UNKNOWNS}: a load is very small beside the body; enlarge it or cut the body down."
        )
    spent("mesh")
    stiffness = grid_stiffness(basis, [scene.material, *(material for _, material in plan.regions)])
    share = 0.5 ** len(plan.mirrors)
    probes = {probe.name: np.zeros(3) for probe in scene.probes}
    energy_mj, residual, unknowns, parts = 0.0, 0.0, 0, []
    for parity in parities(plan.mirrors):
        body = grid_body(basis, stiffness, parity)
        forces = np.zeros((basis.N * 3, 1))
        for load in scene.loads:
            newtons = np.array(load.traction_mpa) * load.size_mm[0] * load.size_mm[1]
            forces += share * (rectangle_rows(basis, load.rectangle, plan.mirrors, parity).T @ newtons[:, None])
        rhs = body.loads(forces)
        spent("assemble")
        iterative = plan.solver == "multigrid" or not solver_plan(rhs.shape[0], definite=True).fits
        modes = free_modes(body) if iterative and not plan.mirrors else None  # mirrors hold single components
        factor = factorized(body.matrix, plan.solver, definite=True, modes=modes)
        spent("factor")
        solution, misfit = checked_solve(body.matrix, factor, rhs)
        u = body.displacements(solution)
        for probe in scene.probes:
            probes[probe.name] += (probe_rows(basis, probe, plan.mirrors, parity) @ u).ravel()
        energy_mj += float((solution * rhs).sum()) / 2 / share
        residual, unknowns = max(residual, misfit), max(unknowns, rhs.shape[0])
        parts.append((parity, u.reshape(-1, 3)))
        spent("solve")
    answer = Answer(probes=probes, energy_mj=energy_mj, residual=residual, unknowns=unknowns)
    return answer, (whole_field(basis, parts, scene, plan) if with_field else None)


def free_modes(body: ElasticBody) -> FloatArray:
    """Rigid-body modes on a body's free degrees of freedom, for the iterative solver."""
    return rigid_body_modes(body.basis.doflocs.T)[body.free]


def rectangle_rows(
    basis: GridBasis, rectangle: Rectangle, mirrors: tuple[Mirror, ...], parity: Parity
) -> sp.csr_matrix:
    """Rows (3, N·3) that take displacements of the solved part to the mean over a rectangle anywhere on the body."""
    rows = sp.csr_matrix((3, basis.N * 3))
    for flipped, signs in images(mirrors, parity):
        rows = rows + sp.diags_array(signs) @ patch_means(basis, flipped_rectangle(rectangle, flipped)[None])
    return rows.tocsr()


def probe_rows(basis: GridBasis, probe: Probe, mirrors: tuple[Mirror, ...], parity: Parity) -> sp.csr_matrix:
    """Rows (3, N·3) that take displacements of the solved part to a probe anywhere on the body."""
    if probe.kind == "mean":
        return rectangle_rows(basis, probe.rectangle, mirrors, parity)
    point = np.array(probe.position_mm)
    beyond = {mirror.axis for mirror in mirrors if point[mirror.axis] < mirror.position_mm}
    flipped, signs = next(image for image in images(mirrors, parity) if {mirror.axis for mirror in image[0]} == beyond)
    values = basis.values(flipped_points(point, flipped)[None])
    return (sp.diags_array(signs) @ sp.kron(values, sp.eye_array(3))).tocsr()


def whole_field(basis: GridBasis, parts: list[tuple[Parity, FloatArray]], scene: Scene, plan: Plan) -> Field:
    """Displacement of the whole body at the nodes of its boxes, from even and odd parts (N, 3) of one part."""
    n = len(basis.local)
    order = [int(np.flatnonzero((basis.local == place).all(axis=1))[0]) for place in VTK_PLACES[:n]]
    cells, points = basis.element_dofs[order].T, basis.doflocs.T
    all_points, all_moved, all_cells = [], [], []
    for number, (flipped, _) in enumerate(images(plan.mirrors, (1, 1))):
        image = cells
        for mirror in flipped:
            image = image[:, VTK_MIRRORED[mirror.axis][:n]]
        all_cells.append(image + number * len(points))
        all_points.append(flipped_points(points, flipped))
        moved = np.zeros_like(points)
        for parity, u in parts:
            moved += u * next(signs for planes, signs in images(plan.mirrors, parity) if planes == flipped)
        all_moved.append(moved)
    region = np.broadcast_to(basis.grid.region, basis.grid.shape).ravel()
    return Field(
        points_mm=np.vstack(all_points),
        cells=np.vstack(all_cells),
        cell_type=TRIQUADRATIC_HEXAHEDRON if n == 27 else QUADRATIC_HEXAHEDRON,
        displacement_mm=np.vstack(all_moved),
        region=np.tile(region, len(all_cells)),
        material=(scene.material, *(material for _, material in plan.regions)),
    )


#: the nodes of VTK's hexahedra in half steps: corners, lower edges, upper edges, uprights; in the triquadratic one also
#: the middles of the sides across x, y and z, and of the whole
VTK_PLACES = np.array(
    [
        *[(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)],
        *[(1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2)],
        *[(0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)],
        *[(0, 1, 1), (2, 1, 1), (1, 0, 1), (1, 2, 1), (1, 1, 0), (1, 1, 2), (1, 1, 1)],
    ]
)
#: for each axis, the node that a mirror puts in each node's place, so that mirrored boxes are not inside out
VTK_MIRRORED = [
    [
        int(np.flatnonzero((np.where(np.arange(3) == axis, 2 - place, place) == VTK_PLACES).all(axis=1))[0])
        for place in VTK_PLACES
    ]
    for axis in (0, 1)
]


def _estimate(levels: list[int], answers: list[Answer]) -> float:
    if len(levels) < 2:
        return np.inf
    last = answers[-1].probes
    changes = [
        relative_errors({name: b.probes[name] - a.probes[name] for name in last}, last) for a, b in pairwise(answers)
    ]
    return max(error_after(levels, [change[name] for change in changes]) for name in last)


def _next(scene: Scene, levels: list[int], answers: list[Answer], estimate: float) -> int | None:
    """The level that the tolerance needs, or None if it is met or out of reach."""
    if len(levels) == 1:
        return levels[0] + 1
    if estimate <= ENOUGH * scene.tolerance:
        return None
    wanted = next_level(levels[-1], estimate, scene.tolerance)
    growth = answers[-1].unknowns / levels[-1] ** 3
    affordable = int((MAX_UNKNOWNS / growth) ** (1 / 3))
    level = min(wanted, affordable, HIGHEST_LEVEL)
    return level if level > levels[-1] else None
