"""Grids of boxes, graded toward the edges where the stress is singular, and quadratic hexahedra (Q2) on them.

A grid is three sets of lines (`graded_lines`). Sizes grow around each attractor (the edge of a loaded patch, a face of
the body) as distance^(2/3), so that errors at the edge and away from it fall together, as the fourth power of the
number of lines.

Q2 is the displacement form, its volumetric part λ div u div v integrated at 2³ points and the rest at 3³: fully
integrated it would stiffen as ν → 0.5; selective reduced integration frees it at the same order of accuracy.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from skfem import ElementHex2

from fem.discretization.elasticity import ElasticBody, SparsePattern
from fem.discretization.lagrange import cube_products, element_terms, line_integral, line_nodes, term_scales
from geometry.design import Material
from geometry.layout import FloatArray

GRADING = 3.0  #: the k-th line lies about k³ from its attractor; 3 balances u ~ r^0.6 at clamped edges (2·0.6·3 ≈ 4)
FAR = 8.0  #: lengths from an attractor beyond which sizes grow with the distance


@dataclass(frozen=True, eq=False, kw_only=True)
class Grid:
    """Boxes between lines, possibly sheared so that their uprights lean; the base is z = 0."""

    x: FloatArray  #: (nx + 1,) at the base [mm]
    y: FloatArray  #: (ny + 1,) at the base [mm]
    z: FloatArray  #: (nz + 1,) [mm]
    lean: tuple[float, float] = (0.0, 0.0)  #: x and y by which points shift per mm of height
    region: NDArray[np.int64] = field(default_factory=lambda: np.zeros((1, 1, 1), dtype=np.int64))
    #: (nx, ny, nz), or broadcastable to it: which material fills each box

    @property
    def lines(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.x, self.y, self.z

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of boxes along each axis."""
        return len(self.x) - 1, len(self.y) - 1, len(self.z) - 1

    @property
    def height_mm(self) -> float:
        return float(self.z[-1])


@dataclass(frozen=True)
class Attractor:
    """A place on an axis where lines crowd."""

    position_mm: float
    length_mm: float  #: scale of the problem around it: one line more every length, far away
    weight: float = 1.0  #: 1 where the stress is singular and matters; less where it matters less


def graded_lines(stops: Sequence[float], attractors: Sequence[Attractor], level: int) -> FloatArray:
    """Lines from the first to the last stop, crowding at the attractors.

    Parameters
    ----------
    stops : sequence of float
        Places that must be lines [mm]; the least and the greatest are the ends.
    attractors : sequence of Attractor
        Where lines crowd.
    level : int
        Refinement: every interval between stops has `level` times as many elements as at level 1, and
        the lines of level 1 stay.

    Returns
    -------
    array, shape (n + 1,)
        Increasing positions [mm].

    Notes
    -----
    An attractor at a counts C(x) = w·sign(x − a)·(|x − a|/L)^(1/3) elements from itself to x, and beyond `FAR` lengths
    only their logarithm more. Counts of all attractors add up; lines lie where their sum is a whole number of steps.

    Examples
    --------
    >>> graded_lines([0, 8], [Attractor(0.0, 8.0, weight=2.0)], level=1)
    array([0., 1., 8.])
    """
    ends = np.unique(np.round(np.asarray(stops, dtype=float), 9))
    lines = [ends[:1]]
    for low, high in pairwise(ends):
        # sample densely toward every attractor, or steep parts of the count would be missed
        spread = np.linspace(-1.0, 1.0, 401) ** GRADING * (high - low)
        near = np.concatenate([np.clip(a.position_mm, low, high) + spread for a in attractors] + [low + (1 + spread)])
        places = np.unique(np.clip(near, low, high))
        count = sum(
            (
                a.weight * np.sign(places - a.position_mm) * _steps(np.abs(places - a.position_mm) / a.length_mm)
                for a in attractors
            ),
            start=np.zeros_like(places),
        )
        steps = level * max(1, round(count[-1] - count[0]))
        if count[-1] == count[0]:  # nothing attracts: evenly
            count = places
        inner = np.interp(np.linspace(count[0], count[-1], steps + 1)[1:-1], count, places)
        lines.append(np.append(inner, high))
    return np.concatenate(lines)


def _steps(lengths: FloatArray) -> FloatArray:
    """Elements from an attractor to so many lengths away: the cube root, continued smoothly by a logarithm."""
    near = np.cbrt(np.minimum(lengths, FAR))
    return near + np.cbrt(FAR) / 3 * np.log(np.maximum(lengths, FAR) / FAR)


ELEMENT = ElementHex2()  #: scikit-fem's, whose order of local nodes is kept
#: place of each local node in its box in half steps, shape (27, 3)
LOCAL = np.rint(ELEMENT.doflocs * 2).astype(np.int64)


@dataclass(frozen=True, eq=False)
class GridBasis:
    """Scalar Q2 functions on a grid; nodes lie half steps apart and are numbered z fastest."""

    grid: Grid

    @cached_property
    def number(self) -> NDArray[np.int64]:
        """Number of the node at each half step, shape (2nx + 1, 2ny + 1, 2nz + 1)."""
        return np.arange(self.N).reshape([2 * n + 1 for n in self.grid.shape])

    @property
    def N(self) -> int:
        """Number of nodes."""
        return int(np.prod([2 * n + 1 for n in self.grid.shape]))

    @property
    def element_dofs(self) -> NDArray[np.int64]:
        """Node numbers, shape (27, n_elements); elements run z fastest."""
        start = 2 * np.indices(self.grid.shape).reshape(3, 1, -1)
        return self.number[tuple(start + LOCAL.T[:, :, None])]

    @property
    def doflocs(self) -> FloatArray:
        """Positions of the nodes, shape (3, N) [mm]."""
        axes = [line_nodes(lines, 2) for lines in self.grid.lines]
        points = np.stack(np.meshgrid(*axes, indexing="ij")).reshape(3, -1)
        points[:2] += np.array(self.grid.lean)[:, None] * points[2]
        return points

    def patch_integrals(self, rectangles: FloatArray) -> sp.csr_matrix:
        """∫ φₙ dA over rectangles (k, 4) of the top face, shape (k, N) [mm²]; exact wherever the grid's lines lie."""
        shift = np.tile(np.array(self.grid.lean) * self.grid.height_mm, 2)
        top = self.number[:, :, -1].ravel()
        rows = []
        for x0, y0, x1, y1 in np.asarray(rectangles, dtype=float) - shift:
            along = line_integral(self.grid.x, 2, x0, x1), line_integral(self.grid.y, 2, y0, y1)
            values = np.multiply.outer(*along).ravel()
            some = np.flatnonzero(values)
            rows.append(sp.csr_matrix((values[some], (np.zeros_like(some), top[some])), shape=(1, self.N)))
        return sp.vstack(rows, format="csr")


#: VTK's nodes of a triquadratic hexahedron in half steps: corners, lower edges, upper edges, uprights, the middles of
#: the sides across x, y and z, and of the whole
VTK_PLACES = np.array(
    [
        *[(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)],
        *[(1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2)],
        *[(0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)],
        *[(0, 1, 1), (2, 1, 1), (1, 0, 1), (1, 2, 1), (1, 1, 0), (1, 1, 2), (1, 1, 1)],
    ]
)


def lattice_boxes(lines: Sequence[FloatArray]) -> tuple[list[FloatArray], NDArray[np.int64]]:
    """Positions of the nodes of quadratic boxes along each axis, and the boxes' nodes (m, 27) in VTK's order."""
    halves = [line_nodes(line, 2) for line in lines]
    start = 2 * np.indices([len(line) - 1 for line in lines]).reshape(3, -1, 1)
    cells = np.ravel_multi_index(tuple(start + VTK_PLACES.T[:, None]), [len(half) for half in halves])
    return halves, cells.astype(np.int64)


def grid_stiffness(basis: GridBasis, material: list[Material], shares: FloatArray | None = None) -> sp.csr_matrix:
    """Stiffness of all displacement degrees of freedom, shape (3 N, 3 N), interleaved n·3 + i [N/mm].

    `material` lists the rubbers by the numbers of the grid's regions. With `shares`, shape (n_materials, nx, ny, nz),
    boxes hold that much of each instead, evenly mixed: stiffer than truth where rubbers meet inside a box.
    """
    grid = basis.grid
    if shares is None:
        shares = np.broadcast_to(grid.region, grid.shape) == np.arange(len(material)).reshape(-1, 1, 1, 1)
    size = np.stack(np.meshgrid(*[np.diff(lines) for lines in grid.lines], indexing="ij"), axis=-1).reshape(-1, 3)
    dofs = basis.element_dofs
    by_place = LOCAL @ np.array([9, 3, 1])  # from scikit-fem's order of local nodes to z fastest
    K = np.zeros((len(size), 3, 3, 27, 27))
    for share, rubber in zip(shares.reshape(len(material), -1), material, strict=True):
        mine = share > 0
        pairs, terms = element_terms(rubber, grid.lean, cube_products(2, 2), cube_products(2, 3))
        terms = terms[:, by_place][:, :, :, by_place].transpose(0, 2, 4, 1, 3)
        K[mine] += np.tensordot(share[mine, None] * term_scales(pairs, size[mine]), terms, 1)
    pattern = SparsePattern(dofs, dofs, (basis.N, basis.N))
    return pattern.vector_matrix(K.transpose(0, 3, 4, 1, 2))


def grid_body(basis: GridBasis, stiffness: sp.csr_matrix, mirrors: tuple[int, int] = (0, 0)) -> ElasticBody:
    """Clamp the base and, on mirror planes, what a mirrored field cannot do.

    Parameters
    ----------
    basis : GridBasis
    stiffness : csr_matrix, shape (3 N, 3 N)
        Of `grid_stiffness`.
    mirrors : tuple of two ints
        What the planes x = first line and y = first line are: 0 a free face, +1 a mirror of symmetric fields (no
        displacement through it), −1 of antisymmetric ones (none along it).

    Returns
    -------
    ElasticBody
    """
    x, y, z = basis.doflocs
    fixed = np.repeat(z == 0.0, 3).reshape(-1, 3)
    for axis, (parity, place) in enumerate(zip(mirrors, (x, y), strict=True)):
        if parity:
            held = np.arange(3) == axis if parity > 0 else np.arange(3) != axis
            fixed |= (place == place.min())[:, None] & held
    free = np.flatnonzero(~fixed.ravel())
    return ElasticBody(basis=basis, matrix=stiffness[free][:, free].tocsr(), free=free, n_pressure=0)
