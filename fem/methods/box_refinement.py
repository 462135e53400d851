"""Scenes of boxes of any contrast, ν, shear and slenderness: few boxes of order 4, split where needed.

The first mesh has a line at every edge of body, regions and loads, and little else. Each solve tells which boxes the
errors of the probes come from, and along which axis; those are split, the others stay. The matrix is factored, so
neither moduli far apart nor ν near 0.5 cost more than anything else.

What the highest degree along an axis adds to an answer u_h and to z_h of `fem.levels` in a box stands for both their
errors there: the sum of the products over all boxes and axes is the probe's indicator η. Over 730 meshes of 111 scenes
the error was 0.05 to 0.92 times η in nine of ten (median 0.31, at most 2).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from threadpoolctl import ThreadpoolController

from fem.boxes.boxes import Boxes, lobatto_points
from fem.boxes.splitting import AxisTree, BoxMesh
from fem.field import Field, unfolded
from fem.kernel.factor import Factor, checked_solve
from fem.kernel.loads import Load, StiffLoad
from fem.kernel.mirrors import Parity, parities
from fem.levels import largest_contributors, shown_ratios, unit_loads
from fem.methods.adaptive import solve_adaptively
from fem.methods.plan import Plan
from fem.rubber.body import Condensed, Kind, RubberBody
from fem.scene.scene import Scene, regions_at
from fem.scene.solution import MeshAnswer, Solution, Stopwatch
from fem.system import System
from geometry.layout import FloatArray

ORDER = 4  #: of the functions along each axis; at 1e-3 order 3 takes three to five times the unknowns
MAX_FIRST = 45  #: first boxes, before any is split; where there would be more, they are wider than the body is thin
ON_FACE = 1e-3  #: of a load's width: an edge so near a body's or region's face gets no line; the load stays exact
SMALL = 0.2  #: of the first boxes' width: smaller loads and probes lie in shells of boxes
SHELL_RATIO = 4.0  #: of the margins of neighbouring shells
NEAR = 0.35  #: of a shell's margin: a face or edge so near is taken for the shell's
MAX_BOXES = 1000  #: beyond, more than 4 GB of memory are needed
SHARES = 0.4, 0.7  #: least and greatest share of the indicators' sum that is split at once
TAKEN = 0.85  #: of the indicators of split boxes, what their splitting takes away
AIM = 0.85  #: share of the tolerance at which splitting aims: what it takes varies
MAX_GROWTH = 2.5  #: of the number of boxes from mesh to mesh
MAX_PROBES = 20  #: that have unit loads of their own; of more, `N_SUMS` sums with random signs
N_SUMS = 24
PRESSURE_WEIGHT = 0.05  #: of pressures beside shear strains; with 0.25 meshes of ν near 0.5 had 10 % more unknowns
SAFETY = 2.5  #: factor on the ratio of error to η that changes have shown
MAX_RATIO = 1.5  #: taken where no change has shown it, and the most that is believed
MIN_RATIO, EARLY_RATIO = 0.3, 1.2  #: the least, and that of the first two meshes and of few boxes
FEW_BOXES = 24
MIN_FALL = 0.3  #: of η from mesh to mesh, where changes are compared with it: over less they say little


class SplitBoxes:
    """A scene on boxes, folded at the mirror planes in which all loads are even, or all odd.

    Loads that are neither need every box refined where their images are, or several factors: neither was faster.
    """

    def __init__(self, scene: Scene, plan: Plan) -> None:
        mirrors = tuple(mirror for mirror in plan.mirrors if len(mirror.parities) == 1)
        self.scene, self.plan = scene, replace(plan, mirrors=mirrors)
        self.mesh = first_mesh(scene, self.plan)
        self.history: list[Indicated] = []
        self._condensed: dict[Kind, Condensed] = {}

    def __str__(self) -> str:
        return f"{len(self.mesh.boxes)} boxes of order {ORDER}"

    def limit(self, unknowns: int) -> str | None:
        return f"{MAX_BOXES} boxes" if len(self.mesh.boxes) >= MAX_BOXES else None

    def solve(self, watch: Stopwatch) -> MeshAnswer:
        scene, mirrors = self.scene, self.plan.mirrors
        (parity,) = parities(mirrors)
        low, high = self.mesh.corners
        boxes = self.mesh.filled(ORDER, scene.outline.lean, regions_at((low + high) / 2, self.plan.regions))
        materials = [scene.material, *(material for _, material in self.plan.regions)]
        body = RubberBody.of(boxes, materials, self._condensed)
        system = System(body, on_lines(scene, boxes), mirrors, parity)
        matrix = system.matrix(system.rest_tangent())
        watch.spent("assemble")
        factor = Factor(matrix, definite=True, upper=True, by_degree=True)
        watch.spent("factor")
        forces = system.loads_on(system.rest()).reshape(-1, 1)
        y, residual = checked_solve(factor, forces)
        u = system.displaced(y)[0]
        probes = np.array([system.seen(probe, u) for probe in scene.probes])
        weights = unit_loads(probes, MAX_PROBES, N_SUMS)
        duals, _ = checked_solve(factor, system.unit_loads(weights, scene.probes))
        found = surplus(body, u, system.displaced(duals))
        self.history.append(Indicated(probes, indicators_of_probes(found, len(probes)), len(boxes.nodes)))
        watch.spent("solve")
        return MeshAnswer(
            probes=probes,
            energy_mj=system.copies * float((forces * y).sum()) / 2,
            residual=residual,
            unknowns=system.n_unknowns,
            indicators=found.sum(axis=2),
            field=lambda: self._field(boxes, parity, u),
        )

    def _field(self, boxes: Boxes, parity: Parity, u: FloatArray) -> Field:
        """Displacement of the whole body on quadratic boxes, eight to each of the solution's."""
        side, corners = boxes.size / 2, np.indices((2, 2, 2)).reshape(3, -1).T
        low = (boxes.low[:, None] + corners * side[:, None]).reshape(-1, 3)
        nodes, region = np.arange(27 * len(low)).reshape(-1, 27), np.repeat(boxes.region, 8)
        high = low + np.repeat(side, 8, axis=0)
        halves = Boxes(low=low, high=high, order=2, nodes=nodes, region=region, lean=boxes.lean)
        materials = [self.scene.material, *(rubber for _, rubber in self.plan.regions)]
        return unfolded(halves, self.plan.mirrors, [(parity, boxes.at(halves.points_mm) @ u)], materials)

    def refine(self, indicators: FloatArray, excess: float) -> None:
        self.mesh.split(marked(indicators, float(np.clip((1 - AIM / excess) / TAKEN, *SHARES))))

    def error(self) -> float:
        return float(estimated_errors(self.history).max())


def solve_on_boxes(scene: Scene, plan: Plan, with_field: bool = False) -> Solution:
    """Solve a scene whose every region is a box (or the same sheared box), as `solve_adaptively`.

    A `SolverError` says that an answer cannot be trusted.
    """
    watch = Stopwatch()
    # OpenBLAS gets products too small for two threads; MKL's factorisation keeps its own
    with ThreadpoolController().select(internal_api="openblas").limit(limits=1):
        mesh = SplitBoxes(scene, plan)
        watch.spent("mesh")
        return solve_adaptively(scene, mesh, watch, [], with_field)


def marked(indicators: FloatArray, share: float) -> np.ndarray:
    """Boxes to split along each axis, shape (n, 3): the largest indicators that hold a share of the sum.

    Fewer where that would make more than `MAX_GROWTH` times as many boxes.
    """
    marks = np.zeros(indicators.shape, dtype=bool)
    for place in largest_contributors(indicators.ravel(), share):
        marks.flat[place] = True
        if (2.0 ** marks.sum(axis=1)).sum() > MAX_GROWTH * len(indicators):
            break
    return marks


def first_mesh(scene: Scene, plan: Plan) -> BoxMesh:
    """Boxes none of which is much wider than the body's least extent, split at the faces of regions and edges of loads.

    A box is split only where such a face or edge cuts it, so none of them runs through the body. Loads and probes much
    smaller than the boxes lie in shells whose sizes fall geometrically, so that boxes of their own size resolve them.
    """
    (low, high), *inner = _solids(scene, plan)
    slack = scene.rounding_mm
    stops = [
        np.array(_apart([float(side[axis]) for solid in ((low, high), *inner) for side in solid], slack))
        for axis in range(3)
    ]
    widest = min(scene.height_mm, *scene.outline.section_mm)
    while np.prod(np.ceil((high - low) / widest)) > MAX_FIRST:
        widest *= 1.25
    lines = [
        np.linspace(start, end, int(np.ceil((end - start) / widest - 1e-9)) + 1)
        for start, end in zip(low, high, strict=True)
    ]
    known = [[*own, *line] for own, line in zip(stops, lines, strict=True)]
    shells = _shells(_patches(scene, plan), stops, known, widest, slack)
    inner += [shell for shell, _ in shells]
    around = [{float(side[axis]): margin for shell, margin in shells for side in shell} for axis in range(3)]
    x, y, z = (AxisTree(line, own, shell) for line, own, shell in zip(lines, stops, around, strict=True))
    mesh = BoxMesh((x, y, z))
    while True:
        lowest, highest = mesh.corners
        marks = np.zeros(lowest.shape, dtype=bool)
        for one, two in inner:
            meets = (lowest <= two + slack) & (highest >= one - slack)
            for axis in range(3):
                beside = np.delete(meets, axis, axis=1).all(axis=1)
                for face in (one[axis], two[axis]):
                    marks[:, axis] |= beside & (lowest[:, axis] < face - slack) & (highest[:, axis] > face + slack)
        if not marks.any():
            return mesh
        mesh.split(marks)


Solid = tuple[FloatArray, FloatArray]  #: lowest and highest corner, where the base shows them [mm]


def _patches(scene: Scene, plan: Plan) -> list[Solid]:
    """Rectangles of loads and probes on the top of the body's solved part."""
    rectangles = [load.rectangle for load in scene.loads] + [probe.rectangle for probe in scene.mean_probes]
    height = scene.height_mm
    shift = np.array([*scene.outline.lean, 0.0]) * height  # from the base, where lines are stated, to the top
    patches = [
        (np.array([x0, y0, height]) - shift, np.array([x1, y1, height]) - shift) for x0, y0, x1, y1 in rectangles
    ]
    for low, high in patches:
        _fold(low, high, plan)
    return patches


def _fold(low: FloatArray, high: FloatArray, plan: Plan) -> None:
    """Bring what lies beyond a mirror plane to this side, in place."""
    for mirror in plan.mirrors:
        axis, place = mirror.axis, mirror.position_mm
        ends = np.abs([low[axis] - place, high[axis] - place])
        low[axis] = place + (0.0 if (low[axis] - place) * (high[axis] - place) < 0 else ends.min())
        high[axis] = place + ends.max()


def _shells(
    patches: list[Solid], stops: list[FloatArray], known: list[list[float]], widest: float, slack: float
) -> list[tuple[Solid, float]]:
    """Boxes around patches smaller than the first boxes, and their margins, which grow by `SHELL_RATIO`.

    Faces less than the slack from `known` places, to which they are added, or from each other, are one.
    """
    found = []
    for low, high in patches:
        side = float((high - low)[:2].min())
        margin = 0.0 if side < SMALL * widest else widest
        while margin < SMALL * widest:
            one, two = low - margin, high + margin * np.array([1.0, 1.0, 0.0])
            for axis in range(3):
                for end in (one, two):
                    end[axis] = _nearest(stops[axis], end[axis], NEAR * margin)
                    end[axis] = _nearest(np.array(known[axis]), end[axis], slack)
                    known[axis].append(end[axis])
            found.append(((one, two), margin))
            margin = max(SHELL_RATIO * margin, side)
    return found


def _solids(scene: Scene, plan: Plan) -> list[Solid]:
    """Corners of the body's solved part, of regions and, flat, of loads.

    What lies beyond a mirror plane is folded to this side. Loads' edges next to a face are moved to it.
    """
    solids = []
    for prism in (scene.outline, *(prism for prism, _ in plan.regions)):
        half = np.array([*prism.section_mm, 0.0]) / 2
        base = np.array(prism.base_mm)
        solids.append((base - half, base + half + [0.0, 0.0, prism.height_mm]))
        _fold(*solids[-1], plan)
    n_lasting = len(solids)
    solids += _patches(scene, plan)[: len(scene.loads)]
    for axis in range(3):
        faces = np.array([side[axis] for solid in solids[:n_lasting] for side in solid])
        for load in solids[n_lasting:]:
            within = ON_FACE * (load[1] - load[0])[axis]
            for side in load:
                side[axis] = _nearest(faces, side[axis], within)
    return solids


def _apart(places: list[float], slack: float) -> list[float]:
    """Places in order, without those that only rounding tells from one named before: the body's own come first."""
    kept: list[float] = []
    for place in places:
        if all(abs(place - other) > slack for other in kept):
            kept.append(place)
    return sorted(kept)


def on_lines(scene: Scene, boxes: Boxes) -> list[Load]:
    """A scene's loads, edges of plates that `first_mesh` moved to a face moved as well."""
    loads: list[Load] = []
    for load in scene.loads:
        if isinstance(load, StiffLoad):
            x0, y0, x1, y1 = (
                _nearest(boxes.lines[k % 2] + boxes.lean[k % 2] * boxes.height_mm, place, ON_FACE * load.size_mm[k % 2])
                for k, place in enumerate(load.rectangle)
            )
            load = replace(load, center_mm=((x0 + x1) / 2, (y0 + y1) / 2), size_mm=(x1 - x0, y1 - y0))
        loads.append(load)
    return loads


def _nearest(line: FloatArray, place: float, within: float) -> float:
    """The nearest of some places if it is near enough, else the place itself."""
    nearest = float(line[np.abs(line - place).argmin()])
    return nearest if abs(nearest - place) <= within else place


# errors of probes


class Indicated(NamedTuple):
    """Probes on a mesh and the indicators of their errors."""

    probes: FloatArray  #: (n_probes, 3) [mm]
    eta: FloatArray  #: (n_probes,), relative
    n_boxes: int


def indicators_of_probes(surplus: FloatArray, n_probes: int) -> FloatArray:
    """η of each probe, (n_probes,), from the `surplus` of the `unit_loads`; of sums, one bound for all."""
    if n_probes <= MAX_PROBES:
        return np.linalg.norm(surplus.sum(axis=(0, 1)).reshape(n_probes, 3), axis=1)
    return np.full(n_probes, np.sqrt((surplus**2).mean(axis=2)).sum())


def estimated_errors(history: Sequence[Indicated]) -> FloatArray:
    """Relative error of each probe on the last of several meshes, (n_probes,): η times `SAFETY` times its shown ratio.

    On the meshes of 111 scenes (blocks, slabs, plates, pillars, voids, inclusions, rigid and tiny patches, ν = 0 to
    0.499999), stopped at six tolerances, 2 of 739 estimates were below the error, by 1.16 and 1.31; factor 2 leaves 10
    of 771, 1.5 leaves 21 of 807.
    """
    probes, eta = (np.array([mesh[k] for mesh in history[-4:]]) for k in (0, 1))
    if len(history) == 1:
        return MAX_RATIO * eta[-1]
    least = EARLY_RATIO if len(history) == 2 or history[-1].n_boxes < FEW_BOXES else MIN_RATIO
    return np.clip(SAFETY * shown_ratios(probes, eta, MIN_FALL), least, MAX_RATIO) * eta[-1]


def surplus(body: RubberBody, u: FloatArray, duals: FloatArray) -> FloatArray:
    """Products of what the highest degrees add to an answer and to others, by element and axis, (n_elements, 3, k).

    The answer is u (n_nodes, 3) of a body at rest, `duals` (k, n_nodes, 3) are answers to unit loads on the probes.
    They are multiplied as strain energies are: the order of the displacement by μ |∂u|², the highest of the pressure by
    p²/μ. Without the pressure the estimate at a loaded corner, ν = 0.4999, was 0.8 times the error.
    """
    boxes, reference = body.boxes, body.reference
    order, n = boxes.order, boxes.order + 1
    to_highest = np.linalg.inv(legendre.legvander(lobatto_points(order), order))[order]
    lumped = 2 / (order * n * legendre.legval(lobatto_points(order), np.eye(n)[order]) ** 2)
    across = np.multiply.outer(lumped, lumped)
    pull = np.linalg.inv(boxes.shear)
    lame, mu = body.law.lame_mpa[:, 0], body.law.mu_mpa[:, 0]
    values = np.concatenate([u[None], duals])[:, boxes.nodes]  # (1 + k, e, n³, 3)
    lattice = values.reshape(*values.shape[:2], n, n, n, 3)
    found = np.empty((len(boxes.nodes), 3, len(duals)))
    for d in range(3):
        top = np.abs(np.tensordot(to_highest, lattice, (0, 2 + d)))
        energy = np.einsum("jk,ejka,cejka->ec", across, top[0], top[1:], optimize=True)
        size = (pull[d] ** 2).sum() * mu * body.scale[d] ** 2 * body.jacobian * order * n
        found[:, d] = size[:, None] * energy
    along = np.einsum("jkn,cena->cejka", reference.divergence, values, optimize=True)
    divergence = np.abs(np.einsum("ja,je,cejka->cek", pull, body.scale, along, optimize=True))
    highest = reference.degrees == reference.degrees.max()
    toward = highest / highest.sum(axis=1, keepdims=True).clip(1)
    of_pressures = np.einsum("ek,cek,kd->edc", divergence[0], divergence[1:], toward, optimize=True)
    return found + (PRESSURE_WEIGHT * lame**2 / mu * body.jacobian)[:, None, None] * of_pressures
