"""Quadratic hexahedra on graded grids."""

import numpy as np
import pytest
from fem.discretization.grid import Attractor, Grid, GridBasis, graded_lines, grid_body, grid_stiffness
from skfem import Basis, ElementHex2, ElementVector, MeshHex
from skfem.models.elasticity import linear_elasticity

from fem.factor import Factor, checked_solve
from geometry.design import Material

LINES = {"x": np.array([0.0, 1.0, 3.0]), "y": np.array([0.0, 2.0, 2.5]), "z": np.array([0.0, 1.5, 4.0])}


def test_full_integration_is_scikit_fem_s_own_stiffness():
    """With ν = 0 the λ part vanishes and the rest is integrated fully: the stock form, to rounding."""
    basis = GridBasis(Grid(**LINES))
    K = grid_stiffness(basis, [Material(young_mpa=2.0, poisson=0.0)])
    stock_basis = Basis(MeshHex.init_tensor(*LINES.values()), ElementVector(ElementHex2()), intorder=5)
    stock = linear_elasticity(0.0, 1.0).assemble(stock_basis)
    place = {tuple(np.round(p, 6)): n for n, p in enumerate(basis.doflocs.T)}
    order = np.array([3 * place[tuple(np.round(p, 6))] for p in stock_basis.doflocs.T])
    for axis, name in enumerate(("u^1", "u^2", "u^3")):
        order[stock_basis.get_dofs(elements=True).all(name)] += axis
    assert np.abs(K[order][:, order] - stock).max() < 1e-12 * np.abs(stock).max()


@pytest.mark.parametrize("lean", [(0.0, 0.0), (0.7, -0.3)])
def test_uniform_strain_and_rigid_motion_on_sheared_boxes(lean):
    """Patch test: a linear field has the energy of its strain; a rigid one has none."""
    basis = GridBasis(Grid(**LINES, lean=lean))
    rubber = Material(young_mpa=3.0, poisson=0.4)
    K = grid_stiffness(basis, [rubber])
    gradient = np.array([[0.1, 0.2, -0.1], [0.0, -0.3, 0.4], [0.2, 0.1, 0.3]])
    u = (basis.doflocs.T @ gradient.T).ravel()
    lame, mu = rubber.lame_mpa
    strain = (gradient + gradient.T) / 2
    density = lame * np.trace(strain) ** 2 / 2 + mu * (strain**2).sum()
    assert np.isclose(u @ (K @ u) / 2, density * 3.0 * 2.5 * 4.0, rtol=1e-12)
    spin = (basis.doflocs.T @ (gradient - gradient.T).T).ravel()
    assert np.abs(K @ spin).max() < 1e-12 * np.abs(K).max()


def test_rectangles_are_integrated_wherever_lines_lie():
    basis = GridBasis(Grid(**LINES, lean=(0.5, 0.0)))
    area = basis.patch_integrals(np.array([[2.3, 0.4, 4.9, 2.2]]))
    assert np.isclose(area.sum(), 2.6 * 1.8)
    assert np.isclose((area @ basis.doflocs[0] ** 2)[0], 1.8 * (4.9**3 - 2.3**3) / 3)


def test_lines_crowd_at_attractors_and_levels_contain_each_other():
    attractors = [Attractor(3.0, 5.0), Attractor(10.0, 5.0, 0.5)]
    one, two = (graded_lines([0.0, 3.0, 10.0], attractors, level) for level in (2, 4))
    assert {0.0, 3.0, 10.0} <= set(one.round(9))
    assert np.isin(one.round(6), two.round(6)).all()
    assert np.diff(two)[np.searchsorted(two, 3.0)] < 0.2 * np.diff(two).max()


def test_one_factor_serves_many_loads():
    basis = GridBasis(Grid(**LINES))
    body = grid_body(basis, grid_stiffness(basis, [Material()]))
    rhs = np.random.default_rng(0).normal(size=(body.matrix.shape[0], 3))
    x, residual = checked_solve(Factor(body.matrix, definite=True), rhs)
    assert residual < 1e-10
    assert np.allclose(body.matrix @ x, rhs)
