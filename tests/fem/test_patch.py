"""Integrals over rectangles are exact wherever the triangles lie."""

import numpy as np
import pytest
from skfem import Basis, ElementTetP2

from fem.tetrahedra.patch import PatchError, patch_integrals
from tests.fem.boxes import box_mesh

RECTANGLES = np.array([[0.0, 0.0, 10.0, 10.0], [1.3, 2.1, 4.7, 9.9], [4.9, 4.9, 5.1, 5.1], [0.0, 9.0, 10.0, 10.0]])


def test_polynomials_are_integrated_exactly():
    """∫ xᵃ yᵇ over a rectangle by its closed form, for every power an element can hold, to rounding."""
    mesh = box_mesh((4, 5, 2), (10.0, 10.0, 3.0))
    basis = Basis(mesh, ElementTetP2(), intorder=2)
    integrals = patch_integrals(basis, RECTANGLES)
    x, y, _ = basis.doflocs
    x0, y0, x1, y1 = RECTANGLES.T
    for a in range(3):
        for b in range(3 - a):
            exact = (x1 ** (a + 1) - x0 ** (a + 1)) / (a + 1) * (y1 ** (b + 1) - y0 ** (b + 1)) / (b + 1)
            assert np.allclose(integrals @ (x**a * y**b), exact, rtol=1e-12)


def test_only_the_top_face_is_loaded():
    """Shape functions of nodes below the top have no part in a patch."""
    mesh = box_mesh((2, 2, 2), (10.0, 10.0, 4.0))
    basis = Basis(mesh, ElementTetP2(), intorder=2)
    integrals = patch_integrals(basis, RECTANGLES[:1]).toarray()[0]
    assert np.all(integrals[basis.doflocs[2] < 4.0] == 0.0)
    assert np.isclose(integrals.sum(), 100.0, rtol=1e-12)


@pytest.mark.parametrize("rectangle", [[8.0, 8.0, 11.0, 9.0], [20.0, 0.0, 21.0, 1.0], [-1e-3, 0.0, 5.0, 5.0]])
def test_a_patch_off_the_body_is_refused_by_name(rectangle):
    mesh = box_mesh((2, 2, 2), (10.0, 10.0, 4.0))
    with pytest.raises(PatchError, match=r"of its .* mm² on the body's top face: move or shrink it"):
        patch_integrals(Basis(mesh, ElementTetP2(), intorder=2), np.array([rectangle]))
