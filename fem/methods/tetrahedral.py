"""Scenes on tetrahedra: one coarse mesh, bisected where the probes need it until they are right to the tolerance.

Bisection keeps every plane face and outline exact and never meshes anew, so the chance of the mesher is in the first
mesh only and the answers of successive meshes differ by their errors alone.
"""

from dataclasses import dataclass
from time import perf_counter

import numpy as np
import scipy.sparse as sp
from skfem import ElementTetP1, ElementTetP2, MeshTet

from fem.discretization.assembly import IntArray
from fem.discretization.bisection import bisected
from fem.discretization.elasticity import MIN_POISSON, ElasticBody, displacement_form, lame_of_regions, taylor_hood
from fem.discretization.indicator import (
    EDGES,
    cell_sizes,
    dual_weights,
    largest_contributors,
    probe_indicators,
    residuals,
    uniform_tractions,
)
from fem.discretization.patch import patch_integrals
from fem.discretization.scene_mesh import prism_of_cells, scene_mesh
from fem.linear.factors import FactorMemoryError, SolverError
from fem.linear.linear_solver import checked_solve, factorized
from fem.linear.multigrid import rigid_body_modes
from fem.methods.plan import Plan
from fem.methods.richardson import estimated_errors
from fem.scene.scene import Scene
from fem.scene.solution import QUADRATIC_TETRAHEDRON, TETRAHEDRON, Field, Solution
from geometry.design import Material
from geometry.layout import FloatArray

MAX_UNKNOWNS = 400_000  #: no finer mesh is tried: its factor would take some 6 GB and minutes
MAX_MESHES = 40  #: a bound on patience; some 10 are usual
SHARE = 0.75  #: of the indicators' sum that is refined at once: unknowns grow about 1.7 times
LAST_SHARE = 0.65  #: the same, where little is missing
EDGES_ACROSS_PATCH = 1.5  #: least edges across every load and probe before the first solve


@dataclass(frozen=True, kw_only=True, eq=False)
class Level:
    """One mesh and what was found on it."""

    mesh: MeshTet
    region: IntArray  #: shape (m,), index into the materials
    body: ElasticBody
    u: FloatArray  #: nodal displacements, shape (n_displacement,) [mm]
    probes: FloatArray  #: shape (n_probes, 3) [mm]
    energy_mj: float
    residual: float
    unknowns: int
    indicators: FloatArray  #: shape (m,), of the error of the probes


def solve_on_tetrahedra(scene: Scene, plan: Plan, field: bool = False) -> Solution:
    """Answer to a scene on tetrahedra, refined until the estimated error of every probe is within its tolerance.

    Parameters
    ----------
    scene : Scene
    plan : Plan
        Of that scene: its element, its solver, and the prisms that need a region of their own.
    field : bool
        Also return the displacement of the whole body.

    Notes
    -----
    The estimate is for the probes as returned, those of the finest mesh; see `estimated_errors`. Where the tolerance
    asks for more than `MAX_UNKNOWNS`, or more memory than there is, the answer is that of the finest mesh that could
    be solved, with the estimate it has; the last of the steps says so.
    """
    seconds = dict.fromkeys(("mesh", "assemble", "factor", "solve"), 0.0)
    start = perf_counter()
    prisms = [prism for prism, _ in plan.regions]
    mesh, kept = scene_mesh(scene, prisms, cached=plan.saves("cache"))
    steps = [f"{mesh.nelements} tetrahedra {'from the cache' if kept else 'by the mesher'}"]
    mesh = with_edges_across(mesh, np.vstack([scene.load_rectangles_mm, scene.probe_rectangles_mm]))
    seconds["mesh"] = perf_counter() - start

    history: list[tuple[float, FloatArray]] = []  # sum of the indicators, and probes, of every mesh
    found: Level | None = None
    errors = dict.fromkeys((probe.name for probe in scene.probes), np.inf)
    while True:
        try:
            found = _solved(scene, plan, mesh, seconds)
        except FactorMemoryError as error:
            if found is None:
                raise
            steps.append(f"stopped: {error}")
            break
        history.append((float(found.indicators.sum()), found.probes))
        errors = estimated_errors([probe.name for probe in scene.probes], history)
        worst = max(errors.values())
        estimate = f"estimate {worst:.1e}" if np.isfinite(worst) else "no estimate yet"
        steps.append(f"{mesh.nelements} tetrahedra, {found.unknowns} unknowns: {estimate}")
        if worst <= scene.tolerance:
            break
        if found.unknowns >= MAX_UNKNOWNS or len(history) >= MAX_MESHES:
            limit = f"{MAX_UNKNOWNS} unknowns" if found.unknowns >= MAX_UNKNOWNS else f"{MAX_MESHES} meshes"
            steps.append(f"stopped at the limit of {limit}, short of the tolerance {scene.tolerance:g}")
            break
        start = perf_counter()
        share = SHARE if worst > 1.5 * scene.tolerance else LAST_SHARE
        marked = largest_contributors(found.indicators, share)
        mesh = bisected(mesh, marked)
        seconds["mesh"] += perf_counter() - start

    return Solution(
        probes={probe.name: found.probes[number] for number, probe in enumerate(scene.probes)},
        energy_mj=found.energy_mj,
        residual=found.residual,
        unknowns=found.unknowns,
        error_estimate=float(max(errors.values())),
        seconds=seconds,
        steps=tuple(steps),
        field=_field(found, materials_of(scene, plan)) if field else None,
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


def _solved(scene: Scene, plan: Plan, mesh: MeshTet, seconds: dict[str, float]) -> Level:
    """Solve a scene on one mesh, and find where it errs."""
    clock = perf_counter()

    def done(step: str) -> None:
        nonlocal clock
        now = perf_counter()
        seconds[step] += now - clock
        clock = now

    materials = materials_of(scene, plan)
    of_prism = np.array([0, *(materials.index(material) for _, material in plan.regions)])
    region = of_prism[prism_of_cells(mesh, [prism for prism, _ in plan.regions])]
    body = _assembled(mesh, materials, region, plan.element)
    loads = patch_integrals(body.basis, scene.load_rectangles_mm) if scene.loads else sp.csr_matrix((0, body.basis.N))
    forces = np.asarray(loads.T @ scene.tractions_mpa).reshape(-1, 1)
    rows = probe_rows(scene, body)
    done("assemble")

    definite = not body.n_pressure
    modes = rigid_body_modes(body.basis.doflocs.T[body.free[::3] // 3]) if definite else None
    factor = factorized(body.matrix, plan.solver, definite=definite, modes=modes)
    done("factor")

    x, residual = checked_solve(body.matrix, factor, body.loads(forces))
    u = body.displacements(x)
    probes = np.asarray(rows @ u.reshape(-1, 3))
    duals, scales, shapes = _dual_loads(scene, rows, probes)
    y, dual_residual = checked_solve(body.matrix, factor, body.loads(duals))
    z = body.displacements(y)
    done("solve")

    lame_mpa, mu_mpa = lame_of_regions(materials, region, at_least_poisson=MIN_POISSON if body.n_pressure else 0.0)
    n = len(body.free)

    def residuals_of(u: FloatArray, p: FloatArray, traction: FloatArray, rectangles: FloatArray) -> FloatArray:
        pressing = uniform_tractions(rectangles, traction) if len(rectangles) else None
        return residuals(body, u, p, region, lame_mpa, mu_mpa, pressing)

    of_answer = residuals_of(u[:, 0], x[n:, 0], scene.tractions_mpa, scene.load_rectangles_mm)
    of_duals = [residuals_of(z[:, k], y[n:, k], shapes[k], scene.probe_rectangles_mm) for k in range(duals.shape[1])]
    indicators = probe_indicators(of_answer, of_duals, scales)
    if not np.isfinite(indicators).all():
        raise SolverError(f"residuals of {len(indicators)} elements are not numbers: bring moduli and sizes closer.")
    done("assemble")
    return Level(
        mesh=mesh,
        region=region,
        body=body,
        u=u[:, 0],
        probes=probes,
        energy_mj=0.5 * float(forces[:, 0] @ u[:, 0]),
        residual=max(residual, dual_residual),
        unknowns=body.matrix.shape[0],
        indicators=indicators,
    )


def materials_of(scene: Scene, plan: Plan) -> list[Material]:
    """The different rubbers of a scene, by the numbers of regions; the body's first."""
    return list(dict.fromkeys([scene.material, *(material for _, material in plan.regions)]))


def _assembled(mesh: MeshTet, materials: list[Material], region: IntArray, element: str) -> ElasticBody:
    if element == "TH":
        return taylor_hood(mesh, materials, region)
    return displacement_form(mesh, materials, region, {"P1": ElementTetP1, "P2": ElementTetP2}[element])


def probe_rows(scene: Scene, body: ElasticBody) -> sp.csr_matrix:
    """Rows that take one component of all nodes to that component of every probe, shape (n_probes, n_nodes)."""
    rectangles = scene.probe_rectangles_mm
    means = iter(())
    if len(rectangles):
        areas = (rectangles[:, 2:] - rectangles[:, :2]).prod(axis=1)
        means = iter(sp.csr_matrix(sp.diags_array(1 / areas) @ patch_integrals(body.basis, rectangles)))
    points = iter([point_row(body, position) for position in scene.probe_points_mm])
    return sp.vstack([next(means if probe.kind == "mean" else points) for probe in scene.probes], format="csr")


def point_row(body: ElasticBody, position_mm: FloatArray) -> sp.csr_matrix:
    """Shape functions at a point, shape (1, n_nodes); a point that rounding put outside takes the nearest element."""
    mesh = body.basis.mesh
    corners = mesh.p.T[mesh.t.T]
    last_three = np.linalg.solve(
        (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1), (position_mm - corners[:, 0])[..., None]
    )[..., 0]
    barycentric = np.column_stack([1 - last_three.sum(axis=1), last_three])
    element = int(barycentric.min(axis=1).argmax())
    L, vertices = barycentric[element], mesh.t[:, element]
    nodes = body.basis.nodal_dofs[0, vertices]
    values = L
    if body.basis.edge_dofs.size:
        nodes = np.concatenate([nodes, body.basis.edge_dofs[0, mesh.t2e[:, element]]])
        values = np.concatenate([L * (2 * L - 1), [4 * L[a] * L[b] for a, b in EDGES]])
    return sp.csr_matrix((values, (np.zeros(len(nodes), dtype=int), nodes)), shape=(1, body.basis.N))


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


def _field(found: Level, materials: list[Material]) -> Field:
    """The displacement of the whole body, in VTK's order of nodes, which is scikit-fem's."""
    basis, mesh = found.body.basis, found.mesh
    quadratic = bool(basis.edge_dofs.size)
    cells = np.vstack([basis.nodal_dofs[0][mesh.t], basis.edge_dofs[0][mesh.t2e]]) if quadratic else mesh.t.copy()
    return Field(
        points_mm=basis.doflocs.T.copy(),
        cells=cells.T.astype(np.int64),
        cell_type=QUADRATIC_TETRAHEDRON if quadratic else TETRAHEDRON,
        displacement_mm=found.u.reshape(-1, 3),
        region=found.region.astype(np.int64),
        material=tuple(materials),
    )
