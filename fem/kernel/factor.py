"""Sparse linear systems: factored once or again and again, by MKL PARDISO (x86-64) or SciPy's SuperLU.

`Factor` gives unchecked solutions for many right-hand sides; `checked_solve` and `schur_product` check theirs.
"""

import ctypes
import os
import weakref
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib import metadata
from importlib.util import find_spec
from typing import TypeAlias

import numpy as np
import psutil
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from common.errors import TriPillarError
from geometry.layout import FloatArray

SparseMatrix: TypeAlias = sp.csr_matrix | sp.bsr_matrix

RESIDUAL_LIMIT = 1e-9  #: largest relative residual of an accepted solution; a sound factorisation gives 1e-12
ROUNDING = 1e-14  #: backward error of a solution as good as double precision gives
SLENDER_LIMIT = 1e-4  #: largest relative residual of such a solution; a singular matrix leaves more
MEMORY_SHARE = 0.9  #: largest share of the available memory that a factor may take
WIDTH = 128  #: columns of whole solves at a time: as quick as all at once, and their copies take far less memory

#: Memory of SuperLU's factor in bytes over n^(4/3), the law of nested dissection in 3-D. Measured on cubes of hexahedra
#: and P2 tetrahedra of 14 to 105 thousand unknowns; slabs need a third less. PARDISO's analysis foresees its own
SUPERLU_BYTES = 640.0


class SolverError(TriPillarError, ArithmeticError):
    """A linear system whose solution could not be trusted."""


class FactorMemoryError(SolverError, MemoryError):
    """A factor that would not fit in memory."""


def solver_name() -> str:
    """The solver in use, 'pardiso' or 'superlu'."""
    return "pardiso" if find_spec("pypardiso") else "superlu"


class Factor:
    """A factored sparse matrix K; its memory goes back when the object dies.

    A `SolverError` says that K cannot be factored, a `FactorMemoryError`, before it is tried, that it would not fit.

    Parameters
    ----------
    matrix : csr_matrix or bsr_matrix, shape (n, n), optional
        K; left out, `factor` takes the first one. PARDISO analyses square blocks as one entry each: 6 × 6 coupled cells
        (11 613 unknowns in blocks of 21) in 3 ms instead of 0.6 to 1.1 s.
    definite, symmetric : bool
        Positive definite, as of displacements alone (the mixed form's K is not); symmetric, or with `False` not.
    upper : bool
        True if only the upper triangle of a symmetric matrix is given; blocks on the diagonal are whole.
    by_degree : bool
        Order by minimum degree, not by nested dissection: better for boxes that are split, worse for grids.
    solver : {"pardiso", "superlu"}, optional
        Default: `solver_name`. SuperLU is many times slower.
    """

    def __init__(
        self,
        matrix: SparseMatrix | None = None,
        *,
        definite: bool = False,
        symmetric: bool = True,
        upper: bool = False,
        by_degree: bool = False,
        solver: str | None = None,
    ) -> None:
        if solver not in (None, "pardiso", "superlu"):
            raise ValueError(f"no solver '{solver}': choose pardiso or superlu.")
        self.solver = solver or solver_name()
        self.definite, self.symmetric, self.upper = definite, symmetric, upper
        self.memory_gb = 0.0  #: of the factor, at the peak
        self.n_negative: int | None = None  #: eigenvalues of an indefinite K below 0, where the solver counts them
        self._by_degree = by_degree
        self._pardiso: _Pardiso | None = None
        self._lower: SparseMatrix | None = None
        if matrix is not None:
            self.factor(matrix)

    @property
    def matrix(self) -> SparseMatrix:
        """K, both triangles."""
        return whole(self._given) if self.upper else self._given

    def times(self, x: FloatArray) -> FloatArray:
        """K x, shape (n, k)."""
        if not self.upper:
            return self._given @ x
        if self._lower is None:
            self._lower = self._given.T.asformat(self._given.format)  # scipy would make it anew for every product
        return _times(self._given, x, self._lower)

    def factor(self, matrix: SparseMatrix) -> None:
        """Factor a matrix, the first one or other values in its pattern; raises as the class does."""
        self._given, self._lower, self.n_unknowns = matrix, None, matrix.shape[0]
        if not np.isfinite(matrix.data).all():
            raise _not_factored(self.n_unknowns, "the matrix is not finite.")
        if self.solver == "pardiso":
            self._by_pardiso(matrix)
            return
        self.memory_gb = SUPERLU_BYTES * self.n_unknowns ** (4 / 3) / 1e9
        _check_memory(self.n_unknowns, self.memory_gb)
        # symmetric mode keeps the fill of a symmetric ordering, 1e-3 pivots where rounding would be lost otherwise
        options = {"ColPerm": "MMD_AT_PLUS_A", "DiagPivotThresh": 1e-3, "SymmetricMode": True}
        try:
            self._superlu = splu(self.matrix.tocsc(), options=options)
        except RuntimeError as error:
            raise _not_factored(self.n_unknowns, error) from None
        except MemoryError:
            raise _out_of_memory(self.n_unknowns) from None

    def _by_pardiso(self, matrix: SparseMatrix) -> None:
        if matrix.format == "bsr" and matrix.blocksize[0] != matrix.blocksize[1]:
            matrix = matrix.tocsr()
        part = _upper(matrix) if self.symmetric and not self.upper else matrix
        part = part if part.has_sorted_indices else part.sorted_indices()  # answers are wrong otherwise
        if self._pardiso is None:
            pardiso = _Pardiso(part, (2 if self.definite else -2) if self.symmetric else 11, self._by_degree)
            # not at exit: the process gives all memory back then, and MKL may be gone already
            weakref.finalize(self, pardiso.call, -1).atexit = False
            pardiso.call(11)
            self.memory_gb = pardiso.memory_gb
            _check_memory(self.n_unknowns, self.memory_gb)
            self._pardiso = pardiso
        else:
            self._pardiso.take(part)
        self._pardiso.call(22)
        self.n_negative = int(self._pardiso.iparm[22]) if self._pardiso.mtype == -2 else None

    def solve(self, rhs: FloatArray) -> FloatArray:
        """K⁻¹ B, shape (n, k), of right-hand sides B, shape (n, k); unchecked, see `checked_solve`."""
        return self._solved(rhs, 33)

    def inner(self, rhs: FloatArray) -> FloatArray:
        """Bᵀ K⁻¹ B, shape (k, k); unchecked, see `schur_product`.

        K = Pᵀ L Lᵀ P of a definite matrix has half solves Y = L⁻¹ P B with YᵀY = Bᵀ K⁻¹ B. Those of LDLᵀ do not
        multiply so.
        """
        if self._pardiso is not None and self.definite:
            y = self._solved(rhs, 331)
            return y.T @ y
        starts = range(0, max(1, rhs.shape[-1]), WIDTH)
        return np.hstack([rhs.T @ self.solve(rhs[..., start : start + WIDTH]) for start in starts])

    def _solved(self, rhs: FloatArray, phase: int) -> FloatArray:
        if rhs.ndim != 2 or rhs.shape[0] != self.n_unknowns:  # the libraries would read past the end of shorter ones
            expected = f"({self.n_unknowns}, k): one column for each"
            raise ValueError(f"right-hand sides have shape {rhs.shape}, expected {expected}.")
        return self._superlu.solve(rhs) if self._pardiso is None else self._pardiso.call(phase, rhs)


class _Pardiso:
    """The library's state for one pattern; knows nothing of the `Factor` whose death releases it.

    The library is called directly, because pypardiso refines every answer, copies the matrix at each call and keeps the
    factor's memory for good. `checked_solve` refines instead, when it must. iparm 24 = 10 corrupted the heap (MKL
    2026.2). Scaling and matching (11, 13) want the values at the analysis, and tangents need neither.
    """

    def __init__(self, part: SparseMatrix, mtype: int, by_degree: bool = False) -> None:
        block = part.blocksize[0] if part.format == "bsr" else 1
        self.n, self.mtype = part.shape[0], mtype
        if part.nnz >= 2**31:
            raise FactorMemoryError(f"{part.nnz} entries are too many for 32-bit PARDISO: take a coarser mesh.")
        self._indptr = part.indptr.astype(np.int32, copy=False)
        self._indices = part.indices.astype(np.int32, copy=False)
        first = part.indices[part.indptr[:-1][np.diff(part.indptr) > 0]]  # of each row that has any
        if mtype != 11 and not np.array_equal(first, np.arange(self.n // block)):
            raise _not_factored(self.n, "an entry on the diagonal is missing.")
        self.take(part)
        self._pt = np.zeros(64, dtype=np.int64)
        self.iparm = np.zeros(64, dtype=np.int32)
        # numbers as in MKL's manual, which counts from 1; its own defaults gave wrong answers (pypardiso issue 87)
        for number, value in {
            1: 1,  # take these settings instead of the defaults
            2: 0 if by_degree else 3,  # nested dissection, in parallel
            8: 0,  # no iterative refinement, unless a pivot had to be perturbed
            10: 13,  # perturb pivots below 1e-13: none of definite, quasi-definite or indefinite tangents' were
            21: 1,  # 1×1 and 2×2 Bunch-Kaufman pivots
            35: 1,  # indices count from 0, and blocks are stored by rows
            37: block if block > 1 else 0,  # entries are blocks
        }.items():
            self.iparm[number - 1] = value

    def take(self, part: SparseMatrix) -> None:
        """Values to be factored next."""
        if not (np.array_equal(part.indptr, self._indptr) and np.array_equal(part.indices, self._indices)):
            raise ValueError(f"this matrix of {self.n} unknowns has another pattern than the first: make a new Factor.")
        self._data = np.ascontiguousarray(part.data, dtype=np.float64)

    def call(self, phase: int, rhs: FloatArray | None = None) -> FloatArray:
        """Run one phase, on right-hand sides (n, k) if it takes any; returns (n, k), columns contiguous."""
        b = np.zeros((self.n, 1)) if rhs is None else np.asfortranarray(rhs, dtype=np.float64)
        x = np.zeros(b.shape, order="F")
        if b.size == 0:
            return x
        error, blocks = ctypes.c_int32(0), len(self._indptr) - 1
        numbers = [ctypes.byref(ctypes.c_int32(i)) for i in (1, 1, self.mtype, phase, blocks, b.shape[1], 0)]
        entries = (self._data.ctypes, self._indptr.ctypes, self._indices.ctypes, None)
        ends = (self.iparm.ctypes, numbers[6], b.ctypes, x.ctypes, ctypes.byref(error))
        _mkl_pardiso()(self._pt.ctypes, *numbers[:5], *entries, numbers[5], *ends)
        if error.value == -4 and self.mtype == 2:
            why = "Is the body clamped? A mixed (quasi-definite) matrix takes definite=False."
            raise _not_factored(self.n, f"the matrix is not positive definite. {why}")
        if error.value == -2:
            raise _out_of_memory(self.n)
        if error.value:
            raise _not_factored(self.n, f"PARDISO gave error {error.value}.")
        return x

    @property
    def memory_gb(self) -> float:
        """What the factor takes at the peak, known after the analysis."""
        return max(self.iparm[14], int(self.iparm[15]) + int(self.iparm[16])) / 1e6


def _upper(matrix: SparseMatrix) -> SparseMatrix:
    """Entries or square blocks on the diagonal and above it; those on it whole."""
    if matrix.format != "bsr":
        return sp.triu(matrix, format="csr")
    kept = sp.triu(sp.csr_matrix((np.arange(len(matrix.indices)), matrix.indices, matrix.indptr)), format="csr")
    return sp.bsr_matrix((matrix.data[kept.data], kept.indices, kept.indptr), shape=matrix.shape)


def whole(upper: SparseMatrix) -> sp.csr_matrix:
    """Both triangles of a symmetric matrix given by the upper one; blocks on the diagonal are whole."""
    part, block = upper.tocoo(), upper.blocksize[0] if upper.format == "bsr" else 1
    above = part.row // block < part.col // block
    rest = (part.data[above], (part.col[above], part.row[above]))
    return (part + sp.coo_matrix(rest, shape=upper.shape)).tocsr()


def _times(upper: SparseMatrix, x: FloatArray, lower: SparseMatrix) -> FloatArray:
    """K x, shape (n, k), of a symmetric K given by its upper triangle and the transpose of that."""
    block = upper.blocksize[0] if upper.format == "bsr" else 1
    rows = np.repeat(np.arange(len(upper.indptr) - 1), np.diff(upper.indptr))
    diagonal = upper.data.reshape(-1, block, block)[rows == upper.indices]
    return upper @ x + lower @ x - (diagonal @ x.reshape(len(diagonal), block, -1)).reshape(x.shape)


@cache
def _mkl_pardiso() -> Callable[..., None]:
    """The library's function: from the package `mkl`, or by pypardiso's own search, which takes 0.4 s."""
    library = None
    if "PYPARDISO_MKL_RT" not in os.environ:  # a person's choice, which pypardiso heeds
        with suppress(metadata.PackageNotFoundError, StopIteration, OSError):
            file = next(file for file in metadata.files("mkl") or [] if "mkl_rt" in file.name)
            library = ctypes.CDLL(str(file.locate()))
    if library is None:
        from pypardiso import PyPardisoSolver

        library = PyPardisoSolver().libmkl
    return library["pardiso"]  # by index: a fresh function, without pypardiso's argument types


def _check_memory(n: int, memory_gb: float) -> None:
    limit = MEMORY_SHARE * psutil.virtual_memory().available / 1e9
    if memory_gb > limit:
        need = f"the factor of {n} unknowns needs {memory_gb:.3g} GB"
        raise FactorMemoryError(f"{need} of {limit:.3g} GB available: take a coarser mesh.")


def _not_factored(n: int, why: object) -> SolverError:
    return SolverError(f"{n} unknowns could not be factored: {why}")


def _out_of_memory(n: int) -> FactorMemoryError:
    return FactorMemoryError(f"the factor of {n} unknowns does not fit in memory: take a coarser mesh.")


def checked_solve(
    factor: Factor, rhs: FloatArray, product: Callable[[FloatArray], FloatArray] | None = None
) -> tuple[FloatArray, float]:
    """Solutions (n, k) and their largest relative residual ‖Kx − b‖/‖b‖; `SolverError` if it is too large.

    Of several columns a sum with random signs, each over its own ‖b‖, is looked at first: where its residual is within
    `RESIDUAL_LIMIT`, it stands for all. Else, columns above the limit get one step of iterative refinement. Slender
    bodies bend so far under small forces that rounding alone leaves more: a backward error of `ROUNDING` is accepted
    too. `product` takes x to K x where something is faster than the sparse matrix.
    """
    product = product or factor.times
    x = factor.solve(rhs)
    with np.errstate(over="ignore", invalid="ignore"):  # infinities and NaN are refused below
        if rhs.shape[1] > 1:
            size = np.linalg.norm(rhs, axis=0)
            signs = np.random.default_rng(0).choice([-1.0, 1.0], len(size)) / np.where(size > 0, size, 1.0)
            together = float(np.linalg.norm(rhs @ signs - product((x @ signs)[:, None])[:, 0]))
            if together <= RESIDUAL_LIMIT:
                return x, together
        misfit = rhs - product(x)
        residuals = _relative(misfit, rhs)
        poor = ~(residuals <= RESIDUAL_LIMIT)
        if poor.any() and np.isfinite(misfit).all():
            x[:, poor] += factor.solve(misfit[:, poor])
            residuals[poor] = _relative(rhs[:, poor] - product(x[:, poor]), rhs[:, poor])
            poor = ~(residuals <= RESIDUAL_LIMIT)
        if poor.any():
            matrix = factor.matrix
            size = np.linalg.norm(abs(matrix) @ np.abs(x), axis=0) + np.linalg.norm(rhs, axis=0)
            rounded = np.linalg.norm(rhs - matrix @ x, axis=0) <= ROUNDING * size
            poor &= ~(rounded & (residuals <= SLENDER_LIMIT))
    residual = float(np.max(residuals, initial=0.0))
    if poor.any():
        raise SolverError(
            f"residual {residual:.1e} is above {RESIDUAL_LIMIT:g} for {factor.n_unknowns} unknowns: the mesh may have "
            "degenerate elements or the moduli differ too widely; mesh again or bring them closer."
        )
    return x, residual


def schur_product(factor: Factor, rhs: FloatArray) -> FloatArray:
    """Bᵀ K⁻¹ B, shape (m, m), symmetric: what eliminating K takes from the stiffness of the rest, coupled by B (n, m).

    Its product with a random vector is checked, columns scaled to equal energies; a `SolverError` says if it is off.
    """
    product = factor.inner(rhs)
    energies = np.abs(np.diag(product))
    scale = 1 / np.sqrt(np.where(energies > 0, energies, 1.0))[:, None]
    w = scale * np.random.default_rng(0).standard_normal((rhs.shape[1], 1))
    x, _ = checked_solve(factor, rhs @ w)
    expected = rhs.T @ x
    misfit = float(np.max(_relative(scale * (product @ w - expected), scale * expected), initial=0.0))
    if not misfit <= RESIDUAL_LIMIT:
        raise SolverError(
            f"the product of {rhs.shape[1]} columns with {factor.n_unknowns} unknowns eliminated is off by "
            f"{misfit:.1e}, above {RESIDUAL_LIMIT:g}: the mesh may have degenerate elements or the moduli differ too "
            "widely."
        )
    return (product + product.T) / 2


def _relative(misfit: FloatArray, rhs: FloatArray) -> FloatArray:
    """‖misfit‖/‖rhs‖ of each column; ‖misfit‖ where the right-hand side is zero."""
    size = np.linalg.norm(rhs, axis=0)
    return np.linalg.norm(misfit, axis=0) / np.where(size > 0, size, 1.0)
