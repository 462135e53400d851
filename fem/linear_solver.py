"""Factor once, solve for many right-hand sides, and check every answer.

`factorized(matrix)` picks the solver: MKL PARDISO where its wheel is installed (x86-64), SuperLU of scipy elsewhere.
Both give the same object: a function from right-hand sides to solutions.
"""

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from geometry.errors import TriPillarError
from geometry.layout import FloatArray

Solve = Callable[[FloatArray], FloatArray]

RESIDUAL_LIMIT = 1e-9  #: largest relative residual of an accepted answer; a sound factorisation gives 1e-12


class SolverError(TriPillarError, ArithmeticError):
    """A linear system whose solution could not be trusted."""


def solver_name() -> str:
    """The direct solver in use: 'pardiso' or 'superlu'."""
    return "pardiso" if find_spec("pypardiso") else "superlu"


def factorized(matrix: sp.csr_matrix, solver: str | None = None) -> Solve:
    """Factor a symmetric, definite or quasi-definite matrix.

    Parameters
    ----------
    matrix : csr_matrix, shape (n, n)
        Full symmetric matrix (both triangles).
    solver : {"pardiso", "superlu"}, optional
        Default: `solver_name`.

    Returns
    -------
    function
        Takes right-hand sides of shape (n, k), returns solutions of shape (n, k).

    Raises
    ------
    SolverError
        If the matrix cannot be factored.
    """
    return {"pardiso": _pardiso, "superlu": _superlu}[solver or solver_name()](matrix)


def checked_solve(matrix: sp.csr_matrix, solve: Solve, rhs: FloatArray) -> tuple[FloatArray, float]:
    """Solve and measure the largest relative residual ‖Kx − b‖/‖b‖ over the columns.

    Returns the solutions (n, k) and that residual.

    Raises
    ------
    SolverError
        If the residual is above `RESIDUAL_LIMIT` or not a number.
    """
    x = solve(rhs)
    size = np.linalg.norm(rhs, axis=0)
    misfit = np.linalg.norm(rhs - matrix @ x, axis=0)
    residual = float(np.max(misfit / np.where(size > 0, size, 1.0), initial=0.0))
    if not residual <= RESIDUAL_LIMIT:
        raise SolverError(
            f"residual {residual:.1e} is above {RESIDUAL_LIMIT:g} for {matrix.shape[0]} unknowns: the mesh may have "
            "degenerate elements or the moduli differ too widely; mesh again or bring them closer."
        )
    return x, residual


def _pardiso(matrix: sp.csr_matrix) -> Solve:
    from pypardiso import PyPardisoSolver
    from pypardiso.pardiso_wrapper import PyPardisoError

    upper = sp.triu(matrix, format="csr")
    # -2: real symmetric indefinite, factored as LDLᵀ; half the memory and work of the general LU
    pardiso = PyPardisoSolver(mtype=-2)
    pardiso.set_iparm(1, 1)  # take the settings below instead of the defaults
    pardiso.set_iparm(2, 3)  # nested dissection, in parallel
    pardiso.set_iparm(8, 2)  # at most two steps of iterative refinement
    pardiso.set_iparm(10, 13)  # perturb pivots below 1e-13: a quasi-definite matrix has none
    pardiso.set_iparm(21, 1)  # 1×1 and 2×2 Bunch-Kaufman pivots
    try:
        pardiso.factorize(upper)
    except PyPardisoError as error:
        raise SolverError(f"{matrix.shape[0]} unknowns could not be factored: {error}") from None
    return lambda rhs: pardiso.solve(upper, rhs)


def _superlu(matrix: sp.csr_matrix) -> Solve:
    try:
        # symmetric mode keeps the fill of a symmetric ordering; quasi-definite matrices need no pivoting
        factor = splu(
            matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
    except RuntimeError as error:
        raise SolverError(f"{matrix.shape[0]} unknowns could not be factored: {error}") from None
    return factor.solve
