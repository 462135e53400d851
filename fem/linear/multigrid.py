"""Conjugate gradients with algebraic multigrid, for elastic bodies too big to factor."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import cg

from fem.linear.factors import Factor, SolverError, checked_shape
from geometry.layout import FloatArray


def rigid_body_modes(points_mm: FloatArray) -> FloatArray:
    """The three translations and three rotations of the nodes: what an unclamped elastic body does at no cost.

    Parameters
    ----------
    points_mm : array, shape (n_nodes, 3)
        The free nodes, in the order of the system's unknowns [mm].

    Returns
    -------
    array, shape (n_nodes·3, 6)
        Component i of node n in row n·3 + i; rotations are about the centre of the nodes.

    Examples
    --------
    >>> rigid_body_modes(np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))[:, 5]  # about z
    array([ 0., -1.,  0.,  0.,  1.,  0.])
    """
    arms = points_mm - points_mm.mean(axis=0)
    modes = np.zeros((len(arms), 3, 6))
    for axis in range(3):
        modes[:, axis, axis] = 1.0
        modes[:, :, 3 + axis] = np.cross(np.eye(3)[axis], arms)
    return modes.reshape(-1, 6)


class MultigridFactor(Factor):
    """Conjugate gradients, preconditioned by smoothed-aggregation multigrid that knows the rigid-body modes.

    Parameters
    ----------
    matrix : csr_matrix, shape (n, n)
        Positive definite; components of displacement interleave, clamped nodes are left out whole.
    modes : array, shape (n, 6)
        See `rigid_body_modes`.
    tolerance : float
        Relative residual at which an answer is accepted.
    max_iterations : int
        More than this raise `SolverError`.

    Notes
    -----
    Smoothed aggregation: Vanek, Mandel, Brezina, Computing 1996, 56, 179. Iterations for one right-hand side at
    1e-9 on a slab of hexahedra, volumetric part integrated at one point for ν near 0.5:

    ========  ===========  ===========  ============
    ν         17 thousand  55 thousand  242 thousand
    ========  ===========  ===========  ============
    0.3       10           10           12
    0.49      42           41           44
    0.4999    300          324          not tried
    ========  ===========  ===========  ============

    Every right-hand side costs its own iterations, 11 to 17 s at 242 thousand unknowns on two cores after 5 to 18 s of
    setup, where a factor (14 s, 2 GB) solves 108 of them in 3 s. So it pays where the factor does not fit in memory,
    for few right-hand sides, and up to ν = 0.49; at ν = 0.4999 it takes eight times the iterations of 0.49.
    """

    solver = "multigrid"

    def __init__(
        self, matrix: sp.csr_matrix, modes: FloatArray, tolerance: float = 1e-10, max_iterations: int = 1000
    ) -> None:
        super().__init__(matrix)
        if modes.shape[0] != self.n_unknowns or self.n_unknowns % 3:
            raise ValueError(
                f"modes have shape {modes.shape}, expected ({self.n_unknowns}, 6), three unknowns a node: "
                "give rigid_body_modes of the free nodes."
            )
        try:
            from pyamg import smoothed_aggregation_solver
        except ImportError:
            raise SolverError(
                "the iterative solver needs pyamg: pip install pyamg, which compiles on ARM Linux."
            ) from None
        self.tolerance, self.max_iterations = tolerance, max_iterations
        hierarchy = smoothed_aggregation_solver(
            matrix.tobsr((3, 3)), B=modes, smooth="jacobi", max_coarse=100, coarse_solver="splu"
        )
        self._preconditioner = hierarchy.aspreconditioner()

    def solve(self, rhs: FloatArray) -> FloatArray:
        """As `Factor.solve`; raises `SolverError` if a column does not converge."""
        x = np.zeros(checked_shape(rhs, self.n_unknowns).shape, order="F")
        for column in range(rhs.shape[1]):
            x[:, column], unfinished = cg(
                self.matrix,
                rhs[:, column],
                rtol=self.tolerance,
                maxiter=self.max_iterations,
                M=self._preconditioner,
            )
            if unfinished or not np.isfinite(x[:, column]).all():
                raise SolverError(
                    f"conjugate gradients did not reach {self.tolerance:g} in {self.max_iterations} iterations for "
                    f"{self.n_unknowns} unknowns: is the body clamped and definite? Near ν = 0.5 take a direct solver."
                )
        return x
