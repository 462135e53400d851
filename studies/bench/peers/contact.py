"""``python -m studies.bench.peers.contact``: a sphere pressed into the paper's slab, by NGSolve and by `fem.contact`.

NGSolve takes a disc as wide as the slab, axially symmetric, third-order triangles that are fine under the sphere, and
Signorini's law by a penalty with its own Newton's method: no kernel, no cells, no grid of the contact in common. The
disc's rim and the square's are 45 mm away or more, more than three decay lengths of the layer.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fem.contact import Sphere, press, surface_compliance
from geometry.design import SensorDesign

ORDER, GRADING = 3, 0.2
PENALTY = 2e5  #: MPa per mm of overlap: at 3 MPa 1.5e-5 mm
FINE, COARSE_MM = 50, 2.0  #: elements along the radius of the contact; size of those far away
AROUND = 1.3  #: of the radius of the contact: how far elements are fine
STEPS, ACCURATE = 40, 1e-8  #: of Newton's method
CASES = ((10.0, 0.5, 2.5), (10.0, 1.5, 4.5), (4.0, 1.0, 2.2), (30.0, 1.0, 6.9))  #: radius, depth, contact's radius [mm]


@dataclass(frozen=True)
class Pressed:
    """Results of one contact."""

    force_n: float
    radius_mm: float
    peak_mpa: float
    unknowns: int


def pressed_by_ngsolve(design: SensorDesign, radius_mm: float, depth_mm: float, contact_mm: float) -> Pressed:
    """A sphere pressed into a disc of the slab's rubber, `contact_mm` about the radius that will touch."""
    import ngsolve as ng
    from netgen import occ

    ng.SetNumThreads(1)
    wide, height = design.slab_mm[0] / 2, design.unit.height_mm
    fine = AROUND * contact_mm
    body = occ.WorkPlane().MoveTo(0, 0).Rectangle(wide, height).Face()
    body.edges.Min(occ.Y).name, body.edges.Min(occ.X).name = "base", "axis"
    inner = occ.WorkPlane().MoveTo(0, height - contact_mm / 2).Rectangle(fine, contact_mm / 2).Face()
    inner.edges.Max(occ.Y).name, inner.edges.Min(occ.X).name = "under", "axis"
    inner.faces.maxh = contact_mm / FINE
    geometry = occ.OCCGeometry(occ.Glue([body - inner, inner]), dim=2)
    mesh = ng.Mesh(geometry.GenerateMesh(maxh=COARSE_MM, grading=GRADING))
    space = ng.VectorH1(mesh, order=ORDER, dirichletx="base|axis", dirichlety="base")
    lame, mu = design.matrix_material.lame_mpa
    u, r = space.TrialFunction(), ng.x
    strain = (ng.Grad(u) + ng.Grad(u).trans) / 2
    hoop = u[0] / r
    volume = ng.Trace(strain) + hoop
    energy = mu * (ng.InnerProduct(strain, strain) + hoop**2) + lame / 2 * volume**2
    underside = r**2 / (radius_mm + ng.sqrt(radius_mm**2 - r**2))

    def overlap(along_z: Any) -> Any:
        return depth_mm - underside + along_z

    form, alone = ng.BilinearForm(space), ng.BilinearForm(space)
    for each in (form, alone):
        each += ng.Variation(2 * np.pi * r * energy * ng.dx)
    over = overlap(u[1])
    form += ng.Variation(PENALTY * np.pi * r * ng.IfPos(over, over**2, 0) * ng.ds("under", bonus_intorder=4))
    found = ng.GridFunction(space)
    residual, step = found.vec.CreateVector(), found.vec.CreateVector()
    for _ in range(STEPS):
        form.Apply(found.vec, residual)
        form.AssembleLinearization(found.vec)
        step.data = form.mat.Inverse(space.FreeDofs(), "sparsecholesky") * residual
        found.vec.data -= step
        if ng.Norm(step) < ACCURATE * ng.Norm(found.vec):
            break
    # work of the body's stress on a field that is 1 on the top and 0 at the base: smoother than the penalty's pressure
    rising = ng.GridFunction(space)
    rising.Set(ng.CoefficientFunction((0, ng.y / height)))
    alone.Apply(found.vec, residual)
    force = -float(ng.InnerProduct(residual, rising.vec))
    places = np.linspace(1e-6, 0.999 * fine, 4000)
    depths = np.array([found(mesh(place, height - 1e-10))[1] for place in places])
    below = depth_mm - places**2 / (radius_mm + np.sqrt(radius_mm**2 - places**2)) + depths
    pressure = PENALTY * np.maximum(below, 0.0)
    peak = float(pressure[: len(places) // 20].max())
    return Pressed(force, float(places[below > 0][-1]), peak, space.ndof)


def main() -> None:
    """Print both answers, and the differences, as a Markdown table."""
    design = SensorDesign()
    surface, _, _ = surface_compliance(design)
    print("| sphere, depth [mm] | NGSolve: force [N], radius [mm], peak [MPa] | unknowns | ours, difference |")
    print("| --- | --- | ---: | --- |")
    for radius_mm, depth_mm, contact_mm in CASES:
        theirs = pressed_by_ngsolve(design, radius_mm, depth_mm, contact_mm)
        ours = press(surface, Sphere(radius_mm), depth_mm)
        errors = (
            ours.net_force_n[2] / theirs.force_n - 1,
            np.sqrt(ours.area_mm2 / np.pi) / theirs.radius_mm - 1,
            ours.peak_mpa / theirs.peak_mpa - 1,
        )
        print(
            f"| {radius_mm:g}, {depth_mm:g} | {theirs.force_n:.3f}, {theirs.radius_mm:.3f}, {theirs.peak_mpa:.4f} "
            f"| {theirs.unknowns} | {', '.join(f'{error:+.2%}' for error in errors)} |"
        )


if __name__ == "__main__":
    main()
