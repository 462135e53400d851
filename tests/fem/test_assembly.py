"""The vectorised assembly gives scikit-fem's own matrices."""

import numpy as np
from skfem import Basis, ElementTetP2, ElementVector, asm
from skfem.models.elasticity import lame_parameters, linear_elasticity

from fem.discretization.elasticity import SparsePattern, shear_blocks


def test_stiffness_equals_that_of_the_stock_vector_form(disordered_cube):
    """Two routes to one matrix; entries agree to rounding, 1e-13 of the largest."""
    scalar = Basis(disordered_cube, ElementTetP2(), intorder=2)
    vector = Basis(disordered_cube, ElementVector(ElementTetP2()), intorder=2)
    _, mu = lame_parameters(6.1, 0.3)
    stock = asm(linear_elasticity(0.0, mu), vector)

    cells = np.ones(disordered_cube.nelements)
    pattern = SparsePattern(scalar.element_dofs, scalar.element_dofs, (scalar.N, scalar.N))
    ours = pattern.vector_matrix(shear_blocks(scalar, mu * cells))

    # ours interleaves components by node; find where the vector basis keeps each
    order = np.empty(scalar.N * 3, dtype=int)
    for local in range(scalar.Nbfun):
        for axis in range(3):
            order[scalar.element_dofs[local] * 3 + axis] = vector.element_dofs[local * 3 + axis]
    difference = np.abs(ours - stock[order][:, order]).max()
    assert difference <= 1e-13 * np.abs(stock).max()


def test_pattern_sums_what_elements_share():
    """Two bar elements sharing a node add up there."""
    dofs = np.array([[0, 1], [1, 2]])  # (2 functions, 2 elements)
    values = np.array([[[1.0, -1.0], [-1.0, 1.0]], [[2.0, -2.0], [-2.0, 2.0]]])
    matrix = SparsePattern(dofs, dofs, (3, 3)).matrix(values).toarray()
    assert matrix.tolist() == [[1.0, -1.0, 0.0], [-1.0, 3.0, -2.0], [0.0, -2.0, 2.0]]


def test_rigid_motions_carry_no_energy(disordered_cube):
    """Translation along and rotation about each axis: ½ uᵀKu is rounding beside that of a stretch."""
    basis = Basis(disordered_cube, ElementTetP2(), intorder=2)
    cells = np.ones(disordered_cube.nelements)
    pattern = SparsePattern(basis.element_dofs, basis.element_dofs, (basis.N, basis.N))
    K = pattern.vector_matrix(shear_blocks(basis, 2.0 * cells))
    x, y, z = basis.doflocs
    zero, one = np.zeros_like(x), np.ones_like(x)
    motions = [
        (one, zero, zero), (zero, one, zero), (zero, zero, one),
        (zero, -z, y), (z, zero, -x), (-y, x, zero),
    ]  # fmt: skip
    stretch = np.stack([x, zero, zero]).T.ravel()
    scale = stretch @ K @ stretch
    for motion in motions:
        u = np.stack(motion).T.ravel()
        assert abs(u @ K @ u) < 1e-12 * scale
