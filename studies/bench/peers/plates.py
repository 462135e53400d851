"""``python -m studies.bench.peers.plates``: shapes pressed on 2 × 2 rigid plates, by NGSolve and by `fem.contact`.

NGSolve takes the whole slab in tetrahedra, whose top follows six numbers a plate by a penalty: no condensed cell, no
tiles and no kernel in common. Its answers to these numbers and to pressures on small squares between plates are put
together by an active set; faces of plates give as `fem.contact` says, on a fine raster. Its displacements then deform
the pillars of the unit that is pressed most, in which it solves conduction on another mesh.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from dataset.indentation import contact_lengths
from dataset.resistance import exact_resistances, pillar_lengths, rest_resistances
from fem.conduction.potentials import pillars_per_mm
from fem.contact import Convex, Shape, Sphere, SurfaceCompliance, press, surface_compliance
from geometry.design import EQUATIONS, Array, Electrics, Pad, Plate, SensorDesign
from geometry.layout import FloatArray, electrode_squares, pad_squares, unit_centres
from studies.bench.peers.conduction import VOXEL_MM, Deformed, NgsolveUnit

ORDER, LARGEST_MM = 3, 5.0  #: of elements, and their size before they are refined
LEVELS, RATIO = 2, 0.15  #: of geometric refinement toward edges of plates
SQUARE_MM, RASTER_MM = 0.75, 0.05  #: of pressures between plates, and on plates
BOND = 1e6  #: MPa per mm, of plates to the rubber
STEPS = 60  #: of the active set
CELLS = 96  #: of our grid
DESIGN = SensorDesign(array=Array(rows=2, cols=2), pad=Pad(kind="stiff", plate=Plate(thickness_mm=0.4)))
BOX = Convex.hull(np.array([(x, y, z) for x in (-9.0, 9.0) for y in (-6.0, 6.0) for z in (0.0, 10.0)]))
TILTED = replace(BOX, turn=Rotation.from_euler("xyz", [4.0, 6.0, 20.0], degrees=True).as_matrix())
#: shape, depth, place, and the rectangle that it touches [mm]
CASES: dict[str, tuple[Shape, float, tuple[float, float], tuple[float, float, float, float]]] = {
    "ball over a crossing": (Sphere(6.0), 1.5, (0.5, 1.0), (-4.5, -4.5, 4.5, 5.25)),
    "tilted box": (TILTED, 1.2, (1.0, 2.0), (-1.5, -7.5, 12.0, 7.5)),
}


@dataclass(frozen=True)
class PressedPlates:
    """Results of one press."""

    net_n: float
    wrench: FloatArray  #: (plates, 3): force down [N], and ∫ x p, ∫ y p about the plate's middle [N mm]
    electrode_mm: FloatArray  #: (rows, cols, n_upper, 3)
    unknowns: int
    resistance: FloatArray  #: of the pillars of the unit that is pressed most, over that at rest, (n_pillars,)


def squares_between(near_mm: tuple[float, float, float, float]) -> FloatArray:
    """Squares (n, 4) of a rectangle that lie on no plate."""
    x0, y0, x1, y1 = near_mm
    x, y = np.arange(x0, x1 - 1e-9, SQUARE_MM), np.arange(y0, y1 - 1e-9, SQUARE_MM)
    low = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    middle = low + SQUARE_MM / 2
    on = [((middle > plate[:2]) & (middle < plate[2:])).all(axis=1) for plate in pad_squares(DESIGN)]
    return np.hstack([low, low + SQUARE_MM])[~np.any(on, axis=0)]


class NgsolvePlates:
    """The slab with its plates and squares of a rectangle between them, as NGSolve meshes and solves it.

    `compliance` has motions of the plates (24) and mean rise of squares (n) by wrenches and by forces up on squares.
    """

    def __init__(self, squares: FloatArray) -> None:
        import ngsolve as ng
        from netgen.occ import Box, Glue, OCCGeometry, Pnt

        from studies.bench.peers.ngsolve_peer import _face

        ng.SetNumThreads(1)
        (x, y, h), plates = DESIGN.slab_mm, pad_squares(DESIGN).tolist()
        parts = [Box(Pnt(-x / 2, -y / 2, 0), Pnt(x / 2, y / 2, h))]
        for corners in [*plates, *squares.tolist()]:
            parts.append(_face(corners, h))
        for edge in (edge for part in parts[1:5] for edge in part.edges):
            edge.hpref = 1
        body = Glue(parts)
        for face in body.faces:
            if abs(face.center.z) < 1e-9:
                face.name = "base"
            elif abs(face.center.z - h) < 1e-9:
                place = np.array([face.center.x, face.center.y])
                names = [(f"plate{k}", plate) for k, plate in enumerate(plates)]
                names += [(f"square{k}", square) for k, square in enumerate(squares.tolist())]
                for name, (x0, y0, x1, y1) in names:
                    if x0 < place[0] < x1 and y0 < place[1] < y1:
                        face.name = name
        self.mesh = mesh = ng.Mesh(OCCGeometry(body).GenerateMesh(maxh=LARGEST_MM, grading=0.5))
        mesh.RefineHP(LEVELS, factor=RATIO)
        self.space = space = ng.VectorH1(mesh, order=ORDER, dirichlet="base")
        lame, mu = DESIGN.matrix_material.lame_mpa
        u, v = space.TnT()
        a = ng.BilinearForm(space, symmetric=True)
        a += (2 * mu * ng.InnerProduct(ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))) + lame * ng.div(u) * ng.div(v)) * ng.dx
        a += BOND * u * v * ng.ds("plate.*")
        a.Assemble()
        self._inverse = a.mat.Inverse(space.FreeDofs(), "sparsecholesky")
        loads, own = [], np.zeros((24 + len(squares), 24 + len(squares)))
        for k, (cx, cy) in enumerate(unit_centres(DESIGN).tolist()):
            p, q, where = ng.x - cx, ng.y - cy, mesh.Boundaries(f"plate{k}")
            motions = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, q), (0, 0, -p), (-q, p, 0)]
            for i, one in enumerate(motions):
                loads.append(ng.LinearForm(BOND * ng.CF(one) * v * ng.ds(f"plate{k}")).Assemble())
                for j, other in enumerate(motions):
                    both = ng.InnerProduct(ng.CF(one), ng.CF(other))
                    own[6 * k + i, 6 * k + j] = BOND * ng.Integrate(both, mesh, ng.BND, order=4, definedon=where)
        for k in range(len(squares)):
            loads.append(ng.LinearForm(v[2] / SQUARE_MM**2 * ng.ds(f"square{k}")).Assemble())
        moved, found = a.mat.CreateColVector(), np.zeros_like(own)
        for j, load in enumerate(loads):
            moved.data = self._inverse * load.vec
            found[:, j] = [ng.InnerProduct(other.vec, moved) for other in loads]
        self._loads = loads
        # plates: S m = w + B p; squares: Bᵀ m + C p
        S, B, C = own[:24, :24] - found[:24, :24], found[:24, 24:], found[24:, 24:]
        by_wrench = np.linalg.inv(S)
        half = by_wrench @ B
        self.compliance = np.block([[by_wrench, half], [half.T, C + B.T @ half]])

    def deformed(self, motions: FloatArray, pressing_n: FloatArray, unit: int) -> Deformed:
        """Gradients on a lattice around a unit, of motions of the plates (24,) and forces down on squares (n,).

        They are scaled so that J F⁻¹F⁻ᵀ has the volume change of linear elasticity, div u, as ours has.
        """
        import ngsolve as ng

        u = ng.GridFunction(self.space)
        total = u.vec.CreateVector()
        total[:] = 0.0
        for share, load in zip([*motions, *-pressing_n], self._loads, strict=True):
            total.data += float(share) * load.vec
        u.vec.data = self._inverse * total
        reach, height = DESIGN.unit.footprint_mm / 2, DESIGN.unit.height_mm
        ends = ((-reach, reach), (-reach, reach), (VOXEL_MM, height - VOXEL_MM))
        lines = tuple(np.linspace(low, high, 1 + round((high - low) / VOXEL_MM)) for low, high in ends)
        places = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
        at = places + np.append(unit_centres(DESIGN)[unit], 0.0)
        H = np.array(ng.Grad(u)(self.mesh(*at.T))).reshape(*(len(line) for line in lines), 3, 3)
        F = np.eye(3) + H
        scale = (1 + np.trace(H, axis1=-2, axis2=-1)) / np.linalg.det(F)
        return Deformed(lines, F * scale[..., None, None], np.zeros(3))


def pressed_by_ngsolve(
    shape: Shape, depth_mm: float, at_mm: tuple[float, float], near_mm: tuple[float, float, float, float]
) -> PressedPlates:
    """Press a shape on the plates of `DESIGN` without friction, by an active set."""
    squares, centres = squares_between(near_mm), unit_centres(DESIGN)
    slab = NgsolvePlates(squares)
    C = slab.compliance
    x0, y0, x1, y1 = near_mm
    raster = [np.arange(low, high, RASTER_MM) + RASTER_MM / 2 for low, high in ((x0, x1), (y0, y1))]
    x, y = (each.ravel() for each in np.meshgrid(*raster))
    rows, below = [], []
    for k, (plate, centre) in enumerate(zip(pad_squares(DESIGN), centres, strict=True)):
        own = (x > plate[0]) & (x < plate[2]) & (y > plate[1]) & (y < plate[3])
        row = np.zeros((own.sum(), 24))  # rise of points by motions
        row[:, 6 * k + 2], row[:, 6 * k + 3], row[:, 6 * k + 4] = 1.0, y[own] - centre[1], centre[0] - x[own]
        rows.append(row)
        below.append(depth_mm - shape.heights_mm(x[own] - at_mm[0], y[own] - at_mm[1]))
    R, over = np.vstack(rows), np.concatenate(below)
    at = (squares[:, :2] + squares[:, 2:]) / 2
    over_square = depth_mm - DESIGN.pad.plate.thickness_mm - shape.heights_mm(at[:, 0] - at_mm[0], at[:, 1] - at_mm[1])
    spring = RASTER_MM**2 / DESIGN.pad.plate.face_mm_per_mpa
    on, on_square, m = over > 0, np.zeros(len(squares), dtype=bool), np.zeros(24)
    p = np.zeros(len(squares))  # forces down
    for _ in range(STEPS):
        # m = −C (Rᵀ spring (over + R m) + p): linear for the cells that touch; rise of squares that do is −over
        K = spring * R[on].T @ R[on]
        A, rhs = np.eye(24) + C[:24, :24] @ K, -C[:24, :24] @ (spring * R[on].T @ over[on])
        a = np.flatnonzero(on_square)
        whole = np.block([[A, C[:24, 24 + a]], [C[24 + a, :24] @ K, C[np.ix_(24 + a, 24 + a)]]])
        given = np.concatenate([rhs, over_square[a] - C[24 + a, :24] @ (spring * R[on].T @ over[on])])
        both = np.linalg.solve(whole, given)
        m, p = both[:24], np.zeros(len(squares))
        p[a] = both[24:]
        wrench = spring * R[on].T @ (over[on] + R[on] @ m)
        rise = -(C[24:, :24] @ wrench + C[24:, 24:] @ p)
        now, now_square = over + R @ m > 0, np.where(on_square, p > 0, over_square + rise > 1e-9)
        if (now == on).all() and (now_square == on_square).all():
            break
        on, on_square = now, now_square
    found = np.stack([wrench.reshape(4, 6)[:, 2], -wrench.reshape(4, 6)[:, 4], wrench.reshape(4, 6)[:, 3]], axis=1)
    electrodes = np.zeros((4, len(DESIGN.unit.layout.upper), 3))
    for k, square in enumerate(electrode_squares(DESIGN)):
        plate, number = divmod(k, electrodes.shape[1])
        own, (a, b) = m[6 * plate : 6 * plate + 6], (square[:2] + square[2:]) / 2 - centres[plate]
        electrodes[plate, number] = own[0] - own[5] * b, own[1] + own[5] * a, own[2] + own[3] * b - own[4] * a
    most = int(found[:, 0].argmax())
    unit = NgsolveUnit(DESIGN.unit)
    loaded, rest = (
        pillars_per_mm(unit.conductances(state), DESIGN.unit.layout.pillar_terminals)
        for state in (slab.deformed(m, p, most), None)
    )
    net_n = float(p.sum() + found[:, 0].sum())
    return PressedPlates(net_n, found, electrodes.reshape(2, 2, -1, 3), int(slab.space.ndof), loaded / rest)


def pressed_here(
    surface: SurfaceCompliance, shape: Shape, depth_mm: float, at_mm: tuple[float, float], cells: int
) -> PressedPlates:
    """The same by `fem.contact`."""
    contact = press(surface, shape, depth_mm, at_mm=at_mm, cells=cells)
    patch, pressing = contact.patch, contact.cell_force_n[2]
    x, y = np.broadcast_arrays(patch.x_mm, patch.y_mm[:, None])
    wrench = np.zeros((4, 3))
    for k, (plate, (cx, cy)) in enumerate(zip(pad_squares(DESIGN), unit_centres(DESIGN), strict=True)):
        own = pressing * ((x > plate[0]) & (x < plate[2]) & (y > plate[1]) & (y < plate[3]))
        wrench[k] = own.sum(), (own * (x - cx)).sum(), (own * (y - cy)).sum()
    most = int(wrench[:, 0].argmax())
    of_conduction = contact_lengths([contact])
    lengths = pillar_lengths(contact.electrode_mm, DESIGN.unit)[None] if of_conduction is None else of_conduction
    at_rest = rest_resistances(contact.design)
    ratio = exact_resistances(lengths, contact.design).reshape(4, -1)[most] / at_rest
    return PressedPlates(float(pressing.sum()), wrench, contact.electrode_mm, 0, ratio)


def main() -> None:
    """Print both answers, and the differences, as Markdown tables."""
    surfaces = [surface_compliance(replace(DESIGN, electrics=Electrics(model=model)))[0] for model in EQUATIONS]
    print("| press | NGSolve: force, of it between plates [N] | unknowns | ours off: force, wrenches, electrodes |")
    print("| --- | --- | ---: | --- |")
    read = []
    for name, (shape, depth_mm, at_mm, near_mm) in CASES.items():
        theirs = pressed_by_ngsolve(shape, depth_mm, at_mm, near_mm)
        by_eq1, ours = (pressed_here(surface, shape, depth_mm, at_mm, CELLS) for surface in surfaces)
        arms = np.array([1.0, 1 / 6.0, 1 / 6.0])
        pairs = ((ours.wrench * arms, theirs.wrench * arms), (ours.electrode_mm, theirs.electrode_mm))
        off = [np.linalg.norm(one - other) / np.linalg.norm(other) for one, other in pairs]
        print(
            f"| {name} | {theirs.net_n:.3f}, {theirs.net_n - theirs.wrench[:, 0].sum():.3f} | {theirs.unknowns} "
            f"| {ours.net_n / theirs.net_n - 1:+.2%}, {', '.join(f'{one:.2%}' for one in off)} |",
            flush=True,
        )
        each = (theirs.resistance - 1, ours.resistance - theirs.resistance, by_eq1.resistance - theirs.resistance)
        read.append(f"| {name} | {' | '.join(', '.join(f'{one:+.2%}' for one in values) for values in each)} |")
    print("\n| pillars of the unit pressed most | NGSolve: R over rest − 1 | ours off | eq. 1 off |")
    print("\n".join(["| --- | --- | --- | --- |", *read]))


if __name__ == "__main__":
    main()
