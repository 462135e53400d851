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

WHEELS = {"pardiso": "pypardiso", "cholmod": "kvxopt"}  #: neither is everywhere


@pytest.fixture(scope="module")
def mixed():
    """Taylor-Hood, quasi-definite, all but incompressible."""
    mesh = box_mesh((4, 4, 3), (10.0, 10.0, 6.0), disorder=0.2)
    matrix = taylor_hood(mesh, [Material(poisson=0.4999)], np.zeros(mesh.nelements, dtype=int)).matrix
    return matrix, np.random.default_rng(3).standard_normal((matrix.shape[0], 5))


def elastic_system(boxes, poisson):
    """Stiffness of a slab of Q2 boxes of 2 mm, and five displacements."""
    basis = GridBasis(Grid(**{axis: np.linspace(0.0, 2.0 * n, n + 1) for axis, n in zip("xyz", boxes, strict=True)}))
    body = grid_body(basis, grid_stiffness(basis, [Material(poisson=poisson)]))
    return body.matrix, np.random.default_rng(3).standard_normal((body.matrix.shape[0], 5))


@pytest.fixture(scope="module")
def definite():
    return elastic_system((3, 3, 2), 0.3)


def installed(solver):
    if solver in WHEELS and not find_spec(WHEELS[solver]):
        pytest.skip(f"no {WHEELS[solver]} here")
    return solver


@pytest.fixture(params=FACTOR_BYTES)
def solver(request):
    return installed(request.param)


@pytest.fixture(params=["pardiso", "superlu"])
def direct(request):
    """A solver of any symmetric matrix."""
    return installed(request.param)


@pytest.fixture(params=["pardiso", "cholmod"])
def halving(request, definite):
    """A factor of `definite` that solves by halves."""
    return factorized(definite[0], installed(request.param), definite=True)


@pytest.fixture(
    scope="module",
    params=[
        (kind, solver)
        for kind in ("quasi-definite", "ν=0.3", "ν=0.4999")
        for solver in FACTOR_BYTES
        if (kind, solver) != ("quasi-definite", "cholmod")
    ],
    ids=", ".join,
)
def factored(request, mixed):
    """A matrix, five solutions and its factor, of every solver that takes it; near ν = 0.5 ill conditioned."""
    kind, solver = request.param
    is_definite = kind != "quasi-definite"
    matrix, exact = elastic_system((3, 3, 2), float(kind[2:])) if is_definite else mixed
    factor = factorized(matrix, installed(solver), definite=is_definite)
    assert factor.solver == solver
    return matrix, exact, factor


def test_every_system_is_solved_to_rounding(factored):
    matrix, exact, factor = factored
    assert isinstance(factor, Factor)
    x, residual = checked_solve(matrix, factor, matrix @ exact)
    assert residual < 1e-12
    # the condition number, near 1e4 of the mixed form, 1e3 at ν = 0.3 and 1e7 at 0.4999, times the residual, and room
    assert np.allclose(x, exact, rtol=0, atol=1e-8)
    assert np.array_equal(factor(matrix @ exact), factor.solve(matrix @ exact))
    x, residual = checked_solve(matrix, factor, np.zeros_like(exact))
    assert residual == 0.0
    assert not x.any()


def test_products_with_the_inverse_are_right(factored):
    """YᵀY = Bᵀ K⁻¹ B by half solves or whole ones, with K⁻¹ B known: B = K X."""
    matrix, exact, factor = factored
    expected = exact.T @ (matrix @ exact)
    product = schur_product(factor, matrix @ exact)
    assert np.array_equal(product, product.T)
    assert np.abs(product - expected).max() < 1e-11 * np.abs(expected).max()  # rounding times what cancels
    if factor.halves:
        y = factor.half_solve(matrix @ exact)
        assert np.abs(y.T @ y - expected).max() < 1e-12 * np.abs(expected).max()  # rounding, and room
    else:
        with pytest.raises(SolverError, match="has no half solve of this matrix: use schur_product"):
            factor.half_solve(exact)


def test_definite_matrices_have_half_solves_and_others_none(definite, mixed, direct):
    assert factorized(definite[0], direct, definite=True).halves == (direct == "pardiso")
    assert not factorized(mixed[0], direct).halves


def test_what_cannot_be_solved_is_refused(factored):
    """A load that is not a number; lengths that the libraries, told an address and a length, would read past."""
    matrix, exact, factor = factored
    load = exact.copy()
    load[3, 1] = np.nan
    with pytest.raises(SolverError):
        checked_solve(matrix, factor, load)
    for rhs in (exact[:-1], exact[:, 0]):
        with pytest.raises(ValueError, match=r"right-hand sides have shape .*, expected \(\d+, k\)"):
            factor(rhs)


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


def test_schur_product_eliminates(definite, solver):
    """Against eliminating the unknowns from the dense matrix."""
    matrix, _ = definite
    columns = np.arange(0, matrix.shape[0], 97)[:7]
    coupling = np.zeros((matrix.shape[0], len(columns)))
    coupling[columns, np.arange(len(columns))] = np.arange(1.0, len(columns) + 1)
    expected = coupling.T @ np.linalg.solve(matrix.toarray(), coupling)
    product = schur_product(factorized(matrix, solver, definite=True), coupling)
    assert np.abs(product - expected).max() < 1e-11 * np.abs(expected).max()


def test_a_wrong_schur_product_is_refused(definite, halving, monkeypatch):
    """A small column as well: off by 1e-6 itself, it would add 1e-14 to what the others, 1e8 times as large, leave."""
    half_solve, exact = halving.half_solve, definite[1]
    small = np.array([1e-8, 1, 1, 1, 1])
    for off, rhs, says in (
        (1.0001, exact, r"the product of 5 columns .* is off by 2.0e-04"),
        (np.array([1 + 1e-6, 1, 1, 1, 1]), exact * small, "the product of 5 columns"),
    ):
        monkeypatch.setattr(halving, "half_solve", lambda b, off=off: half_solve(b) * off)
        with pytest.raises(SolverError, match=says):
            schur_product(halving, rhs)


def test_two_factorisations_live_side_by_side(mixed, direct):
    """Factoring another matrix leaves the first one's factors alone, and so does the other's end."""
    matrix, exact = mixed
    first = factorized(matrix, direct)
    other = factorized(sp.eye_array(7, format="csr") * 2.0, direct)
    checked_solve(matrix, first, matrix @ exact)
    del other
    gc.collect()
    checked_solve(matrix, first, matrix @ exact)


def test_memory_goes_back_when_a_factor_dies(halving):
    """40 factorisations kept for good would leave 730 MB behind."""
    matrix, exact = elastic_system((8, 8, 3), 0.3)
    process = psutil.Process()

    def factor_and_forget(times):
        for _ in range(times):
            factorized(matrix, halving.solver, definite=True).solve(exact)
        gc.collect()
        return process.memory_info().rss / 1e6

    before_mb = factor_and_forget(5)  # allocators keep some of what they once had
    assert factor_and_forget(40) - before_mb < 60


def test_answers_are_refined_once_or_refused(mixed):
    """One off by 1e-6 misses the limit; the same solver applied to what is left brings it to 1e-12. Good ones stay."""
    matrix, exact = mixed
    factor, calls = factorized(matrix), []
    rhs = matrix @ exact
    rhs[:, 1] = 0.0

    def counted(b, off=0.0):
        calls.append(b.shape[1])
        return factor.solve(b) * (1 + off)

    checked_solve(matrix, counted, rhs)
    assert calls == [5]
    _, residual = checked_solve(matrix, lambda b: counted(b, 1e-6), rhs)
    assert residual < 1e-11
    assert calls == [5, 5, 4]  # the zero column needs none
    with pytest.raises(SolverError, match=r"residual .* is above 1e-09 for \d+ unknowns"):
        checked_solve(matrix, lambda b: exact * 1.001, matrix @ exact)
    with pytest.raises(SolverError):
        checked_solve(matrix, lambda b: exact * np.nan, matrix @ exact)


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


@pytest.mark.parametrize("is_definite", [False, True])
def test_a_singular_matrix_is_refused(solver, is_definite):
    """A free body moves at no cost; the factorisation or the residual says so."""
    if solver == "cholmod" and not is_definite:
        pytest.skip("CHOLMOD takes definite matrices only")
    matrix = sp.csr_matrix(np.array([[1.0, -1.0], [-1.0, 1.0]]))
    with pytest.raises(SolverError):
        checked_solve(matrix, factorized(matrix, solver, definite=is_definite), np.array([[1.0], [1.0]]))


def test_an_indefinite_matrix_is_refused_as_definite(mixed, halving):
    with pytest.raises(SolverError, match=r"not positive definite.*definite=False"):
        factorized(mixed[0], halving.solver, definite=True)


@pytest.mark.parametrize("poisson", [0.3, 0.4999])
@pytest.mark.parametrize("shape", [(3, 3), (3, 1)], ids=["square", "oblong"])
def test_a_matrix_in_blocks_is_the_same_matrix(solver, poisson, shape):
    """Square blocks reach PARDISO as they are, all else as entries; whole and half solves alike."""
    matrix, exact = elastic_system((3, 3, 2), poisson)
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


def test_what_a_solver_cannot_do_is_said(definite):
    matrix, _ = definite
    with pytest.raises(ValueError, match="no solver 'cholesky': choose pardiso"):
        factorized(matrix, "cholesky")
    with pytest.raises(ValueError, match="cholmod takes definite matrices only"):
        factorized(matrix, "cholmod")


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


@pytest.mark.skipif(not find_spec("kvxopt"), reason="kvxopt is optional")
def test_cholmod_reads_one_triangle():
    """As PARDISO does: an entry that is there in the lower triangle alone counts for both."""
    factor = CholmodFactor(sp.csr_matrix(np.array([[4.0, 0.0], [1.0, 3.0]])))
    assert np.allclose(factor.solve(np.array([[5.0], [4.0]])), 1.0)
