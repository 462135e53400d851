"""Factor once, solve for many right-hand sides, check every solution.

`factorized(matrix)` picks the solver and gives a `Factor` (`factors.py`), which takes right-hand sides to solutions.
"""

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
import psutil
import scipy.sparse as sp

from fem.linear.factors import CholmodFactor, Factor, FactorMemoryError, PardisoFactor, SolverError, SuperluFactor
from geometry.layout import FloatArray

LinearMap = Callable[[FloatArray], FloatArray]  #: columns (n, k) to columns (n, k)

RESIDUAL_LIMIT = 1e-9  #: largest relative residual of an accepted solution; a sound factorisation gives 1e-12
ROUNDING = 1e-14  #: backward error of a solution as good as double precision gives
SLENDER_LIMIT = 1e-4  #: largest relative residual of such a solution; a singular matrix leaves more
MEMORY_SHARE = 0.9  #: largest share of the available memory that a factor may take

#: Memory of a factor in bytes over n^(4/3), the law of nested dissection in 3-D. Measured on cubes of hexahedra and P2
#: tetrahedra of 14 to 105 thousand unknowns; slabs need a third less
FACTOR_BYTES = {"pardiso": 200.0, "cholmod": 320.0, "superlu": 640.0}


def solver_name(definite: bool = False) -> str:
    """The solver in use: 'pardiso', 'cholmod' (definite matrices only) or 'superlu'."""
    if find_spec("pypardiso"):
        return "pardiso"
    return "cholmod" if definite and find_spec("kvxopt") else "superlu"


def factorized(
    matrix: sp.csr_matrix | sp.bsr_matrix,
    solver: str | None = None,
    *,
    definite: bool = False,
    memory_gb: float | None = None,
) -> Factor:
    """Factor a symmetric, definite or quasi-definite matrix.

    Parameters
    ----------
    matrix : csr_matrix or bsr_matrix, shape (n, n)
        Full symmetric matrix (both triangles); PARDISO analyses one of dense blocks far faster if stored in them.
    solver : {"pardiso", "cholmod", "superlu"}, optional
        Default: the first one installed.
    definite : bool
        True for a positive definite matrix, as of displacements alone; the mixed form's is not. Definite matrices are
        factored without pivots and have `half_solve`.
    memory_gb : float, optional
        Memory that the factor may take [GB]; default: most of what is free now.

    Raises
    ------
    FactorMemoryError
        If the factor would not fit in memory.
    SolverError
        If the matrix cannot be factored.
    ValueError
        If the solver cannot take such a matrix.

    Notes
    -----
    Slabs of hexahedra clamped below, 75 entries a row, on two cores; time in seconds, half solves for 108 columns:

    ========  ============  =========  ======  ===========  ===========  ===========
    unknowns  solver        memory GB  factor  108 columns  half solves  300 columns
    ========  ============  =========  ======  ===========  ===========  ===========
    55 296    pardiso, LLᵀ  0.3        2.3     0.8          0.4          2.2
    55 296    cholmod       0.4        1.9     2.3          1.1
    242 064   pardiso, LLᵀ  2.0        14      3.2          1.2          8.8
    242 064   cholmod       3.0        29      21           18
    ========  ============  =========  ======  ===========  ===========  ===========

    The last line's solves shared the machine with other work, which doubles such times. One column at a time costs
    PARDISO four to five times as much each: give it all columns together.
    """
    if solver not in (None, *FACTOR_BYTES):
        raise ValueError(f"no solver '{solver}': choose {', '.join(FACTOR_BYTES)}.")
    if solver == "cholmod" and not definite:
        raise ValueError("cholmod takes definite matrices only: say definite=True, or choose pardiso or superlu.")
    solver = solver or solver_name(definite)
    available_gb = MEMORY_SHARE * psutil.virtual_memory().available / 1e9 if memory_gb is None else memory_gb
    if solver == "pardiso":
        return PardisoFactor(matrix, definite, available_gb)  # its symbolic analysis knows better than the law
    factor_gb = FACTOR_BYTES[solver] * matrix.shape[0] ** (4 / 3) / 1e9
    if factor_gb > available_gb:
        raise FactorMemoryError(
            f"the factor of {matrix.shape[0]} unknowns needs about {factor_gb:.3g} GB of {available_gb:.3g} GB "
            "available: take a coarser mesh."
        )
    return CholmodFactor(matrix) if solver == "cholmod" else SuperluFactor(matrix)


def checked_solve(
    matrix: sp.csr_matrix | sp.bsr_matrix, solve: LinearMap, rhs: FloatArray, product: LinearMap | None = None
) -> tuple[FloatArray, float]:
    """Solve and measure the largest relative residual ‖Kx − b‖/‖b‖ over the columns.

    Columns above `RESIDUAL_LIMIT` get one step of iterative refinement. Slender bodies bend so far under small forces
    that rounding alone leaves more: a backward error of `ROUNDING` is accepted too. `product` takes x to K x where
    something is faster than the sparse matrix. Returns the solutions (n, k) and the residual.

    Raises
    ------
    SolverError
        If the residual is still above `RESIDUAL_LIMIT`, or not a number.
    """
    product = product or matrix.__matmul__
    x = solve(rhs)
    with np.errstate(over="ignore", invalid="ignore"):  # infinities and NaN are refused below
        misfit = rhs - product(x)
        residuals = _relative(misfit, rhs)
        poor = ~(residuals <= RESIDUAL_LIMIT)
        if poor.any() and np.isfinite(misfit).all():
            x = x.copy()  # the caller may keep the array it gave
            x[:, poor] += solve(misfit[:, poor])
            residuals[poor] = _relative(rhs[:, poor] - product(x[:, poor]), rhs[:, poor])
            poor = ~(residuals <= RESIDUAL_LIMIT)
        if poor.any():
            rounded = _backward_errors(matrix, x[:, poor], rhs[:, poor]) <= ROUNDING
            poor[poor] = ~(rounded & (residuals[poor] <= SLENDER_LIMIT))
    residual = float(np.max(residuals, initial=0.0))
    if poor.any():
        raise SolverError(
            f"residual {residual:.1e} is above {RESIDUAL_LIMIT:g} for {matrix.shape[0]} unknowns: the mesh may have "
            "degenerate elements or the moduli differ too widely; mesh again or bring them closer."
        )
    return x, residual


def schur_product(factor: Factor, rhs: FloatArray) -> FloatArray:
    """Bᵀ K⁻¹ B: what eliminating K takes from the stiffness of the rest.

    Parameters
    ----------
    factor : Factor
        Of K, shape (n, n).
    rhs : array, shape (n, m)
        B, the coupling of K's unknowns to the rest.

    Returns
    -------
    array, shape (m, m)
        Symmetric.

    Raises
    ------
    SolverError
        If it cannot be trusted. The check: its product with a random vector w is compared with Bᵀx, where K x = B w was
        solved with its residual checked. Columns are scaled to equal energies bᵀK⁻¹b, or forces of 1 N would hide
        behind port modes of 1 mm.

    Notes
    -----
    With half solves, Y = L⁻¹PB gives YᵀY, half the work of whole solves. On 55 thousand unknowns and two cores, against
    whole solves and a sparse product: 0.6 s to 0.8 s for m = 108, 1.6 to 2.4 for 300, 8.8 to 9.1 for 1000.
    """
    product = factor.inner(rhs)
    energies = np.abs(np.diag(product))
    scale = 1 / np.sqrt(np.where(energies > 0, energies, 1.0))[:, None]
    w = scale * np.random.default_rng(0).standard_normal((rhs.shape[1], 1))
    x, _ = checked_solve(factor.matrix, factor.solve, rhs @ w)
    expected = rhs.T @ x
    misfit = float(np.max(_relative(scale * (product @ w - expected), scale * expected), initial=0.0))
    if not misfit <= RESIDUAL_LIMIT:
        raise SolverError(
            f"the product of {rhs.shape[1]} columns with {factor.n_unknowns} unknowns eliminated is off by "
            f"{misfit:.1e}, above {RESIDUAL_LIMIT:g}: the mesh may have degenerate elements or the moduli differ too "
            "widely."
        )
    return (product + product.T) / 2


def _backward_errors(matrix: sp.csr_matrix | sp.bsr_matrix, x: FloatArray, rhs: FloatArray) -> FloatArray:
    """‖Kx − b‖ / (‖|K||x|‖ + ‖b‖) of each column."""
    scale = np.linalg.norm(abs(matrix) @ np.abs(x), axis=0) + np.linalg.norm(rhs, axis=0)
    return np.linalg.norm(rhs - matrix @ x, axis=0) / np.where(scale > 0, scale, 1.0)


def _relative(misfit: FloatArray, rhs: FloatArray) -> FloatArray:
    """‖misfit‖/‖rhs‖ of each column; ‖misfit‖ where the right-hand side is zero."""
    size = np.linalg.norm(rhs, axis=0)
    return np.linalg.norm(misfit, axis=0) / np.where(size > 0, size, 1.0)
