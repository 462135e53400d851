"""``python -m studies.bench.peers.conduction``: conduction in a unit's pillars against NGSolve, at rest and pressed.

NGSolve's own mesh of the union of three prisms, hp-refined toward the edges of the electrodes and the crotches, its own
functions and its own algebra for J F⁻¹F⁻ᵀ. Deformations come from `fem.finite`, on a lattice between whose points both
codes interpolate linearly. Also printed: by how much eq. 1 overstates the change of resistance.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from dataset.resistance import pillar_lengths
from fem.conduction import unit_conductances
from fem.conduction.potentials import pillars_per_mm
from fem.finite.samples import gradients
from fem.finite.solving import solve_finite
from fem.kernel.loads import DeadLoad, Load, StiffLoad
from fem.scene.scene import Probe, Scene, Sensor
from geometry.design import Array, Pad, SensorDesign, Unit, with_model
from geometry.layout import (
    FloatArray,
    electrode_centres,
    electrode_squares,
    pad_squares,
    pillar_volumes,
    unit_centres,
)
from geometry.prism import pillar_prisms

ORDER, LEVELS, RATIO = 4, 3, 0.15  #: of NGSolve's functions and of its refinement
MORE_POINTS = 4  #: order of its quadrature above what the rest state needs
VOXEL_MM = 0.25  #: of the lattice that holds a deformation

Shear = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Pressed:
    """A finite-strain state: all pads of an array under the same load, seen at its first unit."""

    name: str
    kind: str  #: of the pads
    pressure_mpa: float
    shear_mpa: Shear = (0.0, 0.0)
    units: int = 1  #: along each side of the array
    tolerance: float = 1.5e-2


STATES = (
    Pressed(name="stiff, 2 MPa", kind="stiff", pressure_mpa=2.0),
    Pressed(name="stiff, 2.5 MPa, shear 0.2 and 0.15", kind="stiff", pressure_mpa=2.5, shear_mpa=(0.2, 0.15)),
    Pressed(name="soft, 2 MPa", kind="soft", pressure_mpa=2.0),
)


@dataclass(frozen=True, eq=False)
class Deformed:
    """Deformation gradients on a lattice around a unit, and what its electrodes make of it."""

    lines: tuple[FloatArray, ...]  #: evenly spaced, in the unit's frame [mm]
    F: FloatArray  #: (nx, ny, nz, 3, 3)
    length_mm: FloatArray  #: of the z, x and y pillars, (3,)

    def __call__(self, points: FloatArray) -> FloatArray:
        inside = np.clip(points, [line[0] for line in self.lines], [line[-1] for line in self.lines])
        return np.asarray(RegularGridInterpolator(self.lines, self.F)(inside))


def deformed(pressed: Pressed) -> Deformed:
    """The first unit's deformation by `fem.finite`."""
    own = Array(rows=pressed.units, cols=pressed.units)
    design = with_model(SensorDesign(array=own, pad=Pad(kind=pressed.kind)), "neo-hookean")
    size = (design.pad.size_mm,) * 2
    traction = np.array([*pressed.shear_mpa, -pressed.pressure_mpa])
    loads: list[Load] = []
    for x0, y0, x1, y1 in pad_squares(design).tolist():
        middle = ((x0 + x1) / 2, (y0 + y1) / 2)
        if pressed.kind == "stiff":
            loads.append(StiffLoad(center_mm=middle, size_mm=size, force_n=tuple(traction * size[0] * size[1])))
        else:
            loads.append(DeadLoad(center_mm=middle, size_mm=size, traction_mpa=tuple(traction)))
    x, y = electrode_squares(design)[:2].reshape(2, 2, 2).mean(axis=1).T
    electrode = (design.unit.electrode_mm,) * 2
    scene = Scene(
        body=Sensor(design=design),
        material=design.matrix_material,
        loads=tuple(loads),
        probes=tuple(
            Probe(name=name, kind="mean", center_mm=(float(x[k]), float(y[k])), size_mm=electrode)
            for k, name in enumerate(Unit().layout.upper_names)
        ),
        tolerance=pressed.tolerance,
    )
    found = solve_finite(scene, with_field=True)
    assert found.field is not None
    field = found.field
    centre = np.append(unit_centres(design)[0], 0.0)
    reach, height = design.unit.footprint_mm / 2, design.unit.height_mm
    ends = ((-reach, reach), (-reach, reach), (VOXEL_MM, height - VOXEL_MM))  # plates' edges have no strain
    lines = tuple(np.linspace(low, high, 1 + round((high - low) / VOXEL_MM)) for low, high in ends)
    places = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)
    slopes = field.slopes(places.reshape(-1, 3) + centre)
    F = np.eye(3) + gradients(slopes, field.displacement_mm[None])[0]
    moved = np.array([found.probes[name] for name in Unit().layout.upper_names])
    return Deformed(lines, F.reshape(*places.shape, 3), pillar_lengths(moved, design.unit))


class NgsolveUnit:
    """A unit's pillars as NGSolve meshes and solves them."""

    def __init__(self, unit: Unit, order: int = ORDER, levels: int = LEVELS) -> None:
        import ngsolve as ng
        from netgen.occ import Glue, OCCGeometry

        from studies.bench.peers.ngsolve_peer import _face, _solid

        alone = SensorDesign(unit=unit, array=Array(rows=1, cols=1))
        one, *others = [_solid(prism) for prism in pillar_prisms(alone)]
        for other in others:
            one = one + other
        h, e, self.names = unit.height_mm, unit.electrode_mm / 2, unit.layout.terminals
        places = dict(zip(self.names, electrode_centres(unit).tolist(), strict=True))
        shape = Glue([one, *[_face((x - e, y - e, x + e, y + e), z) for x, y, z in places.values()]])
        for face in shape.faces:
            for name, (x, y, z) in places.items():
                inside = abs(face.center.x - x) < e * 0.1 and abs(face.center.y - y) < e * 0.1
                if inside and abs(face.center.z - z) < 1e-6 * h:
                    face.name = name
                    for edge in face.edges:
                        edge.hpref = 1
        for edge in shape.edges:  # crotches are level, and lie between the ends
            if abs(edge.start.z - edge.end.z) < 1e-6 * h and 1e-6 * h < edge.center.z < h * (1 - 1e-6):
                edge.hpref = 1
        self.mesh = ng.Mesh(OCCGeometry(shape).GenerateMesh(maxh=1.5, grading=0.5))
        self.mesh.RefineHP(levels, factor=RATIO)
        self.space = ng.H1(self.mesh, order=order, dirichlet="|".join(self.names))

    def conductances(self, deformation: Deformed | None) -> FloatArray:
        """The matrix of `fem.conduction.Conductances` [mm]."""
        import ngsolve as ng

        u, v = self.space.TnT()
        sigma: Any = ng.Id(3)
        if deformation is not None:
            low, high = zip(*[(line[0], line[-1]) for line in deformation.lines], strict=True)
            values = deformation.F.transpose(2, 1, 0, 3, 4)  # NGSolve's voxels run x fastest
            parts = [
                ng.VoxelCoefficient(low, high, np.ascontiguousarray(values[..., a, b]), linear=True)
                for a, b in np.ndindex(3, 3)
            ]
            F = ng.CF(tuple(parts), dims=(3, 3))
            sigma = ng.Det(F) * ng.Inv(F) * ng.Inv(F).trans
        form = ng.BilinearForm(self.space, symmetric=True, condense=True)
        form += (sigma * ng.grad(u)) * ng.grad(v) * ng.dx(bonus_intorder=MORE_POINTS)
        form.Assemble()
        inverse = form.mat.Inverse(self.space.FreeDofs(True), inverse="sparsecholesky")
        found = []
        for name in self.names:
            phi = ng.GridFunction(self.space)
            phi.Set(1.0, definedon=self.mesh.Boundaries(name))
            rest = phi.vec.CreateVector()
            rest.data = form.mat * phi.vec
            phi.vec.data -= inverse * rest
            found.append(phi)
        G = np.empty((len(found), len(found)))
        for i, phi in enumerate(found):
            rest = phi.vec.CreateVector()
            rest.data = form.mat * phi.vec
            for j, other in enumerate(found):
                G[i, j] = ng.InnerProduct(rest, other.vec)
        return G


def main(write: Callable[[str], Any] = print) -> None:
    """Print the table."""
    unit = Unit()
    peer = NgsolveUnit(unit)
    coarser = NgsolveUnit(unit, ORDER - 1, LEVELS - 1)
    write(f"NGSolve: {peer.space.ndof} unknowns, order {ORDER}; {coarser.space.ndof}, order {ORDER - 1}")
    rest = unit_conductances(unit).pillars_per_mm
    for pressed in (None, *STATES):
        deformation = None if pressed is None else deformed(pressed)
        ours = unit_conductances(unit, deformation)
        theirs, check = (pillars_per_mm(one.conductances(deformation), ours.pairs) for one in (peer, coarser))
        write(f"{'at rest' if pressed is None else pressed.name}")
        write(f"  R/ρ of z, x, y [1/mm]     {ours.pillars_per_mm}  estimated error {ours.error_estimate}")
        write(f"  NGSolve                   {theirs}  its coarser mesh off by {check / theirs - 1}")
        write(f"  ours over NGSolve − 1     {ours.pillars_per_mm / theirs - 1}")
        if deformation is not None:
            length = deformation.length_mm
            relaxed = pillar_lengths(np.zeros((2, 3)), unit)
            eq1 = (length / relaxed) ** 2 - 1
            change = ours.pillars_per_mm / rest - 1
            write(f"  ΔR/R: eq. 1 {eq1}, conduction {change}: overstated by {eq1 / change - 1}")
            volumes = pillar_volumes(unit)
            absolute = (length**2 - relaxed**2) / volumes
            write(f"  ΔR of eq. 1 over ΔR of conduction − 1: {absolute / (ours.pillars_per_mm - rest) - 1}")


if __name__ == "__main__":
    main()
