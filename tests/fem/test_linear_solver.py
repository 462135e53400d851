"""Every solver gives the same answers on every problem it takes, and a wrong answer is not passed on."""

import ctypes
import gc
from importlib import metadata
from importlib.util import find_spec

import numpy as np
import psutil
import pytest
import scipy.sparse as sp

from fem.discretization.elasticity import taylor_hood
from fem.discretization.grid import Grid, GridBasis, grid_body, grid_stiffness
from fem.linear import factors, linear_solver
from fem.linear.factors import CholmodFactor, Factor, FactorMemoryError, PardisoFactor
from fem.linear.linear_solver import (
    FACTOR_BYTES,
    SolverError,
    checked_solve,
    factorized,
    schur_product,
    solver_name,
)
from geometry.design import Material
from tests.fem.boxes import box_mesh

PARDISO = pytest.param("pardiso", marks=pytest.mark.skipif(not find_spec("pypardiso"), reason="no wheel of MKL here"))
CHOLMOD = pytest.param("cholmod", marks=pytest.mark.skipif(not find_spec("kvxopt"), reason="kvxopt is optional"))
DIRECT = [PARDISO, "superlu"]  #: of any symmetric matrix
DEFINITE = [PARDISO, CHOLMOD, "superlu"]
HALVES = [PARDISO, CHOLMOD]


@pytest.fixture(scope="module")
def mesh():
    return box_mesh((4, 4, 3), (10.0, 10.0, 6.0), disorder=0.2)


@pytest.fixture(scope="module")
def mixed(mesh):
    """Taylor-Hood, quasi-definite, all but incompressible."""
    matrix = taylor_hood(mesh, [Material(poisson=0.4999)], np.zeros(mesh.nelements, dtype=int)).matrix
    return matrix, np.random.default_rng(3).standard_normal((matrix.shape[0], 5))


@pytest.fixture(scope="module", params=[0.3, 0.4999], ids=["ν=0.3", "ν=0.4999"])
def elastic(request):
    """Displacements alone, definite; ill conditioned near ν = 0.5."""
    return elastic_system((3, 3, 2), request.param)


@pytest.fixture(scope="module")
def definite():
    return elastic_system((3, 3, 2), 0.3)


def elastic_system(boxes, poisson):
    """Stiffness of a slab of Q2 boxes of 2 mm, and five displacements."""
    basis = GridBasis(Grid(**{axis: np.linspace(0.0, 2.0 * n, n + 1) for axis, n in zip("xyz", boxes, strict=True)}))
    body = grid_body(basis, grid_stiffness(basis, [Material(poisson=poisson)]))
    return body.matrix, np.random.default_rng(3).standard_normal((body.matrix.shape[0], 5))


@pytest.mark.parametrize("solver", DIRECT)
def test_a_quasi_definite_system_is_solved_to_rounding(mixed, solver):
    matrix, exact = mixed
    x, residual = checked_solve(matrix, factorized(matrix, solver), matrix @ exact)
    assert residual < 1e-12
    assert np.allclose(x, exact, rtol=0, atol=1e-8)  # the condition number, near 1e4, times rounding, and room


@pytest.mark.parametrize("solver", DEFINITE)
def test_a_definite_system_is_solved(elastic, solver):
    matrix, exact = elastic
    factor = factorized(matrix, solver, definite=True)
    assert factor.solver == solver
    x, residual = checked_solve(matrix, factor, matrix @ exact)
    assert residual < 1e-12
    # the condition number, near 1e3 at ν = 0.3 and 1e7 at 0.4999, times the residual
    assert np.allclose(x, exact, rtol=0, atol=1e-8)


@pytest.mark.parametrize("solver", DEFINITE)
@pytest.mark.parametrize("columns", [0, 1, 2, 65, 130])
def test_any_number_of_columns_in_any_order_of_memory(definite, solver, columns):
    """CHOLMOD's columns go by 64, one column takes another way; rows or columns may be contiguous, or neither."""
    matrix, _ = definite
    rhs = np.random.default_rng(5).standard_normal((matrix.shape[0], 2 * columns))[:, ::2]
    kept = rhs.copy()
    factor = factorized(matrix, solver, definite=True)
    for layout in (rhs, np.asfortranarray(rhs)):
        x, _ = checked_solve(matrix, factor, layout)
        assert x.shape == rhs.shape
        assert np.array_equal(layout, kept)  # a solve leaves its right-hand sides alone


@pytest.mark.parametrize("solver", HALVES)
def test_half_solves_multiply_to_the_whole(elastic, solver):
    """YᵀY = Bᵀ K⁻¹ B, with K⁻¹ B known: B = K X."""
    matrix, exact = elastic
    factor = factorized(matrix, solver, definite=True)
    assert factor.halves
    y = factor.half_solve(matrix @ exact)
    expected = exact.T @ (matrix @ exact)
    assert np.abs(y.T @ y - expected).max() < 1e-12 * np.abs(expected).max()  # rounding, and room


@pytest.mark.parametrize("solver", DIRECT)
def test_an_indefinite_matrix_has_no_half_solve(mixed, solver):
    matrix, exact = mixed
    factor = factorized(matrix, solver)
    assert not factor.halves
    with pytest.raises(SolverError, match="has no half solve of this matrix: use schur_product"):
        factor.half_solve(exact)


@pytest.mark.parametrize("solver", DEFINITE)
def test_schur_product_of_a_definite_matrix(definite, solver):
    """Against eliminating the unknowns from the dense matrix."""
    matrix, _ = definite
    columns = np.arange(0, matrix.shape[0], 97)[:7]
    coupling = np.zeros((matrix.shape[0], len(columns)))
    coupling[columns, np.arange(len(columns))] = np.arange(1.0, len(columns) + 1)
    expected = coupling.T @ np.linalg.solve(matrix.toarray(), coupling)
    product = schur_product(factorized(matrix, solver, definite=True), coupling)
    assert np.array_equal(product, product.T)
    assert np.abs(product - expected).max() < 1e-11 * np.abs(expected).max()


@pytest.mark.parametrize("solver", DIRECT)
def test_schur_product_of_a_quasi_definite_matrix(mixed, solver):
    matrix, exact = mixed
    expected = exact.T @ (matrix @ exact)
    product = schur_product(factorized(matrix, solver), matrix @ exact)
    assert np.abs(product - expected).max() < 1e-11 * np.abs(expected).max()  # rounding times what cancels


@pytest.mark.parametrize("solver", HALVES)
def test_a_wrong_schur_product_is_refused(definite, solver, monkeypatch):
    matrix, exact = definite
    factor = factorized(matrix, solver, definite=True)
    half_solve = factor.half_solve
    monkeypatch.setattr(factor, "half_solve", lambda rhs: half_solve(rhs) * 1.0001)
    with pytest.raises(SolverError, match=r"the product of 5 columns .* is off by 2.0e-04"):
        schur_product(factor, exact)


@pytest.mark.parametrize("solver", HALVES)
def test_a_small_column_is_checked_as_well(definite, solver, monkeypatch):
    """Off by 1e-6 itself, it would add 1e-14 to what the others, 1e8 times as large, leave."""
    matrix, exact = definite
    factor = factorized(matrix, solver, definite=True)
    half_solve = factor.half_solve
    off = np.array([1 + 1e-6, 1, 1, 1, 1])
    monkeypatch.setattr(factor, "half_solve", lambda rhs: half_solve(rhs) * off)
    with pytest.raises(SolverError, match="the product of 5 columns"):
        schur_product(factor, exact * np.array([1e-8, 1, 1, 1, 1]))


@pytest.mark.parametrize("solver", DIRECT)
def test_two_factorisations_live_side_by_side(mixed, solver):
    """Factoring another matrix leaves the first one's factors alone, and so does the other's end."""
    matrix, exact = mixed
    first = factorized(matrix, solver)
    other = factorized(sp.eye_array(7, format="csr") * 2.0, solver)
    checked_solve(matrix, first, matrix @ exact)
    del other
    gc.collect()
    checked_solve(matrix, first, matrix @ exact)


@pytest.mark.parametrize("solver", [PARDISO, CHOLMOD])
def test_memory_goes_back_when_a_factor_dies(solver):
    """40 factorisations kept for good would leave 730 MB behind."""
    matrix, exact = elastic_system((8, 8, 3), 0.3)
    process = psutil.Process()

    def factor_and_forget(times):
        for _ in range(times):
            factorized(matrix, solver, definite=True).solve(exact)
        gc.collect()
        return process.memory_info().rss / 1e6

    before_mb = factor_and_forget(5)  # allocators keep some of what they once had
    assert factor_and_forget(40) - before_mb < 60


def test_a_poor_answer_is_refined_once(mixed):
    """An answer off by 1e-6 misses the limit; the same solver applied to what is left brings it to 1e-12."""
    matrix, exact = mixed
    factor = factorized(matrix)
    rhs = matrix @ exact
    rhs[:, 1] = 0.0
    calls = []

    def sloppy(b):
        calls.append(b.shape[1])
        return factor.solve(b) * (1 + 1e-6)

    _, residual = checked_solve(matrix, sloppy, rhs)
    assert residual < 1e-11
    assert calls == [5, 4]  # the zero column needs none


def test_columns_are_judged_one_by_one():
    """Refinement brings the first column to 1e-10; the slender second one is off by four roundings of x, 1e-7 of b."""
    k = 1e8
    matrix = sp.csr_matrix(np.array([[1.0, 0.0, 0.0], [0.0, k, -k], [0.0, -k, k + 1]]))
    rhs = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    slender = [0.0, 1 + 4 * np.finfo(float).eps, 1.0]
    answers = iter([np.array([[1 + 1e-6, 0.0, 0.0], slender]).T, np.array([[1e-10 - 1e-6, 0, 0], np.zeros(3)]).T])
    x, residual = checked_solve(matrix, lambda b: next(answers), rhs)
    assert 1e-8 < residual < 1e-6
    assert x[0, 0] == pytest.approx(1 + 1e-10, rel=1e-14)
    answers = iter([np.array([[1 + 1e-6, 0.0, 0.0], slender]).T, np.zeros((3, 2))])
    with pytest.raises(SolverError, match=r"residual 1\.0e-06"):  # far more than rounding, and not refined
        checked_solve(matrix, lambda b: next(answers), rhs)


def test_a_product_may_stand_in_for_the_matrix(mixed):
    """It is what the residual is measured by, so a wrong one is found out."""
    matrix, exact = mixed
    factor = factorized(matrix)
    _, residual = checked_solve(matrix, factor, matrix @ exact, lambda x: matrix @ x)
    assert residual < 1e-12
    with pytest.raises(SolverError):
        checked_solve(matrix, factor, matrix @ exact, lambda x: matrix @ x * 1.001)


def test_a_good_answer_is_not_refined(mixed):
    matrix, exact = mixed
    factor, calls = factorized(matrix), []
    checked_solve(matrix, lambda b: calls.append(b) or factor.solve(b), matrix @ exact)
    assert len(calls) == 1


def test_a_wrong_answer_is_refused_with_its_residual(mixed):
    matrix, exact = mixed
    with pytest.raises(SolverError, match=r"residual .* is above 1e-09 for \d+ unknowns"):
        checked_solve(matrix, lambda rhs: exact * 1.001, matrix @ exact)


def test_a_nan_is_refused(mixed):
    matrix, exact = mixed
    with pytest.raises(SolverError):
        checked_solve(matrix, lambda rhs: exact * np.nan, matrix @ exact)


@pytest.mark.parametrize("solver", DEFINITE)
def test_a_nan_load_is_refused(definite, solver):
    matrix, exact = definite
    factor = factorized(matrix, solver, definite=True)
    load = exact.copy()
    load[3, 1] = np.nan
    with pytest.raises(SolverError):
        checked_solve(matrix, factor, load)


@pytest.mark.parametrize("solver", DEFINITE)
def test_a_zero_load_gives_zero(mixed, definite, solver):
    for matrix, exact in (definite,) if solver == "cholmod" else (definite, mixed):
        factor = factorized(matrix, solver, definite=matrix is definite[0])
        x, residual = checked_solve(matrix, factor, np.zeros_like(exact))
        assert residual == 0.0
        assert not x.any()


@pytest.mark.parametrize("definite", [False, True])
@pytest.mark.parametrize("solver", [*DIRECT, CHOLMOD])
def test_a_singular_matrix_is_refused(solver, definite):
    """A free body moves at no cost; the factorisation or the residual says so."""
    if solver == "cholmod" and not definite:
        pytest.skip("CHOLMOD takes definite matrices only")
    matrix = sp.csr_matrix(np.array([[1.0, -1.0], [-1.0, 1.0]]))
    with pytest.raises(SolverError):
        checked_solve(matrix, factorized(matrix, solver, definite=definite), np.array([[1.0], [1.0]]))


@pytest.mark.parametrize("solver", HALVES)
def test_an_indefinite_matrix_is_refused_as_definite(mixed, solver):
    with pytest.raises(SolverError, match=r"not positive definite.*definite=False"):
        factorized(mixed[0], solver, definite=True)


@pytest.mark.parametrize("solver", DEFINITE)
@pytest.mark.parametrize("shape", [(3, 3), (3, 1)], ids=["square", "oblong"])
def test_a_matrix_in_blocks_is_the_same_matrix(elastic, solver, shape):
    """Square blocks reach PARDISO as they are, all else as entries; whole and half solves alike."""
    matrix, exact = elastic
    factor = factorized(matrix.tobsr(shape), solver, definite=True)
    x, residual = checked_solve(factor.matrix, factor, matrix @ exact)
    assert residual < 1e-12
    assert np.allclose(x, exact, rtol=0, atol=1e-8)  # as of entries, above
    expected = exact.T @ (matrix @ exact)
    assert np.abs(factor.inner(matrix @ exact) - expected).max() < 1e-12 * np.abs(expected).max()


def test_pardiso_wants_the_whole_diagonal():
    pytest.importorskip("pypardiso")
    with pytest.raises(SolverError, match="an entry on the diagonal is missing"):
        factorized(sp.csr_matrix(np.array([[0.0, 1.0], [1.0, 0.0]])), "pardiso")
    with pytest.raises(SolverError, match="an entry on the diagonal is missing"):
        factorized(sp.bsr_matrix(np.kron([[0.0, 1.0], [1.0, 0.0]], np.ones((2, 2))), blocksize=(2, 2)), "pardiso")


def test_mkl_is_found_in_its_package_or_left_to_pypardiso(monkeypatch):
    """Both are one library; without the package's list of files, or by a person's choice, pypardiso searches."""
    pypardiso = pytest.importorskip("pypardiso")
    searched = pypardiso.PyPardisoSolver().libmkl
    try:
        metadata.distribution("mkl")
    except metadata.PackageNotFoundError:
        assert factors._installed_mkl() is None
    else:
        assert factors._installed_mkl()._handle == searched._handle
    with monkeypatch.context() as patch:
        patch.setenv("PYPARDISO_MKL_RT", "elsewhere")
        assert factors._installed_mkl() is None
    monkeypatch.setattr(factors.metadata, "files", lambda name: None)
    assert factors._installed_mkl() is None
    address = ctypes.cast(factors._mkl_pardiso.__wrapped__(), ctypes.c_void_p).value
    assert address == ctypes.cast(searched["pardiso"], ctypes.c_void_p).value


@pytest.mark.parametrize("solver", DEFINITE)
def test_right_hand_sides_of_another_length_are_refused(definite, solver):
    """The libraries are told an address and a length; a wrong length must not reach them."""
    matrix, exact = definite
    factor = factorized(matrix, solver, definite=True)
    for rhs in (exact[:-1], exact[:, 0]):
        with pytest.raises(ValueError, match=r"right-hand sides have shape .*, expected \(\d+, k\)"):
            factor(rhs)


def test_what_a_solver_cannot_do_is_said(definite):
    matrix, _ = definite
    with pytest.raises(ValueError, match="no solver 'cholesky': choose pardiso"):
        factorized(matrix, "cholesky")
    with pytest.raises(ValueError, match="cholmod takes definite matrices only"):
        factorized(matrix, "cholmod")


@pytest.mark.parametrize("solver", DEFINITE)
def test_a_factor_that_does_not_fit_is_refused(definite, solver):
    with pytest.raises(FactorMemoryError, match=r"GB of 1e-05 GB available: take a coarser mesh"):
        factorized(definite[0], solver, definite=True, memory_gb=1e-5)


def test_the_default_is_the_fastest_solver_installed(definite, mixed, monkeypatch):
    assert factorized(mixed[0]).solver == solver_name()
    assert factorized(definite[0], definite=True).solver == solver_name(definite=True)
    monkeypatch.setattr(linear_solver, "find_spec", lambda name: None)
    assert solver_name() == solver_name(definite=True) == "superlu"
    monkeypatch.setattr(linear_solver, "find_spec", lambda name: name == "kvxopt" or None)
    assert solver_name() == "superlu"
    assert solver_name(definite=True) == "cholmod"


def test_the_law_of_memory_holds_for_a_cube():
    """PARDISO's symbolic analysis agrees with the law to a third."""
    pytest.importorskip("pypardiso")
    matrix, _ = elastic_system((8, 8, 8), 0.3)
    factor = PardisoFactor(matrix, definite=True)
    law_gb = FACTOR_BYTES["pardiso"] * matrix.shape[0] ** (4 / 3) / 1e9
    assert law_gb == pytest.approx(factor.memory_gb, rel=0.33)


def test_a_factor_is_a_function(definite):
    matrix, exact = definite
    factor = factorized(matrix, definite=True)
    assert isinstance(factor, Factor)
    assert np.array_equal(factor(exact), factor.solve(exact))


@pytest.mark.skipif(not find_spec("kvxopt"), reason="kvxopt is optional")
def test_cholmod_reads_one_triangle():
    """As PARDISO does: an entry that is there in the lower triangle alone counts for both."""
    factor = CholmodFactor(sp.csr_matrix(np.array([[4.0, 0.0], [1.0, 3.0]])))
    assert np.allclose(factor.solve(np.array([[5.0], [4.0]])), 1.0)
