"""A scene on tetrahedra: one coarse mesh, bisected where the probes need it.

Bisection keeps every plane face and outline exact and never meshes anew, so the chance of the mesher is in the first
mesh only and the answers of successive meshes differ by their errors alone.
"""

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from skfem import Basis, MeshTet

from fem.factor import Factor, checked_solve
from fem.field import Field
from fem.levels import SAFETY
from fem.scene.scene import Region, Scene
from fem.scene.solution import MeshAnswer, Stopwatch, relative_errors
from fem.tetrahedra.elements import Elements
from fem.tetrahedra.indicator import (
    cell_sizes,
    dual_weights,
    largest_contributors,
    probe_indicators,
    residuals,
)
from fem.tetrahedra.mixed import TaylorHood, taylor_hood
from fem.tetrahedra.patch import bonded, patch_integrals
from fem.tetrahedra.scene_mesh import bisected, mesh_scene, prism_of_cells
from geometry.layout import FloatArray

MAX_UNKNOWNS = 400_000  #: no finer mesh is tried: its factor would take some 6 GB and minutes
SHARE = 0.75  #: of the indicators' sum that is refined at once: unknowns grow about 1.7 times
LAST_SHARE = 0.65  #: the same, where little is missing
MIN_MARKED = 0.12  #: of all elements: few hold the share where rubbers differ 100 times, and the mesh would hardly grow
MIN_MESHES = 3  #: before an estimate by indicators is believed
EDGES_ACROSS_PATCH = 1.5  #: edges across every load and probe before the first solve, at least
NOWHERE = np.empty((0, 4))


def errors_by_indicators(names: Sequence[str], history: Sequence[tuple[float, FloatArray]]) -> dict[str, float]:
    """Relative error of each probe on the last of several adapted meshes, infinite with fewer than `MIN_MESHES`.

    `history` holds, for every mesh, the sum of its indicators and its probes, shape (n_probes, 3) [mm].

    Notes
    -----
    The error of a probe is close to proportional to the sum η of its indicators: J(η) = J₀ + C η, with C unknown but
    changing little from mesh to mesh. The line through the last two meshes and the one fitted to the last three each
    give |C| η; the larger is taken, times `SAFETY`.
    """
    if len(history) < MIN_MESHES:
        return dict.fromkeys(names, np.inf)
    eta = np.array([indicated for indicated, _ in history[-3:]])
    J = np.array([probes for _, probes in history[-3:]])  # (3, n_probes, 3)
    if eta[-1] == 0.0:
        return dict.fromkeys(names, 0.0)
    fitted = np.tensordot(eta - eta.mean(), J, axes=1) / ((eta - eta.mean()) ** 2).sum()
    between = (J[-1] - J[-2]) / (eta[-1] - eta[-2])
    answer = dict(zip(names, J[-1], strict=True))
    estimates = [relative_errors(dict(zip(names, slope * eta[-1], strict=True)), answer) for slope in (fitted, between)]
    return {name: SAFETY * max(estimate[name] for estimate in estimates) for name in names}


class AdaptedTetrahedra:
    """A scene on Taylor-Hood tetrahedra.

    Parameters
    ----------
    scene : Scene
    regions : sequence of (Prism, Material)
        Those that need a region of their own.
    rectangles : array, shape (k, 4), optional
        More rectangles of the top face that the mesh is to resolve, beside those of loads and probes.
    """

    def __init__(self, scene: Scene, regions: Sequence[Region], rectangles: FloatArray = NOWHERE) -> None:
        self.scene = scene
        self.prisms = [prism for prism, _ in regions]
        mesh, self.is_kept = mesh_scene(scene, self.prisms)
        narrow = [scene.load_rectangles_mm, scene.plate_rectangles_mm, scene.probe_rectangles_mm, rectangles]
        self.mesh = with_edges_across(mesh, np.vstack(narrow))
        self._body: TaylorHood | None = None
        self.history: list[tuple[float, FloatArray]] = []  #: sum of indicators and probes of every mesh
        #: the different rubbers, the body's first
        self.materials = list(dict.fromkeys([scene.material, *(material for _, material in regions)]))
        self._material_of = np.array([0, *(self.materials.index(material) for _, material in regions)])

    def __str__(self) -> str:
        return f"{self.mesh.nelements} tetrahedra"

    def error(self) -> float:
        names = [probe.name for probe in self.scene.probes]
        return max(errors_by_indicators(names, self.history).values())

    def limit(self, unknowns: int) -> str | None:
        return f"{MAX_UNKNOWNS} unknowns" if unknowns >= MAX_UNKNOWNS else None

    def refine(self, indicators: FloatArray, excess: float) -> None:
        least = int(MIN_MARKED * self.mesh.nelements)
        marked = largest_contributors(indicators, SHARE if excess > 1.5 else LAST_SHARE)
        self._body = None
        self.mesh = bisected(self.mesh, marked if len(marked) > least else np.argsort(-indicators)[:least])

    @property
    def body(self) -> TaylorHood:
        """The body on the mesh as it is."""
        if self._body is None:
            region = self._material_of[prism_of_cells(self.mesh, self.prisms)]
            self._body = taylor_hood(self.mesh, self.materials, region)
        return self._body

    def solve(self, watch: Stopwatch) -> MeshAnswer:
        scene, body = self.scene, self.body
        no_loads = sp.csr_matrix((0, body.basis.N))
        loads = patch_integrals(body.basis, scene.load_rectangles_mm) if scene.dead_loads else no_loads
        forces = np.asarray(loads.T @ scene.tractions_mpa).reshape(-1, 1)
        rows = probe_rows(scene, body.basis)
        plates = scene.plate_rectangles_mm
        motions = bonded(body.n_unknowns, body.free, body.points_mm, plates)
        matrix = sp.triu(motions.T @ body.matrix @ motions, format="csr") if len(plates) else body.upper
        watch.spent("assemble")
        factor = Factor(matrix, upper=True)
        watch.spent("factor")

        pushing = motions.T @ body.loads(forces)
        reduced, residual = checked_solve(factor, pushing)
        x = motions @ reduced
        u = body.displacements(x)
        probes = np.asarray(rows @ u.reshape(-1, 3))
        duals, scales, shapes = _dual_loads(scene, rows, probes)
        y, dual_residual = checked_solve(factor, motions.T @ body.loads(duals))
        y = motions @ y
        z = body.displacements(y)
        watch.spent("solve")

        n = len(body.free)
        loaded, seen = scene.load_rectangles_mm, scene.probe_rectangles_mm
        of_answer = residuals(body, u[:, 0], x[n:, 0], loaded, scene.tractions_mpa, plates)
        of_duals = [
            residuals(body, own, pressure, seen, tractions, plates)
            for own, pressure, tractions in zip(z.T, y[n:].T, shapes, strict=True)
        ]
        watch.spent("assemble")
        indicators = probe_indicators(of_answer, of_duals, scales)
        self.history.append((float(indicators.sum()), probes))
        return MeshAnswer(
            probes=probes,
            energy_mj=0.5 * float(pushing[:, 0] @ reduced[:, 0]),
            residual=max(residual, dual_residual),
            unknowns=matrix.shape[0],
            indicators=indicators,
            field=lambda: Field(
                mesh=body.elements,
                displacement_mm=u.reshape(-1, 3),
                material=self.materials,
            ),
        )


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


def probe_rows(scene: Scene, basis: Basis) -> sp.csr_matrix:
    """Rows that take one component of all nodes to that component of every probe, shape (n_probes, n_nodes)."""
    rectangles, points = scene.probe_rectangles_mm, scene.probe_points_mm
    rows: dict[str, list[sp.csr_matrix]] = {"mean": [], "point": []}
    if len(rectangles):
        areas = (rectangles[:, 2:] - rectangles[:, :2]).prod(axis=1)
        rows["mean"] = list(sp.csr_matrix(sp.diags_array(1 / areas) @ patch_integrals(basis, rectangles)))
    if len(points):
        elements = Elements.of_basis(basis, np.zeros(basis.mesh.nelements, dtype=np.int64))
        rows["point"] = list(elements.at(points))
    return sp.vstack([rows[probe.kind].pop(0) for probe in scene.probes], format="csr")


def _dual_loads(
    scene: Scene, rows: sp.csr_matrix, probes: FloatArray
) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """Unit loads on the probes: nodal forces (n_displacement, k), their scales, and tractions (n_means, 3) of each."""
    weights, scales = dual_weights(probes)
    rectangles = scene.probe_rectangles_mm
    areas = (rectangles[:, 2:] - rectangles[:, :2]).prod(axis=1)[:, None]
    is_mean = np.array([probe.kind == "mean" for probe in scene.probes])
    forces = np.stack([np.asarray(rows.T @ weight).ravel() for weight in weights], axis=1)
    return forces, scales, [weight[is_mean] / areas for weight in weights]
