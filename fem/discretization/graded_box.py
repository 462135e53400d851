"""Functions of high order on a graded grid of boxes (Qp), and elasticity on them as a sum of Kronecker products.

On lines x × y × z with nodal Lagrange functions of order p along each, a constant elastic tensor C gives

    K[a, b] = Σ_kl C[a, k, b, l] · A_x ⊗ A_y ⊗ A_z,    A_d = ∫ φ⁽ᵏ⁼ᵈ⁾ φ⁽ˡ⁼ᵈ⁾ dx_d,

where (k=d) says whether the test function is differentiated and (l=d) whether the trial function is. The matrix is
never formed: applying it is a handful of small dense products along each axis.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

from fem.discretization.grid import Grid, geometric_line
from fem.discretization.lagrange import line_integral, line_nodes, line_values, reference_matrices
from fem.discretization.mirrors import Mirror, Parity, folded_integrals, folded_point, held_components
from fem.factor import SolverError
from fem.scene.loads import Rectangle
from fem.scene.scene import Probe, Region, Scene, regions_at
from geometry.layout import FloatArray

RATIO = 0.15  #: of the distances of neighbouring layers; Schwab, *p- and hp-finite element methods*, 1998


class Level(NamedTuple):
    """Fineness of a graded grid."""

    order: int  #: of the functions along each axis
    layers: int  #: of elements on either side of the body's and regions' edges
    at_loads: int  #: of those on either side of the loads' outlines, where the stress is less singular
    widest: float  #: width of an element far from all edges, relative to the body's height
    fall: float  #: of the error, from the level before; measured on blocks, slabs, pillars and stiff inclusions


@dataclass(frozen=True)
class Held:
    """Whether the first node along x, y, z of each component is held at zero: on the mirror planes and the base."""

    component: tuple[tuple[bool, bool, bool], ...]  #: [component][axis]

    def clear(self, u: FloatArray) -> None:
        """Set what is held to zero, in place."""
        for values, (x, y, z) in zip(u, self.component, strict=True):
            if x:
                values[0] = 0.0
            if y:
                values[:, 0] = 0.0
            if z:
                values[:, :, 0] = 0.0


@dataclass(frozen=True, eq=False)
class BoxPart:
    """Functions of one order on the grid of the solved part; displacements have shape (3, nx, ny, nz)."""

    grid: Grid
    order: int
    mirrors: tuple[Mirror, ...]  #: planes in which the rest of the body mirrors the part

    @property
    def shape(self) -> tuple[int, int, int, int]:
        nx, ny, nz = (self.order * count + 1 for count in self.grid.shape)
        return 3, nx, ny, nz

    @property
    def share(self) -> float:
        """The part's share of the whole body."""
        return 0.5 ** len(self.mirrors)

    def held(self, parity: Parity) -> Held:
        """Components that vanish on the first plane of each axis; the base holds all."""
        at_x, at_y = (held_components(axis, parity).tolist() for axis in range(2))
        return Held(tuple((x, y, True) for x, y in zip(at_x, at_y, strict=True)))

    def integrals(self, rectangle: Rectangle, parity: Parity) -> FloatArray:
        """∫ of the top's functions over a rectangle, its mirror images folded in, shape (nx, ny, 3)."""
        shift = np.tile(np.array(self.grid.lean) * self.grid.height_mm, 2)

        def integral(part: FloatArray) -> FloatArray:
            x0, y0, x1, y1 = part - shift
            along = (
                line_integral(self.grid.x, self.order, x0, x1),
                line_integral(self.grid.y, self.order, y0, y1),
            )
            return np.multiply.outer(*along)

        return folded_integrals(integral, np.array(rectangle), self.mirrors, parity)

    def seen(self, probe: Probe, u: FloatArray, parity: Parity) -> FloatArray:
        """A probe's displacement, shape (3,) [mm]."""
        if probe.kind == "mean":
            x0, y0, x1, y1 = probe.rectangle
            return np.einsum("xya,axy->a", self.integrals(probe.rectangle, parity), u[..., -1]) / (
                (x1 - x0) * (y1 - y0)
            )
        place = np.array(probe.position_mm)
        place[:2] -= np.array(self.grid.lean) * place[2]
        place, signs = folded_point(place, self.mirrors, parity)
        return signs * self.at([place[d : d + 1] for d in range(3)], u)[:, 0, 0, 0]

    def at(self, positions: Sequence[FloatArray], u: FloatArray) -> FloatArray:
        """A displacement at all crossings of positions along x, y and z, shape (3, kx, ky, kz)."""
        rows = [line_values(line, self.order, at) for line, at in zip(self.grid.lines, positions, strict=True)]
        return np.stack([along_axes(rows, component) for component in u])

    def taken_from(self, coarser: "BoxPart", u: FloatArray) -> FloatArray:
        """A coarser level's displacement at this one's nodes."""
        return coarser.at([line_nodes(line, self.order) for line in self.grid.lines], u)


def box_part(scene: Scene, regions: Sequence[Region], mirrors: tuple[Mirror, ...], level: Level) -> BoxPart:
    """The grid of a level: lines at the edges of body, loads and regions, in layers there."""
    outline, height = scene.outline, scene.height_mm
    reach = min([height, *outline.section_mm, *(side for load in scene.loads for side in load.size_mm)])
    mirrored = {mirror.axis: mirror.position_mm for mirror in mirrors}

    def line(edges: list[tuple[float, int]]) -> FloatArray:
        return geometric_line(_layers(edges, scene.rounding_mm), RATIO, level.widest * height, reach)

    lines = []
    for axis in (0, 1):
        shift = outline.lean[axis] * height  # from the base, where lines are stated, to the top, where the loads are
        prisms = (outline, *(prism for prism, _ in regions))
        edges = [
            (prism.base_mm[axis] + side * prism.section_mm[axis] / 2, level.layers)
            for prism in prisms
            for side in (-1, 1)
        ]
        edges += [(load.rectangle[side] - shift, level.at_loads) for load in scene.loads for side in (axis, axis + 2)]
        if axis in mirrored:
            middle = mirrored[axis]
            edges = [(middle + abs(place - middle), layers) for place, layers in edges] + [(middle, 0)]
        lines.append(line(edges))
    levels = [z for prism, _ in regions for z in (prism.base_mm[2], prism.top_mm[2])]
    x, y, z = *lines, line([(height, level.at_loads)] + [(z, level.layers) for z in (0.0, *levels)])
    centres = [(ends[1:] + ends[:-1]) / 2 for ends in (x, y, z)]
    points = np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1)
    region = regions_at(points.reshape(-1, 3), regions).reshape(points.shape[:3])
    return BoxPart(Grid(x=x, y=y, z=z, lean=outline.lean, region=region), level.order, mirrors)


def _layers(edges: list[tuple[float, int]], slack: float) -> dict[float, int]:
    """Most layers asked for at each position; positions that only rounding tells apart are one."""
    layers: dict[float, int] = {}
    for place, count in sorted(edges):
        last = next(reversed(layers), -np.inf)
        at = last if place - last <= slack else place
        layers[at] = max(layers.get(at, 0), count)
    return layers


Lines = tuple[FloatArray, FloatArray, FloatArray]  #: element boundaries along x, y, z [mm]


def line_matrices(lines: FloatArray, order: int, n_points: int) -> dict[tuple[bool, bool], FloatArray]:
    """Dense ∫ φₐ⁽ⁱ⁾ φ_b⁽ʲ⁾ dx of a line, n_points Gauss points an element; keyed by (i, j): which is differentiated."""
    matrices = {}
    for (test, trial), element in reference_matrices(order, n_points).items():
        A = np.zeros((order * (len(lines) - 1) + 1,) * 2)
        for e, half in enumerate(np.diff(lines) / 2):
            mine = slice(e * order, (e + 1) * order + 1)
            A[mine, mine] += half ** (1 - test - trial) * element
        matrices[test, trial] = A
    return matrices


class Term:
    """One elastic tensor on one box of elements: applies Σ C A_x ⊗ A_y ⊗ A_z to a window of the nodes.

    Parameters
    ----------
    lines : Lines
    order, n_points : int
        Order of the functions; Gauss points along each axis of an element.
    C : array, shape (3, 3, 3, 3)
    elements : three (first, last) pairs
        The box, as ranges of elements along each axis.
    """

    def __init__(
        self, lines: Lines, order: int, n_points: int, C: FloatArray, elements: tuple[tuple[int, int], ...]
    ) -> None:
        self.window = tuple(slice(first * order, last * order + 1) for first, last in elements)
        self._A = [
            line_matrices(line[first : last + 1], order, n_points)
            for line, (first, last) in zip(lines, elements, strict=True)
        ]
        # products along x, then y, are shared by all that need them; those along z wait until all are summed
        self._plan: dict = defaultdict(lambda: defaultdict(lambda: defaultdict(list)))
        for a, k, b, m in np.argwhere(C != 0.0):
            x, y, z = ((bool(k == d), bool(m == d)) for d in range(3))
            self._plan[int(b)][x][y].append(((int(a), z), float(C[a, k, b, m])))

    def add_to(self, result: FloatArray, u: FloatArray) -> None:
        """Add K u to the result; both of shape (3, nx, ny, nz)."""
        window = (slice(None), *self.window)
        u, result = u[window], result[window]
        sums: dict = {}
        for b, along_x in self._plan.items():
            for x, along_y in along_x.items():
                ux = (self._A[0][x] @ u[b].reshape(u.shape[1], -1)).reshape(u[b].shape)
                for y, targets in along_y.items():
                    uxy = self._A[1][y] @ ux
                    for key, c in targets:
                        if key in sums:
                            sums[key] += c * uxy
                        else:
                            sums[key] = c * uxy
        for (a, z), total in sums.items():
            result[a] += total @ self._A[2][z].T


class FastDiagonal:
    """Exact inverse of the diagonal blocks K[a, a] of a homogeneous box, through eigenvectors along each axis.

    Lynch, Rice and Thomas, "Direct solution of partial difference equations by tensor product methods",
    Numer. Math. 6 (1964). Preconditions conjugate gradients independently of mesh grading and order.
    """

    def __init__(self, lines: Lines, order: int, C: FloatArray, held: Held) -> None:
        self._held = held
        matrices = [line_matrices(line, order, order + 1) for line in lines]
        self._modes: list[list[FloatArray]] = []
        self._inverse: list[FloatArray] = []
        spectra = {}
        for d, first in {(d, int(held.component[a][d])) for a in range(3) for d in range(3)}:
            eigenvalues, V = eigh(matrices[d][True, True][first:, first:], matrices[d][False, False][first:, first:])
            # rounding is relative to the largest: at lines far closer than others it makes the least negative
            least = first * (np.pi / 2 / np.ptp(lines[d])) ** 2
            spectra[d, first] = np.maximum(eigenvalues, least), V
        for a in range(3):
            modes, total = [], np.zeros((1, 1, 1))
            for d in range(3):
                eigenvalues, V = spectra[d, int(held.component[a][d])]
                modes.append(V)
                total = total + C[a, d, a, d] * eigenvalues.reshape([-1 if axis == d else 1 for axis in range(3)])
            self._modes.append(modes)
            self._inverse.append(1 / total)

    def __call__(self, r: FloatArray) -> FloatArray:
        """The preconditioned residual; zero where held."""
        z = np.zeros_like(r)
        for a, (X, Y, Z) in enumerate(self._modes):
            inner = tuple(slice(int(held), None) for held in self._held.component[a])
            z[a][inner] = along_axes((X, Y, Z), self._inverse[a] * along_axes((X.T, Y.T, Z.T), r[a][inner]))
        return z


def along_axes(matrices: Sequence[FloatArray], u: FloatArray) -> FloatArray:
    """X ⊗ Y ⊗ Z applied to u of shape (nx, ny, nz)."""
    X, Y, Z = matrices
    u = (X @ u.reshape(u.shape[0], -1)).reshape(-1, *u.shape[1:])
    return (Y @ u) @ Z.T


def conjugate_gradients(
    A: Callable[[FloatArray], FloatArray],
    precondition: Callable[[FloatArray], FloatArray],
    b: FloatArray,
    first: FloatArray,
    tolerance: float,
    most: int = 5000,
) -> tuple[FloatArray, int, float]:
    """Solution, number of steps and relative residual ‖b − A u‖/‖b‖, both in the preconditioner's norm.

    Parameters
    ----------
    A, precondition : functions
        Of arrays like b.
    b : array
    first : array, like b
        Where to begin.
    tolerance : float
        Residual at which to stop.
    most : int
        Number of steps.

    Raises
    ------
    SolverError
        If that many steps do not reach the tolerance.
    """
    u = first.copy()
    r = b - A(u)
    z = precondition(r)
    p = z.copy()
    rz = float(np.vdot(r, z))
    enough = tolerance**2 * float(np.vdot(b, precondition(b)))
    for step in range(most + 1):
        if rz <= enough:
            return u, step, tolerance * (rz / enough) ** 0.5 if enough else 0.0
        Ap = A(p)
        alpha = rz / float(np.vdot(p, Ap))
        u += alpha * p
        r -= alpha * Ap
        z = precondition(r)
        rz, before = float(np.vdot(r, z)), rz
        p *= rz / before
        p += z
    raise SolverError(
        f"conjugate gradients left a residual of {tolerance * (rz / enough) ** 0.5:.1e} after {most} steps: the moduli "
        "may differ too widely or ν be too near 0.5."
    )
