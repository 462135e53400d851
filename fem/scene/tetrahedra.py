"""A scene on tetrahedra: one coarse mesh, bisected where the probes need it.

Bisection keeps every plane face and outline exact and never meshes anew, so the chance of the mesher is in the first
mesh only and the answers of successive meshes differ by their errors alone.

Indicators say how far an answer u misses equilibrium in each element. Its residual is what the stress leaves
unbalanced: div σ inside the elements, jumps of the traction σ·n across their faces, traction missing on the surface,
and div u − p/λ in the mixed form. The error of a probe is at most a constant times the sum over the elements of the
product of two such residuals: of the answer, and of the answer to a unit load on the probe (`fem.levels`).
"""

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from skfem import MeshTet
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTri

from fem.kernel.elements import taylor_hood
from fem.kernel.factor import checked_solve
from fem.kernel.field import Field, rows_at
from fem.kernel.loads import FollowerLoad, at_rest
from fem.kernel.newton import Equilibrium, find_equilibrium
from fem.kernel.reference import IntArray, tabulated
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from fem.kernel.top import Top
from fem.levels import largest_contributors, limits, sizes, unit_loads
from fem.meshes.tetrahedra import Tetrahedra, bisected, cell_sizes, coarse_edge_mm, graded, mesh_body, prism_of_cells
from fem.scene.scene import Region, Scene
from fem.scene.solution import MeshAnswer, Stopwatch
from geometry.layout import FloatArray
from geometry.prism import Prism

MAX_UNKNOWNS = 400_000  #: no finer mesh is tried: its factor would take some 6 GB and minutes
SHARE = 0.75  #: of the indicators' sum that is refined at once: unknowns grow about 1.7 times
LAST_SHARE = 0.65  #: the same, where little is missing
MIN_MARKED = 0.12  #: of all elements: few hold the share where rubbers differ 100 times, and the mesh would hardly grow
MIN_MESHES = 3  #: before an estimate is believed
EDGES_ACROSS_PATCH = 1.5  #: edges across every load and probe before the first solve, at least
MAX_PROBES, N_SUMS = 4, 12  #: probes that have unit loads of their own; of more, sums with random signs
SAFETY = 2.0  #: deviations that the error is stated as
CUT_ORDER = 8  #: of integration on loaded faces, which loads' edges may cut
LEVELS, RATIO = 3, 0.25  #: of the grading to edges of plates, and of neighbouring distances
#: of regular tetrahedra: edge of the cube of six times the volume, over the inradius; root of a facet's area, over
#: inradius² · area / volume
OF_CELL, OF_FACET = 4.364, 4.298
NOWHERE = np.empty((0, 4))


class AdaptedTetrahedra:
    """A scene on Taylor-Hood tetrahedra; `regions` are those that need one of their own.

    `rectangles` (k, 4) of the top face are to be resolved beside those of loads and probes. The coarse mesh is
    `mesh_scene`'s unless another is given. At finite strain it is refined where the answer at small strain errs: the
    sum of that one's indicators is what the errors are taken to be proportional to.
    """

    equilibrium: Equilibrium | None = None  #: on the last mesh, at finite strain

    def __init__(
        self,
        scene: Scene,
        regions: Sequence[Region],
        rectangles: FloatArray = NOWHERE,
        given: MeshTet | None = None,
    ) -> None:
        self.scene = scene
        self.prisms = [prism for prism, _ in regions]
        mesh, self.is_kept = mesh_scene(scene, self.prisms) if given is None else (given, True)
        self._coarse = mesh
        narrow = [scene.load_rectangles_mm, scene.plate_rectangles_mm, scene.probe_rectangles_mm, rectangles]
        self.mesh = with_edges_across(mesh, np.vstack(narrow))
        if scene.is_linear:  # strains are so large there that boxes so thin would give way
            self.mesh = graded_to_plates(self.mesh, scene.plate_rectangles_mm, scene.rounding_mm)
        self._body: Rubber | None = None
        self.history: list[tuple[FloatArray, FloatArray]] = []  #: answers of every mesh, and sums of their indicators
        self._error = np.inf
        #: the different rubbers, the body's first
        self.materials = list(dict.fromkeys([scene.material, *(material for _, material in regions)]))
        self._material_of = np.array([0, *(self.materials.index(material) for _, material in regions)])

    def __str__(self) -> str:
        return f"{self.mesh.nelements} tetrahedra"

    def error(self) -> float:
        return self._error

    def _towards(self, values: FloatArray, eta: FloatArray) -> FloatArray:
        """The best answers after another mesh's (n, 3), the probes' first, and their η: of linear bodies the limits.

        At finite strain it stays that mesh's, in error by what the limit is off, too.
        """
        self.history.append((values, eta))
        if len(self.history) < MIN_MESHES:
            return values
        limit, deviation = limits(*np.array(self.history).swapaxes(0, 1))
        found = limit if self.scene.is_linear else values
        error = np.linalg.norm(limit - found, axis=1) + SAFETY * deviation
        self._error = float((error[:-1] / sizes(found[:-1])).max())
        return found

    def limit(self, unknowns: int) -> str | None:
        return f"{MAX_UNKNOWNS} unknowns" if unknowns >= MAX_UNKNOWNS else None

    def refine(self, indicators: FloatArray, excess: float) -> None:
        least = int(MIN_MARKED * self.mesh.nelements)
        marked = largest_contributors(indicators, SHARE if excess > 1.5 else LAST_SHARE)
        self._body = None
        self.mesh = bisected(self.mesh, marked if len(marked) > least else np.argsort(-indicators)[:least])

    @property
    def body(self) -> Rubber:
        """The body on the mesh as it is."""
        if self._body is None:
            region = self._material_of[prism_of_cells(self.mesh, self.prisms, self._coarse)]
            self._body = Rubber.of(self.mesh, taylor_hood(), self.materials, region)
        return self._body

    def probe_rows(self) -> sp.csr_matrix:
        """Rows that take one component of all nodes to that component of every probe, (n_probes, n_nodes)."""
        scene, body = self.scene, self.body
        seen, points = scene.probe_rectangles_mm, scene.probe_points_mm
        rows: dict[str, list[sp.csr_matrix]] = {"mean": [], "point": []}
        if len(seen):
            areas = (seen[:, 2:] - seen[:, :2]).prod(axis=1)
            rows["mean"] = list(sp.csr_matrix(sp.diags_array(1 / areas) @ Top(body.basis).integrals(seen, whole=True)))
        if len(points):
            rows["point"] = list(rows_at(body, *Tetrahedra(self.mesh).located(points)))
        return sp.vstack([rows[probe.kind].pop(0) for probe in scene.probes], format="csr")

    def solve(self, watch: Stopwatch) -> MeshAnswer:
        scene, body = self.scene, self.body
        system = System(body, at_rest(scene.loads))
        rows, matrix = self.probe_rows(), system.rest_matrix()
        watch.spent("assemble")
        factor = system.new_factor()
        factor.factor(matrix)
        watch.spent("factor")

        forces = system.full_loads
        x, residual = checked_solve(factor, forces)
        u = system.displaced(x)[0]
        probes = np.asarray(rows @ u)
        weights = unit_loads(probes, MAX_PROBES, N_SUMS)
        y, dual_residual = checked_solve(factor, system.rest_loads(np.stack([rows.T @ weight for weight in weights])))
        z = system.displaced(y)
        watch.spent("solve")

        n, plates = system.n_mixed, scene.plate_rectangles_mm
        loaded, seen = scene.load_rectangles_mm, scene.probe_rectangles_mm
        areas_mm2 = (seen[:, 2:] - seen[:, :2]).prod(axis=1)[:, None]
        shapes = weights[:, [probe.kind == "mean" for probe in scene.probes]] / areas_mm2
        of_answer = residuals(body, u, x[-n:, 0], loaded, scene.tractions_mpa, plates)
        of_duals = [
            residuals(body, own, pressure, seen, tractions, plates)
            for own, pressure, tractions in zip(z, y[-n:].T, shapes, strict=True)
        ]
        watch.spent("assemble")
        indicators = np.sqrt(of_answer * of_duals)
        energy_mj, residual = 0.5 * float(forces[:, 0] @ x[:, 0]), max(residual, dual_residual)
        if not scene.is_linear:
            self.equilibrium = found = find_equilibrium(System(body, scene.loads))
            watch.spent("solve")
            u, energy_mj, residual = found.state.u, found.stored_mj, found.residual
            probes = np.asarray(rows @ u)
        of_each = indicators.sum(axis=1)
        eta = of_each.reshape(probes.shape) if len(of_each) == probes.size else np.full(probes.shape, of_each.mean())
        limit = self._towards(np.vstack([probes, [energy_mj, 0.0, 0.0]]), np.vstack([eta, np.full(3, of_answer.sum())]))
        return MeshAnswer(
            probes=limit[:-1],
            energy_mj=float(limit[-1, 0]),
            residual=residual,
            unknowns=matrix.shape[0],
            indicators=indicators.sum(axis=0),
            field=lambda: Field(places=Tetrahedra(body.basis.mesh), body=body, displacement_mm=u),
        )


def mesh_scene(scene: Scene, prisms: Sequence[Prism]) -> tuple[MeshTet, bool]:
    """A coarse mesh of a scene's body, as by `mesh_body`: stiff plates and following loads have outlines in it."""
    height, lean, depth_mm = scene.height_mm, scene.outline.lean, coarse_edge_mm(scene.outline)
    following = [load for load in scene.loads if isinstance(load, FollowerLoad) and not scene.is_linear]
    under = []  # layers of the body, under what does not cover the whole top
    for load in (*scene.stiff_loads, *following):
        depth = min(depth_mm, height / 2, *load.size_mm)
        x, y = load.center_mm
        below = (x - lean[0] * depth, y - lean[1] * depth, height - depth)
        if np.abs(np.array(load.rectangle) - scene.top_mm).max() > scene.rounding_mm:
            under.append(Prism(base_mm=below, top_mm=(x, y, height), section_mm=load.size_mm))
    return mesh_body(scene.outline, prisms, under, scene.rounding_mm)


def with_edges_across(mesh: MeshTet, rectangles: FloatArray) -> MeshTet:
    """A mesh whose elements at the edges of rectangles of the top face are not much longer than these are wide."""
    if not len(rectangles):
        return mesh
    narrow_mm = (rectangles[:, 2:] - rectangles[:, :2]).min(axis=1)
    while True:
        corners = mesh.p.T[mesh.t.T]
        at_top = corners[:, :, 2].max(axis=1) == mesh.p[2].max()
        low, high = corners[at_top].min(axis=1)[:, :2], corners[at_top].max(axis=1)[:, :2]
        size_mm = cell_sizes(mesh)[at_top]
        coarse = np.zeros(len(low), dtype=bool)
        for (x0, y0, x1, y1), width_mm in zip(rectangles, narrow_mm, strict=True):
            meets = ((high >= (x0, y0)) & (low <= (x1, y1))).all(axis=1)
            within = ((low > (x0, y0)) & (high < (x1, y1))).all(axis=1)
            coarse |= meets & ~within & (size_mm > width_mm / EDGES_ACROSS_PATCH)
        if not coarse.any():
            return mesh
        mesh = bisected(mesh, np.flatnonzero(at_top)[coarse])


def graded_to_plates(mesh: MeshTet, plates: FloatArray, slack_mm: float) -> MeshTet:
    """A mesh that shrinks towards the edges of plates (k, 4) on its top, where stress is singular."""
    while len(plates):
        x, y, z = mesh.p[:, :, None]
        low, high = plates[:, :2] - slack_mm, plates[:, 2:] + slack_mm
        within = (z == mesh.p[2].max()) & (x > low[:, 0]) & (y > low[:, 1]) & (x < high[:, 0]) & (y < high[:, 1])
        off = np.abs([x - plates[:, 0], x - plates[:, 2], y - plates[:, 1], y - plates[:, 3]])
        sides = np.moveaxis(within & (off < slack_mm), 1, 2).reshape(-1, mesh.p.shape[1])  # points on each side
        one, other = sides[:, mesh.edges[0]], sides[:, mesh.edges[1]]
        chords = one.any(axis=0) & other.any(axis=0) & ~(one & other).any(axis=0)
        if not chords.any():
            return graded(mesh, sides.any(axis=0), LEVELS, RATIO)
        mesh = bisected(mesh, np.flatnonzero(chords[mesh.t2e].any(axis=0)))
    return mesh


def residuals(
    body: Rubber,
    u: FloatArray,
    pressure: FloatArray,
    rectangles: FloatArray,
    tractions_mpa: FloatArray,
    plates: FloatArray,
) -> FloatArray:
    """Squared residual of an answer in each element, in units of energy, (m,) [N mm].

    The answer is u (n_nodes, 3) [mm] and pressures (n_pressures,) [MPa], under uniform tractions (n, 3) on
    rectangles (n, 4) of the top face, which add up where they overlap. Rectangles (k, 4) of stiff `plates` have
    tractions that nobody knows.
    """
    mesh = body.basis.mesh
    points, cells = mesh.p.T, mesh.t.T
    slopes = tabulated(body.basis.elem, body.basis.elem.doflocs[:4].T)[1]
    gradient = np.einsum("eni,mnv,emj->evij", u[body.nodes], slopes, body.pull[:, 0], optimize=True)  # at corners
    divergence = np.trace(gradient, axis1=2, axis2=3)
    p, lame_mpa, mu_mpa = pressure[body.pressure_dofs], body.law.lame_mpa[:, 0], body.law.mu_mpa[:, 0]
    stress = mu_mpa[:, None, None, None] * (gradient + gradient.swapaxes(2, 3))
    for i in range(3):
        stress[..., i, i] += p

    corners = points[cells]
    volumes = body.dx.sum(axis=1)
    facets, sides = mesh.facets.T, mesh.f2t
    triangles = points[facets]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = np.linalg.norm(normal, axis=1) / 2
    normal /= 2 * areas[:, None]
    inradius = 3 * volumes / areas[mesh.t2f].sum(axis=0)

    def reach(element: IntArray, facet: IntArray) -> FloatArray:
        """Length over which an element takes up what is missing on one of its facets; sqrt(area) of a regular one."""
        return OF_FACET * inradius[element] ** 2 * areas[facet] / volumes[element]

    unbalanced = np.einsum("evij,evj->ei", stress[:, 1:] - stress[:, :1], body.pull[:, 0])
    squared: FloatArray = (OF_CELL * inradius) ** 2 * volumes * (unbalanced**2).sum(axis=1) / mu_mpa
    squared += mu_mpa * _integral_of_square((divergence - p / lame_mpa[:, None])[..., None], volumes)

    def tractions(side: int, chosen: IntArray) -> FloatArray:
        """σ·n at the corners of facets, from the elements on one side, shape (k, 3, 3)."""
        element = sides[side, chosen]
        corner = (cells[element][:, None, :] == facets[chosen][:, :, None]).argmax(axis=2)
        return np.einsum("fvij,fj->fvi", stress[element[:, None], corner], normal[chosen])

    inner = np.flatnonzero(sides[1] >= 0)
    jump = _integral_of_square(tractions(0, inner) - tractions(1, inner), areas[inner])
    for side in (0, 1):
        element = sides[side, inner]
        squared += np.bincount(element, 0.5 * reach(element, inner) * jump / mu_mpa[element], len(cells))

    outer = np.flatnonzero((sides[1] < 0) & (triangles[..., 2] != 0.0).any(axis=1))
    element = sides[0, outer]
    outward = triangles[outer].mean(axis=1) - corners[element].mean(axis=1)
    missing = tractions(0, outer) * np.sign((outward * normal[outer]).sum(axis=1))[:, None, None]
    misfit = _integral_of_square(missing, areas[outer])
    top = (triangles[outer][..., 2] == points[:, 2].max()).all(axis=1)
    if len(rectangles):
        at, rule = get_quadrature(RefTri, CUT_ORDER)
        shares = np.stack([1 - at.sum(axis=0), *at], axis=1)
        places, found = (np.einsum("qv,fvi->fqi", shares, corner[top]) for corner in (triangles[outer], missing))
        off = ((found - _tractions_at(places, rectangles, tractions_mpa)) ** 2).sum(axis=2)
        misfit[top] = 2 * (off @ rule) * areas[outer][top]
    middle = triangles[outer].mean(axis=1)
    for x0, y0, x1, y1 in plates:
        misfit[top & ((middle[:, :2] > (x0, y0)) & (middle[:, :2] < (x1, y1))).all(axis=1)] = 0.0
    return squared + np.bincount(element, reach(element, outer) * misfit / mu_mpa[element], len(cells))


def _tractions_at(points: FloatArray, rectangles: FloatArray, tractions_mpa: FloatArray) -> FloatArray:
    """The sum of uniform loads on rectangles at points (..., 3) of the top face, of the same shape [MPa]."""
    total = np.zeros(points.shape)
    x, y = points[..., 0], points[..., 1]
    for (x0, y0, x1, y1), value in zip(rectangles, tractions_mpa, strict=True):
        total[(x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)] += value
    return total


def _integral_of_square(values: FloatArray, measures: FloatArray) -> FloatArray:
    """∫ |v|² over simplices, exact for linear v with values (n, d + 1, k) at the corners."""
    corners = values.shape[1]
    total = (values**2).sum(axis=(1, 2)) + (values.sum(axis=1) ** 2).sum(axis=1)
    return measures / (corners * (corners + 1)) * total
