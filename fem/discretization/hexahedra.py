"""Quadratic hexahedra on a grid: the displacement form, its volumetric part integrated at 2 × 2 × 2 points.

Fully integrated quadratic elements stiffen as ν → 0.5. Integrating λ div u div v at fewer points than 2μ ε(u):ε(v)
(selectively reduced integration) frees them, at the same order of accuracy. On a grid every element is the unit cube
under a constant Jacobian, so products of reference gradients are integrated once and all element matrices are
combinations of them.
"""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from skfem import ElementHex2, ElementHexS2
from skfem.quadrature import get_quadrature
from skfem.refdom import RefHex

from fem.discretization.assembly import SparsePattern
from fem.discretization.elasticity import ElasticBody, lame_of_regions
from fem.discretization.grid import Grid
from geometry.design import Material
from geometry.layout import FloatArray

HexElement = Literal["Q2", "S2"]
#: scikit-fem element, and the orders to which the λ and μ parts are integrated (3: 2 points an axis, 5: 3 points)
ELEMENTS = {"Q2": (ElementHex2(), 3, 5), "S2": (ElementHexS2(), 3, 3)}


@dataclass(frozen=True, eq=False)
class GridBasis:
    """Scalar quadratic functions on a grid: Q2 has 27 nodes a box, S2 the 20 of them on its edges."""

    grid: Grid
    element: HexElement = "Q2"
    number: NDArray[np.int64] = field(init=False)  #: (2nx + 1, 2ny + 1, 2nz + 1) by half steps; −1 where S2 has no node

    def __post_init__(self) -> None:
        nx, ny, nz = self.grid.shape
        odd = [np.arange(2 * n + 1) % 2 for n in (nx, ny, nz)]
        between = odd[0][:, None, None] + odd[1][None, :, None] + odd[2][None, None, :]
        present = between <= (3 if self.element == "Q2" else 1)
        number = np.where(present, np.cumsum(present).reshape(present.shape) - 1, -1)
        object.__setattr__(self, "number", number)

    @property
    def N(self) -> int:
        """Number of nodes."""
        return int(self.number.max()) + 1

    @property
    def local(self) -> NDArray[np.int64]:
        """Place of each function's node in its box in half steps, shape (n_functions, 3), in scikit-fem's order."""
        return np.rint(ELEMENTS[self.element][0].doflocs * 2).astype(np.int64)

    @property
    def element_dofs(self) -> NDArray[np.int64]:
        """Node numbers, shape (n_functions, n_elements); elements run z fastest."""
        start = np.stack(np.meshgrid(*[2 * np.arange(n) for n in self.grid.shape], indexing="ij")).reshape(3, 1, -1)
        return self.number[tuple(start + self.local.T[:, :, None])]

    @property
    def doflocs(self) -> FloatArray:
        """Positions of the nodes, shape (3, N) [mm]."""
        axes = [np.insert(lines[1:], np.arange(len(lines) - 1), (lines[1:] + lines[:-1]) / 2) for lines in self._lines]
        axes = [np.concatenate([lines[:1], inner]) for lines, inner in zip(self._lines, axes, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"))[:, self.number >= 0]
        points[0] += self.grid.lean[0] * points[2]
        points[1] += self.grid.lean[1] * points[2]
        return points

    @property
    def _lines(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.grid.x, self.grid.y, self.grid.z

    def patch_integrals(self, rectangles: FloatArray) -> sp.csr_matrix:
        """∫ φₙ dA over rectangles (k, 4) of the top face, shape (k, N) [mm²]; exact wherever the grid's lines lie."""
        shift = np.array(self.grid.lean) * self.grid.height_mm
        rows = []
        for x0, y0, x1, y1 in np.asarray(rectangles, dtype=float):
            x_parts = _clipped(self.grid.x + shift[0], x0, x1)
            y_parts = _clipped(self.grid.y + shift[1], y0, y1)
            rows.append(self._top_row(x_parts, y_parts))
        return sp.vstack(rows, format="csr")

    def values(self, points_mm: FloatArray) -> sp.csr_matrix:
        """Rows φₙ(point) that interpolate at points (k, 3) [mm] of the body, shape (k, N)."""
        rows = []
        for x, y, z in np.asarray(points_mm, dtype=float):
            at = (x - self.grid.lean[0] * z, y - self.grid.lean[1] * z, z)
            box, local = [], []
            for lines, position in zip(self._lines, at, strict=True):
                index = int(np.clip(np.searchsorted(lines, position) - 1, 0, len(lines) - 2))
                box.append(index)
                local.append((position - lines[index]) / (lines[index + 1] - lines[index]))
            nodes = self.number[tuple(2 * np.array(box)[:, None] + self.local.T)]
            rows.append(
                sp.csr_matrix(
                    (_shapes(self.element, np.array(local)[:, None])[:, 0], (np.zeros_like(nodes), nodes)),
                    shape=(1, self.N),
                )
            )
        return sp.vstack(rows, format="csr")

    def _top_row(self, x_parts: list, y_parts: list) -> sp.csr_matrix:
        nz = self.grid.shape[2]
        nodes, weights = [], []
        for i, x, wx in x_parts:
            for j, y, wy in y_parts:
                X, Y = np.meshgrid(x, y, indexing="ij")
                shapes = _shapes(self.element, np.stack([X.ravel(), Y.ravel(), np.ones(X.size)]))
                start = np.array([2 * i, 2 * j, 2 * (nz - 1)])
                nodes.append(self.number[tuple((start + self.local).T)])
                weights.append(shapes @ np.outer(wx, wy).ravel())
        if not nodes:
            return sp.csr_matrix((1, self.N))
        columns = np.concatenate(nodes)
        return sp.csr_matrix((np.concatenate(weights), (np.zeros_like(columns), columns)), shape=(1, self.N))


def _clipped(lines: FloatArray, low: float, high: float) -> list[tuple[int, FloatArray, FloatArray]]:
    """Intervals between lines that overlap [low, high]: index, local Gauss points in [0, 1], weights [mm]."""
    points, weights = np.polynomial.legendre.leggauss(3)
    parts = []
    for index, (start, end) in enumerate(pairwise(lines)):
        a, b = max(start, low), min(end, high)
        if b > a:
            at = (a + b) / 2 + points * (b - a) / 2
            parts.append((index, (at - start) / (end - start), weights * (b - a) / 2))
    return parts


def _shapes(element: HexElement, local: FloatArray) -> FloatArray:
    """Shape functions at local points (3, n) of the unit cube, shape (n_functions, n)."""
    kind = ELEMENTS[element][0]
    return np.stack([np.broadcast_to(kind.lbasis(local, a)[0], local.shape[1:]) for a in range(len(kind.doflocs))])


def _reference_products(element: HexElement, order: int) -> FloatArray:
    """∫ ∂ₖφₐ ∂ₗφ_b over the unit cube, shape (n_functions, 3, n_functions, 3)."""
    kind = ELEMENTS[element][0]
    points, weights = get_quadrature(RefHex, order)
    gradients = np.stack([np.asarray(kind.lbasis(points, a)[1]) for a in range(len(kind.doflocs))])  # (a, k, q)
    return np.einsum("akq,blq,q->akbl", gradients, gradients, weights, optimize=True)


def grid_stiffness(basis: GridBasis, material: list[Material]) -> sp.csr_matrix:
    """Stiffness of all displacement degrees of freedom, shape (3 N, 3 N), interleaved n·3 + i [N/mm].

    Notes
    -----
    With J = ∂x/∂ξ constant in each box, ∂φ/∂x = J⁻ᵀ ∂φ/∂ξ and D[a i, b j] = ∫ ∂ᵢφₐ ∂ⱼφ_b dx is a combination of nine
    reference products. As in `assembly.py`: div u div v gives D[i, j]; 2 ε(u):ε(v) gives δᵢⱼ tr D + D[j, i].
    """
    grid = basis.grid
    _, lame_order, mu_order = ELEMENTS[basis.element]
    lame_mpa, mu_mpa = lame_of_regions(material, np.broadcast_to(grid.region, grid.shape).ravel())
    steps = np.stack(np.meshgrid(*[np.diff(lines) for lines in (grid.x, grid.y, grid.z)], indexing="ij")).reshape(3, -1)
    inverse = np.zeros((steps.shape[1], 3, 3))  # ∂ξ/∂x by element: [k, i]
    for k in range(3):
        inverse[:, k, k] = 1 / steps[k]
    for k in range(2):
        inverse[:, k, 2] = -grid.lean[k] / steps[k]
    volume = steps.prod(axis=0)

    def combine(products: FloatArray, coefficient: FloatArray) -> FloatArray:
        """coefficient[e, i, j, k, l] · products[a, k, b, l], shape (e, i, j, a, b)."""
        n = len(products)
        flat = products.transpose(1, 3, 0, 2).reshape(9, n * n)
        return (coefficient.reshape(-1, 9) @ flat).reshape(-1, 3, 3, n, n)

    pairs = np.einsum("eki,elj,e->eijkl", inverse, inverse, volume)  # D[i, j] = pairs[i, j, k, l] · reference[k, l]
    trace = np.einsum("eiikl->ekl", pairs)
    shear = pairs.swapaxes(1, 2) + np.eye(3)[None, :, :, None, None] * trace[:, None, None]
    K = combine(_reference_products(basis.element, lame_order), lame_mpa[:, None, None, None, None] * pairs)
    K += combine(_reference_products(basis.element, mu_order), mu_mpa[:, None, None, None, None] * shear)
    dofs = basis.element_dofs
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
