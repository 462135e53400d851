"""Factor once, solve for many right-hand sides, and check every answer.

`factorized(matrix)` picks the solver and gives a `Factor`: a function from right-hand sides to solutions. The direct
ones are in `factors.py`, the iterative one in `multigrid.py`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
import psutil
import scipy.sparse as sp

from fem.linear.factors import CholmodFactor, Factor, FactorMemoryError, PardisoFactor, SolverError, SuperluFactor
from fem.linear.multigrid import MultigridFactor
from geometry.layout import FloatArray

Solve = Callable[[FloatArray], FloatArray]
Product = Callable[[FloatArray], FloatArray]

RESIDUAL_LIMIT = 1e-9  #: largest relative residual of an accepted answer; a sound factorisation gives 1e-12
ROUNDING = 1e-14  #: backward error of an answer as good as double precision gives
SLENDER_LIMIT = 1e-4  #: largest relative residual of such an answer; a singular matrix leaves more
MEMORY_SHARE = 0.9  #: of the memory available, what a factor may take

#: Memory of a factor: this many bytes times n^(4/3), the law of nested dissection in 3-D. Measured on cubes of
#: hexahedra and P2 tetrahedra of 14 to 105 thousand unknowns; slabs need a third less, so the law errs on the safe side
FACTOR_BYTES = {"pardiso": 200.0, "cholmod": 320.0, "superlu": 640.0}

HALF_SOLVE_COLUMNS = 1000  #: up to here YᵀY of half solves is cheaper than whole solves and a sparse product


@dataclass(frozen=True, kw_only=True)
class SolverPlan:
    """Which solver a system of a given size would get, and why. `str` puts it in a line."""

    solver: str  #: "pardiso", "cholmod", "superlu" or "multigrid"
    factor_gb: float  #: memory of the factor by an empirical law
    available_gb: float  #: memory that it may take

    @property
    def fits(self) -> bool:
        return self.factor_gb <= self.available_gb

    def __str__(self) -> str:
        if self.solver == "multigrid":
            return f"iterative: the factor would need {self.factor_gb:.2g} GB of {self.available_gb:.2g} GB"
        return f"direct, {self.solver}: about {self.factor_gb:.2g} GB of {self.available_gb:.2g} GB"


def solver_name(definite: bool = False) -> str:
    """The direct solver in use: 'pardiso', 'cholmod' (definite matrices only) or 'superlu'."""
    if find_spec("pypardiso"):
        return "pardiso"
    return "cholmod" if definite and find_spec("kvxopt") else "superlu"


def solver_plan(n_unknowns: int, *, definite: bool = False, memory_gb: float | None = None) -> SolverPlan:
    """The solver for a system not assembled yet: iterative where a definite one is too big to factor.

    `memory_gb` is the memory a factor may take; default: most of what is free now.

    Examples
    --------
    >>> plan = solver_plan(50_000_000, definite=True, memory_gb=24.0)
    >>> plan.solver, plan.fits
    ('multigrid', False)
    """
    direct = solver_name(definite)
    available_gb = _available_gb() if memory_gb is None else memory_gb
    factor_gb = FACTOR_BYTES[direct] * n_unknowns ** (4 / 3) / 1e9
    iterative = definite and factor_gb > available_gb
    return SolverPlan(solver="multigrid" if iterative else direct, factor_gb=factor_gb, available_gb=available_gb)


def factorized(
    matrix: sp.csr_matrix | sp.bsr_matrix,
    solver: str | None = None,
    *,
    definite: bool = False,
    modes: FloatArray | None = None,
    memory_gb: float | None = None,
) -> Factor:
    """Factor a symmetric, definite or quasi-definite matrix.

    Parameters
    ----------
    matrix : csr_matrix or bsr_matrix, shape (n, n)
        Full symmetric matrix (both triangles); PARDISO analyses one of dense blocks far faster if stored in them.
    solver : {"pardiso", "cholmod", "superlu", "multigrid"}, optional
        Default: the first direct one installed; for a definite matrix whose factor would not fit in memory, multigrid.
    definite : bool
        Whether the matrix is positive definite, as that of displacements alone; that of the mixed form is not. Definite
        matrices are factored without pivots and have `half_solve`.
    modes : array, shape (n, 6), optional
        `multigrid.rigid_body_modes` of the free nodes; the iterative solver needs them.
    memory_gb : float, optional
        Memory the factor may take [GB]; default: most of what is free now.

    Returns
    -------
    Factor
        Takes right-hand sides of shape (n, k), returns solutions of shape (n, k).

    Raises
    ------
    FactorMemoryError
        If the factor would not fit in memory and no iterative solver can take its place.
    SolverError
        If the matrix cannot be factored.
    ValueError
        If the solver asked for cannot take such a matrix.

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
    if solver not in (None, *FACTOR_BYTES, "multigrid"):
        raise ValueError(f"no solver '{solver}': choose pardiso, cholmod, superlu or multigrid.")
    if solver in ("cholmod", "multigrid") and not definite:
        raise ValueError(f"{solver} takes definite matrices only: say definite=True, or choose pardiso or superlu.")
    if solver == "multigrid":
        return _multigrid(matrix, modes)
    direct = solver or solver_name(definite)
    available_gb = _available_gb() if memory_gb is None else memory_gb
    try:
        return _direct(direct, matrix, definite, available_gb)
    except FactorMemoryError:
        if solver is None and definite and modes is not None:
            return _multigrid(matrix, modes)
        raise


def checked_solve(
    matrix: sp.csr_matrix | sp.bsr_matrix, solve: Solve, rhs: FloatArray, product: Product | None = None
) -> tuple[FloatArray, float]:
    """Solve and measure the largest relative residual ‖Kx − b‖/‖b‖ over the columns.

    Columns whose residual is above `RESIDUAL_LIMIT` get one step of iterative refinement. Slender bodies bend so far
    under small forces that rounding alone leaves more: then `ROUNDING` of |K||x| + |b| is allowed. Returns the
    solutions (n, k) and the residual. `product` takes x to K x where there is a faster way than by the sparse matrix.

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
            x = x.copy()  # it may be somebody else's
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


def schur_product(factor: Factor, rhs: FloatArray | sp.sparray | sp.spmatrix, width: int = 256) -> FloatArray:
    """Bᵀ K⁻¹ B, what eliminating K takes from the stiffness of the rest.

    Parameters
    ----------
    factor : Factor
        Of K, shape (n, n).
    rhs : array or sparse matrix, shape (n, m)
        B, the coupling of K's unknowns to the rest.
    width : int
        Columns solved for at a time where whole solves are taken, which bounds their memory.

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
    With half solves, Y = L⁻¹PB gives YᵀY: half the work, but Y is dense, (n, m), and the product grows as m². On 55
    thousand unknowns and two cores, against whole solves and a sparse product: 0.6 s to 0.8 s for m = 108, 1.6 to 2.4
    for 300, 8.8 to 9.1 for 1000, 17.6 to 14.9 for 2000. A sparse B of more than `HALF_SOLVE_COLUMNS` columns takes the
    second way, whose memory is bounded.
    """
    m = rhs.shape[1]
    if isinstance(rhs, np.ndarray):
        product = factor.inner(rhs)
    elif m <= HALF_SOLVE_COLUMNS and factor.halves:
        product = factor.inner(rhs.toarray(order="F"))
    else:
        columns = rhs.tocsc()
        starts = range(0, m, width)
        product = np.hstack([rhs.T @ factor.solve(columns[:, i : i + width].toarray(order="F")) for i in starts])
    energies = np.abs(np.diag(product))
    scale = 1 / np.sqrt(np.where(energies > 0, energies, 1.0))[:, None]
    w = scale * np.random.default_rng(0).standard_normal((m, 1))
    x, _ = checked_solve(factor.matrix, factor.solve, rhs @ w)
    expected = rhs.T @ x
    misfit = float(np.max(_relative(scale * (product @ w - expected), scale * expected), initial=0.0))
    if not misfit <= RESIDUAL_LIMIT:
        raise SolverError(
            f"the product of {m} columns with {factor.n_unknowns} unknowns eliminated is off by {misfit:.1e}, above "
            f"{RESIDUAL_LIMIT:g}: the mesh may have degenerate elements or the moduli differ too widely."
        )
    return (product + product.T) / 2


def _direct(solver: str, matrix: sp.csr_matrix | sp.bsr_matrix, definite: bool, available_gb: float) -> Factor:
    if solver == "pardiso":
        return PardisoFactor(matrix, definite, available_gb)  # its symbolic analysis knows better than the law
    factor_gb = FACTOR_BYTES[solver] * matrix.shape[0] ** (4 / 3) / 1e9
    if factor_gb > available_gb:
        raise FactorMemoryError(
            f"the factor of {matrix.shape[0]} unknowns needs about {factor_gb:.3g} GB of {available_gb:.3g} GB "
            "available: take a coarser mesh, or the iterative solver for a definite matrix."
        )
    return CholmodFactor(matrix) if solver == "cholmod" else SuperluFactor(matrix)


def _multigrid(matrix: sp.csr_matrix, modes: FloatArray | None) -> Factor:
    if modes is None:
        raise ValueError("the iterative solver needs modes: give multigrid.rigid_body_modes of the free nodes.")
    return MultigridFactor(matrix, modes, tolerance=RESIDUAL_LIMIT / 10)


def _backward_errors(matrix: sp.csr_matrix | sp.bsr_matrix, x: FloatArray, rhs: FloatArray) -> FloatArray:
    """‖Kx − b‖ / (‖|K||x|‖ + ‖b‖) of each column."""
    scale = np.linalg.norm(abs(matrix) @ np.abs(x), axis=0) + np.linalg.norm(rhs, axis=0)
    return np.linalg.norm(rhs - matrix @ x, axis=0) / np.where(scale > 0, scale, 1.0)


def _relative(misfit: FloatArray, rhs: FloatArray) -> FloatArray:
    """‖misfit‖/‖rhs‖ of each column; ‖misfit‖ where the right-hand side is zero."""
    size = np.linalg.norm(rhs, axis=0)
    return np.linalg.norm(misfit, axis=0) / np.where(size > 0, size, 1.0)


def _available_gb() -> float:
    return MEMORY_SHARE * psutil.virtual_memory().available / 1e9
