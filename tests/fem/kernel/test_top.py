"""Loads and means on rectangles of the top, wherever its faces lie; pressures that follow it."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from skfem import MeshHex

from fem.kernel.elements import Basis, hexahedra
from fem.kernel.loads import FollowerLoad
from fem.kernel.system import System
from fem.kernel.top import PatchError, Top
from geometry.law import cofactors
from tests.fem.kernel.bodies import LINES, body_of, model

#: the whole top of an upright body, parts of it across faces, a sliver along an edge of it
RECTANGLES = np.array([[0.0, 0.0, 4.0, 4.0], [0.5, 0.8, 1.9, 3.9], [1.9, 1.9, 2.1, 2.1], [0.0, 3.6, 4.0, 4.0]])


def skewed(order: int) -> Basis:
    """Hexahedra whose faces on the top are no parallelograms."""
    mesh = MeshHex.init_tensor(*LINES)
    x, y, _ = mesh.p
    inside = (x > 0) & (x < 4) & (y > 0) & (y < 4)
    moves = 0.15 * np.stack([np.sin(5 * x + 3 * y), np.cos(4 * x - y), 0 * x]) * inside
    return Basis(MeshHex(mesh.p + moves, mesh.t), hexahedra(order)[0])


@pytest.mark.parametrize("kind", ["grid 2", "grid 4", "leaning 3", "skewed 2", "skewed 3", "tetrahedra 2"])
def test_polynomials_are_integrated_exactly_over_rectangles(kind):
    """∫ xᵃ yᵇ by its closed form, for every power an element can hold, to rounding; nodes below have no part in it."""
    order = int(kind.split()[1])
    basis = skewed(order) if kind.startswith("skewed") else body_of(kind).basis
    rectangles = RECTANGLES + (np.tile([1.2, -0.8], 2) if kind.startswith("leaning") else 0.0)
    integrals = Top(basis).integrals(rectangles, whole=True)
    x, y, z = basis.doflocs
    x0, y0, x1, y1 = rectangles.T
    for a, b in product(range(order + 1), repeat=2):
        if a + b <= order:
            exact = (x1 ** (a + 1) - x0 ** (a + 1)) / (a + 1) * (y1 ** (b + 1) - y0 ** (b + 1)) / (b + 1)
            assert np.allclose(integrals @ (x**a * y**b * (z > 4.0 - 1e-9)), exact, rtol=1e-11)
            assert np.allclose(integrals @ (x**a * y**b), exact, rtol=1e-11)


def test_a_rectangle_off_the_top_is_refused_or_cut():
    top, off = Top(body_of("tetrahedra 2").basis), np.array([[-1.0, 0.0, 1.0, 2.0]])
    with pytest.raises(PatchError, match=r"has 2 of its 4 mm² on the body's top face: move or shrink it"):
        top.integrals(off, whole=True)
    assert top.integrals(off).sum() == pytest.approx(2.0, rel=1e-12)


@pytest.mark.parametrize("kind", ["grid 3", "mapped 2", "tetrahedra 2"])
def test_pressure_follows_the_deformed_top(kind):
    """On a rectangle that x = F X turns and stretches: −p cof F e_z A, with the moment of its deformed middle."""
    F = np.array([[1.2, 0.1, 0.3], [0.0, 0.9, -0.2], [-0.2, 0.3, 1.1]])
    load = FollowerLoad(center_mm=(1.7, 2.1), size_mm=(1.0, 0.8), pressure_mpa=0.5)
    system = System(body_of(kind, [model("neo-hookean")]), [load])
    x = system.points_mm @ F.T
    forces = system.nodal_loads(replace(system.rest(), u=x - system.points_mm), 0.3)
    expected = -0.3 * 0.5 * 0.8 * cofactors(F)[:, 2]
    assert np.allclose(forces.sum(axis=0), expected, atol=1e-12)
    assert np.allclose(np.cross(x, forces).sum(axis=0), np.cross(F @ [1.7, 2.1, 4.0], expected), atol=1e-12)
