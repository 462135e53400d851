"""Tables of an element on its reference domain: all elements share them, whatever their mesh.

Slopes in space are ∂φ/∂x_J = Σ_m pull[m, J] ∂φ/∂ξ_m with `pull` = ∂ξ/∂x, one matrix of an affine element.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from skfem import Element, Mesh
from skfem.quadrature import get_quadrature
from skfem.refdom import RefHex

from fem.kernel.elements import Basis
from geometry.layout import FloatArray

IntArray = NDArray[np.int64]
AFFINE = 1e-12  #: of the mesh's extent: how far rounding may take a corner off its parallelepiped
PAIRS = tuple((i, j) for i in range(3) for j in range(i, 3))  #: components of a symmetric tensor
NEWTON_STEPS = 20  #: at most, of a place in a mapped hexahedron


@dataclass(frozen=True, eq=False)
class Reference:
    """n functions at q points of integration, and k pressures."""

    values: FloatArray  #: (n, q)
    slopes: FloatArray  #: by each local coordinate, (3, n, q)
    weights: FloatArray  #: (q,)
    pressures: FloatArray  #: (q, k); no columns where there are none
    surface: IntArray  #: functions that elements share, (n_surface,)
    inside: IntArray  #: functions of the element alone, (n_inside,)

    @cached_property
    def products(self) -> FloatArray:
        """Weighted ∂ₘφₐ ∂ₗφ_b at the points, (9 q, n²): rows run over m, l and points."""
        n, q = self.slopes.shape[1:]
        table = np.einsum("maq,lbq,q->mlqab", self.slopes, self.slopes, self.weights, optimize=True)
        return table.reshape(9 * q, n * n)

    @cached_property
    def pressing(self) -> FloatArray:
        """Weighted ∂ₘφₐ times pressures at the points, (3 q, n k): rows run over m and points."""
        table = np.einsum("maq,qk,q->mqak", self.slopes, self.pressures, self.weights, optimize=True)
        return table.reshape(3 * len(self.weights), -1)

    @cached_property
    def stiffness(self) -> tuple[FloatArray, FloatArray]:
        """∫ ∂ₘφₐ ∂ₗφ_b, and Σₖ ∫ ∂ₘφₐ qₖ ∫ ∂ₗφ_b qₖ / ∫ qₖ²; each (n², 9), columns run over m and l."""
        n = self.slopes.shape[1]
        weighted = self.slopes * self.weights
        shear = np.einsum("maq,lbq->abml", weighted, self.slopes, optimize=True)
        modes = weighted @ self.pressures / np.sqrt(self.weights @ self.pressures**2)  # (3, n, k)
        bulk = np.einsum("mak,lbk->abml", modes, modes, optimize=True)
        return shear.reshape(n * n, 9), bulk.reshape(n * n, 9)

    def uniform_stiffness(self, pull: FloatArray, mu_n_mm: FloatArray, lame_n_mm: FloatArray | None) -> FloatArray:
        """Stiffness of affine elements of one rubber each, (e, n, n, 3, 3), with M and N of `stiffness`.

        K = V Σₘₗ λ pullₘᵢ pullₗⱼ Nₘₗ + μ (δᵢⱼ gₘₗ + pullₘⱼ pullₗᵢ) Mₘₗ of `pull` (e, 3, 3), V μ and V λ (e,), which is
        None where pressures are continuous.
        """
        M, N = self.stiffness
        g = np.einsum("eij,emk,elk->emlij", np.broadcast_to(np.eye(3), pull.shape), pull, pull, optimize=True)
        shear = g + np.einsum("emj,eli->emlij", pull, pull)
        shear *= mu_n_mm[:, None, None, None, None]
        K = M @ shear.reshape(len(pull), 9, 9)
        if lame_n_mm is not None:
            bulk = np.einsum("emi,elj->emlij", pull, pull)
            bulk *= lame_n_mm[:, None, None, None, None]
            K += N @ bulk.reshape(len(pull), 9, 9)
        n = self.slopes.shape[1]
        return K.reshape(len(pull), n, n, 3, 3)

    def in_space(self, pull: FloatArray) -> FloatArray:
        """∂ᵢφ at the points of integration, (e, 3, n, q), with `pull` (e, 1 or q, 3, 3)."""
        every = np.broadcast_to(pull, (len(pull), len(self.weights), 3, 3))
        return (self.slopes.transpose(2, 1, 0) @ every).transpose(0, 3, 2, 1)


def point_stiffness(
    slopes: FloatArray, mu_n_mm: FloatArray, pressing: FloatArray | None = None, pressed: FloatArray | None = None
) -> FloatArray:
    """∫ μ (δᵢⱼ ∂ₖφₐ ∂ₖφ_b + ∂ⱼφₐ ∂ᵢφ_b) + Pₐᵢ · B_bj, point by point, (e, n, n, 3, 3).

    Slopes are (e, 3, n, q), μ dV (e, q); B = ∫ q ∂φ of jumping pressures and P = B (∫ q qᵀ/λ)⁻¹ are (e, 3, n, k).
    """
    left, n = slopes * mu_n_mm[:, None, None], slopes.shape[2]
    K = np.empty((len(slopes), n, n, 3, 3))
    shear = sum(left[:, k] @ slopes[:, k].swapaxes(1, 2) for k in range(3))
    for i, j in PAIRS:
        K[..., i, j] = left[:, j] @ slopes[:, i].swapaxes(1, 2)
        if pressing is not None and pressed is not None:
            K[..., i, j] += pressed[:, i] @ pressing[:, j].swapaxes(1, 2)
        if i == j:
            K[..., i, i] += shear
        else:
            K[..., j, i] = K[..., i, j].swapaxes(1, 2)
    return K


@lru_cache(maxsize=32)
def reference(elem: Element, pressure: Element | None) -> Reference:
    """The tables of an element, one object each, and of the element of its pressures."""
    X, weights = get_quadrature(elem.refdom, 2 * elem.maxdeg + 1 if elem.refdom is RefHex else 2)
    values, slopes = tabulated(elem, X)
    n, n_inside = len(values), elem.interior_dofs
    shown = np.zeros((len(weights), 0)) if pressure is None else tabulated(pressure, X)[0].T
    every = np.arange(n)
    return Reference(values, slopes, weights, shown, every[: n - n_inside], every[n - n_inside :])


def tabulated(elem: Element, X: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Functions of an element at local places X (3, ...), (n, ...), and their slopes, (3, n, ...)."""
    n, shape = len(elem.doflocs), X.shape[1:]
    values, slopes = np.empty((n, *shape)), np.empty((3, n, *shape))
    for i in range(n):
        value, slope = elem.lbasis(X, i)
        values[i] = value
        for d in range(3):
            slopes[d, i] = slope[d]
    return values, slopes


def pulls(basis: Basis) -> tuple[FloatArray, FloatArray]:
    """∂ξ/∂x (e, 1 or q, 3, 3) and volumes (e, 1 or q) that points of weight 1 stand for; 1 of affine elements."""
    mesh, X = basis.mesh, basis.X
    if is_straight(mesh):
        X = X[:, :1]
    pull = basis.mapping.invDF(X).transpose(2, 3, 0, 1)
    return np.ascontiguousarray(pull), np.abs(basis.mapping.detDF(X)).reshape(mesh.nelements, -1)


def is_straight(mesh: Mesh) -> bool:
    """True of tetrahedra, and where every hexahedron is a parallelepiped: their mappings are affine."""
    if mesh.refdom is not RefHex:
        return True
    corners, where = mesh.p[:, mesh.t].transpose(1, 0, 2), RefHex.p.T  # (8, 3, e), (8, 3)
    origin = corners[np.flatnonzero(where.sum(axis=1) == 0)[0]]
    sides = np.array([corners[np.flatnonzero((where == axis).all(axis=1))[0]] - origin for axis in np.eye(3)])
    off = corners - origin - np.tensordot(where, sides, 1)
    return float(np.abs(off).max()) <= AFFINE * float(np.ptp(mesh.p, axis=1).max())


def local_places(mesh: Mesh, element: IntArray, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where places x (3, t, q) [mm] lie in elements (t,): X of the same shape, and ∂ξ/∂x there, (3, 3, t, q).

    By Newton's method, whose first step is exact in affine elements.
    """
    corners, elem = mesh.p[:, mesh.t[:, element]], mesh.elem()  # (3, n, t)
    X = np.full(places.shape, 0.5 if mesh.refdom is RefHex else 0.25)
    for _ in range(NEWTON_STEPS):
        values, slopes = tabulated(elem, X)
        off = places - np.einsum("int,ntq->itq", corners, values)
        pull = np.linalg.inv(np.einsum("int,mntq->tqim", corners, slopes)).transpose(2, 3, 0, 1)
        step = np.einsum("mitq,itq->mtq", pull, off)
        X += step
        if np.abs(step).max(initial=0.0) < AFFINE:
            break
    return X, pull
