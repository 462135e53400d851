"""Scenes of boxes by few hexahedra of high order, refined until the probes are as accurate as asked.

Elements shrink geometrically toward every edge at which the stress is singular, and their order rises with the number
of layers: so the error falls about tenfold a level, whatever ν. The matrix is never formed: see `graded_box.py`.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from fem.discretization.graded_box import BoxPart, FastDiagonal, Level, Term, box_part, conjugate_gradients
from fem.discretization.grid import lattice_boxes
from fem.discretization.lagrange import elastic_tensors
from fem.discretization.mirrors import Parity, parities
from fem.discretization.richardson import errors_by_falls
from fem.factor import SolverError
from fem.methods.box_field import crossings, picture_lines, unfolded_field
from fem.methods.plan import Plan
from fem.scene.scene import Scene
from fem.scene.solution import Field, Probes, Solution, Stopwatch
from geometry.layout import FloatArray

LEVELS = (
    Level(2, 0, 0, 1.6, 1.0),
    Level(2, 1, 1, 0.8, 0.1),
    Level(3, 2, 1, 0.8, 0.13),
    Level(4, 3, 1, 0.8, 0.17),
    Level(5, 3, 1, 0.8, 0.28),
    Level(6, 4, 2, 0.8, 0.17),
)
RESIDUAL = 1e-2  #: of conjugate gradients, over the tolerance; relative, in the norm of the preconditioner
ROUNDED = 1e-12  #: share of the loads below which a parity's part of them cancels but for rounding
MAX_UNKNOWNS = 1_500_000  #: beyond, a level takes longer than anyone waits for a scene


class LevelAnswer(NamedTuple):
    """Answer of one level, or of one parity of it."""

    part: BoxPart
    displacements: dict[Parity, FloatArray]
    probes: Probes
    energy_mj: float
    residual: float
    iterations: int


def solve_by_order(scene: Scene, plan: Plan, with_field: bool = False) -> Solution:
    """Solve a scene whose every region is a box (or the same sheared box) at rising levels of order and layers.

    Parameters
    ----------
    scene : Scene
    plan : Plan
        Of element "Qp".
    with_field : bool
        Also return the displacement of the whole body.

    Raises
    ------
    SolverError
        If the conjugate gradients do not converge, or a grid would be too big.
    """
    # small products: two threads each would wait for one another more than they gain
    with threadpool_limits(1, user_api="blas"):
        return _solve(scene, plan, with_field)


def _solve(scene: Scene, plan: Plan, with_field: bool) -> Solution:
    watch = Stopwatch()
    answers: list[LevelAnswer] = []
    steps: list[str] = []
    estimate = np.inf
    for level in LEVELS:
        part = box_part(scene, plan.regions, plan.mirrors, level)
        unknowns = int(np.prod(part.shape))
        if unknowns > MAX_UNKNOWNS:
            break
        answers.append(_answer(scene, plan, part, answers[-1] if answers else None, watch))
        estimate = errors_by_falls([answer.probes for answer in answers], [level.fall for level in LEVELS])
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
        seconds=watch.seconds,
        steps=tuple(steps),
        field=_field(last, scene, plan) if with_field else None,
    )


def _answer(scene: Scene, plan: Plan, part: BoxPart, coarser: LevelAnswer | None, watch: Stopwatch) -> LevelAnswer:
    """A level's answer, begun at a coarser one's; parities at the same time, as many as there are processors."""
    watch.spent("mesh")
    outer = elastic_tensors(scene.material, part.grid.lean)
    stiffness = _terms(part, outer, tuple((0, count) for count in part.grid.shape))
    for number, (_, material) in enumerate(plan.regions, start=1):
        inner = elastic_tensors(material, part.grid.lean)
        box = _box(part.grid.region == number)
        if box is not None:  # a region's mirror image may be all that is in the part
            stiffness += _terms(part, (inner[0] - outer[0], inner[1] - outer[1]), box)
    watch.spent("assemble")
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        answers = list(
            pool.map(
                lambda parity: _of_parity(scene, part, stiffness, outer[0] + outer[1], parity, coarser),
                parities(part.mirrors),
            )
        )
    watch.spent("solve")
    return LevelAnswer(
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
    scene: Scene, part: BoxPart, stiffness: Sequence[Term], C: FloatArray, parity: Parity, coarser: LevelAnswer | None
) -> LevelAnswer:
    """The part of an answer that has a parity. `C` is the body's own elastic tensor."""
    held = part.held(parity)
    load, newtons = np.zeros(part.shape), 0.0
    for one in scene.dead_loads:
        newtons += np.abs(one.traction_mpa).sum() * one.size_mm[0] * one.size_mm[1]
        tractions = part.share * part.integrals(one.rectangle, parity) * np.array(one.traction_mpa)
        load[..., -1] += np.moveaxis(tractions, -1, 0)
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

    precondition = FastDiagonal(part.grid.lines, part.order, C, held)
    u, iterations, residual = conjugate_gradients(apply, precondition, load, first, RESIDUAL * scene.tolerance)
    return LevelAnswer(
        part=part,
        displacements={parity: u},
        probes={probe.name: part.seen(probe, u, parity) for probe in scene.probes},
        energy_mj=float(np.vdot(load, u)) / 2 / part.share,
        residual=residual,
        iterations=iterations,
    )


def _terms(part: BoxPart, tensors: tuple[FloatArray, FloatArray], box: tuple[tuple[int, int], ...]) -> list[Term]:
    """Stiffness of a box of elements: the volumetric part by one Gauss point less along each axis, or it would lock."""
    return [Term(part.grid.lines, part.order, part.order + k, C, box) for k, C in enumerate(tensors)]


def _box(where: np.ndarray) -> tuple[tuple[int, int], ...] | None:
    """First element and one after the last along each axis, of a box in a grid of booleans."""
    places = np.nonzero(where)
    if not len(places[0]):
        return None
    return tuple((int(place.min()), int(place.max()) + 1) for place in places)


def _field(answer: LevelAnswer, scene: Scene, plan: Plan) -> Field:
    """Displacement of the whole body on quadratic boxes, the solved ones split where they are wide."""
    part = answer.part
    lines = [picture_lines(scene, line) for line in part.grid.lines]
    halves, cells = lattice_boxes(lines)
    parts = [(parity, part.at(halves, u).reshape(3, -1).T) for parity, u in answer.displacements.items()]
    return unfolded_field(scene, plan, crossings(halves), cells, parts)
