"""Scenes of boxes of any contrast, ν, shear and slenderness: few boxes of order 4 or 3, split where needed.

The first mesh has a line at every edge of body, regions and loads, and little else. Each solve tells which boxes the
errors of the probes come from, and along which axis; those are split, the others stay. The matrix is factored, so
neither moduli far apart nor ν near 0.5 cost more than anything else.
"""

from dataclasses import replace

import numpy as np
from threadpoolctl import ThreadpoolController

from fem.discretization.box_mesh import AxisTree, BoxMesh
from fem.discretization.box_system import BoxSystem, Condensed, Kind
from fem.discretization.grid import lattice_boxes
from fem.discretization.indicator import dual_weights
from fem.discretization.plate import tied
from fem.factor import Factor, checked_solve
from fem.methods.adaptive import MeshAnswer, solve_adaptively
from fem.methods.box_field import crossings, picture_lines, unfolded_field
from fem.methods.plan import Plan
from fem.scene.scene import Scene
from fem.scene.solution import Field, Solution, Stopwatch
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
GROWTH = 2.5  #: of the number of boxes, at most, from mesh to mesh


class SplitBoxes:
    """A scene on boxes; of the plan's mirrors those with one parity are used."""

    min_meshes = 2

    def __init__(self, scene: Scene, plan: Plan) -> None:
        mirrors = tuple(mirror for mirror in plan.mirrors if len(mirror.parities) == 1)
        self.scene, self.plan = scene, replace(plan, mirrors=mirrors)
        self.mesh = first_mesh(scene, self.plan)
        self.order = LOOSE_ORDER if scene.tolerance >= LOOSE else ORDER
        self._condensed: dict[Kind, Condensed] = {}

    def __str__(self) -> str:
        return f"{len(self.mesh.boxes)} boxes of order {self.order}"

    def is_trusted(self) -> bool:
        return len(self.mesh.boxes) >= MIN_BOXES

    def limit(self, unknowns: int) -> str | None:
        return f"{MAX_BOXES} boxes" if len(self.mesh.boxes) >= MAX_BOXES else None

    def solve(self, watch: Stopwatch) -> MeshAnswer:
        system = BoxSystem(self.scene, self.plan.regions, self.plan.mirrors, self.mesh, self._condensed, self.order)
        plates = system.plates() if len(self.scene.plate_rectangles_mm) else []
        T = tied(system.n_unknowns, plates)
        matrix = (T.T @ system.matrix @ T).tocsr() if plates else system.matrix
        forces, rows = system.loads(), system.probe_rows()
        watch.spent("assemble")
        factor = Factor(matrix, definite=True)
        watch.spent("factor")
        x, residual = checked_solve(factor, T.T @ forces[:, None])
        u = (T @ x)[:, 0]
        probes = rows @ u
        weights, scales = dual_weights(probes)
        unit = np.tensordot(weights, rows, ((1, 2), (0, 1))).T
        x, _ = checked_solve(factor, np.ascontiguousarray(T.T @ unit))
        duals = T @ x
        del factor
        indicators = system.indicators(u, duals, scales)
        watch.spent("solve")
        return MeshAnswer(
            probes=probes,
            energy_mj=float(forces @ u) / 2 / system.share,
            residual=residual,
            unknowns=system.n_unknowns,
            indicators=indicators,
            field=lambda: _field(self.scene, self.plan, system, u),
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


def _field(scene: Scene, plan: Plan, system: BoxSystem, u: FloatArray) -> Field:
    """Displacement of the whole body on quadratic boxes, the wide ones split."""
    points, cells, moved, count = [], [], [], 0
    for element, (low, high) in enumerate(zip(system.low, system.high, strict=True)):
        halves, own = lattice_boxes([picture_lines(scene, np.array(ends)) for ends in zip(low, high, strict=True)])
        at = crossings(halves)
        points.append(at)
        cells.append(own + count)
        moved.append(system.at(element, at, u))
        count += len(at)
    return unfolded_field(scene, plan, np.vstack(points), np.vstack(cells), [(system.parity, np.vstack(moved))])
