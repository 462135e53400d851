"""Scenes of boxes by few hexahedra of high order, refined until the probes are as accurate as asked.

Elements shrink geometrically toward every edge at which the stress is singular, and their order rises with the number
of layers: so the error falls about tenfold a level, whatever ν. The matrix is never formed: see `kronecker.py`.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from time import perf_counter
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from fem.discretization.grid import Grid, geometric_line
from fem.discretization.hexahedra import GridBasis
from fem.discretization.kronecker import (
    FastDiagonal,
    Held,
    Term,
    along_axes,
    conjugate_gradients,
    elastic_tensors,
    line_integral,
    line_nodes,
    line_values,
)
from fem.discretization.mirrors import Mirror, Parity, parities, sign
from fem.linear.linear_solver import SolverError
from fem.methods.plan import Plan
from fem.methods.structured import material_numbers, whole_field
from fem.scene.scene import Probe, Rectangle, Scene
from fem.scene.solution import Field, Solution, relative_errors
from geometry.layout import FloatArray


class Level(NamedTuple):
    """How fine to solve."""

    order: int  #: of the functions along each axis
    layers: int  #: of elements on either side of the body's and regions' edges
    at_loads: int  #: of those on either side of the loads' outlines, where the stress is less singular
    widest: float  #: width of an element far from all edges, relative to the body's height
    fall: float  #: of the error, from the level before; as measured on blocks, slabs, pillars and stiff inclusions


LEVELS = (
    Level(2, 0, 0, 1.6, 1.0),
    Level(2, 1, 1, 0.8, 0.1),
    Level(3, 2, 1, 0.8, 0.13),
    Level(4, 3, 1, 0.8, 0.17),
    Level(5, 3, 1, 0.8, 0.28),
    Level(6, 4, 2, 0.8, 0.17),
)
BY_CHANCE = 2.0  #: how much more slowly than expected changes may shrink before the estimate heeds it
SLOWEST_FALL = 0.4  #: that the estimate reckons with, where changes shrink more slowly than they should
RATIO = 0.15  #: of the distances of neighbouring layers; Schwab, *p- and hp-finite element methods*, 1998
RESIDUAL = 1e-2  #: of conjugate gradients, over the tolerance; relative, in the norm of the preconditioner
ROUNDED = 1e-12  #: of the loads: what is below it cancels but for rounding
MAX_UNKNOWNS = 1_500_000  #: beyond, a level takes longer than anyone waits for a scene


@dataclass(frozen=True, eq=False)
class BoxPart:
    """What is solved of a body: functions of one order on a grid, and the planes in which the rest mirrors it.

    Displacements have shape (3, nx, ny, nz): component, then node along each axis.
    """

    grid: Grid
    order: int
    mirrors: tuple[Mirror, ...]

    @property
    def lines(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.grid.x, self.grid.y, self.grid.z

    @property
    def shape(self) -> tuple[int, int, int, int]:
        nx, ny, nz = (self.order * count + 1 for count in self.grid.shape)
        return 3, nx, ny, nz

    @property
    def share(self) -> float:
        """Of the whole body."""
        return 0.5 ** len(self.mirrors)

    def held(self, parity: Parity) -> Held:
        """Even parts hold the normal component on a mirror plane, odd ones the two in it; the base holds all."""
        return Held(
            tuple((sign(a, 0, parity) == -1, sign(a, 1, parity) == -1, True) for a in range(3))  # odd across the plane
        )

    def integral(self, rectangle: Rectangle, a: int, parity: Parity) -> FloatArray:
        """∫ of the top's functions of component a over a rectangle, its mirror images folded in, shape (nx, ny)."""
        along = []
        for d in range(2):
            shift = self.grid.lean[d] * self.grid.height_mm
            low, high = rectangle[d] - shift, rectangle[d + 2] - shift
            integral = line_integral(self.lines[d], self.order, low, high)
            for mirror in self.mirrors:
                if mirror.axis == d:
                    low, high = 2 * mirror.position_mm - high, 2 * mirror.position_mm - low
                    integral = integral + sign(a, d, parity) * line_integral(self.lines[d], self.order, low, high)
            along.append(integral)
        return np.multiply.outer(*along)

    def seen(self, probe: Probe, u: FloatArray, parity: Parity) -> FloatArray:
        """A probe's displacement, shape (3,) [mm]."""
        if probe.kind == "mean":
            x0, y0, x1, y1 = probe.rectangle
            totals = [np.vdot(self.integral(probe.rectangle, a, parity), u[a, :, :, -1]) for a in range(3)]
            return np.array(totals) / ((x1 - x0) * (y1 - y0))
        x, y, z = np.array(probe.position_mm)
        place, signs = [x - self.grid.lean[0] * z, y - self.grid.lean[1] * z, z], np.ones(3)
        for mirror in self.mirrors:
            if place[mirror.axis] < mirror.position_mm:
                place[mirror.axis] = 2 * mirror.position_mm - place[mirror.axis]
                signs *= [sign(a, mirror.axis, parity) for a in range(3)]
        rows = [line_values(line, self.order, np.array([at])) for line, at in zip(self.lines, place, strict=True)]
        return signs * np.array([along_axes(rows, component).item() for component in u])

    def taken_from(self, coarser: "BoxPart", u: FloatArray) -> FloatArray:
        """A coarser level's displacement at this one's nodes."""
        rows = [
            line_values(line, coarser.order, line_nodes(mine, self.order))
            for line, mine in zip(coarser.lines, self.lines, strict=True)
        ]
        return np.stack([along_axes(rows, component) for component in u])


class Answer(NamedTuple):
    """What one level says, or of it one parity."""

    part: BoxPart
    displacements: dict[Parity, FloatArray]
    probes: dict[str, FloatArray]
    energy_mj: float
    residual: float
    iterations: int


def solve_by_order(scene: Scene, plan: Plan, with_field: bool = False) -> Solution:
    """Solve a scene whose every region is a box (or the same sheared box) at rising levels of order and layers.

    Parameters
    ----------
    scene : Scene
    plan : Plan
        Of method "grid" and element "Qp".
    with_field : bool
        Also hand back the displacement of the whole body, unfolded from its mirrored part.

    Raises
    ------
    SolverError
        If the conjugate gradients do not converge, or a grid would be too big.
    """
    # small products: two threads each would wait for one another more than they gain
    with threadpool_limits(1, user_api="blas"):
        return _solve(scene, plan, with_field)


def _solve(scene: Scene, plan: Plan, with_field: bool) -> Solution:
    seconds = dict.fromkeys(("mesh", "assemble", "factor", "solve"), 0.0)
    answers: list[Answer] = []
    steps: list[str] = []
    estimate = np.inf
    for level in LEVELS:
        part = box_part(scene, plan, level)
        unknowns = int(np.prod(part.shape))
        if unknowns > MAX_UNKNOWNS:
            break
        answers.append(_answer(scene, plan, part, answers[-1] if answers else None, seconds))
        estimate = _estimate([answer.probes for answer in answers])
        steps.append(
            f"{' × '.join(map(str, part.grid.shape))} hexahedra of order {level.order}: {unknowns} unknowns, "
            f"{answers[-1].iterations} iterations" + (f", estimated error {estimate:.1e}" if len(answers) > 1 else "")
        )
        if estimate <= scene.tolerance:
            break
    if not answers:
        raise SolverError(
            f"a grid of {' × '.join(map(str, part.grid.shape))} boxes has {unknowns} unknowns, the limit is "
            f"{MAX_UNKNOWNS}: a load is very small beside the body; enlarge it or cut the body down."
        )
    last = answers[-1]
    return Solution(
        probes=last.probes,
        energy_mj=last.energy_mj,
        residual=last.residual,
        unknowns=int(np.prod(last.part.shape)),
        error_estimate=estimate,
        seconds=seconds,
        steps=tuple(steps),
        field=_field(last, scene, plan) if with_field else None,
    )


def box_part(scene: Scene, plan: Plan, level: Level) -> BoxPart:
    """The grid of a level: lines at the edges of body, loads and regions, in layers there."""
    outline = scene.outline
    height = outline.height_mm
    lean = tuple((top - base) / height for base, top in zip(outline.base_mm[:2], outline.top_mm[:2], strict=True))
    sizes = [side for load in scene.loads for side in load.size_mm]
    reach = min([height, *outline.section_mm, *sizes])
    mirrored = {mirror.axis: mirror.position_mm for mirror in plan.mirrors}
    lines = []
    for axis in (0, 1):
        middle, half = outline.base_mm[axis], outline.section_mm[axis] / 2
        shift = lean[axis] * height  # from the base, where lines are stated, to the top, where the loads are
        edges = [(middle + side * half, level.layers) for side in (-1, 1)]
        edges += [
            (prism.base_mm[axis] + side * prism.section_mm[axis] / 2, level.layers)
            for prism, _ in plan.regions
            for side in (-1, 1)
        ]
        edges += [(load.rectangle[side] - shift, level.at_loads) for load in scene.loads for side in (axis, axis + 2)]
        if axis in mirrored:
            edges = [(middle + abs(place - middle), layers) for place, layers in edges] + [(middle, 0)]
        lines.append(geometric_line(_most(edges, scene.rounding_mm), RATIO, level.widest * height, reach))
    levels = [z for prism, _ in plan.regions for z in (prism.base_mm[2], prism.top_mm[2])]
    upright = [(height, level.at_loads)] + [(z, level.layers) for z in (0.0, *levels)]
    lines.append(geometric_line(_most(upright, scene.rounding_mm), RATIO, level.widest * height, reach))
    grid = Grid(x=lines[0], y=lines[1], z=lines[2], lean=(lean[0], lean[1]))
    grid = Grid(x=grid.x, y=grid.y, z=grid.z, lean=grid.lean, region=material_numbers(grid, plan))
    return BoxPart(grid, level.order, plan.mirrors)


def _most(edges: list[tuple[float, int]], slack: float) -> dict[float, int]:
    """Positions and their layers, the most of each position; what only rounding tells apart is one position."""
    layers: dict[float, int] = {}
    for place, count in sorted(edges):
        last = next(reversed(layers), -np.inf)
        at = last if place - last <= slack else place
        layers[at] = max(layers.get(at, 0), count)
    return layers


def _answer(scene: Scene, plan: Plan, part: BoxPart, coarser: Answer | None, seconds: dict[str, float]) -> Answer:
    """A level's answer, begun at a coarser one's; parities at the same time, as many as there are processors."""
    start = perf_counter()
    outer = elastic_tensors(scene.material, part.grid.lean)
    stiffness = _terms(part, outer, tuple((0, count) for count in part.grid.shape))
    for number, (_, material) in enumerate(plan.regions, start=1):
        inner = elastic_tensors(material, part.grid.lean)
        box = _box(part.grid.region == number)
        if box is not None:  # a region's mirror image may be all that is in the part
            stiffness += _terms(part, (inner[0] - outer[0], inner[1] - outer[1]), box)
    seconds["assemble"] += perf_counter() - start

    start = perf_counter()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        answers = list(
            pool.map(
                lambda parity: _of_parity(scene, part, stiffness, outer[0] + outer[1], parity, coarser),
                parities(part.mirrors),
            )
        )
    seconds["solve"] += perf_counter() - start
    return Answer(
        part=part,
        displacements={parity: u for answer in answers for parity, u in answer.displacements.items()},
        probes={
            probe.name: np.sum([answer.probes[probe.name] for answer in answers], axis=0) for probe in scene.probes
        },
        energy_mj=sum(answer.energy_mj for answer in answers),
        residual=max(answer.residual for answer in answers),
        iterations=max(answer.iterations for answer in answers),
    )


def _of_parity(
    scene: Scene, part: BoxPart, stiffness: list[Term], C: FloatArray, parity: Parity, coarser: Answer | None
) -> Answer:
    """The part of an answer that has a parity. `C` is the body's own elastic tensor."""
    held = part.held(parity)
    load, newtons = np.zeros(part.shape), 0.0
    for one in scene.loads:
        newtons += np.abs(one.traction_mpa).sum() * one.size_mm[0] * one.size_mm[1]
        for a, traction in enumerate(one.traction_mpa):
            if traction:
                load[a, :, :, -1] += part.share * traction * part.integral(one.rectangle, a, parity)
    held.clear(load)
    if np.abs(load).sum() <= ROUNDED * newtons:
        load[:] = 0.0  # loads whose parts of this parity cancel
    first = part.taken_from(coarser.part, coarser.displacements[parity]) if coarser else np.zeros_like(load)
    held.clear(first)

    def apply(u: FloatArray) -> FloatArray:
        result = np.zeros_like(u)
        for term in stiffness:
            term.add_to(result, u)
        held.clear(result)
        return result

    precondition = FastDiagonal(part.lines, part.order, C, held)
    u, iterations, residual = conjugate_gradients(apply, precondition, load, first, RESIDUAL * scene.tolerance)
    return Answer(
        part=part,
        displacements={parity: u},
        probes={probe.name: part.seen(probe, u, parity) for probe in scene.probes},
        energy_mj=float(np.vdot(load, u)) / 2 / part.share,
        residual=residual,
        iterations=iterations,
    )


def _terms(part: BoxPart, tensors: tuple[FloatArray, FloatArray], box: tuple[tuple[int, int], ...]) -> list[Term]:
    """Stiffness of a box of elements: the volumetric part by one Gauss point less along each axis, or it would lock."""
    return [Term(part.lines, part.order, part.order + k, C, box) for k, C in enumerate(tensors)]


def _box(where: np.ndarray) -> tuple[tuple[int, int], ...] | None:
    """First element and one after the last along each axis, of a box in a grid of booleans."""
    places = np.nonzero(where)
    if not len(places[0]):
        return None
    return tuple((int(place.min()), int(place.max()) + 1) for place in places)


def _estimate(answers: Sequence[dict[str, FloatArray]]) -> float:
    """Error of the last answer: its level's change, times what should be left of it, or more where changes linger."""
    if len(answers) < 2:
        return np.inf
    last = answers[-1]
    changes = [
        relative_errors({name: after[name] - before[name] for name in last}, last)
        for before, after in pairwise(answers[-3:])
    ]
    before, fall = (level.fall for level in LEVELS[len(answers) - 2 : len(answers)])
    worst = 0.0
    for name, change in changes[-1].items():
        lingering = 1.0
        if len(changes) > 1 and changes[0][name] > 0:
            expected = before * (1 - fall) / (1 - before)  # change after change, if errors fall as they should
            lingering = max(1.0, change / changes[0][name] / expected / BY_CHANCE)
        left = min(fall * lingering, SLOWEST_FALL)
        worst = max(worst, change * left / (1 - left))
    return worst


def _field(answer: Answer, scene: Scene, plan: Plan) -> Field:
    """Displacement of the whole body at the edge nodes of its hexahedra and midway between them."""
    part = answer.part
    basis = GridBasis(part.grid, "S2")
    rows = [line_values(line, part.order, line_nodes(line, 2)) for line in part.lines]
    sampled = []
    for parity, u in answer.displacements.items():
        values = np.stack([along_axes(rows, component) for component in u], axis=-1)
        sampled.append((parity, values[basis.number >= 0]))
    return whole_field(basis, sampled, scene, plan)
