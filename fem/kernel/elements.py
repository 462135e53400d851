"""Elements that scikit-fem lacks: hexahedra of any order, and pressures that jump between elements.

Both are ordinary `ElementH1`: numbering, mapping and quadrature are scikit-fem's. What edges and faces share of an
order above 2 is not turned, so the local axes of elements that meet must agree, as those of `MeshHex.init_tensor` do.
"""

from functools import cache, cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from skfem import CellBasis, Element, ElementTetP1, ElementTetP2, Mesh
from skfem.assembly.basis.abstract_basis import AbstractBasis
from skfem.element.element_h1 import ElementH1
from skfem.refdom import RefHex

from geometry.layout import FloatArray


class HexQ(ElementH1):
    """Products of Lagrange functions on Gauss-Lobatto points, of one order along each axis."""

    refdom = RefHex

    def __init__(self, order: int) -> None:
        inner = order - 1
        self.nodal_dofs, self.edge_dofs, self.facet_dofs, self.interior_dofs = 1, inner, inner**2, inner**3
        self.maxdeg, self.dofnames = order, ["u"] * (1 + inner + inner**2 + inner**3)
        x = (lobatto_points(order) + 1) / 2
        self.to_legendre = np.linalg.inv(legendre.legvander(2 * x - 1, order))  #: columns are functions
        vertices = RefHex.p.T * order
        places = [tuple(vertex) for vertex in vertices]
        for ends in [*([edge] for edge in RefHex.edges), *([facet] for facet in RefHex.facets), [range(8)]]:
            low, high = vertices[ends[0]].min(axis=0), vertices[ends[0]].max(axis=0)
            places += product(*(range(1, order) if a < b else [a] for a, b in zip(low, high, strict=True)))
        self.places = np.array(places, dtype=int)  #: of each function's node in the lattice, (n, 3)
        self.doflocs = x[self.places]
        self._last: tuple[bytes, FloatArray, FloatArray] = (b"", np.zeros(0), np.zeros(0))

    def lbasis(self, X: FloatArray, i: int) -> tuple[FloatArray, FloatArray]:
        x, y, z = (along[..., k] for along, k in zip(self._along(X)[0], self.places[i], strict=True))
        dx, dy, dz = (slope[..., k] for slope, k in zip(self._along(X)[1], self.places[i], strict=True))
        return x * y * z, np.stack([dx * y * z, x * dy * z, x * y * dz])

    def _along(self, X: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Functions along each axis and their slopes at places (3, ...); the last ones are kept."""
        key = X.tobytes()
        if self._last[0] != key or self._last[1].shape[:-1] != X.shape:
            powers = legendre.legvander(2 * np.asarray(X) - 1, self.maxdeg)
            slopes = powers[..., : self.maxdeg] @ (2 * legendre.legder(self.to_legendre))
            self._last = key, powers @ self.to_legendre, slopes
        return self._last[1:]


class Pressure(ElementH1):
    """Polynomials up to a degree in all, inside every hexahedron alone; orthogonal on the reference element."""

    refdom = RefHex

    def __init__(self, degree: int) -> None:
        self.maxdeg = degree
        self.degrees = np.array([d for d in product(range(degree + 1), repeat=3) if sum(d) <= degree])  #: (k, 3)
        self.interior_dofs, self.dofnames = len(self.degrees), ["p"] * len(self.degrees)
        self.doflocs = np.full((self.interior_dofs, 3), 0.5)

    def lbasis(self, X: FloatArray, i: int) -> tuple[FloatArray, FloatArray]:
        x, y, z = (legendre.legval(2 * x - 1, np.eye(d + 1)[d]) for x, d in zip(X, self.degrees[i], strict=True))
        return x * y * z, np.zeros_like(X)  # no slopes of pressures are ever asked for


@cache
def hexahedra(order: int) -> tuple[HexQ, Pressure]:
    """A stable pair Q_k/P_(k−1): complete pressures of one degree less, whatever ν and slenderness.

    Order 3 with pressures of degree 2 errs 20 times less than with the usual two degrees less along each axis.
    """
    return HexQ(order), Pressure(order - 1)


@cache
def taylor_hood() -> tuple[Element, Element]:
    """The pair of tetrahedra: displacements P2, pressures P1 that are continuous within a region."""
    return ElementTetP2(), ElementTetP1()


@cache
def lobatto_points(order: int) -> FloatArray:
    """The order + 1 Gauss-Lobatto points of [−1, 1]."""
    inner = np.sort(legendre.legroots(legendre.legder([0.0] * order + [1.0]))) if order > 1 else np.zeros(0)
    return np.concatenate([[-1.0], inner, [1.0]])


class Basis(CellBasis):
    """scikit-fem's basis of a mesh, whose functions in space are tabulated when first asked for.

    The kernel tabulates them on the reference element, once for all elements (`reference.py`): in space those of a
    thousand elements of order 4 fill 400 MB.
    """

    def __init__(self, mesh: Mesh, elem: Element) -> None:
        intorder = 2 * elem.maxdeg + 1 if mesh.refdom is RefHex else 2  # exact for products of slopes at rest
        AbstractBasis.__init__(self, mesh, elem, None, intorder, None, mesh.refdom)
        self.tind, self.nelems = None, mesh.nelements

    @cached_property
    def basis(self) -> list[Any]:
        return [self.elem.gbasis(self.mapping, self.X, j) for j in range(self.Nbfun)]

    @cached_property
    def dx(self) -> FloatArray:
        return np.abs(self.mapping.detDF(self.X)) * self.W
