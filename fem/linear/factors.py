"""Direct factorisations of symmetric sparse matrices: MKL PARDISO, CHOLMOD and SuperLU behind one face, `Factor`.

`linear_solver.factorized` chooses among them. Their packages are imported where they are used: PARDISO's exists on
x86-64 only, and CHOLMOD's is optional.
"""

import ctypes
import os
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cache
from importlib import metadata

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from geometry.errors import TriPillarError
from geometry.layout import FloatArray

WIDTH = 128  #: columns of whole solves at a time: as quick as all at once, and their copies take far less memory


class SolverError(TriPillarError, ArithmeticError):
    """A linear system whose solution could not be trusted."""


class FactorMemoryError(SolverError, MemoryError):
    """A factor that would not fit in memory."""


class Factor(ABC):
    """A factored symmetric matrix K; calling it, or `solve`, takes right-hand sides to solutions.

    Answers are not checked here: go through `linear_solver.checked_solve`. Memory goes back when the object dies.
    """

    solver: str  #: "pardiso", "cholmod" or "superlu"
    halves: bool = False  #: whether `half_solve` is there

    def __init__(self, matrix: sp.csr_matrix | sp.bsr_matrix) -> None:
        self.matrix = matrix  #: K, shape (n, n), both triangles

    @property
    def n_unknowns(self) -> int:
        return self.matrix.shape[0]

    @abstractmethod
    def solve(self, rhs: FloatArray) -> FloatArray:
        """K⁻¹ B, shape (n, k), of right-hand sides B, shape (n, k)."""

    def half_solve(self, rhs: FloatArray) -> FloatArray:
        """Y = L⁻¹ P B, shape (n, k), where K = Pᵀ L Lᵀ P, so that YᵀY = Bᵀ K⁻¹ B; half the work of `solve`.

        Rows are in the factor's own order.

        Raises
        ------
        SolverError
            Where `halves` is False: the matrix was not factored as definite, or the solver does not offer it.
        """
        raise SolverError(f"{self.solver} has no half solve of this matrix: use schur_product, or definite=True.")

    def inner(self, rhs: FloatArray) -> FloatArray:
        """Bᵀ K⁻¹ B, shape (k, k), by half solves where there are any; unchecked, see `linear_solver.schur_product`."""
        if self.halves:
            y = self.half_solve(rhs)
            return y.T @ y
        starts = range(0, max(1, rhs.shape[1]), WIDTH)
        return np.hstack([rhs.T @ self.solve(rhs[:, start : start + WIDTH]) for start in starts])

    def __call__(self, rhs: FloatArray) -> FloatArray:
        return self.solve(rhs)


class PardisoFactor(Factor):
    """LLᵀ of a definite or LDLᵀ of a quasi-definite matrix by MKL PARDISO.

    Parameters
    ----------
    matrix : csr_matrix or bsr_matrix, shape (n, n)
        Square blocks are analysed as one entry each: see the notes.
    definite : bool
        Whether the matrix is positive definite.
    memory_gb : float
        Refuse, after the symbolic analysis and before the factorisation, if more than this is needed [GB].

    Raises
    ------
    FactorMemoryError
        With the memory that the symbolic analysis foresees.
    SolverError
        If the matrix cannot be factored.

    Notes
    -----
    The library is called directly, because pypardiso refines every answer, copies the matrix at each call and keeps
    the factor's memory for good. Refinement steps cost a solve each: two of them made 108 right-hand sides 2.5 to 3
    times dearer for a residual of 1e-15 instead of 2e-15, so `checked_solve` refines instead, when it must. iparm 24 =
    10 corrupted the heap (MKL 2026.2), 24 = 1 gained 0 to 30 % of the factorisation and none of the solves, 25 = 1 or 2
    nothing: they stay at 0. Given as blocks, 6 × 6 coupled cells (11 613 unknowns, 12 481 blocks of 21 × 21) took 3 ms
    to analyse instead of 0.6 to 1.1 s, and as long as before to factor.
    """

    solver = "pardiso"

    def __init__(self, matrix: sp.csr_matrix | sp.bsr_matrix, definite: bool, memory_gb: float = np.inf) -> None:
        super().__init__(matrix)
        self.halves = definite
        self._handle = handle = _PardisoHandle(matrix, definite)
        # not at exit: the process gives all memory back then, and MKL may be gone already
        weakref.finalize(self, handle.release).atexit = False
        handle.call(11)
        self.memory_gb = max(handle.iparm[14], int(handle.iparm[15]) + int(handle.iparm[16])) / 1e6  #: at the peak
        if self.memory_gb > memory_gb:
            raise FactorMemoryError(
                f"the factor of {self.n_unknowns} unknowns needs {self.memory_gb:.3g} GB of {memory_gb:.3g} GB "
                "available: take a coarser mesh."
            )
        handle.call(22)

    def solve(self, rhs: FloatArray) -> FloatArray:
        return self._handle.call(33, rhs)

    def half_solve(self, rhs: FloatArray) -> FloatArray:
        # of LDLᵀ, the library's steps 331 and 332 do not multiply to Bᵀ K⁻¹ B (off by 10 %): whole solves only
        return self._handle.call(331, rhs) if self.halves else super().half_solve(rhs)


class CholmodFactor(Factor):
    """Supernodal LLᵀ of a definite matrix by CHOLMOD, from the kvxopt wheel.

    Raises
    ------
    SolverError
        If the matrix is not positive definite.

    Notes
    -----
    The wheel's CHOLMOD knows no nested dissection, and its `solve` takes one column at a time; `spsolve` takes four,
    which halves the time, so right-hand sides go in as sparse matrices. PARDISO is faster: see `factorized`.
    """

    solver = "cholmod"
    halves = True

    def __init__(self, matrix: sp.csr_matrix) -> None:
        from kvxopt import cholmod, spmatrix
        from kvxopt import matrix as dense

        super().__init__(matrix)
        lower = sp.tril(matrix, format="coo")
        entries = [dense(part) for part in (lower.data, lower.row.astype(np.int64), lower.col.astype(np.int64))]
        kvx = spmatrix(*entries, matrix.shape, "d")
        try:
            self._factor = cholmod.symbolic(kvx)
            cholmod.numeric(kvx, self._factor)
            # asking for the ordering also tells a factorisation that stopped half-way
            order = dense(np.arange(self.n_unknowns, dtype=float))
            cholmod.solve(self._factor, order, sys=7)
        except ArithmeticError:
            raise SolverError(_not_definite(self.n_unknowns)) from None
        except MemoryError:
            raise FactorMemoryError(_out_of_memory(self.n_unknowns)) from None
        self._order = np.array(order).ravel().astype(np.int64)

    def solve(self, rhs: FloatArray) -> FloatArray:
        return self._by_columns(rhs, sys=0)

    def half_solve(self, rhs: FloatArray) -> FloatArray:
        return self._by_columns(checked_shape(rhs, self.n_unknowns)[self._order], sys=4)

    def _by_columns(self, rhs: FloatArray, sys: int, width: int = 64) -> FloatArray:
        from kvxopt import cholmod, sparse
        from kvxopt import matrix as dense

        rhs = checked_shape(rhs, self.n_unknowns)
        x = np.empty(rhs.shape, order="F")
        for start in range(0, rhs.shape[1], width):  # bounds the memory of the sparse copies
            columns = slice(start, start + width)
            block = dense(np.asfortranarray(rhs[:, columns]))
            if block.size[1] > 1:
                block = dense(cholmod.spsolve(self._factor, sparse(block), sys=sys))
            else:
                cholmod.solve(self._factor, block, sys=sys)
            x[:, columns] = np.array(block)
        return x


class SuperluFactor(Factor):
    """LU by SuperLU of scipy, on any platform; two to four times the memory and many times the time of the others."""

    solver = "superlu"

    def __init__(self, matrix: sp.csr_matrix) -> None:
        super().__init__(matrix)
        try:
            # symmetric mode keeps the fill of a symmetric ordering; quasi-definite matrices need no pivoting
            self._factor = splu(
                matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
        except RuntimeError as error:
            raise SolverError(f"{self.n_unknowns} unknowns could not be factored: {error}") from None
        except MemoryError:
            raise FactorMemoryError(_out_of_memory(self.n_unknowns)) from None

    def solve(self, rhs: FloatArray) -> FloatArray:
        return self._factor.solve(checked_shape(rhs, self.n_unknowns))


class _PardisoHandle:
    """The library's state for one matrix; knows nothing of the `PardisoFactor` whose death releases it."""

    def __init__(self, matrix: sp.csr_matrix | sp.bsr_matrix, definite: bool) -> None:
        block = _block_size(matrix)
        upper = _upper_blocks(matrix) if block > 1 else sp.triu(matrix, format="csr")
        upper.sort_indices()  # PARDISO's answers are wrong otherwise
        self.n = upper.shape[0]
        self._n_rows = self.n // block
        if upper.nnz >= 2**31:
            raise FactorMemoryError(f"{upper.nnz} entries are too many for 32-bit PARDISO: take a coarser mesh.")
        starts = upper.indptr[:-1]
        full = np.diff(upper.indptr) > 0
        if not (full.all() and np.array_equal(upper.indices[starts], np.arange(self._n_rows))):
            raise SolverError(f"{self.n} unknowns could not be factored: an entry on the diagonal is missing.")
        self._entries = (
            np.ascontiguousarray(upper.data, dtype=np.float64),
            upper.indptr.astype(np.int32, copy=False),
            upper.indices.astype(np.int32, copy=False),
        )
        self._mtype = 2 if definite else -2
        self._pt = np.zeros(64, dtype=np.int64)
        self.iparm = np.zeros(64, dtype=np.int32)
        # numbers as in MKL's manual, which counts from 1; its own defaults gave wrong answers (pypardiso issue 87)
        settings = {
            1: 1,  # take these settings instead of the defaults
            2: 3,  # nested dissection, in parallel
            8: 0,  # no iterative refinement, unless a pivot had to be perturbed
            10: 13,  # perturb pivots below 1e-13: definite and quasi-definite matrices have none
            21: 1,  # 1×1 and 2×2 Bunch-Kaufman pivots
            35: 1,  # indices count from 0, and blocks are stored by rows
            37: block if block > 1 else 0,  # entries are blocks
        }
        for number, value in settings.items():
            self.iparm[number - 1] = value

    def call(self, phase: int, rhs: FloatArray | None = None) -> FloatArray:
        """Run one phase, on right-hand sides (n, k) if it takes any; returns (n, k), columns contiguous."""
        b = np.zeros((self.n, 1)) if rhs is None else np.asfortranarray(checked_shape(rhs, self.n), dtype=np.float64)
        x = np.zeros(b.shape, order="F")
        if b.size == 0:
            return x
        error = ctypes.c_int32(0)
        data, indptr, indices = self._entries
        numbers = [ctypes.byref(ctypes.c_int32(i)) for i in (1, 1, self._mtype, phase, self._n_rows, b.shape[1], 0)]
        maxfct, mnum, mtype, phase_, n, nrhs, quiet = numbers
        _mkl_pardiso()(
            *(_address(self._pt), maxfct, mnum, mtype, phase_, n, _address(data), _address(indptr), _address(indices)),
            *(None, nrhs, _address(self.iparm), quiet, _address(b), _address(x), ctypes.byref(error)),
        )
        if error.value == -4 and self._mtype == 2:
            raise SolverError(_not_definite(self.n))
        if error.value == -2:
            raise FactorMemoryError(_out_of_memory(self.n))
        if error.value:
            raise SolverError(f"{self.n} unknowns could not be factored: PARDISO gave error {error.value}.")
        return x

    def release(self) -> None:
        self.call(-1)


def _block_size(matrix: sp.csr_matrix | sp.bsr_matrix) -> int:
    """Rows of the square blocks that a matrix is stored in, or 1."""
    rows, cols = matrix.blocksize if matrix.format == "bsr" else (1, 1)
    return rows if rows == cols else 1


def _upper_blocks(matrix: sp.bsr_matrix) -> sp.bsr_matrix:
    """The blocks on the diagonal and above it; those on it whole."""
    counts = np.diff(matrix.indptr)
    rows = np.repeat(np.arange(len(counts)), counts)
    kept = matrix.indices >= rows
    indptr = np.append(0, np.cumsum(np.bincount(rows[kept], minlength=len(counts))))
    return sp.bsr_matrix((matrix.data[kept], matrix.indices[kept], indptr), shape=matrix.shape)


@cache
def _mkl_pardiso() -> Callable[..., None]:
    library = _installed_mkl()
    if library is None:
        from pypardiso import PyPardisoSolver

        library = PyPardisoSolver().libmkl
    pardiso = library["pardiso"]  # by index: a fresh function, without pypardiso's argument types
    pardiso.restype = None
    return pardiso


def _installed_mkl() -> ctypes.CDLL | None:
    """The library that the package `mkl` brought along, or None: pypardiso's own search for it takes 0.4 s."""
    if "PYPARDISO_MKL_RT" in os.environ:  # a person's choice, which pypardiso heeds
        return None
    try:
        files = metadata.files("mkl") or []
    except metadata.PackageNotFoundError:
        return None
    for file in files:
        if "mkl_rt" in file.name:
            try:
                return ctypes.CDLL(str(file.locate()))
            except OSError:
                continue
    return None


def _address(array: NDArray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def checked_shape(rhs: FloatArray, n: int) -> FloatArray:
    """The right-hand sides, if they have shape (n, k); the libraries would read past the end of shorter ones."""
    if rhs.ndim != 2 or rhs.shape[0] != n:
        raise ValueError(f"right-hand sides have shape {rhs.shape}, expected ({n}, k): one column for each.")
    return rhs


def _not_definite(n: int) -> str:
    return (
        f"{n} unknowns could not be factored: the matrix is not positive definite. Is the body clamped? A mixed "
        "(quasi-definite) matrix takes definite=False."
    )


def _out_of_memory(n: int) -> str:
    return f"the factor of {n} unknowns does not fit in memory: take a coarser mesh."
