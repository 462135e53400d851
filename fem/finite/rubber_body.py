"""Boxes of neo-Hookean rubber: internal forces, tangent stiffness and energy of quadratic hexahedra.

The law is W = μ/2 (I₁ − 3) − μ ln J + λ/2 (J − 1)², which at small strain is Hooke's law of Lamé's λ and μ.
Displacements are Q2; the pressure p = λ (J − 1) is linear within an element and jumps between elements (Q2/P1disc), so
that it is found element by element and nearly incompressible rubber does not lock. With P = ∂W/∂F, J = det F and
cof F = J F⁻ᵀ,

    ∫ [μ F + (p − μ/J) cof F] : ∇v = external forces     for all v,
    ∫ [λ (J − 1) − p] q = 0                              for all q linear in an element.

Sussman & Bathe, Computers & Structures 26 (1987) 357, give the form; the pair is the 9/3c element's in 3-D.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.discretization.grid import Grid, GridBasis
from fem.discretization.lagrange import gauss_points, shape_functions
from fem.scene.scene import Region, regions_at
from geometry.design import Material
from geometry.layout import FloatArray

N_NODES, N_POINTS, N_PRESSURES = 27, 27, 4  #: of an element: nodes, Gauss points, pressure functions
AT_ONCE = 512  #: elements whose tangents are computed at a time: their products stay in the cache
PAIRS = tuple((i, j) for i in range(3) for j in range(i, 3))  #: components of a symmetric tensor


def _tables() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Slopes (3, n_nodes, n_points) on [−1, 1]³, weights (n_points,) and pressure functions (n_points, 4)."""
    x, weight = gauss_points(3)
    values, slopes = shape_functions(2, x)
    along = [[slopes if axis == d else values for axis in range(3)] for d in range(3)]
    table = np.stack([np.einsum("pi,qj,rk->ijkpqr", *functions).reshape(N_NODES, N_POINTS) for functions in along])
    points = np.array(list(product(x, x, x)))
    weights = np.einsum("p,q,r->pqr", weight, weight, weight).ravel()
    return table, weights, np.hstack([np.ones((N_POINTS, 1)), points])


SLOPES, WEIGHTS, PRESSURES = _tables()
WEIGHTED = WEIGHTS[:, None] * PRESSURES
MIN_LAME = 1e-9  #: least λ over μ, which is divided by where ν = 0


@dataclass(frozen=True, eq=False)
class Strain:
    """Deformation at the Gauss points of one or several states; m states, e elements, q points."""

    H: FloatArray  #: displacement gradient F − I, (3, 3, m, e, q): component i by coordinate J
    C: FloatArray  #: cof F − I, of the same shape
    dilation: FloatArray  #: J − 1, (m, e, q); with H and C free of cancellation where strains are tiny

    @property
    def J(self) -> FloatArray:
        """Ratio of volumes, (m, e, q)."""
        return 1.0 + self.dilation

    @property
    def F(self) -> FloatArray:
        """Deformation gradient, (3, 3, m, e, q)."""
        return plus_unit(self.H.copy(), 1.0)

    @property
    def cof(self) -> FloatArray:
        """Cofactors J F⁻ᵀ, (3, 3, m, e, q)."""
        return plus_unit(self.C.copy(), 1.0)


class RubberBody:
    """A grid of boxes of one or several rubbers.

    Parameters
    ----------
    grid : Grid
        Its regions number the rubbers.
    materials : sequence of Material
    inside : sequence of (Prism, Material)
        Parts of other rubbers, which need not follow the grid: each Gauss point has the rubber of its place.

    Notes
    -----
    Displacements have shape (..., n_nodes, 3) [mm], where leading axes are states of the same body; nodes are
    `GridBasis`'s. Pressures have shape (..., n_elements, 4) [MPa]: the mean and three slopes over half an element.
    """

    def __init__(self, grid: Grid, materials: Sequence[Material], inside: Sequence[Region] = ()) -> None:
        self.grid, self.basis = grid, GridBasis(grid)
        start = 2 * np.indices(grid.shape).reshape(3, -1, 1)
        local = np.indices((3, 3, 3)).reshape(3, 1, -1)
        self.nodes: NDArray[np.int64] = self.basis.number[tuple(start + local)]  #: (n_elements, 27), z fastest
        size = np.stack(np.meshgrid(*[np.diff(lines) for lines in grid.lines], indexing="ij"), axis=-1).reshape(-1, 3)
        self.scale = (2 / size).T  #: ∂ξ/∂x of the boxes before they are sheared, (3, n_elements) [1/mm]
        self.volume_mm3 = size.prod(axis=1)
        region = np.broadcast_to(grid.region, grid.shape).reshape(-1, 1)
        if inside:
            own = regions_at(self.points_mm.reshape(-1, 3), inside).reshape(-1, N_POINTS)
            region = np.where(own > 0, len(materials) - 1 + own, region)
        lame = np.array([rubber.lame_mpa for rubber in [*materials, *(rubber for _, rubber in inside)]])
        self.mu_mpa = lame[region, 1]  #: at the Gauss points, (n_elements, n_points), or (n_elements, 1)
        self.lame_mpa = np.maximum(lame[region, 0], MIN_LAME * self.mu_mpa)  #: of the same shape
        compliance = np.einsum("eq,qk,ql->ekl", WEIGHTS / self.lame_mpa, PRESSURES, PRESSURES)
        #: (∫ q qᵀ/λ)⁻¹, which takes ∫ q (J − 1) to pressures, (n_elements, 4, 4) [MPa/mm³]
        self.bulk = np.linalg.inv(compliance) / self._jacobian[:, None, None]
        places = np.arange(self.nodes.size)
        self._gather = sp.csr_matrix(
            (np.ones(len(places)), (self.nodes.ravel(), places)), shape=(self.n_nodes, len(places))
        )
        gradients = self._slopes(slice(None))
        #: ∫ μ ∂φₐ/∂X · ∂φ_b/∂X, the part of the tangent that never changes, (n_elements, 27, 27) [N/mm]
        weighted = gradients * (self.mu_mpa * WEIGHTS * self._jacobian[:, None])[:, None, :]
        self._laplace = np.einsum("jeaq,jebq->eab", gradients, weighted, optimize=True)

    @property
    def n_nodes(self) -> int:
        return self.basis.N

    @property
    def n_elements(self) -> int:
        return len(self.nodes)

    @property
    def _jacobian(self) -> FloatArray:
        return self.volume_mm3 / 8

    @property
    def points_mm(self) -> FloatArray:
        """Gauss points at rest, shape (n_elements, n_points, 3)."""
        away = PRESSURES[:, 1:] / self.scale.T[:, None]  # from the elements' middles
        away[..., :2] += away[..., 2:] * np.array(self.grid.lean)
        return self.centres_mm[:, None] + away

    @property
    def centres_mm(self) -> FloatArray:
        """Middles of the elements at rest, shape (n_elements, 3)."""
        return self.basis.doflocs.T[self.nodes[:, 13]]

    def rest(self, *states: int) -> tuple[FloatArray, FloatArray]:
        """Displacements and pressures of the body at rest."""
        return np.zeros((*states, self.n_nodes, 3)), np.zeros((*states, self.n_elements, N_PRESSURES))

    def strain(self, u: FloatArray) -> Strain:
        """Deformation of displacements (m, n_nodes, 3)."""
        H = self.gradient(u)
        second = cofactors(H)
        trace = H[0, 0] + H[1, 1] + H[2, 2]
        determinant = H[0, 0] * second[0, 0] + H[0, 1] * second[0, 1] + H[0, 2] * second[0, 2]
        dilation = trace + second[0, 0] + second[1, 1] + second[2, 2] + determinant
        second -= H.swapaxes(0, 1)
        return Strain(H=H, C=plus_unit(second, trace), dilation=dilation)

    def gradient(self, u: FloatArray) -> FloatArray:
        """∂uᵢ/∂X_J at the Gauss points, shape (3, 3, m, n_elements, n_points), of displacements (m, n_nodes, 3)."""
        states = len(u)
        own = np.ascontiguousarray(u[:, self.nodes].transpose(3, 0, 1, 2)).reshape(-1, N_NODES)
        out = np.empty((3, 3, states, self.n_elements, N_POINTS))
        for d in range(3):
            out[:, d] = (own @ SLOPES[d]).reshape(3, states, self.n_elements, N_POINTS)
            out[:, d] *= self.scale[d][:, None]
        for d, lean in enumerate(self.grid.lean):
            if lean:
                out[:, 2] -= lean * out[:, d]
        return out

    def dilated(self, values: FloatArray) -> FloatArray:
        """Pressures (m, n_elements, 4) of changes J − 1 of volume, (m, n_elements, n_points) [MPa]."""
        return np.einsum("ekl,mel->mek", self.bulk * self._jacobian[:, None, None], values @ WEIGHTED)

    def stress(self, strain: Strain, p: FloatArray) -> FloatArray:
        """First Piola-Kirchhoff stress P at the Gauss points [MPa], (3, 3, m, n_elements, n_points)."""
        pressure, over = p @ PRESSURES.T, self.mu_mpa / strain.J
        P = (pressure - over) * strain.C
        P += self.mu_mpa * strain.H
        return plus_unit(P, pressure + over * strain.dilation)

    def divergence(self, P: FloatArray) -> FloatArray:
        """Nodal forces ∫ P : ∇v, (m, n_nodes, 3) [N], of stresses (3, 3, m, n_elements, n_points); overwrites these."""
        states = P.shape[2]
        for d, lean in enumerate(self.grid.lean):
            if lean:
                P[:, d] -= lean * P[:, 2]
        own = np.zeros((3 * states * self.n_elements, N_NODES))
        for d in range(3):
            weighted = P[:, d] * (self.scale[d] * self._jacobian)[:, None]
            weighted *= WEIGHTS
            own += weighted.reshape(-1, N_POINTS) @ SLOPES[d].T
        nodal = self._gather @ own.reshape(3 * states, -1).T
        return np.ascontiguousarray(nodal.reshape(-1, 3, states).transpose(2, 0, 1))

    def internal_forces(self, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Nodal forces that hold states, their pressures, and the least J of each.

        Parameters
        ----------
        u : array, shape (m, n_nodes, 3)
            Displacements [mm].

        Returns
        -------
        forces : array, shape (m, n_nodes, 3)
            ∫ P : ∇v [N].
        pressures : array, shape (m, n_elements, 4)
            Those that the volumes ask for [MPa].
        least_j : array, shape (m,)
            At or below 0 where a state is turned inside out; its forces mean nothing.
        """
        strain = self.strain(u)
        p = self.dilated(strain.dilation)
        with np.errstate(divide="ignore", invalid="ignore"):
            forces = self.divergence(self.stress(strain, p))
        return forces, p, strain.J.min(axis=(1, 2))

    def least_j(self, u: FloatArray) -> tuple[float, int]:
        """The least ratio of volumes of one state (n_nodes, 3), and the element that has it."""
        least = self.strain(u[None]).J[0].min(axis=1)
        return float(least.min()), int(least.argmin())

    def energy_mj(self, u: FloatArray) -> float:
        """Stored energy of one state (n_nodes, 3); NaN where it is turned inside out."""
        strain = self.strain(u[None])
        H, dilation_at = strain.H[:, :, 0], strain.dilation[0]
        with np.errstate(divide="ignore", invalid="ignore"):  # (I₁ − 3)/2 = tr H + |H|²/2
            shear = H[0, 0] + H[1, 1] + H[2, 2] + (H**2).sum(axis=(0, 1)) / 2 - np.log1p(dilation_at)
            shear *= self.mu_mpa
        pressing = self.dilated(dilation_at[None])[0] * (dilation_at @ WEIGHTED)
        return float(self._jacobian @ (shear @ WEIGHTS + pressing.sum(axis=1) / 2))

    def tangent_parts(self, u: FloatArray, p: FloatArray) -> "TangentParts":
        """Parts of the tangent of one state (n_nodes, 3) whose pressures are iterates (n_elements, 4) of their own."""
        return TangentParts(self, self.strain(u[None]), p)

    def _slopes(self, some: slice) -> FloatArray:
        """∂φₐ/∂X_J of some elements, shape (3, e, n_nodes, n_points)."""
        out = self.scale[:, some, None, None] * SLOPES[:, None]
        for d, lean in enumerate(self.grid.lean):
            if lean:
                out[2] -= lean * out[d]
        return out


class TangentParts:
    """Tangent stiffness of every element, its pressures eliminated.

    With c_a = cof F · ∂φₐ/∂X, s = p − μ/J and weights w,

        K[ai, bj] = ∫ μ ∂φₐ/∂X · ∂φ_b/∂X δᵢⱼ + (p/J) c_ai c_bj − (s/J) c_aj c_bi  +  λ Bₐᵢ M⁻¹ B_bj,   B = ∫ q c.
    """

    def __init__(self, body: RubberBody, strain: Strain, p: FloatArray) -> None:
        self.body, self._cof = body, strain.cof[:, :, 0]
        self._J = J = strain.J[0]
        pressure = p @ PRESSURES.T
        weight = body._jacobian[:, None] * WEIGHTS
        self._direct = weight * pressure / J
        self._crossed = -weight * (pressure - body.mu_mpa / J) / J
        #: B, the forces that pressures exert, shape (3, n_elements, 27, 4) [mm²]
        self.pressing = np.empty((3, body.n_elements, N_NODES, N_PRESSURES))

    def steady(self, some: NDArray[np.bool_]) -> None:
        """Leave out of some elements (n_elements,) what may be negative, all but μ/J² c c of the pressure's terms."""
        weight = self.body._jacobian[some, None] * WEIGHTS
        self._direct[some] = weight * self.body.mu_mpa[some] / self._J[some] ** 2
        self._crossed[some] = 0.0

    def blocks(self) -> dict[tuple[int, int], FloatArray]:
        """K by components i ≤ j, each of shape (n_elements, 27, 27): entry [e, a, b] couples aᵢ with b_j [N/mm]."""
        body, n = self.body, self.body.n_elements
        K = {pair: np.empty((n, N_NODES, N_NODES)) for pair in PAIRS}
        for first in range(0, n, AT_ONCE):
            some = slice(first, min(first + AT_ONCE, n))
            slopes = body._slopes(some)
            c = [
                sum(self._cof[i, d, some, None, :] * slopes[d] for d in range(3)) for i in range(3)
            ]  # (e, n_nodes, n_points) each
            B = [(ci @ WEIGHTED) * body._jacobian[some, None, None] for ci in c]
            direct = [ci * self._direct[some, None, :] for ci in c]
            crossed = [ci * self._crossed[some, None, :] for ci in c]
            bulk = [Bi @ body.bulk[some] for Bi in B]
            for i in range(3):
                self.pressing[i, some] = B[i]
            for i, j in PAIRS:
                own = K[i, j][some]
                np.matmul(direct[i], c[j].transpose(0, 2, 1), out=own)
                own += crossed[j] @ c[i].transpose(0, 2, 1)
                own += bulk[i] @ B[j].transpose(0, 2, 1)
                if i == j:
                    own += body._laplace[some]
        return K

    def pressure_change(self, du: FloatArray) -> FloatArray:
        """λ M⁻¹ Bᵀ du, the change (n_elements, 4) of pressures with displacements (n_nodes, 3); after `blocks`."""
        return self.pressure_changes(du[None])[0]

    def pressure_changes(self, du: FloatArray) -> FloatArray:
        """The same of m displacements (m, n_nodes, 3), shape (m, n_elements, 4)."""
        own = du[:, self.body.nodes].transpose(3, 1, 0, 2)  # (i, e, m, a)
        change = sum(own[i] @ self.pressing[i] for i in range(3))
        return np.einsum("ekl,eml->mek", self.body.bulk, change)

    def pressed(self, p: FloatArray) -> FloatArray:
        """B p, the nodal forces (m, n_nodes, 3) of pressures (m, n_elements, 4); after `blocks`."""
        m = len(p)
        own = np.stack([p.transpose(1, 0, 2) @ self.pressing[i].swapaxes(1, 2) for i in range(3)])  # (i, e, m, a)
        flat = own.transpose(1, 3, 0, 2).reshape(-1, 3 * m)
        return np.ascontiguousarray((self.body._gather @ flat).reshape(-1, 3, m).transpose(2, 0, 1))


def plus_unit(A: FloatArray, scale: FloatArray | float) -> FloatArray:
    """A + scale I, in place, of matrices (3, 3, ...)."""
    for i in range(3):
        A[i, i] += scale
    return A


def cofactors(F: FloatArray) -> FloatArray:
    """Cofactors of matrices (3, 3, ...), of the same shape: J F⁻ᵀ."""
    return bilinear_cofactors(F, F) / 2


def bilinear_cofactors(A: FloatArray, B: FloatArray) -> FloatArray:
    """Twice the symmetric bilinear form of the cofactors: cof(A + B) − cof A − cof B; matrices (3, 3, ...).

    >>> bool(np.allclose(bilinear_cofactors(np.eye(3), np.eye(3)), 2 * np.eye(3)))
    True
    """
    out = np.empty(np.broadcast_shapes(A.shape, B.shape))
    for i, d in product(range(3), range(3)):
        i1, i2, d1, d2 = (i + 1) % 3, (i + 2) % 3, (d + 1) % 3, (d + 2) % 3
        out[i, d] = A[i1, d1] * B[i2, d2] - A[i1, d2] * B[i2, d1]
        if A is B:
            out[i, d] *= 2
        else:
            out[i, d] += B[i1, d1] * A[i2, d2] - B[i1, d2] * A[i2, d1]
    return out
