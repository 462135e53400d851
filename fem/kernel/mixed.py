"""Boxes between lines whose points of integration know how much of each rubber lies around them."""

from collections.abc import Sequence

import numpy as np

from fem.kernel.elements import Basis, hexahedra
from fem.kernel.rubber import Rubber
from fem.meshes.grid import Grid
from geometry.design import Material
from geometry.law import Law
from geometry.layout import FloatArray

ORDER = 2  #: of the elements


def mixed_rubber(grid: Grid, law: type[Law], rubbers: Sequence[Material], shares: FloatArray | None = None) -> Rubber:
    """Quadratic hexahedra of a law, filled with shares (n_rubbers, nx, ny, nz) of rubbers between `quadrature_lines`.

    Without shares all is of the first.
    """
    element, pressure = hexahedra(ORDER)
    basis = Basis(grid.mesh, element)
    mixed = np.ones((1, grid.mesh.nelements, 1))
    if shares is not None:
        lines, places = [quadrature_lines(line) for line in grid.lines], basis.mapping.F(basis.X)
        x, y, z = (np.searchsorted(line, at) - 1 for line, at in zip(lines, places, strict=True))
        mixed = shares[:, x, y, z]
    return Rubber(basis, pressure, law.of(rubbers[: len(mixed)], mixed))


def quadrature_lines(lines: FloatArray) -> FloatArray:
    """Lines of a grid along an axis, and those between the boxes that its points of integration stand for."""
    ends = np.concatenate([[0.0], np.cumsum(np.polynomial.legendre.leggauss(ORDER + 1)[1]) / 2])
    return np.append((lines[:-1, None] + np.diff(lines)[:, None] * ends[:-1]).ravel(), lines[-1])
