"""Operators of high order, held against scikit-fem's matrix and what elasticity must do; lines and their integrals."""

import numpy as np
import pytest
from skfem import Basis, ElementHex2, ElementVector, MeshHex
from skfem.models.elasticity import linear_elasticity

from fem.discretization.graded_box import Term, conjugate_gradients
from fem.discretization.lagrange import elastic_tensors, line_integral, line_nodes, line_values
from fem.factor import SolverError
from geometry.design import Material

RUBBER = Material(young_mpa=6.1, poisson=0.49)
LINES = (np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0]), np.array([0.0, 0.5, 2.0]))


def applied(terms: list[Term], u):
    result = np.zeros_like(u)
    for term in terms:
        term.add_to(result, u)
    return result


def stiffness(material: Material, order: int, shear=(0.0, 0.0)) -> Term:
    elements = tuple((0, len(line) - 1) for line in LINES)
    return Term(LINES, order, order + 1, sum(elastic_tensors(material, shear)), elements)


def positions(order: int, shear=(0.0, 0.0)):
    """Positions of the nodes in the body, shape (3, nx, ny, nz)."""
    x = np.stack(np.meshgrid(*(line_nodes(line, order) for line in LINES), indexing="ij"))
    x[0] += shear[0] * x[2]
    x[1] += shear[1] * x[2]
    return x


def test_order_2_is_the_stiffness_of_scikit_fem():
    term, nodes = stiffness(RUBBER, 2), positions(2)
    u = np.random.default_rng(3).normal(size=nodes.shape)
    basis = Basis(MeshHex.init_tensor(*LINES), ElementVector(ElementHex2()), intorder=6)
    K = linear_elasticity(*RUBBER.lame_mpa).assemble(basis)
    # its functions are Lagrange's on the same 27 nodes: a table by place takes one numbering to the other
    place = {tuple(np.round(x, 9)): i for i, x in enumerate(nodes.reshape(3, -1).T)}
    node = np.array([place[tuple(np.round(x, 9))] for x in basis.doflocs.T])
    component = np.empty(basis.N, dtype=int)
    for a, name in enumerate(("u^1", "u^2", "u^3")):
        component[basis.get_dofs(elements=True).all(name)] = a
    expected = K @ u.reshape(3, -1)[component, node]
    found = applied([term], u).reshape(3, -1)[component, node]
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("shear", [(0.0, 0.0), (-1.0, 0.3)])
def test_rigid_motion_carries_no_energy_and_a_linear_field_is_in_balance_inside(shear):
    term, x = stiffness(RUBBER, 3, shear), positions(3, shear)
    for axis in np.eye(3):
        turned = np.cross(axis, x, axisb=0, axisc=0)
        for u in (turned, np.broadcast_to(axis.reshape(3, 1, 1, 1), x.shape).copy()):
            # measured against the energy of a stretch of the same size
            assert abs(np.vdot(u, applied([term], u))) <= 1e-12 * np.vdot(x, applied([term], x))
    u = np.einsum("ij,jxyz->ixyz", np.random.default_rng(5).normal(size=(3, 3)), x)
    forces = applied([term], u)
    assert np.abs(forces[:, 1:-1, 1:-1, 1:-1]).max() <= 1e-11 * np.abs(forces).max()


def test_splitting_the_body_into_boxes_changes_nothing():
    """A box of the same rubber, added as stiffness of its own, gives the whole."""
    lame_mu, order = elastic_tensors(RUBBER, (0.0, 0.0)), 2
    C = sum(lame_mu)
    whole = stiffness(RUBBER, order)
    parts = [Term(LINES, order, order + 1, C, ((first, first + 1), (0, 1), (0, 2))) for first in (0, 1)]
    u = np.random.default_rng(1).normal(size=positions(order).shape)
    assert np.allclose(applied(parts, u), applied([whole], u), rtol=1e-12, atol=1e-10)


def test_integrals_and_values_of_a_line_are_exact():
    line, order = np.array([0.0, 0.7, 2.0, 2.5]), 4
    nodes = line_nodes(line, order)
    assert line_integral(line, order, 0.3, 2.2) @ nodes**4 == pytest.approx((2.2**5 - 0.3**5) / 5, rel=1e-13)
    assert line_values(line, order, np.array([1.1]))[0] @ nodes**4 == pytest.approx(1.1**4, rel=1e-13)
    assert not line_integral(line, order, -2.0, -1.0).any()


def test_conjugate_gradients_solve_and_say_when_they_do_not():
    A = np.diag([1.0, 2.0, 30.0]) + 0.1
    b = np.array([1.0, -2.0, 3.0])
    x, steps, residual = conjugate_gradients(A.__matmul__, np.copy, b, np.zeros(3), 1e-10)
    assert np.allclose(A @ x, b, atol=1e-9)
    assert (steps <= 3, residual <= 1e-10) == (True, True)
    again, steps, _ = conjugate_gradients(A.__matmul__, np.copy, b, x, 1e-8)
    assert steps == 0
    assert np.array_equal(again, x)
    assert conjugate_gradients(A.__matmul__, np.copy, 0 * b, 0 * b, 1e-8)[1:] == (0, 0.0)
    with pytest.raises(SolverError, match="after 1 steps"):
        conjugate_gradients(A.__matmul__, np.copy, b, 0 * b, 1e-10, most=1)
