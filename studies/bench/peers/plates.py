"""``python -m studies.bench.peers.plates``: shapes pressed on 2 × 2 rigid plates, by NGSolve and by `fem.contact`.

NGSolve takes the slab in tetrahedra that conform to its plates and are hp-refined toward their edges: no condensed
cell, no ports, no tiles, no kernel and no grid in common. The slab is its own mirror image in x and in y, so that a
quarter is solved in four parities. Plates move by six numbers each; these and forces on small squares of the rubber
between plates make one compliance. Contact is then found by an active set of these squares and of springs on a raster
of the plates' faces, which give as `fem.contact` says. Each press is solved three times, as `reference.py` does: as
finely as `FINE` says, with an order less, and coarser; the larger distance from the first is the peer's own error. Its
displacements then deform the pillars of the unit that is pressed most, in which it solves conduction on another mesh.
"""

from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from cyclopts.validators import Number
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from dataset.indentation import contact_lengths
from dataset.resistance import exact_resistances, pillar_lengths, rest_resistances
from fem.conduction.potentials import pillars_per_mm
from fem.contact import Convex, Flat, Shape, Sphere, SurfaceCompliance, press, surface_compliance
from fem.contact.driver import CELLS
from geometry.design import Array, Electrics, Pad, Plate, SensorDesign
from geometry.layout import FloatArray, electrode_squares, pad_squares, unit_centres
from studies.bench.peers.conduction import VOXEL_MM, Deformed, NgsolveUnit
from studies.program import run_alone
from studies.tables import Row, measured_on, report

LARGEST_MM = 5.0  #: of elements before they are refined
RATIO = 0.15  #: of the distances of neighbouring levels
REACH_MM = 10.5  #: from the slab's middle: how far rubber between plates may be touched
STEPS = 100  #: of the active set
NEAR = 3.0  #: depths below which points of plates may touch
PASSES = 30  #: over the place of a shape that drags plates along
SETTLED_MM = 1e-6  #: of that place
DESIGN = SensorDesign(array=Array(rows=2, cols=2), pad=Pad(kind="stiff", plate=Plate(thickness_mm=0.4)))
BOX = Convex.hull(np.array([(x, y, z) for x in (-9.0, 9.0) for y in (-6.0, 6.0) for z in (0.0, 10.0)]))
TILTED = replace(BOX, turn=Rotation.from_euler("xyz", [4.0, 6.0, 20.0], degrees=True).as_matrix())
#: of a plate's motions in the mirrors x = 0 and y = 0: shifts are vectors, turns are axial ones
MIRRORED = np.array([[-1, 1, 1, 1, -1, -1], [1, -1, 1, -1, 1, -1]])


@dataclass(frozen=True)
class Fineness:
    """How finely the peer solves."""

    order: int  #: of displacements; of pressures, which are discontinuous, two less
    levels: int  #: of geometric refinement toward edges of plates, and of the clamped base at the rim
    square_mm: float  #: side of the squares between plates; must divide half the gap
    raster_mm: float  #: on plates

    def coarser(self) -> "Fineness":
        """A level less, and squares and raster twice as wide."""
        return Fineness(self.order, self.levels - 1, 2 * self.square_mm, 2 * self.raster_mm)


FINE = Fineness(4, 3, 0.75, 0.025)


@dataclass(frozen=True)
class Press:
    """One press: how deep, where, and dragged how far, so far that all of it slips."""

    shape: Shape
    depth_mm: float
    at_mm: tuple[float, float]
    slide_mm: tuple[float, float] = (0.0, 0.0)
    friction: float = 0.0

    @property
    def way(self) -> FloatArray:
        """Direction of the slide, (2,)."""
        return np.array(self.slide_mm) / max(np.hypot(*self.slide_mm), np.finfo(float).tiny)

    def above_mm(self, place: FloatArray) -> FloatArray:
        """Height of the shape's underside at places (2, n) above its lowest point."""
        x, y = place - (np.array(self.at_mm) + self.slide_mm)[:, None]
        return self.shape.heights_mm(x, y)


CASES = {
    "ball over a crossing": Press(Sphere(6.0), 1.5, (0.5, 1.0)),
    "tilted box": Press(TILTED, 1.2, (1.0, 2.0)),
    "flat punch over four plates": Press(Flat((20.0, 16.0)), 1.0, (1.0, 1.5)),
    "ball dragged along the diagonal, friction 0.5": Press(Sphere(10.0), 0.5, (5.5, 5.5), (1.5, 1.5), 0.5),
}


@dataclass(frozen=True)
class PressedPlates:
    """Results of one press."""

    net_n: FloatArray  #: along x and y, and down, (3,)
    wrench: FloatArray  #: (plates, 3): force down [N], and ∫ x p, ∫ y p about the plate's middle [N mm]
    electrode_mm: FloatArray  #: (rows, cols, n_upper, 3)
    #: of the peer: motions of the plates (24), and forces down on squares (n)
    amplitudes: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def most(self) -> int:
        """Number of the unit that is pressed most."""
        return int(self.wrench[:, 0].argmax())

    def off(self, other: "PressedPlates") -> FloatArray:
        """Relative differences from another: of the net force, wrenches (moments over half a plate), electrodes.

        Each over the norm of all of them.
        """
        arms = np.array([1.0, *[2 / DESIGN.pad.size_mm] * 2])
        pairs = [(self.net_n, other.net_n), (self.wrench * arms, other.wrench * arms)]
        pairs.append((self.electrode_mm, other.electrode_mm))
        return np.array([np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in pairs])


def squares_between(side_mm: float) -> FloatArray:
    """Squares (n, 4) of the quarter x, y > 0 that lie between plates, no further than `REACH_MM`."""
    low = np.arange(0.0, REACH_MM - 1e-9, side_mm)
    x, y = (each.ravel() for each in np.meshgrid(low, low))
    between = np.minimum(x, y) < pad_squares(DESIGN)[-1, 0] - 1e-9
    return np.stack([x, y, x + side_mm, y + side_mm], axis=1)[between]


@dataclass(frozen=True, eq=False)
class PeerCompliance:
    """Motions of plates and rise of squares by wrenches on plates and forces up on squares."""

    matrix: FloatArray  #: (24 + n, 24 + n) [mm, rad; N, N mm]: six motions of each plate first
    squares: FloatArray  #: (n, 4)


class NgsolvePlates:
    """The slab with its plates and squares between them, as NGSolve solves a quarter of it in four parities.

    A force on one quarter is the sum of four patterns of forces on all quarters, even or odd in each mirror.
    """

    def __init__(self, fine: Fineness) -> None:
        import ngsolve as ng

        ng.SetNumThreads(1)
        quarter = squares_between(fine.square_mm)
        mesh, n = _quarter_mesh(quarter, fine.levels), len(quarter)
        self._parts = [(parity, _Parity(mesh, parity, fine.order, n)) for parity in product((1, -1), repeat=2)]
        signs = np.sign(unit_centres(DESIGN))
        rectangles = [np.sort(quarter.reshape(n, 2, 2) * sign, axis=1).reshape(n, 4) for sign in signs]
        patterns = [(_on_all_quarters(parity, n), part.compliance) for parity, part in self._parts]
        whole = np.sum([pattern @ C @ pattern.T / 4 for pattern, C in patterns], axis=0)
        self.compliance = PeerCompliance(whole, np.concatenate(rectangles))

    def gradients(self, amplitudes: FloatArray, places: FloatArray) -> FloatArray:
        """Of displacements (k, 3, 3) at places (k, 3) of a quarter, by motions of plates (24), forces down (4 n)."""
        n, mirror = (len(amplitudes) - 24) // 4, np.append(np.sign(places[0, :2]), 1.0)
        H = np.zeros((len(places), 3, 3))
        for parity, part in self._parts:
            motions, down_n = np.split(_on_all_quarters(parity, n).T @ amplitudes / 4, [6])
            own = part.gradient(motions, -down_n, places * mirror)
            H += np.prod(np.array(parity)[mirror[:2] < 0]) * mirror[:, None] * own * mirror
        return H

    def deformed(self, amplitudes: FloatArray, unit: int) -> Deformed:
        """Gradients on a lattice around a unit.

        They are scaled so that J F⁻¹F⁻ᵀ has the volume change of linear elasticity, div u, as ours has.
        """
        reach, height = DESIGN.unit.footprint_mm / 2, DESIGN.unit.height_mm
        ends = ((-reach, reach), (-reach, reach), (VOXEL_MM, height - VOXEL_MM))
        lines = tuple(np.linspace(low, high, 1 + round((high - low) / VOXEL_MM)) for low, high in ends)
        places = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
        H = self.gradients(amplitudes, places + np.append(unit_centres(DESIGN)[unit], 0.0))
        F = np.eye(3) + H
        scale = (1 + np.trace(H, axis1=-2, axis2=-1)) / np.linalg.det(F)
        shape = *(len(line) for line in lines), 3, 3
        return Deformed(lines, (F * scale[:, None, None]).reshape(shape), np.zeros(3))


def _on_all_quarters(parity: tuple[int, ...], n: int) -> FloatArray:
    """What one of x, y > 0 with a plate and n squares is on all four, (24 + 4 n, 6 + n)."""
    signs = np.sign(unit_centres(DESIGN))
    pattern = [np.prod(np.array(parity)[sign < 0]) for sign in signs]
    motion = [np.diag(way * np.prod(MIRRORED[sign < 0], axis=0)) for way, sign in zip(pattern, signs, strict=True)]
    return block_diag(np.concatenate(motion), np.concatenate([way * np.eye(n) for way in pattern]))


def _quarter_mesh(squares: FloatArray, levels: int) -> Any:
    """Mesh of the quarter x, y > 0, whose top has faces "plate" and "square0", "square1" and so on."""
    import ngsolve as ng
    from netgen.occ import Box, Glue, OCCGeometry, Pnt

    from studies.bench.peers.ngsolve_peer import _face

    x, y, h = DESIGN.slab_mm
    parts, faces = [Box(Pnt(0, 0, 0), Pnt(x / 2, y / 2, h))], {"plate": pad_squares(DESIGN)[-1]}
    for name, corners in (faces | {f"square{k}": square for k, square in enumerate(squares)}).items():
        parts.append(_face(corners.tolist(), h))
        parts[-1].faces[0].name = name
    rim = [edge for edge in parts[0].edges if edge.center.z < 1e-9 and max(edge.center.x / x, edge.center.y / y) > 0.49]
    for edge in (*parts[1].edges, *rim):
        edge.hpref = 1
    body = Glue(parts)
    for face in body.faces:
        for name, place in (("base", face.center.z), ("mirror_x", face.center.x), ("mirror_y", face.center.y)):
            if abs(place) < 1e-9:
                face.name = name
    mesh = ng.Mesh(OCCGeometry(body).GenerateMesh(maxh=LARGEST_MM, grading=0.5))
    mesh.RefineHP(levels, factor=RATIO)
    return mesh


class _Parity:
    """A quarter's fields, even or odd in each mirror, of motions of its plate and forces up on its n squares."""

    def __init__(self, mesh: Any, parity: tuple[int, ...], order: int, n: int) -> None:
        import ngsolve as ng

        held = {axis: ["base", "plate"] for axis in "xyz"}
        for normal, even in zip("xy", parity, strict=True):
            for axis in held:
                if (axis == normal) == (even > 0):
                    held[axis].append(f"mirror_{normal}")
        clamps = {f"dirichlet{axis}": "|".join(names) for axis, names in held.items()}
        self._space = space = ng.VectorH1(mesh, order=order, **clamps) * ng.L2(mesh, order=order - 2)
        lame, mu = DESIGN.matrix_material.lame_mpa
        (u, pressure), (v, other) = space.TnT()
        self._a = a = ng.BilinearForm(space, symmetric=True, condense=True)  # pressures and all inside elements
        a += 2 * mu * ng.InnerProduct(ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))) * ng.dx
        a += (ng.div(u) * other + ng.div(v) * pressure - pressure * other / lame) * ng.dx
        a.Assemble()
        inverse = a.mat.Inverse(space.FreeDofs(True), "sparsecholesky")
        x, y = (ng.CF(float(place)) for place in unit_centres(DESIGN)[-1])
        p, q = ng.x - x, ng.y - y
        self._moved, pull = [], []
        for motion in [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, q), (0, 0, -p), (-q, p, 0)]:
            w = ng.GridFunction(space)
            w.components[0].Set(ng.CF(motion), definedon=mesh.Boundaries("plate"))
            w.vec.data -= inverse * (a.mat * w.vec).Evaluate()
            self._moved.append(w.vec)
            pull.append((a.mat * w.vec).Evaluate())
        area = ng.Integrate(1, mesh, definedon=mesh.Boundaries("square0"))
        loads = [ng.LinearForm(v[2] / area * ng.ds(f"square{k}")).Assemble().vec for k in range(n)]
        K = np.array([[ng.InnerProduct(one, other) for other in self._moved] for one in pull])
        B = np.array([[ng.InnerProduct(one, load) for load in loads] for one in self._moved])
        self._answers = [(inverse * load).Evaluate() for load in loads]  # with the plate held
        held_still = np.array([[ng.InnerProduct(load, answer) for answer in self._answers] for load in loads])
        # of motions m and forces p: w = K m − B p, rise = Bᵀ m + C p
        by_wrench = np.linalg.inv(K)
        half = by_wrench @ B
        #: motions and rise by wrenches and forces up, (6 + n, 6 + n)
        self.compliance = np.block([[by_wrench, half], [half.T, held_still + B.T @ half]])

    def gradient(self, motions: FloatArray, up_n: FloatArray, places: FloatArray) -> FloatArray:
        """Displacement gradient (k, 3, 3) at places (k, 3)."""
        import ngsolve as ng

        u = ng.GridFunction(self._space)
        for share, vector in zip([*motions, *up_n], [*self._moved, *self._answers], strict=True):
            u.vec.data += float(share) * vector
        u.vec.data += self._a.harmonic_extension * u.vec
        return np.array(ng.Grad(u.components[0])(self._space.mesh(*places.T))).reshape(-1, 3, 3)


def raster_on_plates(pressing: Press, raster_mm: float) -> tuple[FloatArray, FloatArray]:
    """Points (2, n) of plates' faces near a shape, and their displacements (3, n, 24) by the motions of all plates."""
    half, t = DESIGN.pad.size_mm / 2, DESIGN.pad.plate.thickness_mm
    line = np.arange(-half, half - 1e-9, raster_mm) + raster_mm / 2
    p, q = (each.ravel() for each in np.meshgrid(line, line))
    one, no = np.ones_like(p), np.zeros_like(p)
    rows = np.array([[one, no, no, no, t * one, -q], [no, one, no, -t * one, no, p], [no, no, one, q, -p, no]])
    places, motions = [], []
    for k, centre in enumerate(unit_centres(DESIGN)):
        place = np.stack([p, q]) + centre[:, None]
        near = pressing.above_mm(place) < NEAR * pressing.depth_mm
        places.append(place[:, near])
        motions.append(np.zeros((3, near.sum(), 24)))
        motions[-1][:, :, 6 * k : 6 * k + 6] = rows[:, :, near].transpose(0, 2, 1)
    return np.concatenate(places, axis=1), np.concatenate(motions, axis=1)


def pressed_by_ngsolve(compliance: PeerCompliance, pressing: Press, raster_mm: float) -> PressedPlates:
    """Press a shape on the plates of `DESIGN`; where it is dragged, its place over plates is found by iteration.

    `ArithmeticError` if it touches rubber that it is dragged over, or if it settles nowhere.
    """
    place, moved = raster_on_plates(pressing, raster_mm)
    drag = np.zeros_like(place)
    for _ in range(PASSES):
        m, pressure, on_squares = _balanced(compliance, pressing, raster_mm, place + drag, moved)
        if not pressing.friction:
            break
        if on_squares.any():
            raise ArithmeticError("dragged over rubber between plates: only plates know friction here.")
        now = moved[:2] @ m
        if np.abs(now - drag)[:, pressure > 0].max() < SETTLED_MM:
            break
        drag = now
    else:
        raise ArithmeticError(f"the shape settled nowhere in {PASSES} passes.")
    way = pressing.friction * pressing.way
    wrench = moved[2].T @ pressure
    down = np.stack([wrench[2::6], -wrench[4::6], wrench[3::6]], axis=1)
    net = np.array([*(way * pressure.sum()), pressure.sum() + on_squares.sum()])
    return PressedPlates(net, down, electrodes_of(m), np.concatenate([m, on_squares]))


def _balanced(
    compliance: PeerCompliance, pressing: Press, raster_mm: float, place: FloatArray, moved: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Motions (24,) of the plates, and forces down on points of the raster and on squares, by an active set."""
    C, spring = compliance.matrix, raster_mm**2 / DESIGN.pad.plate.face_mm_per_mpa
    rising = moved[2]
    pulled = rising - pressing.friction * np.tensordot(pressing.way, moved[:2], 1)  # what a newton down works on
    over = pressing.depth_mm - pressing.above_mm(place)
    middle = (compliance.squares[:, :2] + compliance.squares[:, 2:]) / 2
    over_square = pressing.depth_mm - DESIGN.pad.plate.thickness_mm - pressing.above_mm(middle.T)
    on, on_square, m, p = over > 0, np.zeros(len(middle), dtype=bool), np.zeros(24), np.zeros(len(middle))
    for _ in range(STEPS):
        # m = −C (Fᵀ spring (over + R m) + p): linear for the points that touch; rise of squares that do is −over
        K, start = spring * pulled[on].T @ rising[on], spring * pulled[on].T @ over[on]
        a = 24 + np.flatnonzero(on_square)
        whole = np.block([[np.eye(24) + C[:24, :24] @ K, C[:24, a]], [C[a, :24] @ K, C[np.ix_(a, a)]]])
        given = np.concatenate([-C[:24, :24] @ start, over_square[on_square] - C[a, :24] @ start])
        found = np.linalg.solve(whole, given)
        m, p[:] = found[:24], 0.0
        p[on_square] = found[24:]
        rise = -C[24:, :24] @ (start + K @ m) - C[24:, 24:] @ p
        now, now_square = over + rising @ m > 0, np.where(on_square, p > 0, over_square + rise > 1e-9)
        if (now == on).all() and (now_square == on_square).all():
            return m, spring * np.where(on, over + rising @ m, 0.0), p
        on, on_square = now, now_square
    raise ArithmeticError(f"the active set did not settle in {STEPS} steps.")


def electrodes_of(motions: FloatArray) -> FloatArray:
    """Displacements (rows, cols, n_upper, 3) of electrodes bonded to plates that move so, (24,)."""
    squares = electrode_squares(DESIGN).reshape(DESIGN.n_units, -1, 4)
    arms = (squares[..., :2] + squares[..., 2:]) / 2 - unit_centres(DESIGN)[:, None]
    shift, turn = motions.reshape(DESIGN.n_units, 2, 1, 3).swapaxes(0, 1)
    moved = shift + np.cross(turn, np.pad(arms, ((0, 0), (0, 0), (0, 1))))
    return moved.reshape(DESIGN.array.rows, DESIGN.array.cols, -1, 3)


def resistance_by_ngsolve(slab: NgsolvePlates, found: PressedPlates) -> FloatArray:
    """Of the pillars of the unit that is pressed most, over that at rest, (n_pillars,), on another mesh."""
    unit, pairs = NgsolveUnit(DESIGN.unit), DESIGN.unit.layout.pillar_terminals
    states = (slab.deformed(found.amplitudes, found.most), None)
    loaded, rest = (pillars_per_mm(unit.conductances(state), pairs) for state in states)
    return np.asarray(loaded / rest)


def pressed_here(surface: SurfaceCompliance, pressing: Press, cells: int = CELLS) -> tuple[PressedPlates, FloatArray]:
    """The same by `fem.contact`: the press, and resistances by the design's own equation."""
    contact = press(surface, **vars(pressing), cells=cells)
    patch, down = contact.patch, contact.cell_force_n[2]
    x, y = np.broadcast_arrays(patch.x_mm, patch.y_mm[:, None])
    wrench = np.zeros((4, 3))
    for k, (plate, (cx, cy)) in enumerate(zip(pad_squares(DESIGN), unit_centres(DESIGN), strict=True)):
        own = down * ((x > plate[0]) & (x < plate[2]) & (y > plate[1]) & (y < plate[3]))
        wrench[k] = own.sum(), (own * (x - cx)).sum(), (own * (y - cy)).sum()
    found = PressedPlates(contact.net_force_n, wrench, contact.electrode_mm)
    of_conduction = contact_lengths([contact])
    lengths = pillar_lengths(contact.electrode_mm, DESIGN.unit)[None] if of_conduction is None else of_conduction
    resistance = exact_resistances(lengths, contact.design).reshape(4, -1)[found.most]
    return found, resistance / rest_resistances(contact.design)


@dataclass(frozen=True)
class Comparison:
    """Both answers to one press."""

    theirs: PressedPlates
    own: FloatArray  #: what NGSolve's answer errs by, as of `PressedPlates.off`, (3,)
    off: FloatArray  #: how far ours is from it
    resistance: FloatArray  #: by NGSolve, of the pillars of the unit that is pressed most, over that at rest
    resistance_off: FloatArray  #: how far ours by conduction, and by eq. 1, is from it, (2, n_pillars)


def compared(fine: Fineness, cells: int) -> dict[str, Comparison]:
    """Every press by name; takes minutes."""
    runs = [fine, replace(fine, order=fine.order - 1), fine.coarser()]
    surfaces = [
        surface_compliance(replace(DESIGN, electrics=Electrics(model=model)))[0] for model in ("conduction", "eq1")
    ]
    slab, found = NgsolvePlates(fine), {}
    compliances = [slab.compliance, *(NgsolvePlates(run).compliance for run in runs[1:])]
    for name, pressing in CASES.items():
        theirs, *others = (
            pressed_by_ngsolve(compliance, pressing, run.raster_mm)
            for compliance, run in zip(compliances, runs, strict=True)
        )
        (ours, by_conduction), (_, by_eq1) = (pressed_here(surface, pressing, cells) for surface in surfaces)
        own = np.max([one.off(theirs) for one in others], axis=0)
        resistance = resistance_by_ngsolve(slab, theirs)
        missed = np.array([by_conduction, by_eq1]) - resistance
        found[name] = Comparison(theirs, own, ours.off(theirs), resistance, missed)
    return found


def compare(
    cells: Annotated[int, Parameter(help="Cells of our grid along a contact.")] = CELLS,
    order: Annotated[int, Parameter(help="Order of the peer's elements, 3 or more.", validator=Number(gte=3))] = 4,
    out: Annotated[Path, Parameter(help="JSON file to write.")] = Path("out/bench/plates.json"),
) -> None:
    """Compare presses on 2 × 2 plates with NGSolve's, beside what NGSolve's own answers err by."""
    presses: list[Row] = []
    pillars: list[Row] = []
    for name, one in compared(replace(FINE, order=order), cells).items():
        down_n = float(one.theirs.net_n[2])
        presses.append(
            {
                "press": name,
                "NGSolve: force down [N]": down_n,
                "of it between plates [N]": down_n - float(one.theirs.wrench[:, 0].sum()),
                "ours off: net / wrenches / electrodes [%]": (100 * one.off).tolist(),
                "NGSolve's own error: the same [%]": (100 * one.own).tolist(),
            }
        )
        by_conduction, by_eq1 = (100 * one.resistance_off).tolist()
        change = (100 * (one.resistance - 1)).tolist()
        pillars.append(
            {"press": name, "NGSolve: R over rest − 1 [%]": change, "ours off": by_conduction, "eq. 1": by_eq1}
        )
    tables = {
        f"Presses on plates, {cells} cells along a contact": presses,
        "Conduction in the pillars of the unit that is pressed most": pillars,
    }
    report(tables, out, measured_on(("numpy", "ngsolve")))


if __name__ == "__main__":
    run_alone(compare)
