"""Scenes of boxes of any contrast, ν, shear and slenderness: few hexahedra of high order, split where needed.

The first mesh has a line at every edge of body, regions and loads, and little else; lines lean with the faces of
oblique regions. A mesh is solved with order 3 and with order 4. The latter tells which boxes the errors of the probes
come from, and along which axis; those are split, the others stay. The matrix is factored, so neither moduli far apart
nor ν near 0.5 cost more than anything else.

What the highest degree along an axis adds to an answer u_h, and to the answer z_h to a unit load on a probe, stands for
both their errors in a box: the error of a probe is a(u − u_h, z − z_h) (Becker & Rannacher, Acta Numerica 10, 2001),
and the sum of the products over all boxes and axes is the probe's indicator η. With the change from one order to the
other it gives the error that is stated (`fem.levels.estimated_errors`).
"""

import math
from copy import copy
from dataclasses import replace
from itertools import pairwise

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre

from common.threads import one_blas_thread
from fem.kernel.elements import Basis, HexQ, Pressure, hexahedra, lobatto_points
from fem.kernel.factor import Factor, checked_solve
from fem.kernel.field import unfolded
from fem.kernel.loads import Load, StiffLoad
from fem.kernel.mirrors import parities
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from fem.levels import estimated_errors, largest_contributors, unit_loads
from fem.meshes.boxes import AxisTree, BoxMesh, hanging
from fem.meshes.leaning import Leaning, apart
from fem.methods.adaptive import solve_adaptively
from fem.methods.plan import Plan
from fem.scene.probes import probe_rows
from fem.scene.scene import Scene, regions_at
from fem.scene.solution import MeshAnswer, Solution, Stopwatch
from geometry.law import LAWS
from geometry.layout import FloatArray

ORDERS = 3, 4  #: of the two answers on a mesh; at 0.1 % order 3 takes two to five times the unknowns of 4
MAX_FIRST = 45  #: first boxes, before any is split; where there would be more, they are wider than the body is thin
ON_FACE = 1e-3  #: of a load's width: an edge so near a body's or region's face gets no line; the load stays exact
SMALL = 0.2  #: of the first boxes' width: smaller loads and probes lie in shells of boxes
SHELL_RATIO = 4.0  #: of the margins of neighbouring shells
NEAR = 0.35  #: of a shell's margin: a face or edge so near is taken for the shell's
MAX_BOXES = 1000  #: beyond, more than 4 GB of memory are needed
SHARES = 0.4, 0.85  #: least and greatest part of the indicators' sum that is split at once; 0.7 took a mesh more
TAKEN = 0.85  #: of the indicators of split boxes, what their splitting takes away
AIM = 0.85  #: fraction of the tolerance at which splitting aims: what it takes varies
MAX_GROWTH = 2.5  #: of the number of boxes from mesh to mesh
MAX_PROBES = 20  #: that have unit loads of their own; of more, `N_SUMS` sums with random signs
N_SUMS = 24
SHEARED = 0.5  #: by which indicators are raised, times the square of the lean: errors of sheared boxes were 2.3 times η
PRESSURE_WEIGHT = 0.05  #: of pressures beside shear strains; with 0.25 meshes of ν near 0.5 had 10 % more unknowns


class SplitBoxes:
    """A scene on boxes, folded at the mirror planes in which all loads are even, or all odd.

    Loads that are neither need every box refined where their images are, or several factors: neither was faster.
    """

    def __init__(self, scene: Scene, plan: Plan) -> None:
        self.mirrors = tuple(mirror for mirror in plan.mirrors if len(mirror.parities) == 1)
        self.scene, self.plan, self.order = with_plates_on_faces(scene, plan), plan, ORDERS[0]
        self.mesh = first_mesh(scene, replace(plan, mirrors=self.mirrors))
        self.coarser: FloatArray | None = None  #: probes (n_probes, 3) by the order before on the same mesh, if any
        self._error, self._is_split = np.inf, False

    def __str__(self) -> str:
        return f"{len(self.mesh.boxes)} boxes of order {self.order}"

    def limit(self, unknowns: int) -> str | None:
        return f"{MAX_BOXES} boxes" if len(self.mesh.boxes) >= MAX_BOXES else None

    def error(self) -> float:
        return self._error

    def refine(self, indicators: FloatArray, excess: float) -> None:
        if self.order < ORDERS[-1]:
            self.order = ORDERS[-1]
        else:
            self.mesh.split(marked(indicators, float(np.clip((1 - AIM / excess) / TAKEN, *SHARES))))
            self.coarser, self._is_split = None, True

    def body(self, order: int) -> Rubber:
        """The boxes as they are, filled with their rubbers."""
        mesh, pair = self.mesh.mesh, hexahedra(order)
        low, high = self.mesh.corners
        region = regions_at(self.mesh.leaning.placed((low + high) / 2), self.plan.regions)
        materials = [self.scene.material, *(material for _, material in self.plan.regions)]
        shares = (region == np.arange(len(materials))[:, None])[..., None].astype(float)
        basis = Basis(mesh, pair[0])
        body = Rubber(basis, pair[1], LAWS["linear"].of(materials, shares), region)
        return body.with_hanging_nodes(hanging(self.mesh, mesh, basis.dofs, pair[0]))

    def solve(self, watch: Stopwatch) -> MeshAnswer:
        if self.order > ORDERS[0] and self.coarser is None:
            self.coarser = _Solved(self, ORDERS[0], watch).probes
        solved = _Solved(self, self.order, watch)
        system, u, probes = solved.system, solved.u, solved.probes
        weights = unit_loads(probes, MAX_PROBES, N_SUMS)
        duals, _ = checked_solve(solved.factor, system.rest_loads(_forces(solved.rows, weights)))
        lean = self.mesh.leaning.leans_at(np.mean(self.mesh.corners, axis=0))
        found = surplus(system.body, u, system.displaced(duals)) * (1 + SHEARED * (lean**2).sum(axis=1))[:, None, None]
        eta, is_suited = _of_probes(found, len(probes)), self._is_split and not self.mesh.leaning.bends
        self._error = float(estimated_errors(probes, eta, self.coarser, is_suited).max())
        self.coarser = probes
        watch.spent("solve")
        mesh = copy(self.mesh)
        return MeshAnswer(
            probes=probes,
            energy_mj=system.copies * float((system.full_loads * solved.y).sum()) / 2,
            residual=solved.residual,
            unknowns=system.n_unknowns,
            indicators=found.sum(axis=2),
            field=lambda: unfolded(mesh, system.body, self.mirrors, [(system.parity, u)]),
        )


class _Solved:
    """The scene's answer by one order on the mesh as it is."""

    def __init__(self, boxes: SplitBoxes, order: int, watch: Stopwatch) -> None:
        (parity,) = parities(boxes.mirrors)
        self.system = System(boxes.body(order), boxes.scene.loads, boxes.mirrors, parity)
        matrix = self.system.rest_matrix()
        watch.spent("assemble")
        self.factor = Factor(matrix, definite=True, upper=True, by_degree=True)
        watch.spent("factor")
        self.y, self.residual = checked_solve(self.factor, self.system.full_loads)
        self.u = self.system.displaced(self.y)[0]
        self.rows = [probe_rows(probe, boxes.mesh, self.system) for probe in boxes.scene.probes]
        self.probes = np.array([(signs * (own @ self.u)).sum(axis=0) for own, signs in self.rows])
        watch.spent("solve")


@one_blas_thread()  # OpenBLAS gets products too small for two; MKL's factorisation keeps its own
def solve_on_boxes(scene: Scene, plan: Plan, with_field: bool = False) -> Solution:
    """Solve a scene along whose regions lines can lean, as `solve_adaptively`.

    A `SolverError` says that an answer cannot be trusted.
    """
    watch = Stopwatch()
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
    leaning, slack = leaning_lines(scene, plan), scene.rounding_mm
    (low, high), *inner = _solids(scene, plan, leaning)
    kinks = [
        [place for place in leaning.kinks(axis).tolist() if low[axis] + slack < place < high[axis] - slack]
        for axis in range(3)
    ]
    stops = [
        np.array(apart([low[axis], high[axis], *kinks[axis], *(side[axis] for one in inner for side in one)], slack))
        for axis in range(3)
    ]

    def divided(widest: float) -> list[FloatArray]:
        """Lines along each axis, at the kinks and between them no further apart than `widest`."""
        lines = []
        for start, end, bends in zip(low, high, kinks, strict=True):
            ends = pairwise([start, *sorted(bends), end])
            parts = [np.linspace(a, b, int(np.ceil((b - a) / widest - 1e-9)) + 1)[1:] for a, b in ends]
            lines.append(np.concatenate([[start], *parts]))
        return lines

    widest, fewest = min(scene.height_mm, *scene.outline.section_mm), math.prod(len(bends) + 1 for bends in kinks)
    while math.prod(len(line) - 1 for line in divided(widest)) > max(MAX_FIRST, fewest):
        widest *= 1.25
    lines = divided(widest)
    known = [[*own, *line] for own, line in zip(stops, lines, strict=True)]
    shells = _shells(_patches(scene, plan, leaning), stops, known, widest, slack)
    inner += [shell for shell, _ in shells]
    around = [{float(side[axis]): margin for shell, margin in shells for side in shell} for axis in range(3)]
    x, y, z = (AxisTree(line, own, shell) for line, own, shell in zip(lines, stops, around, strict=True))
    mesh = BoxMesh((x, y, z), leaning)
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


def leaning_lines(scene: Scene, plan: Plan) -> Leaning:
    """The lines along the faces of the body and of the plan's regions."""
    found = Leaning.of(scene.outline, [prism for prism, _ in plan.regions], scene.rounding_mm)
    assert found is not None  # or the plan had not chosen boxes
    return found


def _patches(scene: Scene, plan: Plan, leaning: Leaning) -> list[Solid]:
    """Rectangles of loads and probes on the top of the body's solved part."""
    rectangles = [load.rectangle for load in scene.loads] + [probe.rectangle for probe in scene.mean_probes]
    height = scene.height_mm
    patches = []
    for x0, y0, x1, y1 in rectangles:
        low, high = leaning.starts(np.array([[x0, y0, height], [x1, y1, height]]))
        _fold(low, high, plan)
        patches.append((low, high))
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


def _solids(scene: Scene, plan: Plan, leaning: Leaning) -> list[Solid]:
    """Corners of the body's solved part, of regions and, flat, of loads.

    What lies beyond a mirror plane is folded to this side. Loads' edges next to a face are moved to it.
    """
    solids = []
    for prism in (scene.outline, *(prism for prism, _ in plan.regions)):
        half = np.array([*prism.section_mm, 0.0]) / 2
        low, high = leaning.starts(np.array([prism.base_mm - half, prism.base_mm + half]))
        high[2] = prism.top_mm[2]
        solids.append((low, high))
        _fold(*solids[-1], plan)
    n_lasting = len(solids)
    solids += _patches(scene, plan, leaning)[: len(scene.loads)]
    for axis in range(3):
        faces = np.array([side[axis] for solid in solids[:n_lasting] for side in solid])
        for load in solids[n_lasting:]:
            within = ON_FACE * (load[1] - load[0])[axis]
            for side in load:
                side[axis] = _nearest(faces, side[axis], within)
    return solids


def with_plates_on_faces(scene: Scene, plan: Plan) -> Scene:
    """The scene with edges of plates that lie next to a face moved to it, where their lines are."""
    lines = leaning_lines(scene, plan).lines_mm

    def moved(load: Load) -> Load:
        if not isinstance(load, StiffLoad):
            return load
        ends = [
            _nearest(lines[k % 2][:, -1], place, ON_FACE * load.size_mm[k % 2])
            for k, place in enumerate(load.rectangle)
        ]
        return load.image(np.array(ends), np.ones(3), np.ones(3))

    return replace(scene, loads=tuple(moved(load) for load in scene.loads))


def _nearest(line: FloatArray, place: float, within: float) -> float:
    """The nearest of some places if it is near enough, else the place itself."""
    nearest = float(line[np.abs(line - place).argmin()])
    return nearest if abs(nearest - place) <= within else place


# probes, and the errors of these


def _forces(rows: list[tuple[sp.csr_matrix, FloatArray]], weights: FloatArray) -> FloatArray:
    """Nodal forces (k, n_nodes, 3) that do weights (k, n_probes, 3) times the displacements of probes as work."""
    n = rows[0][0].shape[1]
    forces = np.zeros((len(weights), n, 3))
    for number, (own, signs) in enumerate(rows):
        signed = np.einsum("ri,ki->rki", signs, weights[:, number]).reshape(len(signs), -1)
        forces += (own.T @ signed).reshape(n, -1, 3).swapaxes(0, 1)
    return forces


def _of_probes(surplus: FloatArray, n_probes: int) -> FloatArray:
    """η of each probe, (n_probes,), from the `surplus` of the `unit_loads`; of sums, one bound for all."""
    if n_probes <= MAX_PROBES:
        return np.linalg.norm(surplus.sum(axis=(0, 1)).reshape(n_probes, 3), axis=1)
    return np.full(n_probes, np.sqrt((surplus**2).mean(axis=2)).sum())


def surplus(body: Rubber, u: FloatArray, duals: FloatArray) -> FloatArray:
    """Products of what the highest degrees add to an answer and to others, by element and local axis, (e, 3, k).

    The answer is u (n_nodes, 3) of a body at rest, `duals` (k, n_nodes, 3) are answers to unit loads on the probes.
    They are multiplied as strain energies are: the order of the displacement by μ |∂u|², the highest of the pressure by
    p²/μ. Without the pressure the estimate at a loaded corner, ν = 0.4999, was 0.8 times the error.
    """
    elem, pressure, table = body.basis.elem, body.pressure, body.reference
    assert isinstance(elem, HexQ)
    assert isinstance(pressure, Pressure)
    order, n = elem.maxdeg, elem.maxdeg + 1
    lattice = np.empty((n, n, n), dtype=np.int64)
    lattice[tuple(elem.places.T)] = np.arange(n**3)
    lumped = 2 / (order * n * legendre.legval(lobatto_points(order), np.eye(n)[order]) ** 2)
    across, to_highest = np.multiply.outer(lumped, lumped), elem.to_legendre[order]
    lame, mu = body.law.lame_mpa[:, 0], body.law.mu_mpa[:, 0]
    pull, volume = body.pull.mean(axis=1), body.dx.sum(axis=1)
    values = np.concatenate([u[None], duals])
    own = values[:, body.nodes[:, lattice.ravel()]].reshape(len(values), body.n_elements, n, n, n, 3)
    found = np.empty((body.n_elements, 3, len(duals)))
    for d in range(3):
        top = np.abs(np.tensordot(to_highest, own, (0, 2 + d)))
        energy = np.einsum("jk,ejka,cejka->ec", across, top[0], top[1:], optimize=True)
        found[:, d] = ((pull[:, d] ** 2).sum(axis=1) * mu * volume * order * n / 2)[:, None] * energy
    highest = pressure.degrees.sum(axis=1) == pressure.maxdeg
    shown = table.pressures[:, highest] / np.sqrt(table.weights @ table.pressures[:, highest] ** 2)
    pressing = body.integrated_slopes(shown) / volume[:, None, None, None]  # (e, 3, n, highest)
    theta = np.einsum("ceni,einh->ceh", values[:, body.nodes], pressing, optimize=True)
    moments, toward = np.abs(theta), pressure.degrees[highest] / max(pressure.maxdeg, 1)
    of_pressures = np.einsum("eh,ceh,hd->edc", moments[0], moments[1:], toward, optimize=True)
    found += (PRESSURE_WEIGHT * lame**2 / mu * volume)[:, None, None] * of_pressures
    return found
