"""Boxes filled with rubber: forces, stiffness and energy of displacements of any order with pressures of their own.

Displacements are continuous, of order p; pressures jump between elements, which find them from their own change of
volume, so that nearly incompressible rubber does not lock. Find u, and p in every element, with

    ∫ P(H, p) : ∇v = external forces      for all v,        P = ∂W/∂F + p ∂θ/∂F of a `Law`,
    ∫ (λ θ − p) q = 0                     for all q of the element.

At order 2 pressures are linear (Q2/P1disc; Sussman & Bathe, Computers & Structures 26 (1987) 357, give the form). From
order 3 on they have two degrees less along each axis: with one less, at ν = 0.4999 and beside boxes 10⁵ times as long
as wide, pressures grew with each refinement (Schötzau, Schwab & Stenberg, Numer. Math. 83 (1999), for two less).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre
from numpy.typing import NDArray

from fem.boxes.boxes import Boxes, cube_slopes, gauss_points
from fem.kernel.law import LAWS, Law, Strain, plus_unit
from geometry.design import Material
from geometry.layout import FloatArray

IntArray = NDArray[np.int64]
CHUNK_VALUES = 1_500_000  #: numbers in the stiffness matrices that are computed at a time: their products stay in cache
AT_ONCE = 8  #: elements whose insides are eliminated, likewise
PAIRS = tuple((i, j) for i in range(3) for j in range(i, 3))  #: components of a symmetric tensor


@dataclass(frozen=True, eq=False)
class ReferenceBox:
    """Tables on [−1, 1]³: n nodes, q Gauss points, k pressure functions."""

    slopes: FloatArray  #: of the functions, (3, n, q)
    weights: FloatArray  #: (q,)
    pressures: FloatArray  #: products of Legendre polynomials, (q, k)
    degrees: IntArray  #: of them along each axis, (k, 3)
    surface: IntArray  #: nodes that elements share, (n_surface,)
    inside: IntArray  #: nodes of the element alone that are eliminated, (n_inside,)

    @cached_property
    def products(self) -> FloatArray:
        """Weighted ∂_Jφₐ ∂_Lφ_b at the Gauss points, (9 q, n²): rows run over J, L and points."""
        _, n, q = self.slopes.shape
        table = np.einsum("jaq,lbq,q->jlqab", self.slopes, self.slopes, self.weights, optimize=True)
        return table.reshape(9 * q, n * n)

    @cached_property
    def divergence(self) -> FloatArray:
        """∫ qⱼ ∂_kφₐ of the pressure functions over their norms, (3, k, n)."""
        modes = np.einsum("knq,qj,q->kjn", self.slopes, self.pressures, self.weights, optimize=True)
        return modes / np.sqrt(self.weights @ self.pressures**2)[:, None]

    @cached_property
    def pressing(self) -> FloatArray:
        """Weighted ∂_Jφₐ times pressure functions at the Gauss points, (3 q, n k): rows run over J and points."""
        table = np.einsum("jaq,qk,q->jqak", self.slopes, self.pressures, self.weights)
        return table.reshape(3 * len(self.weights), -1)


@cache
def reference_box(order: int) -> ReferenceBox:
    """The tables of an order."""
    x, w = gauss_points(order + 1)
    points = np.array(list(product(x, x, x)))
    weights = np.einsum("i,j,k->ijk", w, w, w).ravel()
    top = 1 if order == 2 else order - 2
    degrees = np.eye(4, 3, -1, dtype=np.int64) if order == 2 else np.array(list(product(range(top + 1), repeat=3)))
    along = legendre.legvander(points, top)  # (q, 3, degree)
    pressures = np.stack([along[:, range(3), d].prod(axis=1) for d in degrees], axis=1)
    within = (np.indices((order + 1,) * 3).reshape(3, -1) % order != 0).all(axis=0) & (order > 2)
    slopes = cube_slopes(order, points).swapaxes(1, 2)
    return ReferenceBox(slopes, weights, pressures, degrees, np.flatnonzero(~within), np.flatnonzero(within))


@cache
def rest_terms(order: int, lean: tuple[float, float]) -> tuple[tuple[tuple[int, int], ...], FloatArray]:
    """Stiffness at rest of boxes of any size as a sum of fixed matrices: K = Σ s_kl (λ M_kl⁽⁰⁾ + μ M_kl⁽¹⁾).

    s_kl = (volume/8) (2/h_k) (2/h_l). Returns the pairs (k, l) and M, shape (2, n_pairs, n, n, 3, 3): entry
    [.., a, b, i, j] couples aᵢ with b_j. The lean is that of `Boxes`.
    """
    box = reference_box(order)
    n = box.slopes.shape[1]
    pull = np.eye(3)  # ∂/∂x_k = Σ_m pull[m, k] ∂/∂ξ_m
    pull[:2, 2] = -np.array(lean)
    shear = np.einsum("knq,lmq,q->klnm", box.slopes, box.slopes, box.weights, optimize=True)
    bulk = np.einsum("kjn,ljm->klnm", box.divergence, box.divergence, optimize=True)
    one = np.eye(3)
    tensors = (
        np.einsum("mi,nj->imjn", pull, pull),
        np.einsum("ij,mk,nk->imjn", one, pull, pull) + np.einsum("mj,ni->imjn", pull, pull),
    )
    pairs, terms = [], []
    for pair in PAIRS:
        M = np.zeros((2, n, n, 3, 3))
        for k, m in {pair, pair[::-1]}:
            for part, (C, products) in enumerate(zip(tensors, (bulk, shear), strict=True)):
                M[part] += np.multiply.outer(products[k, m], C[:, k, :, m])
        if M.any():
            pairs.append(pair)
            terms.append(M)
    return tuple(pairs), np.stack(terms, axis=1)


class Condensed(NamedTuple):
    """An element at rest whose inside is eliminated."""

    stiffness: FloatArray  #: between the nodes on its surface, (n_surface, n_surface, 3, 3) [N/mm]
    inner: FloatArray  #: (n_inside·3, n_surface·3): displacements inside, from those of the surface


Kind = tuple[float, ...]  #: of alike elements: relative extents and Lamé's constants


class RubberBody:
    """Boxes filled with rubber by a law whose λ and μ have shape (n_elements, 1).

    `condensed` are elements of earlier bodies of the same height, order and lean; new ones are kept there, and no
    others.

    Displacements have shape (..., n_nodes, 3) [mm], where leading axes are states of the same body. Pressures have
    shape (..., n_elements, k) [MPa]: coefficients of `ReferenceBox.pressures`, at order 2 the mean and three slopes
    over half an element.
    """

    def __init__(self, boxes: Boxes, law: Law, condensed: dict[Kind, Condensed] | None = None) -> None:
        self.boxes, self.law, self.reference = boxes, law, reference_box(boxes.order)
        self.nodes, self.n_nodes = boxes.nodes, boxes.n_nodes  #: (n_elements, n), and their number
        self.n_elements, self.n_pressures = len(boxes.nodes), len(self.reference.degrees)
        self._known = {} if condensed is None else condensed
        self.scale = (2 / boxes.size).T  #: ∂ξ/∂x of the boxes before they are sheared, (3, n_elements) [1/mm]
        self.jacobian = boxes.size.prod(axis=1) / 8  #: volume over that of the reference box, (n_elements,) [mm³]
        self._mass = self.reference.weights @ self.reference.pressures**2
        self._weighted = self.reference.weights[:, None] * self.reference.pressures

    @classmethod
    def of(
        cls, boxes: Boxes, materials: Sequence[Material], condensed: dict[Kind, Condensed] | None = None
    ) -> "RubberBody":
        """Boxes of which each holds the material that its region numbers; all materials are of one model."""
        shares = (boxes.region == np.arange(len(materials))[:, None])[..., None]
        return cls(boxes, LAWS[materials[0].model].of(materials, shares.astype(float)), condensed)

    @property
    def centres_mm(self) -> FloatArray:
        """Middles of the elements at rest, shape (n_elements, 3)."""
        return (self.boxes.low + self.boxes.high) / 2 @ self.boxes.shear.T

    @cached_property
    def _gather(self) -> sp.csr_matrix:
        places = np.arange(self.nodes.size)
        return sp.csr_matrix((np.ones(len(places)), (self.nodes.ravel(), places)), shape=(self.n_nodes, len(places)))

    @cached_property
    def chunks(self) -> list[slice]:
        """Elements whose stiffness is computed at a time; one by one where their insides are eliminated."""
        step = 1 if len(self.reference.inside) else max(1, CHUNK_VALUES // (9 * self.nodes.shape[1] ** 2))
        return [slice(first, min(first + step, self.n_elements)) for first in range(0, self.n_elements, step)]

    def gradient(self, u: FloatArray) -> FloatArray:
        """∂uᵢ/∂X_J at the Gauss points, shape (3, 3, m, n_elements, q), of displacements (m, n_nodes, 3)."""
        states, (_, n, q) = len(u), self.reference.slopes.shape
        own = np.ascontiguousarray(u[:, self.nodes].transpose(3, 0, 1, 2)).reshape(-1, n)
        out = np.empty((3, 3, states, self.n_elements, q))
        for d in range(3):
            out[:, d] = (own @ self.reference.slopes[d]).reshape(3, states, self.n_elements, q)
            out[:, d] *= self.scale[d][:, None]
        for d, lean in enumerate(self.boxes.lean):
            if lean:
                out[:, 2] -= lean * out[:, d]
        return out

    def strain(self, u: FloatArray) -> Strain:
        """Deformation at the Gauss points of displacements (m, n_nodes, 3)."""
        return self.law.strain(self.gradient(u))

    def pressures(self, theta: FloatArray) -> FloatArray:
        """Pressures (m, n_elements, k) that changes of volume (m, n_elements, q) ask for [MPa]."""
        return self.law.lame_mpa * ((theta @ self._weighted) / self._mass)

    def stress(self, strain: Strain, p: FloatArray) -> FloatArray:
        """First Piola-Kirchhoff stress at the Gauss points [MPa], (3, 3, m, n_elements, q)."""
        return self.law.stress(strain, p @ self.reference.pressures.T)

    def divergence(self, P: FloatArray) -> FloatArray:
        """Nodal forces ∫ P : ∇v, (m, n_nodes, 3) [N], of stresses (3, 3, m, n_elements, q); overwrites these."""
        states, (_, n, q) = P.shape[2], self.reference.slopes.shape
        for d, lean in enumerate(self.boxes.lean):
            if lean:
                P[:, d] -= lean * P[:, 2]
        own = np.zeros((3 * states * self.n_elements, n))
        for d in range(3):
            weighted = P[:, d] * (self.scale[d] * self.jacobian)[:, None]
            weighted *= self.reference.weights
            own += weighted.reshape(-1, q) @ self.reference.slopes[d].T
        nodal = self._gather @ own.reshape(3 * states, -1).T
        return np.ascontiguousarray(nodal.reshape(-1, 3, states).transpose(2, 0, 1))

    def internal_forces(self, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Nodal forces ∫ P : ∇v (m, n_nodes, 3) [N] that hold states u (m, n_nodes, 3), and two more of each state.

        The pressures (m, n_elements, k) that the volumes ask for [MPa], and the least J (m,): at or below 0 a state is
        turned inside out, and its forces mean nothing.
        """
        strain = self.strain(u)
        p = self.pressures(strain.theta)
        with np.errstate(divide="ignore", invalid="ignore"):
            forces = self.divergence(self.stress(strain, p))
        return forces, p, strain.J.min(axis=(1, 2))

    def energy_mj(self, u: FloatArray) -> float:
        """Stored energy of one state (n_nodes, 3); NaN where it is turned inside out."""
        strain = self.strain(u[None])
        with np.errstate(divide="ignore", invalid="ignore"):
            stored = self.law.energy(strain)[0] @ self.reference.weights
        pressing = (self.pressures(strain.theta)[0] * (strain.theta[0] @ self._weighted)).sum(axis=1) / 2
        return float(self.jacobian @ (stored + pressing))

    def tangent(self, u: FloatArray, p: FloatArray) -> "Tangent":
        """The body linearised at a state (n_nodes, 3) whose pressures are iterates (n_elements, k) of their own."""
        return Tangent(self, self.strain(u[None]), p)

    def rest_stiffness(self, some: IntArray | slice = slice(None)) -> FloatArray:
        """Stiffness at rest of some elements, (e, n, n, 3, 3): entry [e, a, b, i, j] couples aᵢ with b_j [N/mm]."""
        pairs, terms = rest_terms(self.boxes.order, self.boxes.lean)
        size = self.boxes.size[some]
        scales = np.stack([size.prod(axis=1) / 2 / size[:, k] / size[:, m] for k, m in pairs], axis=1)
        both = np.stack([self.law.lame_mpa[some], self.law.mu_mpa[some]], axis=1) * scales[:, None]
        return np.tensordot(both.reshape(len(size), -1), terms.reshape(-1, *terms.shape[2:]), 1)

    @cached_property
    def _kinds(self) -> list[Kind]:
        """Elements of one kind are alike; sizes that only rounding tells apart are one."""
        size = (self.boxes.size / self.boxes.height_mm).round(12)
        return [tuple(row) for row in np.column_stack([size, self.law.lame_mpa, self.law.mu_mpa]).tolist()]

    @cached_property
    def condensed(self) -> dict[Kind, Condensed]:
        """Elements by kind, their insides eliminated."""
        known, surface, inside = self._known, self.reference.surface, self.reference.inside
        for kind in known.keys() - set(self._kinds):
            del known[kind]
        first = {kind: element for element, kind in enumerate(self._kinds) if kind not in known}
        new = np.array(list(first.values()), dtype=np.int64)
        for elements in np.array_split(new, np.arange(AT_ONCE, len(new), AT_ONCE)) if len(new) else []:
            K = self.rest_stiffness(elements)
            inside_rows = (K[:, inside[:, None], own].swapaxes(2, 3) for own in (inside, surface))
            within, beside = (rows.reshape(len(K), 3 * len(inside), -1) for rows in inside_rows)
            inner = np.linalg.solve(within, beside)
            outer = K[:, surface[:, None], surface]
            taken = (beside.swapaxes(1, 2) @ inner).reshape(len(K), len(surface), 3, len(surface), 3)
            outer -= taken.swapaxes(2, 3)
            for element, own, recovered in zip(elements, outer, inner, strict=True):
                known[self._kinds[element]] = Condensed(own.copy(), -recovered)
        return known

    def filled(self, u: FloatArray) -> FloatArray:
        """Displacements at rest (m, n_nodes, 3) with those inside the elements, from those on their surfaces."""
        inside, surface = self.reference.inside, self.reference.surface
        if not len(inside):
            return u
        u = u.copy()
        for own, kind in zip(self.nodes, self._kinds, strict=True):
            u[:, own[inside]] = (u[:, own[surface]].reshape(len(u), -1) @ self.condensed[kind].inner.T).reshape(
                len(u), -1, 3
            )
        return u

    def on_surfaces(self, forces: FloatArray) -> FloatArray:
        """Nodal forces (m, n_nodes, 3) at rest with those inside the elements moved to their surfaces."""
        inside, surface = self.reference.inside, self.reference.surface
        if not len(inside):
            return forces
        forces = forces.copy()
        for element in np.flatnonzero(forces[:, self.nodes[:, inside]].any(axis=(0, 2, 3))):
            own, inner = self.nodes[element], self.condensed[self._kinds[element]].inner
            forces[:, own[surface]] += (forces[:, own[inside]].reshape(len(forces), -1) @ inner).reshape(
                len(forces), -1, 3
            )
            forces[:, own[inside]] = 0.0
        return forces

    def rest_blocks(self) -> Iterator[tuple[slice, FloatArray]]:
        """Chunks of elements and their stiffness at rest between nodes on their surfaces, (e, n, n, 3, 3) [N/mm]."""
        for some in self.chunks:
            if len(self.reference.inside):
                yield some, self.condensed[self._kinds[some.start]].stiffness[None]
            else:
                yield some, self.rest_stiffness(some)


class Tangent:
    """Stiffness of every element at a state, its pressures eliminated.

    With c = ∂θ/∂F ∇φ and A = ∂²W/∂F² + p ∂²θ/∂F²,

        K[ai, bj] = ∫ ∂_Jφₐ A[i, J, j, L] ∂_Lφ_b  +  Bₐᵢ (∫ q qᵀ/λ)⁻¹ B_bj,   B = ∫ q c.

    The strain is of one state, with the first axis of states, and its pressures p have shape (n_elements, k).
    """

    def __init__(self, body: RubberBody, strain: Strain, p: FloatArray) -> None:
        self.body, self._p, self._definite, self._share = body, p, np.zeros(body.n_elements, dtype=bool), 1.0
        self._strain = Strain(H=strain.H[:, :, 0], C=strain.C[:, :, 0], theta=strain.theta[0])
        #: (∫ q qᵀ/λ)⁻¹, diagonal, (n_elements, k) [MPa/mm³]
        self._bulk = body.law.lame_mpa / (body._mass * body.jacobian[:, None])
        #: B, the forces that pressures exert, shape (3, n_elements, n, k) [mm²]
        self.pressing = np.empty((3, *body.nodes.shape, body.n_pressures))

    def make_definite(self, some: NDArray[np.bool_], share: float = 1.0) -> None:
        """Leave a share of A's negative eigenvalues out at every Gauss point of some elements (n_elements,)."""
        self._definite, self._share = some, share

    def blocks(self) -> Iterator[tuple[slice, FloatArray]]:
        """Chunks of elements and their K, (e, n, n, 3, 3): entry [e, a, b, i, j] couples aᵢ with b_j [N/mm]."""
        body, box = self.body, self.body.reference
        n, k = body.nodes.shape[1], body.n_pressures
        for some in body.chunks:
            e = some.stop - some.start
            cof = self._in_box(plus_unit(self._strain.C[:, :, some].copy(), 1.0), 1, some)  # (3, 3, e, q)
            A = self._in_box(self._in_box(self._moduli(some), 1, some), 3, some)
            A *= body.jacobian[some, None]
            for i in range(3):
                own = cof[i].swapaxes(0, 1).reshape(e, -1) @ box.pressing
                self.pressing[i, some] = own.reshape(e, n, k) * body.jacobian[some, None, None]
            K = np.empty((e, n, n, 3, 3))
            for i, j in PAIRS:
                own = (np.moveaxis(A[i, :, j], 2, 0).reshape(e, -1) @ box.products).reshape(e, n, n)
                own += (self.pressing[i, some] * self._bulk[some][:, None]) @ self.pressing[j, some].swapaxes(1, 2)
                K[..., i, j] = own
                if i != j:
                    K[..., j, i] = own.swapaxes(1, 2)
            yield some, K

    def _in_box(self, values: FloatArray, axis: int, some: slice) -> FloatArray:
        """Tensors of shape (..., e, q) with one axis along x, y, z turned to multiply derivatives in the boxes."""
        values = np.moveaxis(values, axis, 0)
        for d, lean in enumerate(self.body.boxes.lean):
            if lean:
                values[d] -= lean * values[2]
        for d in range(3):
            values[d] *= self.body.scale[d, some, None]
        return np.moveaxis(values, 0, axis)

    def _moduli(self, some: slice) -> FloatArray:
        """A at the Gauss points of some elements, (3, 3, 3, 3, e, q)."""
        strain = Strain(H=self._strain.H[:, :, some], C=self._strain.C[:, :, some], theta=self._strain.theta[some])
        A = self.body.law.part(some).tangent(strain, self._p[some] @ self.body.reference.pressures.T)
        definite = np.flatnonzero(self._definite[some])
        if len(definite):
            own = np.moveaxis(A[..., definite, :].reshape(9, 9, -1), -1, 0)
            values, vectors = np.linalg.eigh(own)
            values -= self._share * np.minimum(values, 0.0)
            own = (vectors * values[:, None]) @ vectors.swapaxes(1, 2)
            A[..., definite, :] = np.moveaxis(own, 0, -1).reshape(3, 3, 3, 3, len(definite), -1)
        return A

    def pressure_changes(self, du: FloatArray) -> FloatArray:
        """Changes (m, n_elements, k) of the pressures with displacements (m, n_nodes, 3); after `blocks`."""
        own = du[:, self.body.nodes].transpose(3, 1, 0, 2)  # (i, e, m, a)
        return (sum(own[i] @ self.pressing[i] for i in range(3)) * self._bulk[:, None]).swapaxes(0, 1)

    def pressed(self, p: FloatArray) -> FloatArray:
        """B p, the nodal forces (m, n_nodes, 3) of pressures (m, n_elements, k); after `blocks`."""
        m = len(p)
        own = np.stack([p.transpose(1, 0, 2) @ self.pressing[i].swapaxes(1, 2) for i in range(3)])  # (i, e, m, a)
        flat = own.transpose(1, 3, 0, 2).reshape(-1, 3 * m)
        return np.ascontiguousarray((self.body._gather @ flat).reshape(-1, 3, m).transpose(2, 0, 1))
