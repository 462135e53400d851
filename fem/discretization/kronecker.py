"""Elasticity on a graded box as a sum of Kronecker products of one-dimensional matrices.

On lines x × y × z with nodal Lagrange functions of order p along each, a constant elastic tensor C gives

    K[a, b] = Σ_kl C[a, k, b, l] · A_x ⊗ A_y ⊗ A_z,    A_d = ∫ φ⁽ᵏ⁼ᵈ⁾ φ⁽ˡ⁼ᵈ⁾ dx_d,

where (k=d) says whether the test function is differentiated and (l=d) whether the trial function is. The matrix is
never formed: applying it is a handful of small dense products along each axis.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from fem.discretization.lagrange import reference_matrices
from fem.linear.factors import SolverError
from geometry.layout import FloatArray

Lines = tuple[FloatArray, FloatArray, FloatArray]  #: element boundaries along x, y, z [mm]


def line_matrices(lines: FloatArray, order: int, n_points: int) -> dict[tuple[bool, bool], FloatArray]:
    """Dense ∫ φₐ⁽ⁱ⁾ φ_b⁽ʲ⁾ dx of a line, n_points Gauss points an element; keyed by (i, j): which is differentiated."""
    matrices = {}
    for (test, trial), element in reference_matrices(order, n_points).items():
        A = np.zeros((order * (len(lines) - 1) + 1,) * 2)
        for e, half in enumerate(np.diff(lines) / 2):
            mine = slice(e * order, (e + 1) * order + 1)
            A[mine, mine] += half ** (1 - test - trial) * element
        matrices[test, trial] = A
    return matrices


class Term:
    """One elastic tensor on one box of elements: applies Σ C A_x ⊗ A_y ⊗ A_z to a window of the nodes.

    Parameters
    ----------
    lines : Lines
    order, n_points : int
        Order of the functions; Gauss points along each axis of an element.
    C : array, shape (3, 3, 3, 3)
    elements : three (first, last) pairs
        The box, as ranges of elements along each axis.
    """

    def __init__(
        self, lines: Lines, order: int, n_points: int, C: FloatArray, elements: tuple[tuple[int, int], ...]
    ) -> None:
        self.window = tuple(slice(first * order, last * order + 1) for first, last in elements)
        self._A = [
            line_matrices(line[first : last + 1], order, n_points)
            for line, (first, last) in zip(lines, elements, strict=True)
        ]
        # products along x, then y, are shared by all that need them; those along z wait until all are summed
        self._plan: dict = defaultdict(lambda: defaultdict(lambda: defaultdict(list)))
        for a, k, b, m in np.argwhere(C != 0.0):
            x, y, z = ((bool(k == d), bool(m == d)) for d in range(3))
            self._plan[int(b)][x][y].append(((int(a), z), float(C[a, k, b, m])))

    def add_to(self, result: FloatArray, u: FloatArray) -> None:
        """Add K u to the result; both of shape (3, nx, ny, nz)."""
        window = (slice(None), *self.window)
        u, result = u[window], result[window]
        sums: dict = {}
        for b, along_x in self._plan.items():
            for x, along_y in along_x.items():
                ux = (self._A[0][x] @ u[b].reshape(u.shape[1], -1)).reshape(u[b].shape)
                for y, targets in along_y.items():
                    uxy = self._A[1][y] @ ux
                    for key, c in targets:
                        if key in sums:
                            sums[key] += c * uxy
                        else:
                            sums[key] = c * uxy
        for (a, z), total in sums.items():
            result[a] += total @ self._A[2][z].T


@dataclass(frozen=True)
class Held:
    """Whether the first node along x, y, z of each component is held at zero: on the mirror planes and the base."""

    component: tuple[tuple[bool, bool, bool], ...]  #: [component][axis]

    def clear(self, u: FloatArray) -> None:
        """Set what is held to zero, in place."""
        for values, (x, y, z) in zip(u, self.component, strict=True):
            if x:
                values[0] = 0.0
            if y:
                values[:, 0] = 0.0
            if z:
                values[:, :, 0] = 0.0


class FastDiagonal:
    """Exact inverse of the diagonal blocks K[a, a] of a homogeneous box, through eigenvectors along each axis.

    Lynch, Rice and Thomas, "Direct solution of partial difference equations by tensor product methods",
    Numer. Math. 6 (1964). Preconditions conjugate gradients independently of mesh grading and order.
    """

    def __init__(self, lines: Lines, order: int, C: FloatArray, held: Held) -> None:
        self._held = held
        matrices = [line_matrices(line, order, order + 1) for line in lines]
        self._modes: list[list[FloatArray]] = []
        self._inverse: list[FloatArray] = []
        spectra = {}
        for d, first in {(d, int(held.component[a][d])) for a in range(3) for d in range(3)}:
            eigenvalues, V = eigh(matrices[d][True, True][first:, first:], matrices[d][False, False][first:, first:])
            # rounding is relative to the largest: at lines far closer than others it makes the least negative
            least = first * (np.pi / 2 / np.ptp(lines[d])) ** 2
            spectra[d, first] = np.maximum(eigenvalues, least), V
        for a in range(3):
            modes, total = [], np.zeros((1, 1, 1))
            for d in range(3):
                eigenvalues, V = spectra[d, int(held.component[a][d])]
                modes.append(V)
                total = total + C[a, d, a, d] * eigenvalues.reshape([-1 if axis == d else 1 for axis in range(3)])
            self._modes.append(modes)
            self._inverse.append(1 / total)

    def __call__(self, r: FloatArray) -> FloatArray:
        """The preconditioned residual; zero where held."""
        z = np.zeros_like(r)
        for a, (X, Y, Z) in enumerate(self._modes):
            inner = tuple(slice(int(held), None) for held in self._held.component[a])
            z[a][inner] = along_axes((X, Y, Z), self._inverse[a] * along_axes((X.T, Y.T, Z.T), r[a][inner]))
        return z


def along_axes(matrices: Sequence[FloatArray], u: FloatArray) -> FloatArray:
    """X ⊗ Y ⊗ Z applied to u of shape (nx, ny, nz)."""
    X, Y, Z = matrices
    u = (X @ u.reshape(u.shape[0], -1)).reshape(-1, *u.shape[1:])
    return (Y @ u) @ Z.T


def conjugate_gradients(
    A: Callable[[FloatArray], FloatArray],
    precondition: Callable[[FloatArray], FloatArray],
    b: FloatArray,
    first: FloatArray,
    tolerance: float,
    most: int = 5000,
) -> tuple[FloatArray, int, float]:
    """Solution, number of steps and relative residual ‖b − A u‖/‖b‖, both in the preconditioner's norm.

    Parameters
    ----------
    A, precondition : functions
        Of arrays like b.
    b : array
    first : array, like b
        Where to begin.
    tolerance : float
        Residual at which to stop.
    most : int
        Number of steps.

    Raises
    ------
    SolverError
        If that many steps do not reach the tolerance.
    """
    u = first.copy()
    r = b - A(u)
    z = precondition(r)
    p = z.copy()
    rz = float(np.vdot(r, z))
    enough = tolerance**2 * float(np.vdot(b, precondition(b)))
    for step in range(most + 1):
        if rz <= enough:
            return u, step, tolerance * (rz / enough) ** 0.5 if enough else 0.0
        Ap = A(p)
        alpha = rz / float(np.vdot(p, Ap))
        u += alpha * p
        r -= alpha * Ap
        z = precondition(r)
        rz, before = float(np.vdot(r, z)), rz
        p *= rz / before
        p += z
    raise SolverError(
        f"conjugate gradients left a residual of {tolerance * (rz / enough) ** 0.5:.1e} after {most} steps: the moduli "
        "may differ too widely or ν be too near 0.5."
    )
