"""``python -m studies.bench.peers.finite_contact``: balls and a punch at finite strain, by NGSolve and ours.

NGSolve takes a disc of rubber as wide as the slab, axially symmetric, third-order triangles that are fine under the
shape, its stored energy as it is written, and the shape by a penalty on how deep the deformed top is inside: no
hexahedra, no pressures, no planes, no compliance in common. Meshes twice as fine with seven times the penalty change
forces of the ball of 5 mm by 0.16 % at most, elements of fourth order by 0.13 %.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from time import process_time
from typing import Any

import numpy as np

from fem.contact import Shape, Sphere, at_finite_strain, press, surface_compliance, why_tangent
from geometry.design import Material, SensorDesign
from geometry.layout import FloatArray, electrode_squares

ORDER, GRADING, COARSE_MM, FINE = 3, 0.2, 2.0, 25  #: of the mesh; elements along the radius of the contact
PENALTY = 500.0  #: MPa per mm of overlap, of rubber of 1 MPa
STEP_MM, LEAST_MM, STEPS, ACCURATE = 0.1, 2e-3, 40, 1e-7  #: of the depth; of Newton's method
DEPTHS_MM = 1.0, 2.0, 10 / 3
RUBBER = Material(young_mpa=1.0, poisson=0.49, model="neo-hookean")
GAUSS, FELT_MM = 5, 20.0  #: points along an electrode; from the middle: farther off the disc is no square


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


SHAPES: dict[str, Sphere | Punch] = {
    "ball of 2 mm": Sphere(2.0), "ball of 5 mm": Sphere(5.0), "ball of 10 mm": Sphere(10.0),
    "punch of 5 mm": Punch(radius_mm=5.0, edge_mm=0.5),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Pressed:
    """Results of one contact."""

    force_n: float
    radius_mm: float
    peak_mpa: float
    electrodes_mm: FloatArray  #: mean displacements (k, 3) of those near


def pressed_by_ngsolve(
    design: SensorDesign, shape: Sphere | Punch, depths_mm: Sequence[float]
) -> Iterator[tuple[float, Pressed]]:
    """A shape pressed into a disc of the slab's rubber, as deep as there is a balance."""
    import ngsolve as ng
    from netgen import occ

    ng.SetNumThreads(1)
    wide, height, rubber = design.slab_mm[0] / 2, design.unit.height_mm, design.matrix_material
    widest = shape.radius_mm if isinstance(shape, Punch) else 1.05 * np.sqrt(2 * shape.radius_mm * depths_mm[-1])
    contact = min(widest, 1.25 * shape.radius_mm)
    fine = 1.25 * contact
    body = occ.WorkPlane().MoveTo(0, 0).Rectangle(wide, height).Face()
    body.edges.Min(occ.Y).name, body.edges.Min(occ.X).name = "base", "axis"
    inner = occ.WorkPlane().MoveTo(0, height - contact / 3).Rectangle(fine, contact / 3).Face()
    inner.edges.Max(occ.Y).name, inner.edges.Min(occ.X).name = "under", "axis"
    inner.faces.maxh = contact / FINE
    geometry = occ.OCCGeometry(occ.Glue([body - inner, inner]), dim=2)
    mesh = ng.Mesh(geometry.GenerateMesh(maxh=COARSE_MM, grading=GRADING))
    space = ng.VectorH1(mesh, order=ORDER, dirichletx="base|axis", dirichlety="base")
    (lame, mu), u, r, depth = rubber.lame_mpa, space.TrialFunction(), ng.x, ng.Parameter(0.0)
    G, hoop = ng.Grad(u), 1 + u[0] / r
    J = ((1 + G[0, 0]) * (1 + G[1, 1]) - G[0, 1] * G[1, 0]) * hoop
    squares = (1 + G[0, 0]) ** 2 + (1 + G[1, 1]) ** 2 + G[0, 1] ** 2 + G[1, 0] ** 2 + hoop**2
    energy = mu / 2 * (squares - 3 - 2 * ng.log(J)) + lame / 2 * (J - 1) ** 2

    def gap(out: Any, up: Any, root: Any, where: Any) -> Any:
        """Of places at a distance from the axis and a height above the shape's lowest point."""
        if isinstance(shape, Sphere):
            return root(out**2 + (shape.radius_mm - up) ** 2) - shape.radius_mm
        beside, over = out - shape.radius_mm + shape.edge_mm, shape.edge_mm - up
        round_edge = root(beside**2 + where(over, over, 0.0) ** 2)
        return where(beside, round_edge, over) - shape.edge_mm

    form, alone = ng.BilinearForm(space, condense=True, symmetric=True), ng.BilinearForm(space)
    for each in (form, alone):
        each += ng.Variation(2 * np.pi * r * energy * ng.dx(bonus_intorder=2))
    apart = gap(r + u[0], u[1] + depth, ng.sqrt, ng.IfPos)
    form += ng.Variation(ng.IfPos(apart, 0, PENALTY * np.pi * r * apart**2) * ng.ds("under", bonus_intorder=6))
    found = ng.GridFunction(space)
    residual, step, last, before, start = (found.vec.CreateVector() for _ in range(5))
    rising = ng.GridFunction(space)
    rising.Set(ng.CoefficientFunction((0, ng.y / height)))

    def balances() -> bool:
        for _ in range(STEPS):
            form.Apply(found.vec, residual)
            form.AssembleLinearization(found.vec)
            residual.data += form.harmonic_extension_trans * residual
            step.data = form.mat.Inverse(space.FreeDofs(True), "sparsecholesky") * residual
            step.data += form.harmonic_extension * step
            step.data += form.inner_solve * residual
            start.data, most, length = found.vec, form.Energy(found.vec), 1.0
            found.vec.data = start - step
            while not form.Energy(found.vec) <= most + 1e-9 * abs(most):
                length /= 2
                if length < 1e-3:
                    return False
                found.vec.data = start - length * step
            if length == 1.0 and ng.Norm(step) < ACCURATE * ng.Norm(found.vec):
                return True
        return False

    reached, size, places = 0.0, STEP_MM, np.linspace(1e-6, 0.9999 * fine, 3000)
    for target in depths_mm:
        while reached < target:
            ahead = min(target, reached + size)
            depth.Set(ahead)
            last.data = found.vec
            if not balances():
                found.vec.data, size = last, size / 2
                if size < LEAST_MM:
                    return
                continue
            reached, before.data = ahead, last
        alone.Apply(found.vec, residual)
        moved = np.array([found(mesh(place, height - 1e-9)) for place in places])
        out = places + moved[:, 0]
        overlap = -gap(out, moved[:, 1] + reached, np.sqrt, lambda sign, one, other: np.where(sign > 0, one, other))
        grown = np.hypot(np.gradient(out, places), np.gradient(moved[:, 1], places)) * out / places
        near = slice(2, len(places) // 40)
        local, _ = np.polynomial.legendre.leggauss(GAUSS)
        electrodes = []
        for x0, y0, x1, y1 in electrode_squares(design)[_is_near(design)].tolist():
            x, y = ((low + high) / 2 + (high - low) / 2 * local for low, high in ((x0, x1), (y0, y1)))
            weights = np.outer(*(np.polynomial.legendre.leggauss(GAUSS)[1],) * 2) / 4
            mean = np.zeros(3)
            for (j, i), weight in np.ndenumerate(weights):
                far = float(np.hypot(x[i], y[j]))
                along, up = found(mesh(min(far, wide - 1e-6), height - 1e-9))
                mean += weight * np.array([along * x[i] / far, along * y[j] / far, up])
            electrodes.append(mean)
        yield (
            target,
            Pressed(
                force_n=-float(ng.InnerProduct(residual, rising.vec)),
                radius_mm=float(out[overlap > 0][-1]),
                peak_mpa=float(np.median((PENALTY * np.maximum(overlap, 0.0) / grown)[near])),
                electrodes_mm=np.array(electrodes),
            ),
        )


def main() -> None:
    """Print both answers, and the differences, as a Markdown table."""
    design = replace(SensorDesign(), matrix_material=RUBBER, pillar_material=RUBBER)
    surface, _, _ = surface_compliance(design)
    print("| shape, depth [mm] | NGSolve: force [N], radius [mm], peak [MPa] | linear | finite: stated | CPU s |")
    print("| --- | --- | --- | --- | ---: |")
    for name, shape in SHAPES.items():
        for depth_mm, theirs in pressed_by_ngsolve(design, shape, DEPTHS_MM):
            linear, start = press(surface, shape, depth_mm), process_time()
            cells = [_errors(linear, theirs), f"left as it is: {why_tangent(linear)}"]
            if why_tangent(linear) is None:
                ours = at_finite_strain(linear)
                stated = f"{ours.error_estimate:.1%}, {ours.electrode_error_estimate:.1%}"
                cells[1] = f"{_errors(ours, theirs)}: {stated}"
            truth = f"{theirs.force_n:.3f}, {theirs.radius_mm:.3f}, {theirs.peak_mpa:.4f}"
            print(
                f"| {name}, {depth_mm:.3g} | {truth} | {' | '.join(cells)} | {process_time() - start:.1f} |", flush=True
            )


def _is_near(design: SensorDesign) -> Any:
    """Electrodes that are compared, (k,)."""
    squares = electrode_squares(design)
    return np.hypot(*((squares[:, :2] + squares[:, 2:]) / 2).T) < FELT_MM


def _errors(ours: Any, theirs: Pressed) -> str:
    """Of force, radius, peak and electrodes."""
    own, true = ours.electrode_mm.reshape(-1, 3)[_is_near(ours.design)], theirs.electrodes_mm
    off = np.linalg.norm(own - true) / np.linalg.norm(true)
    radius = np.sqrt(ours.area_mm2 / np.pi) / theirs.radius_mm - 1
    found = ours.net_force_n[2] / theirs.force_n - 1, radius, ours.peak_mpa / theirs.peak_mpa - 1
    return ", ".join(f"{error:+.1%}" for error in found) + f", {off:.1%}"


if __name__ == "__main__":
    main()
