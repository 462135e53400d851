"""NGSolve as an expert would use it: netgen's graded or hp-refined meshes, orders 3 to 6, its own solver.

Patch outlines and inclusions are glued into the body, so that the mesh conforms to them and is refined there: either by
local edge sizes, or by NGSolve's own geometric hp-refinement toward marked edges. The same solver, at high order, makes
the benchmark's references: mesh, functions (integrated Legendre polynomials), assembly, condensation and sparse
Cholesky factors are NGSolve's, none of it is what `fem` solves by.
"""

import os
from collections.abc import Collection, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from fem.scene.scene import Pillar, Prism, Scene
from fem.scene.solution import Stopwatch
from geometry.design import Material
from geometry.layout import FloatArray
from studies.bench.harness import Contender
from studies.bench.scenes import Solved, is_linear

RESIDUAL = 1e-8  #: largest relative residual of a reference after refinement
PLACES = 8  #: Gauss points along each side of a probe to which no mesh conforms


@dataclass(frozen=True, kw_only=True)
class Grading:
    """The fineness of a reference."""

    order: int  #: of the functions
    levels: int  #: of geometric refinement toward singular edges
    ratio: float  #: of the distances of neighbouring levels
    largest_mm: float  #: of elements before they are refined
    edge_mm: float  #: of elements along the outlines of loads and along inclusions
    edges: tuple[str, ...] = ("base", "loads", "regions")  #: the singular ones


@dataclass(frozen=True)
class NgsolveSolution:
    """A converged answer."""

    probes: dict[str, FloatArray]  #: displacement of each probe, shape (3,) [mm]
    energy_mj: float  #: ½ f·u
    unknowns: int
    elements: int


# meshes


def glued_mesh(
    scene: Scene,
    rectangles: Mapping[Any, float | None],
    prisms: Sequence[tuple[Prism, float]],
    base_mm: float | None,
    largest_mm: float,
    grading: float,
    hp: tuple[int, float, Collection[str]],
) -> Any:
    """A mesh of the body by netgen; its faces are 'bottom' and 'top'.

    Parameters
    ----------
    scene : Scene
    rectangles : dict
        Edge length [mm] along each rectangle of the top that is glued in; None where it is not refined.
    prisms : sequence of (prism, edge length [mm])
    base_mm : float or None
        The same along the edges of the base.
    largest_mm, grading : float
        Of netgen.
    hp : (levels, ratio, edges)
        Geometric refinement toward the named edges: "base", "loads", "regions"; "corners" are those of loads.
    """
    from netgen.occ import Glue, OCCGeometry
    from ngsolve import Mesh

    h = scene.height_mm
    levels, ratio, singular = hp

    def refined(edges: Any, kind: str, edge_mm: float | None) -> None:
        for edge in edges:
            edge.hpref = 1 if levels and kind in singular else 0
            if edge_mm is not None:
                edge.maxh = edge_mm

    parts = [_solid(scene.outline)]
    refined([edge for edge in parts[0].edges if abs(edge.center.z) < 1e-9 * h], "base", base_mm)
    for corners, edge_mm in rectangles.items():
        parts.append(_face(corners, h))
        if edge_mm is not None:
            refined(parts[-1].edges, "loads", edge_mm)
        for vertex in parts[-1].vertices:
            vertex.hpref = 1 if levels and "corners" in singular else 0
    for prism, edge_mm in prisms:
        parts.append(_solid(prism))
        refined(parts[-1].edges, "regions", edge_mm)
    shape = Glue(parts)
    for face in shape.faces:
        for name, z in (("bottom", 0.0), ("top", h)):
            if abs(face.center.z - z) < 1e-9 * h:
                face.name = name
    mesh = Mesh(OCCGeometry(shape).GenerateMesh(maxh=largest_mm, grading=grading, parallel_meshing=False))
    if levels:
        mesh.RefineHP(levels, factor=ratio)
    return mesh


def reference_mesh(scenes: Sequence[Scene], grading: Grading) -> Any:
    """A mesh that conforms to the loads of all scenes and to prisms of other rubber."""
    rectangles = {load.rectangle: grading.edge_mm for one in scenes for load in one.loads}
    prisms = [(region, grading.edge_mm) for region, _ in _other_rubber(scenes[0])]
    hp = (grading.levels, grading.ratio, grading.edges)
    return glued_mesh(scenes[0], rectangles, prisms, None, grading.largest_mm, 0.5, hp)


def tetrahedra(scene: Scene, n: float, hp: int = 0) -> Any:
    """A mesh by netgen that shrinks toward the outlines of loads and inclusions, or is hp-refined toward them.

    Edges along loads and inclusions are half as long as those are wide, over a fineness.
    """
    largest_mm, fineness = scene.height_mm / (n if hp else max(1.0, n / 2)), n if hp else n**1.5
    smallest_mm = min(min(load.size_mm) for load in scene.loads)
    loaded, probed = (
        [tuple(row) for row in rows.tolist()] for rows in (scene.load_rectangles_mm, scene.probe_rectangles_mm)
    )
    rectangles = {r: smallest_mm / 2 / fineness if r in loaded else None for r in (*loaded, *probed)}
    prisms = [(inclusion, min(inclusion.section_mm) / 2 / fineness) for inclusion in scene.inclusions]
    # the clamped end of a free pillar is as singular as what is near its load
    free = isinstance(scene.body, Pillar)
    singular = ("base", "loads", "regions")[0 if free else 1 :]
    base_mm = smallest_mm / 2 / fineness if free else None
    return glued_mesh(scene, rectangles, prisms, base_mm, largest_mm, 0.4, (hp, 0.15, singular))


def _face(corners: Sequence[float], z_mm: float) -> Any:
    """A rectangle of OpenCASCADE at some height; corners x0, y0, x1, y1."""
    from netgen.occ import Axes, Pnt, WorkPlane, X, Z

    x0, y0, x1, y1 = corners
    return WorkPlane(Axes(Pnt(x0, y0, z_mm), n=Z, h=X)).Rectangle(x1 - x0, y1 - y0).Face()


def _solid(one: Prism) -> Any:
    """A prism of OpenCASCADE."""
    from netgen.occ import Vec

    (x, y, z), (a, b) = one.base_mm, one.section_mm
    upward = Vec(*(np.array(one.top_mm) - np.array(one.base_mm)).tolist())
    return _face((x - a / 2, y - b / 2, x + a / 2, y + b / 2), z).Extrude(upward)


# equations


class System:
    """An elastic body on a mesh, what lies inside elements condensed: assembled, then factored, then solved."""

    def __init__(self, scene: Scene, mesh: Any, order: int) -> None:
        import ngsolve as ng

        lame, mu = _moduli(scene, mesh)
        self.space = ng.VectorH1(mesh, order=order, dirichlet="bottom")
        u, self.virtual = self.space.TnT()
        self.a = ng.BilinearForm(self.space, symmetric=True, condense=True)
        self.a += 2 * mu * ng.InnerProduct(ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(self.virtual))) * ng.dx
        self.a += lame * ng.div(u) * ng.div(self.virtual) * ng.dx
        self.a.Assemble()

    def load(self, scene: Scene) -> Any:
        """Nodal forces of a scene's loads."""
        import ngsolve as ng

        f = ng.LinearForm(self.space)
        for load in scene.dead_loads:
            f += inside(load.rectangle) * ng.InnerProduct(ng.CF(load.traction_mpa), self.virtual) * ng.ds("top")
        f.Assemble()
        return f

    def factor(self) -> Any:
        return self.a.mat.Inverse(self.space.FreeDofs(True), inverse="sparsecholesky")

    def solve(self, inverse: Any, f: Any, refinements: int = 0) -> Any:
        """The solution; with refinements its residual must stay below `RESIDUAL`, else `ArithmeticError`."""
        import ngsolve as ng

        w = ng.GridFunction(self.space)
        f.vec.data += self.a.harmonic_extension_trans * f.vec
        w.vec.data = inverse * f.vec
        if refinements:
            rest, free = f.vec.CreateVector(), ng.Projector(self.space.FreeDofs(True), True)
            for _ in range(refinements):
                rest.data = free * (f.vec - self.a.mat * w.vec)
                w.vec.data += inverse * rest
            if rest.Norm() > RESIDUAL * f.vec.Norm():
                raise ArithmeticError(f"residual {rest.Norm() / f.vec.Norm():.1e} > {RESIDUAL:g}: inexact factors.")
        w.vec.data += self.a.harmonic_extension * w.vec
        w.vec.data += self.a.inner_solve * f.vec
        return w


def solve_by_ngsolve(scene: Scene, n: float, order: int, hp: int = 0) -> Solved:
    """Mesh, assemble, factor by NGSolve's sparse Cholesky, solve."""
    import ngsolve as ng

    threads = int(os.environ.get("OMP_NUM_THREADS", "2"))
    ng.SetNumThreads(threads)
    watch = Stopwatch()
    mesh = tetrahedra(scene, n, hp)
    watch.spent("mesh")
    with ng.TaskManager() if threads > 1 else nullcontext():  # a task manager of one thread would only cost
        system = System(scene, mesh, order)
        f = system.load(scene)
        watch.spent("assemble")
        inverse = system.factor()
        watch.spent("factor")
        u = system.solve(inverse, f)
        probes = {probe.name: mean_over(u, probe.rectangle) for probe in scene.mean_probes}
        watch.spent("solve")
    return Solved(probes, system.space.ndof, watch.seconds)


def solve_references(scenes: Sequence[Scene], grading: Grading) -> list[NgsolveSolution]:
    """Displacement of the probes of scenes that differ in loads and probes only: one factorisation serves them all.

    Raises
    ------
    ValueError
        If bodies or materials differ.
    ArithmeticError
        If a residual stays above `RESIDUAL`.
    """
    import ngsolve as ng

    first = scenes[0]
    if len({(one.body, one.material, one.inclusions) for one in scenes}) > 1:
        raise ValueError("scenes of one solve must have the same body and materials.")
    mesh = reference_mesh(scenes, grading)
    system = System(first, mesh, grading.order)
    inverse = system.factor()
    found = []
    for scene in scenes:
        f = system.load(scene)
        w = system.solve(inverse, f, refinements=2)
        energy_mj = ng.InnerProduct(f.vec, w.vec) / 2
        found.append(NgsolveSolution(_probed(scene, w), energy_mj, system.space.ndof, mesh.ne))
    return found


def _moduli(scene: Scene, mesh: Any) -> tuple[Any, Any]:
    """λ and μ of each element of a mesh that conforms to the scene's prisms."""
    import ngsolve as ng

    found = [ng.CF(value) for value in scene.material.lame_mpa]
    for region, material in _other_rubber(scene):
        (x, y, z), (a, b) = region.base_mm, region.section_mm
        slope = (np.array(region.top_mm) - np.array(region.base_mm)) / region.height_mm
        rise = ng.z - z
        beside = [(a / 2) ** 2 - (ng.x - x - slope[0] * rise) ** 2, (b / 2) ** 2 - (ng.y - y - slope[1] * rise) ** 2]
        beside.append(rise * (region.height_mm - rise))
        inside = ng.CF(1.0)
        for one in beside:
            inside = ng.IfPos(one, inside, ng.CF(0.0))
        found = [ng.IfPos(inside, ng.CF(own), other) for own, other in zip(material.lame_mpa, found, strict=True)]
    constant = [ng.GridFunction(ng.L2(mesh, order=0)) for _ in found]
    for one, value in zip(constant, found, strict=True):
        one.Set(value)
    return constant[0], constant[1]


def _other_rubber(scene: Scene) -> list[tuple[Prism, Material]]:
    return [(region, material) for region, material in scene.regions if material != scene.material]


# probes


def inside(rectangle: Sequence[float]) -> Any:
    """1 inside a rectangle, 0 outside: constant on each face, for the mesh conforms to its outline."""
    import ngsolve as ng

    x0, y0, x1, y1 = (float(corner) for corner in rectangle)
    return ng.IfPos((ng.x - x0) * (x1 - ng.x), 1, 0) * ng.IfPos((ng.y - y0) * (y1 - ng.y), 1, 0)


def mean_over(u: Any, rectangle: Sequence[float]) -> FloatArray:
    """Mean displacement over a rectangle of the top whose outline the mesh conforms to, shape (3,): exact."""
    import ngsolve as ng

    mesh, order = u.space.mesh, 2 * u.space.globalorder
    x0, y0, x1, y1 = rectangle
    total = ng.Integrate(inside(rectangle) * u, mesh, ng.BND, order=order, definedon=mesh.Boundaries("top"))
    return np.array(total) / ((x1 - x0) * (y1 - y0))


def _probed(scene: Scene, u: Any) -> dict[str, FloatArray]:
    """Each probe: exact over a load's rectangle and at points, by Gauss points elsewhere."""
    mesh, found = u.space.mesh, {}
    conforming = {load.rectangle for load in scene.loads}
    places, weights = np.polynomial.legendre.leggauss(PLACES)
    for probe in scene.probes:
        if probe.position_mm is not None:
            found[probe.name] = np.array(u(mesh(*probe.position_mm)))
        elif probe.rectangle in conforming:
            found[probe.name] = mean_over(u, probe.rectangle)
        else:
            x0, y0, x1, y1 = probe.rectangle
            x, y = np.meshgrid((x0 + x1 + (x1 - x0) * places) / 2, (y0 + y1 + (y1 - y0) * places) / 2, indexing="ij")
            values = u(mesh(x.ravel(), y.ravel(), np.full(x.size, scene.height_mm)))
            found[probe.name] = np.outer(weights, weights).ravel() @ values / 4
    return found


def missing() -> str:
    """The wheel, where it is not installed."""
    return "" if find_spec("ngsolve") else "ngsolve is not installed (pip install 'tripillar[bench]')"


CONTENDERS = [
    Contender(
        name=f"NGSolve, {name}", family="NGSolve", solve=partial(solve_by_ngsolve, order=order, hp=hp),
        settings=settings, covers=is_linear, missing=missing, imports=("ngsolve", "netgen.occ"),
    )
    for name, order, hp, settings in (
        ("third order", 3, 0, (1, 1.5, 2, 3, 4)),
        ("fourth order, hp-refined", 4, 2, (1, 1.5, 2)),
    )
]  # fmt: skip
