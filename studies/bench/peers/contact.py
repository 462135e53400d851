"""Contacts against NGSolve: axially symmetric at small and at finite strain, and on pillars in a softer matrix.

Its third-order elements are fine under the shape, which a penalty keeps out, with Newton's method of its own: no
kernel, no cells, no tiles and no grid of the contact in common. Discs are as wide as the slab, whose rims are three
decay lengths of the layer away. At finite strain meshes twice as fine with seven times the penalty change forces of the
ball of 5 mm by 0.16 % at most, elements of fourth order by 0.13 %; the ball on pillars moves by 1 % at the corner.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import process_time
from typing import Any

import numpy as np

from fem.contact import Contact, Shape, Sphere, at_finite_strain, press, surface_compliance, why_tangent
from geometry.design import Array, Material, SensorDesign
from geometry.layout import FloatArray, electrode_squares
from geometry.prism import pillar_prisms
from studies.bench.peers.ngsolve_tools import balances, face, inside, solid
from studies.tables import Row

ORDER, GRADING, COARSE_MM, FINE = 3, 0.2, 2.0, 50  #: of the disc's mesh; elements along the radius of the contact
PENALTY = {"linear": 2e5, "neo-hookean": 500.0}  #: MPa per mm of overlap
STEP_MM, LEAST_MM, STEPS, ACCURATE = 0.1, 2e-3, 40, 1e-7  #: of the depth; of Newton's method
GAUSS, NEAR_MM = 5, 20.0  #: points along an electrode; from the middle: farther off the disc is no square
SOFT = Material(young_mpa=1.0, poisson=0.49, model="neo-hookean")

BALL_MM, BALL_DEPTH_MM, CONTRASTS = 5.0, 1.0, (6.0, 121.0)  #: on pillars, by how much stiffer they are
PLACES_MM = {"a unit's middle": (7.5, 7.5), "an electrode": (2.5, 2.5), "the corner of four": (0.0, 0.0)}
UNDER_MM, ELSEWHERE_MM, AROUND_MM = 0.33, 3.0, 3.0  #: elements under that ball, elsewhere, and the fine disc's radius
OVER_YOUNG = 1000.0, 300.0  #: its penalty over Young's modulus, of matrix and pillars [1/mm]
ROUGH = 1e-3  #: of Newton's method there


@dataclass(frozen=True, eq=False)
class Punch(Shape):
    """A round flat punch with a rounded edge."""

    radius_mm: float
    edge_mm: float

    def own_heights_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        out = np.maximum(np.hypot(x_mm, y_mm) - self.radius_mm + self.edge_mm, 0.0)
        is_below = out < self.edge_mm
        flat = np.where(is_below, out, 0.0) ** 2
        return np.where(is_below, flat / (self.edge_mm + np.sqrt(self.edge_mm**2 - flat)), np.inf)

    def own_extents_mm(self, height_mm: float) -> tuple[float, float]:
        return self.radius_mm, self.radius_mm


@dataclass(frozen=True, eq=False)
class Pressed:
    """Results of one contact."""

    force_n: float
    radius_mm: float
    peak_mpa: float
    electrodes_mm: FloatArray  #: mean displacements (k, 3) of those near


def gap_of(shape: Sphere | Punch, out: Any, up: Any, root: Any, where: Any) -> Any:
    """From places at a distance from the axis and a height above the shape's lowest point; negative inside."""
    if isinstance(shape, Sphere):
        return root(out**2 + (shape.radius_mm - up) ** 2) - shape.radius_mm
    beside, over = out - shape.radius_mm + shape.edge_mm, shape.edge_mm - up
    return where(beside, root(beside**2 + where(over, over, 0.0) ** 2), over) - shape.edge_mm


def pressed_on_disc(
    design: SensorDesign, shape: Sphere | Punch, depths_mm: Sequence[float]
) -> Iterator[tuple[float, Pressed]]:
    """A shape pressed into a disc of the slab's rubber by its own law, as deep as there is a balance."""
    import ngsolve as ng
    from netgen import occ

    ng.SetNumThreads(1)
    wide, height, rubber = design.slab_mm[0] / 2, design.unit.height_mm, design.matrix_material
    is_linear, penalty = rubber.model == "linear", PENALTY[rubber.model]
    ball_mm = min(1.05 * np.sqrt(2 * shape.radius_mm * depths_mm[-1]), 1.25 * shape.radius_mm)
    contact = shape.radius_mm if isinstance(shape, Punch) else ball_mm
    fine = 1.25 * contact
    body = occ.WorkPlane().MoveTo(0, 0).Rectangle(wide, height).Face()
    body.edges.Min(occ.Y).name, body.edges.Min(occ.X).name = "base", "axis"
    inner = occ.WorkPlane().MoveTo(0, height - contact / 3).Rectangle(fine, contact / 3).Face()
    inner.edges.Max(occ.Y).name, inner.edges.Min(occ.X).name = "under", "axis"
    inner.faces.maxh = contact / (FINE if is_linear else FINE / 2)
    geometry = occ.OCCGeometry(occ.Glue([body - inner, inner]), dim=2)
    mesh = ng.Mesh(geometry.GenerateMesh(maxh=COARSE_MM, grading=GRADING))
    space = ng.VectorH1(mesh, order=ORDER, dirichletx="base|axis", dirichlety="base")
    (lame, mu), u, r, depth = rubber.lame_mpa, space.TrialFunction(), ng.x, ng.Parameter(0.0)
    G, hoop = ng.Grad(u), u[0] / r
    if is_linear:
        volume = ng.Trace(G) + hoop
        energy = mu * (ng.InnerProduct(ng.Sym(G), ng.Sym(G)) + hoop**2) + lame / 2 * volume**2
        apart = r**2 / (shape.radius_mm + ng.sqrt(shape.radius_mm**2 - r**2)) - u[1] - depth
    else:
        J = ((1 + G[0, 0]) * (1 + G[1, 1]) - G[0, 1] * G[1, 0]) * (1 + hoop)
        squares = (1 + G[0, 0]) ** 2 + (1 + G[1, 1]) ** 2 + G[0, 1] ** 2 + G[1, 0] ** 2 + (1 + hoop) ** 2
        energy = mu / 2 * (squares - 3 - 2 * ng.log(J)) + lame / 2 * (J - 1) ** 2
        apart = gap_of(shape, r + u[0], u[1] + depth, ng.sqrt, ng.IfPos)
    form, alone = ng.BilinearForm(space, condense=True, symmetric=True), ng.BilinearForm(space)
    for each in (form, alone):
        each += ng.Variation(2 * np.pi * r * energy * ng.dx(bonus_intorder=2))
    form += ng.Variation(ng.IfPos(apart, 0, penalty * np.pi * r * apart**2) * ng.ds("under", bonus_intorder=6))
    found, rising = ng.GridFunction(space), ng.GridFunction(space)
    rising.Set(ng.CoefficientFunction((0, ng.y / height)))
    residual, last = found.vec.CreateVector(), found.vec.CreateVector()
    reached, size, places = 0.0, depths_mm[-1] if is_linear else STEP_MM, np.linspace(1e-6, 0.999 * fine, 4000)
    for target in depths_mm:
        while reached < target:
            ahead = min(target, reached + size)
            depth.Set(ahead)
            last.data = found.vec
            if balances(form, found, STEPS, ACCURATE):
                reached = ahead
                continue
            found.vec.data, size = last, size / 2
            if size < LEAST_MM:
                return
        # work of the body's stress on a field that is 1 on the top and 0 at the base: smoother than the pressure
        alone.Apply(found.vec, residual)
        moved = np.array([found(mesh(place, height - 1e-9)) for place in places])
        out, up = places + (0.0 if is_linear else moved[:, 0]), moved[:, 1] + reached
        overlap = up - shape.heights_mm(places, 0.0 * places)
        if not is_linear:
            overlap = -gap_of(shape, out, up, np.sqrt, lambda sign, one, other: np.where(sign > 0, one, other))
        grown = np.hypot(np.gradient(out, places), 0.0 if is_linear else np.gradient(up, places)) * out / places
        pressure = penalty * np.maximum(overlap, 0.0) / grown
        yield (
            target,
            Pressed(
                force_n=-float(ng.InnerProduct(residual, rising.vec)),
                radius_mm=float(out[overlap > 0][-1]),
                peak_mpa=float(np.median(pressure[2 : len(places) // 40])),
                electrodes_mm=_electrodes(design, lambda far: found(mesh(min(far, wide - 1e-6), height - 1e-9))),
            ),
        )


def _electrodes(design: SensorDesign, moved: Callable[[float], tuple[float, float]]) -> FloatArray:
    """Mean displacements (k, 3) of electrodes near the axis, by the top's along the radius and up."""
    local, weights = np.polynomial.legendre.leggauss(GAUSS)
    found = []
    for x0, y0, x1, y1 in electrode_squares(design)[_is_near(design)].tolist():
        x, y = ((low + high) / 2 + (high - low) / 2 * local for low, high in ((x0, x1), (y0, y1)))
        mean = np.zeros(3)
        for (j, i), weight in np.ndenumerate(np.outer(weights, weights) / 4):
            far = float(np.hypot(x[i], y[j]))
            along, up = moved(far)
            mean += weight * np.array([along * x[i] / far, along * y[j] / far, up])
        found.append(mean)
    return np.array(found)


def _is_near(design: SensorDesign) -> Any:
    """Electrodes that are compared, (k,)."""
    squares = electrode_squares(design)
    return np.hypot(*((squares[:, :2] + squares[:, 2:]) / 2).T) < NEAR_MM


def _off_pct(ours: Contact, theirs: Pressed) -> list[float]:
    """How far force, radius, peak and electrodes are from NGSolve's [%]."""
    own = ours.electrode_mm.reshape(-1, 3)[_is_near(ours.design)]
    electrodes = np.linalg.norm(own - theirs.electrodes_mm) / np.linalg.norm(theirs.electrodes_mm)
    pairs = (
        (ours.net_force_n[2], theirs.force_n),
        (np.sqrt(ours.area_mm2 / np.pi), theirs.radius_mm),
        (ours.peak_mpa, theirs.peak_mpa),
    )
    return [100 * float(value) for value in (*(one / other - 1 for one, other in pairs), electrodes)]


def disc_rows(design: SensorDesign, presses: Sequence[tuple[Sphere | Punch, Sequence[float]]]) -> Iterator[Row]:
    """A row for each shape and depth: NGSolve's answer, and how far ours is from it, linear and at finite strain."""
    surface, _, _ = surface_compliance(design)
    for shape, depths_mm in presses:
        for depth_mm, theirs in pressed_on_disc(design, shape, depths_mm):
            linear, start = press(surface, shape, depth_mm), process_time()
            row: dict[str, Any] = {
                "shape": f"{type(shape).__name__.lower()} of {shape.radius_mm:g} mm, {depth_mm:.3g} mm deep",
                "NGSolve: N / mm / MPa": [theirs.force_n, theirs.radius_mm, theirs.peak_mpa],
                "linear off: force / radius / peak / electrodes [%]": _off_pct(linear, theirs),
            }
            if design.matrix_material.model != "linear" and (why := why_tangent(linear)):
                row["finite off [%]"] = why
            elif design.matrix_material.model != "linear":
                ours = at_finite_strain(linear)
                row["finite off [%]"] = _off_pct(ours, theirs)
                row["stated [%]"] = [100 * ours.error_estimate, 100 * ours.electrode_error_estimate]
                row["CPU s"] = process_time() - start
            yield row


def two_by_two(contrast: float) -> SensorDesign:
    """The paper's units in a matrix that is softer than the pillars."""
    paper = SensorDesign(array=Array(rows=2, cols=2))
    matrix = replace(paper.matrix_material, young_mpa=paper.pillar_material.young_mpa / contrast)
    return replace(paper, matrix_material=matrix)


def pressed_on_pillars(design: SensorDesign, at_mm: tuple[float, float]) -> tuple[float, FloatArray]:
    """Force [N] on a ball, and mean displacements of the electrodes (k, 3) [mm]: one body of tetrahedra."""
    import ngsolve as ng
    from netgen import occ

    ng.SetNumThreads(1)
    (wide, deep, height), (x, y), prisms = design.slab_mm, at_mm, pillar_prisms(design)
    pillars: Any = solid(prisms[0])
    for prism in prisms[1:]:
        pillars = pillars + solid(prism)
    matrix = occ.Box(occ.Pnt(-wide / 2, -deep / 2, 0), occ.Pnt(wide / 2, deep / 2, height)) - pillars
    matrix.mat("matrix")
    pillars.mat("pillars")
    plane = occ.WorkPlane(occ.Axes(occ.Pnt(0, 0, height), n=occ.Z, h=occ.X))
    squares = electrode_squares(design).tolist()
    disc = plane.Circle(x, y, AROUND_MM).Face()
    shape = occ.Glue([matrix, pillars, disc, *(face(square, height) for square in squares)])
    for each in shape.faces:
        if abs(each.center.z) < 1e-9:
            each.name = "base"
        elif abs(each.center.z - height) < 1e-9:
            each.name, (low, high) = "top", each.bounding_box
            if max(abs(low.x - x), abs(high.x - x), abs(low.y - y), abs(high.y - y)) < 1.01 * AROUND_MM:
                each.maxh = UNDER_MM
    mesh = ng.Mesh(occ.OCCGeometry(shape).GenerateMesh(maxh=ELSEWHERE_MM, grading=0.5))

    soft, stiff = design.matrix_material, design.pillar_material
    tops = ng.CF(0.0)
    for prism in prisms:
        half = np.array(prism.section_mm) / 2
        tops = ng.IfPos(inside((*(prism.top_mm[:2] - half), *(prism.top_mm[:2] + half))), 1.0, tops)
    (low, high) = (factor * one.young_mpa for factor, one in zip(OVER_YOUNG, (soft, stiff), strict=True))
    penalty = low + (high - low) * tops
    lame, mu = (
        mesh.MaterialCF({"pillars": own}, default=other)
        for own, other in zip(stiff.lame_mpa, soft.lame_mpa, strict=True)
    )
    r2 = (ng.x - x) ** 2 + (ng.y - y) ** 2
    beneath = ng.IfPos(BALL_MM**2 - r2, BALL_MM**2 - r2, 0)
    underside, under = r2 / (BALL_MM + ng.sqrt(beneath)), ng.ds("top", bonus_intorder=6)
    before: Any = None
    for order in (2, 3):
        space = ng.VectorH1(mesh, order=order, dirichlet="base")
        u, form, found = space.TrialFunction(), ng.BilinearForm(space, condense=True, symmetric=True), None
        strain = ng.Sym(ng.Grad(u))
        form += ng.Variation((mu * ng.InnerProduct(strain, strain) + lame / 2 * ng.Trace(strain) ** 2) * ng.dx)
        over = ng.IfPos(beneath, BALL_DEPTH_MM - underside + u[2], 0)
        form += ng.Variation(penalty / 2 * ng.IfPos(over, over, 0) ** 2 * under)
        found = ng.GridFunction(space)
        if before is not None:
            found.Set(before)
        balances(form, found, STEPS, ROUGH)
        before = found
    over = ng.IfPos(beneath, BALL_DEPTH_MM - underside + before[2], 0)
    force_n = float(ng.Integrate(penalty * ng.IfPos(over, over, 0) * under, mesh))
    electrodes = [[ng.Integrate(inside(square) * before[k] * under, mesh) for k in range(3)] for square in squares]
    return force_n, np.array(electrodes) / design.unit.electrode_mm**2


def pillar_rows() -> Iterator[Row]:
    """A row for each contrast and place of a ball: NGSolve's force, and how far ours and its electrodes are off."""
    for contrast in CONTRASTS:
        design = two_by_two(contrast)
        surface, _, _ = surface_compliance(design)
        for name, at_mm in PLACES_MM.items():
            force_n, electrodes = pressed_on_pillars(design, at_mm)
            ours = press(surface, Sphere(BALL_MM), BALL_DEPTH_MM, at_mm=at_mm)
            off = np.linalg.norm(ours.electrode_mm.reshape(-1, 3) - electrodes) / np.linalg.norm(electrodes)
            yield {
                "times as stiff": contrast,
                "at": name,
                "NGSolve [N]": force_n,
                "ours off: force / electrodes [%]": [100 * (ours.net_force_n[2] / force_n - 1), 100 * float(off)],
                "stated [%]": [100 * ours.error_estimate, 100 * ours.electrode_error_estimate],
            }


_DEPTHS_MM = 1.0, 2.0, 10 / 3
_PRESSES = [(Sphere(radius_mm), _DEPTHS_MM) for radius_mm in (2.0, 5.0, 10.0)]
sphere_rows = partial(
    disc_rows, SensorDesign(), [(Sphere(10.0), (0.5, 1.5)), (Sphere(4.0), (1.0,)), (Sphere(30.0), (1.0,))]
)
finite_rows = partial(
    disc_rows, replace(SensorDesign(), matrix_material=SOFT, pillar_material=SOFT),
    [*_PRESSES, (Punch(radius_mm=5.0, edge_mm=0.5), _DEPTHS_MM)],
)  # fmt: skip
