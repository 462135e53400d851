"""Both solvers give the same answers on every matrix, and a wrong answer is not passed on."""

import gc
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
import scipy.sparse as sp

from fem.kernel import factor as module
from fem.kernel.elements import hexahedra, taylor_hood
from fem.kernel.factor import (
    Factor,
    FactorMemoryError,
    SolverError,
    checked_solve,
    schur_product,
    whole,
)
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from fem.meshes.grid import Grid
from geometry.design import Material
from tests.fem.scenes import box_mesh


def elastic(poisson, boxes=(3, 3, 2)):
    """Stiffness of a slab of Q2 boxes of 2 mm: definite; near ν = 0.5 its condition number is 1e7."""
    lines = [np.linspace(0.0, 2.0 * n, n + 1) for n in boxes]
    return whole(System(Rubber.of(Grid(lines).mesh, hexahedra(2), [Material(poisson=poisson)])).rest_matrix())


def mixed():
    """Taylor-Hood, all but incompressible: quasi-definite, as many eigenvalues below 0 as pressures."""
    mesh = box_mesh((4, 4, 3), (10.0, 10.0, 6.0), disorder=0.2)
    return whole(System(Rubber.of(mesh, taylor_hood(), [Material(poisson=0.4999)])).rest_matrix())


def indefinite():
    """Eigenvalues on both sides of 0 and no pressures, as a tangent beyond buckling."""
    matrix = elastic(0.3)
    return (matrix - 2.0 * sp.eye_array(matrix.shape[0])).tocsr()


def unsymmetric():
    """As a tangent with pressures that follow."""
    matrix = elastic(0.3).tocoo()
    return sp.csr_matrix((matrix.data * (1 + 0.2 * (matrix.row < matrix.col)), (matrix.row, matrix.col)))


DEFINITE = {"definite": True}
MATRICES = {
    "blocks": (lambda: elastic(0.4999).tobsr((3, 3)), DEFINITE),
    "quasi-definite": (mixed, {}),
    "upper": (lambda: sp.triu(indefinite(), format="csr"), {"upper": True}),
    "upper blocks": (lambda: module._upper(indefinite().tobsr((3, 3))), {"upper": True}),
    "unsymmetric": (unsymmetric, {"symmetric": False}),
}


def pardiso() -> str:
    """Its name where it is there; its own package would search the whole environment for the library, for a second."""
    return "pardiso" if module.solver_name() == "pardiso" else pytest.skip("PARDISO is not there")


@pytest.fixture(scope="module", params=["pardiso", "superlu"])
def solver(request):
    return request.param if request.param == "superlu" else pardiso()


@pytest.mark.parametrize("name", MATRICES)
def test_every_system_is_solved_to_rounding_and_its_eigenvalues_below_0_counted(name, solver):
    """Products Bᵀ K⁻¹ B as well, by half solves or whole ones; and other values of the same pattern."""
    make, kind = MATRICES[name]
    given = make()
    factor = Factor(given, solver=solver, **kind)
    K = factor.matrix.tocsr()
    exact = np.random.default_rng(3).standard_normal((K.shape[0], 5))
    rhs = K @ exact
    kept = rhs.copy()
    x, residual = checked_solve(factor, rhs)
    assert residual < 1e-12
    assert np.allclose(x, exact, rtol=0, atol=1e-8)  # the condition number, 1e7 at most, times the residual, and room
    if solver == "superlu" or factor.definite or not factor.symmetric:
        assert factor.n_negative is None
    else:
        assert factor.n_negative == (np.linalg.eigvalsh(K.toarray()) < 0).sum() > 0
    expected = rhs.T @ exact
    rounding = (1e-12 if factor.definite else 1e-11) * np.abs(expected).max()  # and what cancels
    assert np.abs(factor.inner(np.asfortranarray(rhs)) - expected).max() < rounding
    if factor.symmetric:
        found = schur_product(factor, rhs)
        assert np.array_equal(found, found.T)
        assert np.abs(found - expected).max() < rounding
    assert np.array_equal(rhs, kept)

    again = Factor(solver=solver, **kind)
    again.factor(given * 3.0)
    with pytest.raises(SolverError, match="the matrix is not finite"):
        again.factor(given * np.nan)
    again.factor(given)
    assert np.array_equal(again.solve(rhs), factor.solve(rhs))
    if solver == "pardiso":
        with pytest.raises(ValueError, match="has another pattern than the first"):
            again.factor(sp.eye_array(K.shape[0], format="csr"))
    for wrong in (exact[:-1], exact[:, 0]):  # told an address and a length, the libraries would read past these
        with pytest.raises(ValueError, match=r"right-hand sides have shape .*, expected \(\d+, k\)"):
            factor.solve(wrong)


@pytest.mark.parametrize("columns", [0, 130])
def test_any_number_of_columns_in_any_order_of_memory(solver, columns):
    factor = Factor(elastic(0.3), solver=solver, definite=True)
    rhs = np.random.default_rng(5).standard_normal((factor.n_unknowns, 2 * columns))[:, ::2]
    for layout in (rhs, np.asfortranarray(rhs)):
        assert checked_solve(factor, layout)[0].shape == rhs.shape


def test_a_wrong_product_is_refused(solver, monkeypatch):
    """A small column as well: off by 1e-6 itself, it would add 1e-14 to what the others, 1e8 times as large, leave."""
    factor = Factor(elastic(0.3), solver=solver, definite=True)
    rhs = np.random.default_rng(3).standard_normal((factor.n_unknowns, 5))
    small = np.array([1e-8, 1, 1, 1, 1])
    scaled = factor.inner(rhs) * np.outer(small * (1 + 1e-6 * (small < 1)), small)
    monkeypatch.setattr(factor, "inner", lambda b: scaled)
    with pytest.raises(SolverError, match=r"the product of 5 columns .* is off by"):
        schur_product(factor, rhs * small)


def test_factors_give_their_memory_back():
    """10 factors kept for good would leave 180 MB behind; SuperLU's are SciPy's."""
    pardiso()
    matrix = elastic(0.3, (8, 8, 3))

    def factor_and_forget(times):
        for _ in range(times):
            Factor(matrix, solver="pardiso", definite=True).solve(np.ones((matrix.shape[0], 5)))
        gc.collect()
        return psutil.Process().memory_info().rss / 1e6

    before_mb = factor_and_forget(5)  # allocators keep some of what they once had
    assert factor_and_forget(10) - before_mb < 60


def answering(K, solve):
    """A factor of K that answers what it is told to."""
    return SimpleNamespace(matrix=K, times=K.__matmul__, n_unknowns=K.shape[0], solve=solve)


def test_answers_are_refined_once_or_refused():
    """One off by 1e-6 misses the limit; the same solver applied to what is left brings it to 1e-12. Good ones stay."""
    factor, calls = Factor(mixed()), []
    K = factor.matrix
    exact = np.random.default_rng(3).standard_normal((factor.n_unknowns, 5))
    exact[:, 1] = 0.0

    def solve(b):
        calls.append(b.shape[1])
        return factor.solve(b) * (1 + 1e-6)

    assert checked_solve(answering(K, solve), K @ exact)[1] < 1e-11
    assert calls == [5, 4]  # the zero column needs none
    for off in (0.1, np.nan):
        with pytest.raises(SolverError, match=r"residual .* is above 1e-09 for \d+ unknowns"):
            checked_solve(answering(K, lambda b, off=off: factor.solve(b) * (off + 1.0)), K @ exact)
    with pytest.raises(SolverError):  # a product in the matrix's place is what the residual is measured by
        checked_solve(factor, K @ exact, lambda x: K @ x * 1.001)


def test_columns_are_judged_one_by_one():
    """Refinement brings the first column to 1e-10; the slender second one is off by four roundings of x, 1e-7 of b."""
    k = 1e8
    matrix = sp.csr_matrix(np.array([[1.0, 0.0, 0.0], [0.0, k, -k], [0.0, -k, k + 1]]))
    rhs = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    first = np.array([[1 + 1e-6, 0.0, 0.0], [0.0, 1 + 4 * np.finfo(float).eps, 1.0]]).T
    answers = iter([first.copy(), np.array([[1e-10 - 1e-6, 0, 0], np.zeros(3)]).T, first.copy(), np.zeros((3, 2))])
    guessing = answering(matrix, lambda b: next(answers))
    assert 1e-8 < checked_solve(guessing, rhs)[1] < 1e-6
    with pytest.raises(SolverError, match=r"residual 1\.0e-06"):  # far more than rounding, and not refined
        checked_solve(guessing, rhs)


FREE = sp.csr_matrix(np.array([[1.0, -1.0], [-1.0, 1.0]]))  #: a free body moves at no cost
REFUSED = {
    "singular, as definite": (FREE, DEFINITE, "."),
    "not a number": (FREE * np.nan, {}, "not finite"),
    "indefinite": (sp.csr_matrix(np.diag([1.0, -1.0])), DEFINITE, "not positive definite.*definite=False"),
    "no diagonal": (sp.csr_matrix([[0.0, 1.0], [1.0, 0.0]]), {}, "an entry on the diagonal is missing"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_matrices_are_refused(name, solver):
    matrix, kind, says = REFUSED[name]
    if solver == "superlu" and name in ("indefinite", "no diagonal"):
        assert checked_solve(Factor(matrix, solver=solver, **kind), np.ones((2, 1)))[1] < 1e-15  # pivots, so it can
        return
    with pytest.raises(SolverError, match=says):
        checked_solve(Factor(matrix, solver=solver, **kind), np.ones((2, 1)))


def test_a_factor_that_would_not_fit_is_refused(solver, monkeypatch):
    """SuperLU's memory follows its law: of a cube, 12 bytes an entry, it is half to all of what is foreseen."""
    if solver == "superlu":
        factor = Factor(elastic(0.3, (6, 6, 6)), solver=solver, definite=True)
        lu = factor._superlu
        assert 0.5 < (lu.L.nnz + lu.U.nnz) * 12e-9 / factor.memory_gb < 1
    monkeypatch.setattr(module, "MEMORY_SHARE", 1e-12)
    with pytest.raises(FactorMemoryError, match=r"needs .* GB of .* GB available: take a coarser mesh"):
        Factor(elastic(0.3), solver=solver, definite=True)


def test_without_pardiso_superlu_solves(monkeypatch):
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    assert Factor().solver == "superlu"
