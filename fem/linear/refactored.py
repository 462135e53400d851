"""Sparse systems of one pattern and changing values, as Newton's method has them: analysed once, factored many times.

Matrices are given by the 3 × 3 blocks of a fixed pattern, symmetric (upper blocks) or not. MKL PARDISO where it is
installed, SuperLU elsewhere; see `factors.py` for matrices that do not change.
"""

import ctypes
import weakref
from importlib.util import find_spec

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from fem.linear.factors import FactorMemoryError, SolverError, _address, _mkl_pardiso, checked_shape
from geometry.layout import FloatArray

IntArray = NDArray[np.int64]


class BlockPattern:
    """Blocks of a square matrix of n × n blocks that may differ from zero.

    Parameters
    ----------
    rows, cols : arrays, shape (n_blocks,)
        Block numbers, sorted by rows and then columns, every diagonal block among them; with `symmetric` only those of
        the upper triangle, the diagonal included.
    n : int
        Number of block rows.
    symmetric : bool
    """

    size = 3  #: rows of a block

    def __init__(self, rows: IntArray, cols: IntArray, n: int, symmetric: bool) -> None:
        self.rows, self.cols, self.n, self.symmetric = rows, cols, n, symmetric
        self.indptr = np.searchsorted(rows, np.arange(n + 1)).astype(np.int32)
        self.indices = cols.astype(np.int32)

    def matrix(self, blocks: FloatArray) -> sp.csr_matrix:
        """The whole matrix (3 n, 3 n) of blocks (n_blocks, 3, 3), both triangles."""
        shape = (self.n * self.size,) * 2
        upper = sp.bsr_matrix((blocks, self.indices, self.indptr), shape=shape)
        if not self.symmetric:
            return upper.tocsr()
        inner = sp.bsr_matrix((blocks * (self.rows < self.cols)[:, None, None], self.indices, self.indptr), shape=shape)
        return (upper.tocsr() + inner.tocsr().T).tocsr()


class RepeatedFactor:
    """The factor of a matrix of a pattern, renewed by `factor` whenever the values change.

    Parameters
    ----------
    pattern : BlockPattern
    solver : {"pardiso", "superlu"}, optional
        Default: the first one installed.
    """

    def __init__(self, pattern: BlockPattern, solver: str | None = None) -> None:
        self.pattern = pattern
        self.solver = solver or ("pardiso" if find_spec("pypardiso") else "superlu")
        self.n_negative: int | None = None  #: eigenvalues below 0 of the last matrix, where the solver counts them
        self._handle = _RepeatedPardiso(pattern) if self.solver == "pardiso" else None
        if self._handle is not None:
            weakref.finalize(self, self._handle.release).atexit = False

    @property
    def n_unknowns(self) -> int:
        return self.pattern.n * self.pattern.size

    def factor(self, blocks: FloatArray) -> None:
        """Factor the matrix of blocks (n_blocks, 3, 3).

        Raises
        ------
        SolverError
            If the matrix is singular or holds a NaN.
        """
        if not np.isfinite(blocks).all():
            raise SolverError(f"{self.n_unknowns} unknowns could not be factored: the matrix is not finite.")
        if self._handle is not None:
            self.n_negative = self._handle.factor(blocks)
            return
        try:
            self._lu = splu(self.pattern.matrix(blocks).tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.01)
        except RuntimeError as error:
            raise SolverError(f"{self.n_unknowns} unknowns could not be factored: {error}") from None

    def solve(self, rhs: FloatArray) -> FloatArray:
        """K⁻¹ B, shape (3 n, k), of right-hand sides B, shape (3 n, k), by the last factor; unchecked."""
        if self._handle is not None:
            return self._handle.solve(rhs)
        return self._lu.solve(checked_shape(rhs, self.n_unknowns))


class _RepeatedPardiso:
    """The library's state; knows nothing of the `RepeatedFactor` whose death releases it."""

    def __init__(self, pattern: BlockPattern) -> None:
        self.pattern, self.n = pattern, pattern.n * pattern.size
        if not np.array_equal(pattern.indices[pattern.indptr[:-1]], np.arange(pattern.n)) and pattern.symmetric:
            raise SolverError(f"{self.n} unknowns could not be factored: a block on the diagonal is missing.")
        self._mtype = -2 if pattern.symmetric else 11
        self._pt = np.zeros(64, dtype=np.int64)
        self.iparm = np.zeros(64, dtype=np.int32)
        settings = {
            1: 1,  # take these settings instead of the defaults
            2: 3 if pattern.symmetric else 2,  # nested dissection
            8: 0,  # no refinement: Newton's method refines
            10: 13 if not pattern.symmetric else 10,  # perturb pivots below 1e-13 or 1e-10
            11: 0 if pattern.symmetric else 1,  # scaling
            13: 0 if pattern.symmetric else 1,  # matching
            21: 1,  # 1×1 and 2×2 Bunch-Kaufman pivots
            35: 1,  # indices count from 0, and blocks are stored by rows
            37: pattern.size,  # entries are blocks
        }
        if not pattern.symmetric:
            settings |= {11: 0, 13: 0}  # both need the values at the analysis, and tangents need neither
        for number, value in settings.items():
            self.iparm[number - 1] = value
        self._data = np.zeros((len(pattern.indices), pattern.size, pattern.size))
        self._analysed = False

    def factor(self, blocks: FloatArray) -> int | None:
        self._data = np.ascontiguousarray(blocks, dtype=np.float64)
        if not self._analysed:
            self._call(11)
            self._analysed = True
        self._call(22)
        return int(self.iparm[22]) if self._mtype == -2 else None

    def solve(self, rhs: FloatArray) -> FloatArray:
        return self._call(33, np.asfortranarray(checked_shape(rhs, self.n), dtype=np.float64))

    def _call(self, phase: int, b: FloatArray | None = None) -> FloatArray:
        b = np.zeros((self.n, 1)) if b is None else b
        x = np.zeros(b.shape, order="F")
        if b.size == 0:
            return x
        error = ctypes.c_int32(0)
        numbers = [ctypes.byref(ctypes.c_int32(i)) for i in (1, 1, self._mtype, phase, self.pattern.n, b.shape[1], 0)]
        maxfct, mnum, mtype, phase_, n, nrhs, quiet = numbers
        pointers = [_address(self._data), _address(self.pattern.indptr), _address(self.pattern.indices)]
        _mkl_pardiso()(
            *(_address(self._pt), maxfct, mnum, mtype, phase_, n, *pointers),
            *(None, nrhs, _address(self.iparm), quiet, _address(b), _address(x), ctypes.byref(error)),
        )
        if error.value == -2:
            raise FactorMemoryError(f"the factor of {self.n} unknowns does not fit in memory: take a coarser mesh.")
        if error.value:
            raise SolverError(f"{self.n} unknowns could not be factored: PARDISO gave error {error.value}.")
        return x

    def release(self) -> None:
        self._call(-1)
