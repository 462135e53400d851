"""Solve scenes by NGSolve: netgen's meshes, hp-refined toward singular edges, functions of high order, factored.

None of it is what `fem` solves by: mesh, functions (integrated Legendre polynomials, fully integrated), assembly,
condensation and sparse Cholesky factors are NGSolve's. Covers any scene.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fem.scene.scene import Prism, Scene
from geometry.design import Material
from geometry.layout import FloatArray

RESIDUAL = 1e-8  #: largest relative residual after refinement
PLACES = 8  #: Gauss points along each side of a probe to which no mesh conforms


@dataclass(frozen=True, kw_only=True)
class Grading:
    """How fine to solve."""

    order: int  #: of the functions
    levels: int  #: of geometric refinement toward singular edges
    ratio: float  #: of the distances of neighbouring levels
    largest_mm: float  #: of elements before they are refined
    edge_mm: float  #: of elements along the outlines of loads and along inclusions
    edges: tuple[str, ...] = ("base", "loads", "regions")  #: which are singular


@dataclass(frozen=True)
class NgsolveSolution:
    """What a solve found."""

    probes: dict[str, FloatArray]  #: displacement of each probe, shape (3,) [mm]
    energy_mj: float  #: ½ f·u
    unknowns: int
    elements: int


def solve_by_ngsolve(scenes: Sequence[Scene], grading: Grading) -> list[NgsolveSolution]:
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
    if any(
        (one.body, one.material, one.inclusions) != (first.body, first.material, first.inclusions) for one in scenes
    ):
        raise ValueError("scenes of one solve must have the same body and materials.")
    mesh = hp_mesh(scenes, grading)
    V = ng.VectorH1(mesh, order=grading.order, dirichlet="bottom")
    u, v = V.TnT()
    lame, mu = moduli(first, mesh)
    seen_inside = any(one.point_probes for one in scenes)
    a = ng.BilinearForm(V, symmetric=True, eliminate_internal=True, keep_internal=seen_inside)
    strain, virtual = ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))
    a += (2 * mu * ng.InnerProduct(strain, virtual) + lame * ng.div(u) * ng.div(v)) * ng.dx
    a.Assemble()
    factor = a.mat.Inverse(V.FreeDofs(True), inverse="sparsecholesky")
    free = ng.Projector(V.FreeDofs(True), True)
    found = []
    for scene in scenes:
        f = ng.LinearForm(V)
        for load in scene.loads:
            f += inside(load.rectangle) * ng.InnerProduct(ng.CF(load.traction_mpa), v) * ng.ds("top")
        f.Assemble()
        w, rest = ng.GridFunction(V), f.vec.CreateVector()
        w.vec.data = factor * f.vec
        for _ in range(2):
            rest.data = free * (f.vec - a.mat * w.vec)
            w.vec.data += factor * rest
        if rest.Norm() > RESIDUAL * f.vec.Norm():
            raise ArithmeticError(f"residual {rest.Norm() / f.vec.Norm():.1e} > {RESIDUAL:g}: the factors are inexact.")
        if seen_inside:  # loads lie on faces, so that what lies inside elements follows from what lies around them
            w.vec.data += a.harmonic_extension * w.vec
        energy_mj = ng.InnerProduct(f.vec, w.vec) / 2
        found.append(NgsolveSolution(_probed(scene, w), energy_mj, V.ndof, mesh.ne))
    return found


def hp_mesh(scenes: Sequence[Scene], grading: Grading) -> Any:
    """A mesh of the body that conforms to loads and to prisms of other rubber; its faces are 'bottom' and 'top'."""
    from netgen.occ import Glue, OCCGeometry
    from ngsolve import Mesh

    scene = scenes[0]
    h = scene.height_mm

    def refined(edges: Iterable[Any], kind: str, edge_mm: float | None = None) -> None:
        for edge in edges:
            edge.hpref = 1 if kind in grading.edges else 0
            if edge_mm is not None:
                edge.maxh = edge_mm

    body = prism(scene.outline)
    refined((edge for edge in body.edges if abs(edge.center.z) < 1e-9 * h), "base")
    parts = [body]
    for corners in {load.rectangle for one in scenes for load in one.loads}:
        parts.append(rectangle(corners, h))
        refined(parts[-1].edges, "loads", grading.edge_mm)
    for region, _ in _other_rubber(scene):
        parts.append(prism(region))
        refined(parts[-1].edges, "regions", grading.edge_mm)
    shape = Glue(parts)
    for face in shape.faces:
        if abs(face.center.z) < 1e-9 * h:
            face.name = "bottom"
        elif abs(face.center.z - h) < 1e-9 * h:
            face.name = "top"
    mesh = Mesh(OCCGeometry(shape).GenerateMesh(maxh=grading.largest_mm, grading=0.5, parallel_meshing=False))
    if grading.levels:
        mesh.RefineHP(grading.levels, factor=grading.ratio)
    return mesh


def rectangle(corners: Sequence[float], z_mm: float) -> Any:
    """A face of OpenCASCADE at some height; corners x0, y0, x1, y1."""
    from netgen.occ import Axes, Pnt, WorkPlane, X, Z

    x0, y0, x1, y1 = corners
    return WorkPlane(Axes(Pnt(x0, y0, z_mm), n=Z, h=X)).Rectangle(x1 - x0, y1 - y0).Face()


def prism(one: Prism) -> Any:
    """A solid of OpenCASCADE."""
    from netgen.occ import Vec

    (x, y, z), (a, b) = one.base_mm, one.section_mm
    upward = Vec(*(np.array(one.top_mm) - np.array(one.base_mm)).tolist())
    return rectangle((x - a / 2, y - b / 2, x + a / 2, y + b / 2), z).Extrude(upward)


def moduli(scene: Scene, mesh: Any, least: float = 0.0) -> tuple[Any, Any]:
    """λ and μ of each element of a mesh that conforms to the scene's prisms; λ ≥ least · μ."""
    import ngsolve as ng

    def both(material: Material) -> tuple[float, float]:
        lame, mu = material.lame_mpa
        return max(lame, least * mu), mu

    found = [ng.CF(value) for value in both(scene.material)]
    for region, material in _other_rubber(scene):
        (x, y, z), (a, b) = region.base_mm, region.section_mm
        slope = (np.array(region.top_mm) - np.array(region.base_mm)) / region.height_mm
        rise = ng.z - z
        beside = [(a / 2) ** 2 - (ng.x - x - slope[0] * rise) ** 2, (b / 2) ** 2 - (ng.y - y - slope[1] * rise) ** 2]
        beside.append(rise * (region.height_mm - rise))
        for i, value in enumerate(both(material)):
            within = ng.CF(value)
            for one in beside:
                within = ng.IfPos(one, within, found[i])
            found[i] = within
    constant = [ng.GridFunction(ng.L2(mesh, order=0)) for _ in found]
    for one, value in zip(constant, found, strict=True):
        one.Set(value)
    return constant[0], constant[1]


def _other_rubber(scene: Scene) -> list[tuple[Prism, Material]]:
    return [(region, material) for region, material in scene.regions if material != scene.material]


def inside(rectangle: Sequence[float]) -> Any:
    """1 inside a rectangle, 0 outside: constant on each face, for the mesh conforms to its outline."""
    import ngsolve as ng

    x0, y0, x1, y1 = (float(corner) for corner in rectangle)
    return ng.IfPos((ng.x - x0) * (x1 - ng.x), 1, 0) * ng.IfPos((ng.y - y0) * (y1 - ng.y), 1, 0)


def mean_over(u: Any, rectangle: Sequence[float]) -> FloatArray:
    """Mean displacement over a rectangle of the top whose outline the mesh conforms to, shape (3,): exact."""
    import ngsolve as ng

    mesh = u.space.mesh
    x0, y0, x1, y1 = rectangle
    total = ng.Integrate(
        inside(rectangle) * u, mesh, ng.BND, order=2 * u.space.globalorder, definedon=mesh.Boundaries("top")
    )
    return np.array(total) / ((x1 - x0) * (y1 - y0))


def _probed(scene: Scene, u: Any) -> dict[str, FloatArray]:
    """Each probe: exact over a load's rectangle and at points, by Gauss points elsewhere."""
    mesh, found = u.space.mesh, {}
    conforming = {load.rectangle for load in scene.loads}
    places, weights = np.polynomial.legendre.leggauss(PLACES)
    for probe in scene.probes:
        if probe.position_mm is not None:
            found[probe.name] = np.array(u(mesh(*probe.position_mm)))
            continue
        x0, y0, x1, y1 = probe.rectangle
        if probe.rectangle in conforming:
            found[probe.name] = mean_over(u, probe.rectangle)
        else:
            x, y = np.meshgrid((x0 + x1 + (x1 - x0) * places) / 2, (y0 + y1 + (y1 - y0) * places) / 2, indexing="ij")
            values = u(mesh(x.ravel(), y.ravel(), np.full(x.size, scene.height_mm)))
            found[probe.name] = np.outer(weights, weights).ravel() @ values / 4
    return found
