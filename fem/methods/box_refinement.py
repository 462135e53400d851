"""Scenes of boxes of any contrast, ν, shear and slenderness: few boxes of order 4 or 3, split where needed.

The first mesh has a line at every edge of body, regions and loads, and little else. Each solve tells which boxes the
errors of the probes come from, and along which axis; those are split, the others stay. The matrix is factored, so
neither moduli far apart nor ν near 0.5 cost more than anything else.
"""

from dataclasses import replace

import numpy as np
from numpy.polynomial import legendre
from threadpoolctl import ThreadpoolController

from fem.boxes.boxes import Boxes
from fem.boxes.lagrange import lobatto_points
from fem.boxes.lattice import lattice_boxes
from fem.boxes.splitting import AxisTree, BoxMesh
from fem.discretization.indicator import dual_weights
from fem.factor import Factor, checked_solve
from fem.methods.adaptive import MeshAnswer, solve_adaptively
from fem.methods.box_field import crossings, picture_lines, unfolded_field
from fem.methods.plan import Plan
from fem.mirrors import Parity, parities
from fem.rubber.body import Condensed, Kind, RubberBody
from fem.scene.loads import Load, StiffLoad
from fem.scene.scene import Scene, regions_at
from fem.scene.solution import Field, Solution, Stopwatch
from fem.system import System
from geometry.layout import FloatArray

ORDER = 4  #: of the functions along each axis; at 1e-3 order 3 takes three to five times the unknowns
LOOSE_ORDER, LOOSE = 3, 1e-2  #: the order from this tolerance on: half the time there
WIDEST = 0.7  #: of the first boxes, relative to the least extent of the body, at a tolerance of 1e-3
MAX_FIRST = 60  #: first boxes, before any is split, likewise; where there would be more, they are wider
LOOSER = 0.2  #: power of the tolerance with which the first boxes may be wider and fewer
HAIR = 1e-3  #: of a load's width: an edge so near a body's or region's face gets no line; the load stays exact
MIN_BOXES = 24  #: with fewer an estimate is not believed: 5e-3 for 1e-2 on a pillar that leans by 67°
MAX_BOXES = 1000  #: beyond, more than 4 GB of memory are needed
SHARE = 0.6  #: of the indicators' sum that is split at once, and of what is left near the tolerance
LAST_SHARE = 0.4
DIVERGENCE_WEIGHT = 0.25  #: of pressures beside shear strains in the indicator of the error
GROWTH = 2.5  #: of the number of boxes, at most, from mesh to mesh


class SplitBoxes:
    """A scene on boxes."""

    min_meshes = 2

    def __init__(self, scene: Scene, plan: Plan) -> None:
        self.scene, self.plan = scene, plan
        self.mesh = first_mesh(scene, plan)
        self.order = LOOSE_ORDER if scene.tolerance >= LOOSE else ORDER
        self._condensed: dict[Kind, Condensed] = {}

    def __str__(self) -> str:
        return f"{len(self.mesh.boxes)} boxes of order {self.order}"

    def is_trusted(self) -> bool:
        return len(self.mesh.boxes) >= MIN_BOXES

    def limit(self, unknowns: int) -> str | None:
        return f"{MAX_BOXES} boxes" if len(self.mesh.boxes) >= MAX_BOXES else None

    def solve(self, watch: Stopwatch) -> MeshAnswer:
        scene, mirrors = self.scene, self.plan.mirrors
        low, high = self.mesh.corners
        boxes = self.mesh.filled(self.order, scene.outline.lean, regions_at((low + high) / 2, self.plan.regions))
        materials = [scene.material, *(material for _, material in self.plan.regions)]
        body = RubberBody.of(boxes, materials, self._condensed)
        system = System(body, on_lines(scene, boxes), mirrors, parities(mirrors)[0])
        blocks = system.rest_tangent()
        watch.spent("assemble")
        probes, energy_mj, residuals, answers = np.zeros((len(scene.probes), 3)), 0.0, [], []
        for part in (system.of_parity(parity) for parity in parities(mirrors)):
            factor = Factor(part.matrix(blocks), definite=True, upper=True)
            watch.spent("factor")
            forces = part.loads_on(part.rest()).reshape(-1, 1)
            y, residual = checked_solve(factor, forces)
            u = part.displaced(y)[0]
            probes += [part.seen(probe, u) for probe in scene.probes]
            energy_mj += part.copies * float((forces * y).sum()) / 2
            residuals.append(residual)
            answers.append((part, factor, u))
            watch.spent("solve")
        weights, scales = dual_weights(probes)
        found = np.zeros((len(boxes.nodes), 3))
        for part, factor, u in answers:
            duals, _ = checked_solve(factor, part.unit_loads(weights, scene.probes))
            found += indicators(body, u, part.displaced(duals), scales)
        watch.spent("solve")
        return MeshAnswer(
            probes=probes,
            energy_mj=energy_mj,
            residual=max(residuals),
            unknowns=system.n_unknowns,
            indicators=found,
            field=lambda: self._field(boxes, [(part.parity, u) for part, _, u in answers]),
        )

    def _field(self, boxes: Boxes, parts: list[tuple[Parity, FloatArray]]) -> Field:
        """Displacement of the whole body on quadratic boxes, the wide ones split."""
        points, cells, count = [], [], 0
        for low, high in zip(boxes.low, boxes.high, strict=True):
            halves, own = lattice_boxes(
                [picture_lines(self.scene, np.array(ends)) for ends in zip(low, high, strict=True)]
            )
            points.append(crossings(halves))
            cells.append(own + count)
            count += len(points[-1])
        places = np.vstack(points)
        rows = boxes.at(places @ boxes.shear.T)
        return unfolded_field(
            self.scene, self.plan, places, np.vstack(cells), [(parity, rows @ u) for parity, u in parts]
        )

    def refine(self, indicators: FloatArray, excess: float) -> None:
        self.mesh.split(marked(indicators, SHARE if excess > 2 else LAST_SHARE))


def solve_on_boxes(scene: Scene, plan: Plan, with_field: bool = False) -> Solution:
    """Solve a scene whose every region is a box (or the same sheared box) on boxes that are split where it matters.

    Parameters
    ----------
    scene : Scene
    plan : Plan
        Of method "boxes".
    with_field : bool
        Also return the displacement of the whole body.

    Raises
    ------
    SolverError
        If an answer cannot be trusted.
    """
    watch = Stopwatch()
    # OpenBLAS gets products too small for two threads; MKL's factorisation keeps its own
    with ThreadpoolController().select(internal_api="openblas").limit(limits=1):
        mesh = SplitBoxes(scene, plan)
        watch.spent("mesh")
        return solve_adaptively(scene, mesh, watch, [], with_field)


def marked(indicators: FloatArray, share: float) -> np.ndarray:
    """Boxes to split along each axis, shape (n, 3): the largest indicators that hold a share of the sum.

    Fewer where that would make more than `GROWTH` times as many boxes.
    """
    order = np.argsort(-indicators, axis=None)
    running = np.cumsum(indicators.ravel()[order])
    marks = np.zeros(indicators.shape, dtype=bool)
    for place in order[: int(np.searchsorted(running, share * running[-1])) + 1]:
        marks.flat[place] = True
        if (2.0 ** marks.sum(axis=1)).sum() > GROWTH * len(indicators):
            break
    return marks


def first_mesh(scene: Scene, plan: Plan) -> BoxMesh:
    """Boxes none of which is much wider than the body's least extent, split at the faces of regions and edges of loads.

    A box is split only where such a face or edge cuts it, so none of them runs through the body.
    """
    (low, high), *inner = _solids(scene, plan)
    slack = scene.rounding_mm
    stops = [
        np.array(_apart([float(side[axis]) for solid in ((low, high), *inner) for side in solid], slack))
        for axis in range(3)
    ]
    looser = max(1.0, (scene.tolerance / 1e-3) ** LOOSER)
    widest = WIDEST * looser * min(scene.height_mm, *scene.outline.section_mm)
    while np.prod(np.ceil((high - low) / widest)) > MAX_FIRST / looser:
        widest *= 1.25
    lines = [
        np.linspace(start, end, int(np.ceil((end - start) / widest - 1e-9)) + 1)
        for start, end in zip(low, high, strict=True)
    ]
    x, y, z = (AxisTree(line, own) for line, own in zip(lines, stops, strict=True))
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


def _solids(scene: Scene, plan: Plan) -> list[tuple[FloatArray, FloatArray]]:
    """Lowest and highest corner of the body's solved part, of regions and, flat, of loads, where the base shows them.

    What lies beyond a mirror plane is folded to this side. Loads' edges a hair from a face are moved to it.
    """
    height = scene.height_mm
    shift = (
        np.array([*scene.outline.lean, 0.0]) * height
    )  # from the base, where lines are stated, to the top with its loads
    solids = []
    for prism in (scene.outline, *(prism for prism, _ in plan.regions)):
        half = np.array([*prism.section_mm, 0.0]) / 2
        base = np.array(prism.base_mm)
        solids.append((base - half, base + half + [0.0, 0.0, prism.height_mm]))
    n_lasting = len(solids)
    for x0, y0, x1, y1 in (load.rectangle for load in scene.loads):
        solids.append((np.array([x0, y0, height]) - shift, np.array([x1, y1, height]) - shift))
    for mirror in plan.mirrors:
        axis, place = mirror.axis, mirror.position_mm
        for one, two in solids:
            one[axis], two[axis] = np.sort(place + np.abs([one[axis] - place, two[axis] - place]))
        solids[0][0][axis] = place
    for axis in range(3):
        faces = np.array([side[axis] for solid in solids[:n_lasting] for side in solid])
        for load in solids[n_lasting:]:
            hair = HAIR * (load[1] - load[0])[axis]
            for side in load:
                nearest = faces[np.argmin(np.abs(faces - side[axis]))]
                if abs(nearest - side[axis]) <= hair:
                    side[axis] = nearest
    return solids


def _apart(places: list[float], slack: float) -> list[float]:
    """Places in order, without those that only rounding tells from one named before: the body's own come first."""
    kept: list[float] = []
    for place in places:
        if all(abs(place - other) > slack for other in kept):
            kept.append(place)
    return sorted(kept)


def on_lines(scene: Scene, boxes: Boxes) -> list[Load]:
    """A scene's loads, edges of plates that `first_mesh` moved by a hair moved as well."""
    loads: list[Load] = []
    for load in scene.loads:
        if isinstance(load, StiffLoad):
            x0, y0, x1, y1 = (
                _nearest(boxes.lines[k % 2] + boxes.lean[k % 2] * boxes.height_mm, place, HAIR * load.size_mm[k % 2])
                for k, place in enumerate(load.rectangle)
            )
            load = replace(load, center_mm=((x0 + x1) / 2, (y0 + y1) / 2), size_mm=(x1 - x0, y1 - y0))
        loads.append(load)
    return loads


def _nearest(line: FloatArray, place: float, within: float) -> float:
    """The nearest of some places if it is near enough, else the place itself."""
    nearest = float(line[np.abs(line - place).argmin()])
    return nearest if abs(nearest - place) <= within else place


def indicators(body: RubberBody, u: FloatArray, duals: FloatArray, scales: FloatArray) -> FloatArray:
    """Share of each element, along each axis, in the errors of the probes, up to a constant; shape (n_elements, 3).

    Parameters
    ----------
    body : RubberBody
        At rest.
    u : array, shape (n_nodes, 3)
        The answer.
    duals : array, shape (k, n_nodes, 3)
        Answers to unit loads on the probes.
    scales : array, shape (k,)
        Size of each probe's displacement [mm].

    Notes
    -----
    What the highest degree along an axis adds to u and to a dual, multiplied as strain energies are: the order of the
    displacement by μ |∂u|², the highest of the pressure by p²/μ. Without the pressure the estimate at a loaded corner,
    ν = 0.4999, was 0.8 times the error, with it 1.3 times.
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
    found = np.empty((len(boxes.nodes), 3))
    for d in range(3):
        top = np.abs(np.tensordot(to_highest, lattice, (0, 2 + d)))
        energy = np.einsum("jk,ejka,cejka->ec", across, top[0], top[1:], optimize=True)
        size = (pull[d] ** 2).sum() * mu * body.scale[d] ** 2 * body.jacobian * order * n
        found[:, d] = size * (energy @ (1 / scales))
    along = np.einsum("jkn,cena->cejka", reference.divergence, values, optimize=True)
    divergence = np.einsum("ja,je,cejka->cek", pull, body.scale, along, optimize=True)
    products = np.einsum("ek,cek,c->ek", np.abs(divergence[0]), np.abs(divergence[1:]), 1 / scales)
    highest = reference.degrees == reference.degrees.max()
    toward = highest / highest.sum(axis=1, keepdims=True).clip(1)
    return found + DIVERGENCE_WEIGHT * (lame**2 / mu * body.jacobian)[:, None] * (products @ toward)
