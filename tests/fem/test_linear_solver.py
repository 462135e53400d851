"""Both solvers give the same answers, and a wrong answer is not passed on."""

from importlib.util import find_spec

import numpy as np
import pytest
import scipy.sparse as sp

from fem.elasticity import taylor_hood
from fem.linear_solver import SolverError, checked_solve, factorized
from geometry.design import Material
from tests.fem.boxes import box_mesh

SOLVERS = [
    pytest.param("pardiso", marks=pytest.mark.skipif(not find_spec("pypardiso"), reason="no wheel of MKL here")),
    "superlu",
]


@pytest.fixture(scope="module")
def system():
    mesh = box_mesh((4, 4, 3), (10.0, 10.0, 6.0), disorder=0.2)
    matrix = taylor_hood(mesh, [Material(poisson=0.4999)], np.zeros(mesh.nelements, dtype=int)).matrix
    return matrix, np.random.default_rng(3).standard_normal((matrix.shape[0], 5))


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_quasi_definite_system_is_solved_to_rounding(system, solver):
    matrix, exact = system
    x, residual = checked_solve(matrix, factorized(matrix, solver), matrix @ exact)
    assert residual < 1e-12
    assert np.allclose(x, exact, rtol=0, atol=1e-8)  # the condition number, near 1e4, times rounding, and room


@pytest.mark.parametrize("solver", SOLVERS)
def test_two_factorisations_live_side_by_side(system, solver):
    """Factoring another matrix leaves the first one's factors alone."""
    matrix, exact = system
    first = factorized(matrix, solver)
    factorized(sp.eye_array(7, format="csr") * 2.0, solver)
    checked_solve(matrix, first, matrix @ exact)


def test_a_wrong_answer_is_refused_with_its_residual(system):
    matrix, exact = system
    with pytest.raises(SolverError, match=r"residual .* is above 1e-09 for \d+ unknowns"):
        checked_solve(matrix, lambda rhs: exact * 1.001, matrix @ exact)


def test_a_nan_is_refused(system):
    matrix, exact = system
    with pytest.raises(SolverError):
        checked_solve(matrix, lambda rhs: exact * np.nan, matrix @ exact)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_zero_load_gives_zero(system, solver):
    matrix, exact = system
    x, residual = checked_solve(matrix, factorized(matrix, solver), np.zeros_like(exact))
    assert residual == 0.0
    assert not x.any()


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_singular_matrix_is_refused(solver):
    """A free body moves at no cost; the factorisation or the residual says so."""
    matrix = sp.csr_matrix(np.array([[1.0, -1.0], [-1.0, 1.0]]))
    with pytest.raises(SolverError):
        checked_solve(matrix, factorized(matrix, solver), np.array([[1.0], [1.0]]))
