"""``python -m studies.bench.peers.pillars``: a ball on pillars in a softer matrix, by NGSolve and by `fem.contact`.

NGSolve takes 2 × 2 units as one body of tetrahedra, second and then third order, that conform to the pillars and are
fine under the ball, and Signorini's law by a penalty with its own Newton's method: no cells, no ports, no tiles, no
grid of the contact in common.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fem.contact import Sphere, press, surface_compliance
from geometry.design import Array, Material, SensorDesign
from geometry.layout import FloatArray, electrode_squares, unit_centres
from geometry.prism import unit_prisms

RADIUS_MM, DEPTH_MM, CONTRASTS = 5.0, 1.0, (6.0, 121.0)
PLACES_MM = {"a unit's middle": (7.5, 7.5), "an electrode": (2.5, 2.5), "the corner of four": (0.0, 0.0)}
FINE_MM, COARSE_MM, AROUND_MM = 0.33, 3.0, 3.0  #: elements under the ball, elsewhere, and the disc where they are fine
PENALTY = 1000.0, 300.0  #: over Young's modulus, of matrix and pillars [1/mm]: they overlap by 2e-3 mm at most
STEPS, ACCURATE = 24, 7e-4  #: of Newton's method, and change of the force in its last one
LENGTHS = (1.0, 0.6, 0.35, 0.15)  #: of a step, of which the one with the least energy is taken


def two_by_two(contrast: float) -> SensorDesign:
    """The paper's units in a matrix that is softer than the pillars."""
    paper = SensorDesign(array=Array(rows=2, cols=2))
    young_mpa = paper.pillar_material.young_mpa / contrast
    return replace(paper, matrix_material=Material(young_mpa=young_mpa, poisson=paper.pillar_material.poisson))


def pressed_by_ngsolve(design: SensorDesign, at_mm: tuple[float, float]) -> tuple[float, FloatArray, int]:
    """Force [N] on a ball, mean displacements of the electrodes (k, 3) [mm], and unknowns."""
    import ngsolve as ng
    from netgen import occ

    ng.SetNumThreads(1)
    (wide, deep, height), (x, y) = design.slab_mm, at_mm

    def plane(z_mm: float) -> Any:
        return occ.WorkPlane(occ.Axes(occ.Pnt(0, 0, z_mm), n=occ.Z, h=occ.X))

    def rectangle(corners: Sequence[float], z_mm: float) -> Any:
        x0, y0, x1, y1 = corners
        return plane(z_mm).MoveTo(x0, y0).Rectangle(x1 - x0, y1 - y0).Face()

    solids: list[Any] = []
    tops = ng.CF(0.0)
    for centre in unit_centres(design):
        for one in unit_prisms(design.unit, (*centre, 0.0)):
            low, high = (np.array(one.base_mm[:2]) + sign * np.array(one.section_mm) / 2 for sign in (-1, 1))
            solids.append(rectangle([*low, *high], 0.0).Extrude(occ.Vec(*np.subtract(one.top_mm, one.base_mm))))
            shift = np.subtract(one.top_mm, one.base_mm)[:2]
            tops = ng.IfPos(_inside(*(low + shift), *(high + shift)), 1.0, tops)
    slab = occ.Box(occ.Pnt(-wide / 2, -deep / 2, 0), occ.Pnt(wide / 2, deep / 2, height))
    pillars: Any = sum(solids[1:], start=solids[0])
    matrix, disc = slab - pillars, plane(height).Circle(x, y, AROUND_MM).Face()
    matrix.mat("matrix")
    pillars.mat("pillars")
    squares = [rectangle(square, height) for square in electrode_squares(design).tolist()]
    shape = occ.Glue([matrix, pillars, disc, *squares])
    for face in shape.faces:
        if abs(face.center.z) < 1e-9:
            face.name = "base"
        elif abs(face.center.z - height) < 1e-9:
            face.name = "top"
            low, high = face.bounding_box
            if max(abs(low.x - x), abs(high.x - x), abs(low.y - y), abs(high.y - y)) < 1.01 * AROUND_MM:
                face.maxh = FINE_MM
    mesh = ng.Mesh(occ.OCCGeometry(shape).GenerateMesh(maxh=COARSE_MM, grading=0.5))

    (soft, stiff), nu = (one.young_mpa for one in (design.matrix_material, design.pillar_material)), 0.49
    young = mesh.MaterialCF({"pillars": stiff}, default=soft)
    penalty = PENALTY[0] * soft + (PENALTY[1] * stiff - PENALTY[0] * soft) * tops
    mu, lame = young / 2 / (1 + nu), young * nu / (1 + nu) / (1 - 2 * nu)
    r2 = (ng.x - x) ** 2 + (ng.y - y) ** 2
    underside = r2 / (RADIUS_MM + ng.sqrt(ng.IfPos(RADIUS_MM**2 - r2, RADIUS_MM**2 - r2, 0)))
    under = ng.ds("top", bonus_intorder=6)
    found: Any = None

    def pressure(up: Any) -> Any:
        over = DEPTH_MM - underside + up
        return penalty * ng.IfPos(over, ng.IfPos(RADIUS_MM**2 - r2, over, 0), 0)

    for order in (2, 3):
        space = ng.VectorH1(mesh, order=order, dirichlet="base")
        u, form = space.TrialFunction(), ng.BilinearForm(space, condense=True, symmetric=True)
        strain = ng.Sym(ng.Grad(u))
        form += ng.Variation((mu * ng.InnerProduct(strain, strain) + lame / 2 * ng.Trace(strain) ** 2) * ng.dx)
        form += ng.Variation(pressure(u[2]) ** 2 / penalty / 2 * under)
        before, found = found, ng.GridFunction(space)
        if before is not None:
            found.Set(before)
        residual, step, last_n = found.vec.CreateVector(), found.vec.CreateVector(), 0.0
        for _ in range(STEPS):
            form.Apply(found.vec, residual)
            form.AssembleLinearization(found.vec)
            residual.data += form.harmonic_extension_trans * residual
            step.data = form.mat.Inverse(space.FreeDofs(True), "sparsecholesky") * residual
            step.data += form.harmonic_extension * step
            step.data += form.inner_solve * residual
            energies = []
            for length in LENGTHS:
                found.vec.data -= length * step
                energies.append(form.Energy(found.vec))
                found.vec.data += length * step
            found.vec.data -= LENGTHS[int(np.argmin(energies))] * step
            force_n = float(ng.Integrate(pressure(found[2]) * under, mesh))
            if abs(force_n - last_n) < ACCURATE * force_n:
                break
            last_n = force_n
    electrodes = [
        [ng.Integrate(ng.IfPos(_inside(*square), found[axis], 0) * under, mesh) for axis in range(3)]
        for square in electrode_squares(design).tolist()
    ]
    return force_n, np.array(electrodes) / design.unit.electrode_mm**2, space.ndof


def _inside(x0: float, y0: float, x1: float, y1: float) -> Any:
    """Positive in a rectangle, 0 elsewhere."""
    import ngsolve as ng

    return ng.IfPos((ng.x - x0) * (x1 - ng.x), 1, 0) * ng.IfPos((ng.y - y0) * (y1 - ng.y), 1, 0)


def main() -> None:
    """Print both answers, and the differences, as a Markdown table."""
    print("| times as stiff | at | NGSolve [N] | unknowns | ours: force, electrodes | stated |")
    print("| ---: | --- | ---: | ---: | --- | --- |")
    for contrast in CONTRASTS:
        design = two_by_two(contrast)
        surface, _, _ = surface_compliance(design)
        for name, at_mm in PLACES_MM.items():
            force_n, electrodes, unknowns = pressed_by_ngsolve(design, at_mm)
            ours = press(surface, Sphere(RADIUS_MM), DEPTH_MM, at_mm=at_mm)
            off = np.linalg.norm(ours.electrode_mm.reshape(-1, 3) - electrodes) / np.linalg.norm(electrodes)
            print(
                f"| {contrast:g} | {name} | {force_n:.4f} | {unknowns} | {ours.net_force_n[2] / force_n - 1:+.2%}, "
                f"{off:.2%} | {ours.error_estimate:.1%}, {ours.electrode_error_estimate:.1%} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
