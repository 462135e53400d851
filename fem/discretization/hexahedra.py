"""Quadratic hexahedra (Q2, 27 nodes) on a grid: the displacement form, its volumetric part integrated at 2³ points.

Fully integrated quadratic elements stiffen as ν → 0.5. Integrating λ div u div v at fewer points than 2μ ε(u):ε(v)
(selective reduced integration) frees them at the same order of accuracy.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from skfem import ElementHex2

from fem.discretization.assembly import SparsePattern
from fem.discretization.elasticity import ElasticBody
from fem.discretization.grid import Grid
from fem.discretization.lagrange import cube_products, element_terms, line_integral, line_nodes, term_scales
from geometry.design import Material
from geometry.layout import FloatArray

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


def grid_stiffness(basis: GridBasis, material: list[Material]) -> sp.csr_matrix:
    """Stiffness of all displacement degrees of freedom, shape (3 N, 3 N), interleaved n·3 + i [N/mm].

    `material` lists the rubbers by the numbers of the grid's regions.
    """
    grid = basis.grid
    region = np.broadcast_to(grid.region, grid.shape).ravel()
    size = np.stack(np.meshgrid(*[np.diff(lines) for lines in grid.lines], indexing="ij"), axis=-1).reshape(-1, 3)
    dofs = basis.element_dofs
    by_place = LOCAL @ np.array([9, 3, 1])  # from scikit-fem's order of local nodes to z fastest
    K = np.empty((len(size), 3, 3, 27, 27))
    for number, rubber in enumerate(material):
        mine = region == number
        pairs, terms = element_terms(rubber, grid.lean, cube_products(2, 2), cube_products(2, 3))
        terms = terms[:, by_place][:, :, :, by_place].transpose(0, 2, 4, 1, 3)
        K[mine] = np.tensordot(term_scales(pairs, size[mine]), terms, 1)
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
