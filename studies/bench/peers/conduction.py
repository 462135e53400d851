"""Conduction in a unit's pillars against NGSolve, at rest and pressed.

NGSolve's own mesh of the union of three prisms, hp-refined toward the edges of the electrodes and the crotches, its own
functions and its own algebra for J F⁻¹F⁻ᵀ. Deformations come from `fem.finite`, on a lattice between whose points both
codes interpolate linearly. Also told: by how much eq. 1 overstates the change of resistance.
"""

from collections.abc import Iterator
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
from geometry.layout import FloatArray, electrode_centres, electrode_squares
from geometry.prism import Triple, pillar_prisms
from studies.bench.peers.ngsolve_tools import face, solid
from studies.tables import Row

ORDER, LEVELS, RATIO = 4, 3, 0.15  #: of NGSolve's functions and of its refinement
MORE_POINTS = 4  #: order of its quadrature above what the rest state needs
VOXEL_MM = 0.25  #: of the lattice that holds a deformation
TOLERANCE = 1.5e-2  #: of the deformation
#: finite-strain states: kind of the pad, and its traction [MPa]
STATES: dict[str, tuple[str, Triple]] = {
    "stiff, 2 MPa": ("stiff", (0.0, 0.0, -2.0)),
    "stiff, 2.5 MPa, shear 0.2 and 0.15": ("stiff", (0.2, 0.15, -2.5)),
    "soft, 2 MPa": ("soft", (0.0, 0.0, -2.0)),
}


@dataclass(frozen=True, eq=False)
class Deformed:
    """Deformation gradients on a lattice around a unit, and what its electrodes make of it."""

    lines: tuple[FloatArray, ...]  #: evenly spaced, in the unit's frame [mm]
    F: FloatArray  #: (nx, ny, nz, 3, 3)
    length_mm: FloatArray  #: of the pillars

    def __call__(self, points: FloatArray) -> FloatArray:
        within = np.clip(points, [line[0] for line in self.lines], [line[-1] for line in self.lines])
        return np.asarray(RegularGridInterpolator(self.lines, self.F)(within))


def deformed(kind: str, traction_mpa: Triple) -> Deformed:
    """A lone unit under a traction on its pad, by `fem.finite`."""
    alone = SensorDesign(array=Array(rows=1, cols=1), pad=Pad(kind=kind))
    design, side = with_model(alone, "neo-hookean"), alone.pad.size_mm
    x_n, y_n, z_n = (one * side**2 for one in traction_mpa)
    load: Load = DeadLoad(center_mm=(0.0, 0.0), size_mm=(side, side), traction_mpa=traction_mpa)
    if kind == "stiff":
        load = StiffLoad(center_mm=(0.0, 0.0), size_mm=(side, side), force_n=(x_n, y_n, z_n))
    unit, electrode = design.unit, (design.unit.electrode_mm,) * 2
    middles = electrode_squares(design).reshape(-1, 2, 2).mean(axis=1).tolist()
    probes = tuple(
        Probe(name=name, kind="mean", center_mm=(x, y), size_mm=electrode)
        for name, (x, y) in zip(unit.layout.upper_names, middles, strict=True)
    )
    scene = Scene(
        body=Sensor(design=design), material=design.matrix_material, loads=(load,), probes=probes, tolerance=TOLERANCE
    )
    found = solve_finite(scene, with_field=True)
    field, reach, height = found.field, unit.footprint_mm / 2, unit.height_mm
    assert field is not None
    ends = ((-reach, reach), (-reach, reach), (VOXEL_MM, height - VOXEL_MM))  # plates' edges have no strain
    lines = tuple(np.linspace(low, high, 1 + round((high - low) / VOXEL_MM)) for low, high in ends)
    places = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)
    F = np.eye(3) + gradients(field.slopes_at(places.reshape(-1, 3)), field.displacement_mm[None])[0]
    moved = np.array([found.probes[name] for name in unit.layout.upper_names])
    return Deformed(lines, F.reshape(*places.shape, 3), pillar_lengths(moved, unit))


class NgsolveUnit:
    """A unit's pillars as NGSolve meshes and solves them."""

    def __init__(self, unit: Unit, order: int = ORDER, levels: int = LEVELS) -> None:
        import ngsolve as ng
        from netgen.occ import Glue, OCCGeometry

        one, *others = [solid(prism) for prism in pillar_prisms(SensorDesign(unit=unit, array=Array(rows=1, cols=1)))]
        for other in others:
            one = one + other
        h, e, self.names = unit.height_mm, unit.electrode_mm / 2, unit.layout.terminals
        places = dict(zip(self.names, electrode_centres(unit).tolist(), strict=True))
        shape = Glue([one, *[face((x - e, y - e, x + e, y + e), z) for x, y, z in places.values()]])
        for each in shape.faces:
            for name, place in places.items():
                if np.abs(np.array([*each.center]) - place).max() < 1e-6 * h:
                    each.name = name
                    for edge in each.edges:
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
        potentials, currents = [], []
        for name in self.names:
            phi = ng.GridFunction(self.space)
            phi.Set(1.0, definedon=self.mesh.Boundaries(name))
            phi.vec.data -= inverse * (form.mat * phi.vec).Evaluate()
            potentials.append(phi)
            currents.append((form.mat * phi.vec).Evaluate())
        return np.array([[ng.InnerProduct(current, phi.vec) for phi in potentials] for current in currents])


def rows() -> Iterator[Row]:
    """A row for each state: what NGSolve finds, how far its coarser mesh and ours are from it, and eq. 1 [%]."""
    unit = Unit()
    peer, coarser = NgsolveUnit(unit), NgsolveUnit(unit, ORDER - 1, LEVELS - 1)
    rest, relaxed = unit_conductances(unit).pillars_per_mm, pillar_lengths(np.zeros((2, 3)), unit)
    for name in ("at rest", *STATES):
        deformation = deformed(*STATES[name]) if name in STATES else None
        ours = unit_conductances(unit, deformation)
        theirs, check = (pillars_per_mm(one.conductances(deformation), ours.pairs) for one in (peer, coarser))
        row: dict[str, Any] = {
            "state": name,
            "NGSolve: R/ρ of z / x / y [1/mm]": theirs.tolist(),
            "its coarser mesh off [%]": (100 * (check / theirs - 1)).tolist(),
            "ours off [%]": (100 * (ours.pillars_per_mm / theirs - 1)).tolist(),
        }
        if deformation is not None:
            by_eq1 = (deformation.length_mm / relaxed) ** 2 - 1
            overstated = by_eq1 / (ours.pillars_per_mm / rest - 1) - 1
            row["eq. 1 overstates the change by [%]"] = (100 * overstated).tolist()
        yield row
