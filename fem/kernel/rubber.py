"""Elements filled with rubber, on any mesh and pair of elements: forces, stiffness and energy of displacements.

Displacements are continuous; pressures make rubber that hardly changes its volume bend without locking. Find u and p
with

    ∫ P(H, p) : ∇v = external forces      for all v,        P = ∂W/∂F + p ∂θ/∂F of a `Law`,
    ∫ (θ − p/λ) q = 0                     for all q.

Pressures of hexahedra jump between elements, which find them from their own change of volume (Sussman & Bathe,
Computers & Structures 26 (1987) 357); those of tetrahedra are unknowns, continuous within a region (Taylor-Hood). What
is inside one hexahedron alone, from order 3 on, is eliminated at rest.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from functools import cached_property
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from skfem import Element, Mesh

from fem.kernel.elements import Basis
from fem.kernel.reference import PAIRS, point_stiffness, pulls, reference
from geometry.design import Material
from geometry.law import LAWS, Law, Strain, plus_unit
from geometry.layout import FloatArray

IntArray = NDArray[np.int64]
CHUNK_VALUES = 1_500_000  #: numbers in the stiffness matrices that are computed at a time: their products stay in cache
ALIKE = 11  #: digits in which elements agree that share one stiffness


class Condensed(NamedTuple):
    """Kinds of elements at rest whose insides are eliminated."""

    kind: IntArray  #: of every element, (n_elements,)
    stiffness: FloatArray  #: between the nodes on their surfaces, (n_kinds, n_surface, n_surface, 3, 3) [N/mm]
    inner: FloatArray  #: (n_kinds, n_inside·3, n_surface·3): displacements inside, from those of the surface


class Chunk(NamedTuple):
    """Elements whose stiffness is computed at a time."""

    elements: slice | IntArray  #: g of them
    nodes: IntArray  #: that it is of, (g, k)
    #: displacements of the elements' own nodes by those, (g, n, k), where some hang on larger elements
    hung: FloatArray | None = None


class Rubber:
    """Rubber by a law whose λ and μ have shape (n_elements, 1), or (n_elements, q) where they vary inside elements.

    Displacements have shape (m, n_nodes, 3) [mm]: m states of the body. Pressures [MPa] have shape (m, n_elements, k)
    where they jump, coefficients of the pair's functions in each element, or (n_pressures,) where they are continuous,
    of one state. `region` (n_elements,) parts continuous pressures: they jump where rubbers meet, as the true one does.
    """

    def __init__(self, basis: Basis, pressure: Element, law: Law, region: IntArray | None = None) -> None:
        self.basis, self.pressure, self.law, self.reference = basis, pressure, law, reference(basis.elem, pressure)
        self.nodes = basis.element_dofs.T.astype(np.int64)  #: (n_elements, n)
        self.n_nodes, self.n_elements = int(basis.N), basis.mesh.nelements
        self.region = np.zeros(self.n_elements, dtype=np.int64) if region is None else region
        self.pull, self._volume = pulls(basis)
        self._is_diagonal = not (self.pull * (1 - np.eye(3))).any()
        self.is_mixed = pressure.interior_dofs == 0
        self.constraint: sp.csr_matrix | None = None  #: of nodes that hang on larger elements
        if self.is_mixed:
            keys = basis.mesh.t.T.astype(np.int64) * (int(self.region.max()) + 1) + self.region[:, None]
            self.pressure_dofs = np.unique(keys, return_inverse=True)[1].reshape(keys.shape)  #: (n_elements, k)
            self.pressures_shape: tuple[int, ...] = (int(self.pressure_dofs.max()) + 1,)
        else:
            self.pressures_shape = (self.n_elements, self.reference.pressures.shape[1])

    @classmethod
    def of(
        cls, mesh: Mesh, pair: tuple[Element, Element], materials: Sequence[Material], region: IntArray | None = None
    ) -> "Rubber":
        """A mesh of which each element holds the material that `region` (n_elements,) numbers; all are of one model."""
        own = np.zeros(mesh.nelements, dtype=np.int64) if region is None else region
        shares = (own == np.arange(len(materials))[:, None])[..., None].astype(float)
        return cls(Basis(mesh, pair[0]), pair[1], LAWS[materials[0].model].of(materials, shares), own)

    @property
    def points_mm(self) -> FloatArray:
        """Positions of the nodes at rest, (n_nodes, 3)."""
        return self.basis.doflocs.T

    @property
    def centres_mm(self) -> FloatArray:
        """Middles of the elements at rest, (n_elements, 3)."""
        return self.basis.mesh.p[:, self.basis.mesh.t].mean(axis=1).T

    @cached_property
    def dx(self) -> FloatArray:
        """Volumes that the points of integration stand for, (n_elements, q) [mm³]."""
        return self._volume * self.reference.weights

    def with_hanging_nodes(self, constraint: sp.csr_matrix | None) -> "Rubber":
        """The same where nodes hang on larger elements: a row (n_nodes, n_nodes) is what each takes of the others."""
        found = copy(self)
        found.constraint = constraint
        return found

    @cached_property
    def chunks(self) -> list[Chunk]:
        """All elements, a few at a time."""
        nodes = self.nodes[:, self.reference.surface] if self.is_condensed else self.nodes
        step, plain = max(1, CHUNK_VALUES // (9 * nodes.shape[1] ** 2)), np.arange(self.n_elements)
        if self.constraint is None:
            ends = [*range(0, self.n_elements, step), self.n_elements]
            return [Chunk(slice(*pair), nodes[slice(*pair)]) for pair in pairwise(ends)]
        is_hung = (self.constraint.diagonal() != 1)[nodes].any(axis=1)
        groups: dict[int, list[tuple[int, IntArray, FloatArray]]] = {}
        for element in np.flatnonzero(is_hung).tolist():
            rows = self.constraint[nodes[element]]
            masters, column = np.unique(rows.indices, return_inverse=True)
            dense = np.zeros((nodes.shape[1], len(masters)))
            dense[np.repeat(np.arange(len(dense)), np.diff(rows.indptr)), column] = rows.data
            groups.setdefault(len(masters), []).append((element, masters, dense))
        found = [Chunk(own, nodes[own]) for own in _split(plain[~is_hung], step)]
        for group in groups.values():
            for some in (group[first : first + step] for first in range(0, len(group), step)):
                elements, masters, dense = (np.array(part) for part in zip(*some, strict=True))
                found.append(Chunk(elements, masters, dense))
        return found

    def part(self, elements: IntArray) -> "Rubber":
        """Some elements alone; nodes are numbered as before. Of pressures that jump."""
        part = copy(self)
        part.law, part.n_elements = self.law.part(elements), len(elements)
        part.nodes, part.pull, part._volume = self.nodes[elements], self.pull[elements], self._volume[elements]
        part.pressures_shape = (len(elements), *self.pressures_shape[1:])
        for name in ("dx", "_gather", "_inverse_mass", "condensed", "chunks", "rest"):
            part.__dict__.pop(name, None)
        return part

    # displacements to strain

    def gradient(self, u: FloatArray) -> FloatArray:
        """∂uᵢ/∂X_J at the points of integration, (3, 3, m, n_elements, q), of displacements (m, n_nodes, 3)."""
        states, (_, n, q) = len(u), self.reference.slopes.shape
        own = np.ascontiguousarray(u[:, self.nodes].transpose(3, 0, 1, 2)).reshape(-1, n)
        out = np.empty((3, 3, states, self.n_elements, q))
        for d in range(3):
            out[:, d] = (own @ self.reference.slopes[d]).reshape(3, states, self.n_elements, q)
        return self._in_space(out, 1)

    def strain(self, u: FloatArray) -> Strain:
        """Deformation at the points of integration of displacements (m, n_nodes, 3)."""
        return self.law.strain(self.gradient(u))

    def volume_ratios(self, u: FloatArray) -> FloatArray:
        """J at the points of integration of one state (n_nodes, 3), (n_elements, q)."""
        return self.strain(u[None]).J[0]

    def _in_space(self, values: FloatArray, axis: int) -> FloatArray:
        """Derivatives (..., n_elements, q) by local coordinates along an axis to those by X, perhaps in place."""
        return self._turned(values, axis, self.pull.swapaxes(-1, -2))

    def _turned(self, values: FloatArray, axis: int, matrix: FloatArray) -> FloatArray:
        """Σ_k matrix[..., i, k] values[k] along an axis, perhaps in place; matrix (n_elements, 1 or q, 3, 3)."""
        values = np.moveaxis(values, axis, 0)
        if self._is_diagonal:
            for d in range(3):
                values[d] *= matrix[..., d, d]
            return np.moveaxis(values, 0, axis)
        out = np.zeros_like(values)
        for i, k in product(range(3), range(3)):
            out[i] += matrix[..., i, k] * values[k]
        return np.moveaxis(out, 0, axis)

    # pressures

    @cached_property
    def _inverse_mass(self) -> FloatArray:
        """(∫ q qᵀ / λ)⁻¹ [MPa/mm³]: diagonal (n_elements, k), or (n_elements, k, k) where λ or the mapping varies."""
        shown, weights = self.reference.pressures, self.reference.weights
        if self._volume.shape[1] == 1 and self.law.lame_mpa.shape[1] == 1:
            return self.law.lame_mpa / (self._volume * (weights @ shown**2))
        mass = np.einsum("qk,eq,ql->ekl", shown, self.dx / self.law.lame_mpa, shown, optimize=True)
        return np.asarray(np.linalg.inv(mass), np.float64)

    def _asked(self, moments: FloatArray) -> FloatArray:
        """Pressures (m, n_elements, k) that moments ∫ θ q of the same shape ask for [MPa]."""
        if self._inverse_mass.ndim == 2:
            return moments * self._inverse_mass
        return np.einsum("ekl,mel->mek", self._inverse_mass, moments)

    def pressures(self, theta: FloatArray) -> FloatArray:
        """Pressures (m, n_elements, k) that changes of volume (m, n_elements, q) ask for [MPa]; of those that jump."""
        if self._volume.shape[1] == 1:  # one product of all elements with the table
            weighted = self.reference.weights[:, None] * self.reference.pressures
            return self._asked((theta @ weighted) * self._volume)
        return self._asked((theta * self.dx) @ self.reference.pressures)

    def pressure_at(self, p: FloatArray) -> FloatArray:
        """Pressures at the points of integration, (..., n_elements, q)."""
        return (p[self.pressure_dofs] if self.is_mixed else p) @ self.reference.pressures.T

    def missing_volume(self, strain: Strain, p: FloatArray) -> FloatArray:
        """∫ (θ − p/λ) q (n_pressures,) of one state [mm³]; of continuous pressures."""
        volume = ((strain.theta[0] - self.pressure_at(p) / self.law.lame_mpa) * self.dx) @ self.reference.pressures
        return np.bincount(self.pressure_dofs.ravel(), volume.ravel(), self.pressures_shape[0]).astype(np.float64)

    @cached_property
    def pressure_mass(self) -> sp.csr_matrix:
        """∫ p q / λ, (n_pressures, n_pressures); of continuous pressures."""
        shown, own = self.reference.pressures, self.pressure_dofs
        mass = np.einsum("qk,eq,ql->ekl", shown, self.dx / self.law.lame_mpa, shown, optimize=True)
        rows, cols = np.broadcast_arrays(own[:, :, None], own[:, None, :])
        return sp.csr_matrix((mass.ravel(), (rows.ravel(), cols.ravel())), shape=self.pressures_shape * 2)

    # stress to forces

    @cached_property
    def _gather(self) -> sp.csr_matrix:
        places = np.arange(self.nodes.size)
        return sp.csr_matrix((np.ones(len(places)), (self.nodes.ravel(), places)), shape=(self.n_nodes, len(places)))

    def stress(self, strain: Strain, p: FloatArray) -> FloatArray:
        """First Piola-Kirchhoff stress at the points of integration [MPa], (3, 3, m, n_elements, q)."""
        return self.law.stress(strain, self.pressure_at(p))

    def divergence(self, P: FloatArray) -> FloatArray:
        """Nodal forces ∫ P : ∇v, (m, n_nodes, 3) [N], of stresses (3, 3, m, n_elements, q); overwrites these."""
        states, (_, n, q) = P.shape[2], self.reference.slopes.shape
        P = self._turned(P, 1, self.pull)
        own = np.zeros((3 * states * self.n_elements, n))
        for d in range(3):
            weighted = P[:, d] * self._volume
            weighted *= self.reference.weights
            own += weighted.reshape(-1, q) @ self.reference.slopes[d].T
        nodal = self._gather @ own.reshape(3 * states, -1).T
        return np.ascontiguousarray(nodal.reshape(-1, 3, states).transpose(2, 0, 1))

    def forces(self, u: FloatArray, p: FloatArray | None = None) -> tuple[FloatArray, Strain, FloatArray]:
        """Nodal forces ∫ P : ∇v (m, n_nodes, 3) [N] that hold states u (m, n_nodes, 3), their strain and pressures.

        Without `p` the pressures are those that the volumes ask for. Where J is not above 0 forces mean nothing.
        """
        strain = self.strain(u)
        p = self.pressures(strain.theta) if p is None else p
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.divergence(self.stress(strain, p)), strain, p

    def energy_mj(self, u: FloatArray, p: FloatArray | None = None) -> float:
        """Stored energy ∫ W + p²/(2 λ) of one state (n_nodes, 3); NaN where it is turned inside out."""
        strain = self.strain(u[None])
        with np.errstate(divide="ignore", invalid="ignore"):
            stored = self.law.energy(strain)[0]
        if p is None:  # p θ / 2 in the mean over every element
            stored = stored + self.pressure_at(self.pressures(strain.theta)[0]) * strain.theta[0] / 2
        else:
            stored = stored + self.pressure_at(p) ** 2 / (2 * self.law.lame_mpa)
        return float((stored * self.dx).sum())

    # stiffness

    def tangent(self, u: FloatArray, p: FloatArray) -> "Tangent":
        """The body linearised at a state (n_nodes, 3) whose pressures are iterates of their own."""
        return Tangent(self, self.strain(u[None]), p)

    @cached_property
    def rest(self) -> "Tangent":
        """The body linearised at rest."""
        return self.tangent(np.zeros((self.n_nodes, 3)), np.zeros(self.pressures_shape))

    @property
    def is_condensed(self) -> bool:
        """True if what is inside elements is eliminated: at rest alone."""
        return self.law.is_linear and self.condensed is not None

    def rest_blocks(self) -> Iterator[FloatArray]:
        """Stiffness at rest of each of `chunks`, (g, k, k, 3, 3) [N/mm].

        Entry [e, a, b, i, j] couples aᵢ with b_j. Continuous pressures are not in it.
        """
        for some, _, hung in self.chunks:
            if self.condensed is not None and self.is_condensed:
                K = self.condensed.stiffness[self.condensed.kind[some]]
            else:
                K = self._rest_stiffness(some)
            yield K if hung is None else _by_masters(K, hung)

    @property
    def _is_uniform(self) -> bool:
        """True if every element is affine and of one rubber: its stiffness at rest is a sum of fixed matrices."""
        return self._volume.shape[1] == 1 and self.law.mu_mpa.shape[1] == 1

    def _rest_stiffness(self, some: IntArray | slice) -> FloatArray:
        """Stiffness at rest of some elements, (e, n, n, 3, 3) [N/mm], without continuous pressures."""
        table, pull, law = self.reference, self.pull[some], self.law
        if self._is_uniform:
            volume = self._volume[some, 0]
            lame = None if self.is_mixed else law.lame_mpa[some, 0] * volume
            return table.uniform_stiffness(pull[:, 0], law.mu_mpa[some, 0] * volume, lame)
        slopes, dx = table.in_space(pull), self.dx[some]
        if self.is_mixed:
            return point_stiffness(slopes, law.mu_mpa[some] * dx)
        pressing, bulk = (slopes * dx[:, None, None]) @ table.pressures, self._inverse_mass[some]
        pressed = pressing * bulk[:, None, None] if bulk.ndim == 2 else pressing @ bulk[:, None]
        return point_stiffness(slopes, law.mu_mpa[some] * dx, pressing, pressed)

    def integrated_slopes(self, shown: FloatArray) -> FloatArray:
        """∫ q ∂ᵢφ over elements, (e, 3, n, k), of functions q with values (q, k) at the points of integration."""
        table, pull = self.reference, self.pull
        if pull.shape[1] == 1:
            whole = (table.slopes * table.weights) @ shown
            return np.einsum("mnk,emi->eink", whole, pull[:, 0] * self._volume[..., None], optimize=True)
        return (table.in_space(pull) * self.dx[:, None, None]) @ shown

    @property
    def _alike(self) -> FloatArray:
        """Numbers in which elements of one stiffness agree, (n_elements, k), each of at most about 1."""
        parts = (self.pull.reshape(self.n_elements, -1), self.law.lame_mpa, self.law.mu_mpa)
        return np.column_stack([part / np.abs(part).max() for part in parts])

    @cached_property
    def condensed(self) -> Condensed | None:
        """Elements by kind, their insides eliminated; None where nothing is inside, or an element is of many rubbers.

        Elements of one kind are alike; sizes that only rounding tells apart are one.
        """
        surface, inside = self.reference.surface, self.reference.inside
        if not len(inside) or self.law.mu_mpa.shape[1] > 1:
            return None
        _, first, kind = np.unique(np.round(self._alike, ALIKE), axis=0, return_index=True, return_inverse=True)
        n, m = 3 * len(surface), 3 * len(inside)
        stiffness, inner = np.empty((len(first), n // 3, n // 3, 3, 3)), np.empty((len(first), m, n))
        at_once = max(1, CHUNK_VALUES // (9 * self.nodes.shape[1] ** 2))
        for start in range(0, len(first), at_once):
            some = slice(start, min(start + at_once, len(first)))
            K = self._rest_stiffness(first[some]).swapaxes(2, 3).reshape(-1, n + m, n + m)  # what is inside is last
            found = np.linalg.solve(K[:, n:, n:], K[:, n:, :n])
            outer = K[:, :n, :n] - K[:, :n, n:] @ found
            stiffness[some] = outer.reshape(-1, n // 3, 3, n // 3, 3).swapaxes(2, 3)
            inner[some] = -found
        return Condensed(kind.ravel(), stiffness, inner)

    def filled(self, u: FloatArray) -> FloatArray:
        """Displacements at rest (m, n_nodes, 3) with those inside elements, from those on their surfaces."""
        if self.condensed is None:
            return u
        u, inside, surface = u.copy(), self.reference.inside, self.reference.surface
        for kind, inner in enumerate(self.condensed.inner):
            own = self.nodes[self.condensed.kind == kind]
            given = u[:, own[:, surface]].reshape(len(u), len(own), -1)
            u[:, own[:, inside]] = (given @ inner.T).reshape(len(u), len(own), -1, 3)
        return u

    def on_surfaces(self, forces: FloatArray) -> FloatArray:
        """Nodal forces (m, n_nodes, 3) at rest with those inside elements moved to their surfaces."""
        inside, surface = self.reference.inside, self.reference.surface
        if self.condensed is None or not forces[:, self.nodes[:, inside]].any():
            return forces
        forces = forces.copy()
        for own, kind in zip(self.nodes, self.condensed.kind, strict=True):
            inner = forces[:, own[inside]].reshape(len(forces), -1)
            forces[:, own[surface]] += (inner @ self.condensed.inner[kind]).reshape(len(forces), -1, 3)
            forces[:, own[inside]] = 0.0
        return forces


class Tangent:
    """Stiffness of every element at a state; pressures that jump are eliminated.

    With c = ∂θ/∂F ∇φ and A = ∂²W/∂F² + p ∂²θ/∂F²,

        K[ai, bj] = ∫ ∂_Jφₐ A[i, J, j, L] ∂_Lφ_b  +  Bₐᵢ (∫ q qᵀ/λ)⁻¹ B_bj,   B = ∫ q c.

    The strain is of one state, with the first axis of states.
    """

    def __init__(self, rubber: Rubber, strain: Strain, p: FloatArray) -> None:
        self.rubber = rubber
        self._strain = Strain(H=strain.H[:, :, 0], C=strain.C[:, :, 0], theta=strain.theta[0])
        self._pressure = rubber.pressure_at(p)
        #: B, the forces that pressures exert, (n_elements, 3 n, k) [mm²]
        self.pressing = np.empty((rubber.n_elements, 3 * rubber.nodes.shape[1], rubber.reference.pressures.shape[1]))

    def blocks(self) -> Iterator[FloatArray]:
        """K of each of the body's chunks, (e, n, n, 3, 3): entry [e, a, b, i, j] couples aᵢ with b_j [N/mm].

        `pressing` of a chunk is known as it comes.
        """
        rubber, table = self.rubber, self.rubber.reference
        n, k = rubber.nodes.shape[1], table.pressures.shape[1]
        for some, nodes, _ in rubber.chunks:
            e, pull, volume = len(nodes), rubber.pull[some], rubber._volume[some]
            strain = Strain(H=self._strain.H[:, :, some], C=self._strain.C[:, :, some], theta=self._strain.theta[some])
            A = rubber.law.part(some).tangent(strain, self._pressure[some])
            A = rubber._turned(rubber._turned(A, 1, pull), 3, pull)
            A *= volume
            cof = rubber._turned(plus_unit(strain.C.copy(), 1.0), 1, pull)
            cof *= volume
            B = np.stack([cof[i].swapaxes(0, 1).reshape(e, -1) @ table.pressing for i in range(3)], axis=1)
            self.pressing[some] = B.reshape(e, 3, n, k).swapaxes(1, 2).reshape(e, 3 * n, k)
            K = np.empty((e, n, n, 3, 3))
            for i, j in PAIRS:
                K[..., i, j] = (np.moveaxis(A[i, :, j], 2, 0).reshape(e, -1) @ table.products).reshape(e, n, n)
                if i != j:
                    K[..., j, i] = K[..., i, j].swapaxes(1, 2)
            if not rubber.is_mixed:
                own = self.pressing[some]
                both = (self._times_bulk(own, some) @ own.swapaxes(1, 2)).reshape(e, n, 3, n, 3)
                K += both.swapaxes(2, 3)
            yield K

    def _times_bulk(self, B: FloatArray, some: slice | IntArray = slice(None)) -> FloatArray:
        """B (e, r, k) times (∫ q qᵀ/λ)⁻¹."""
        bulk = self.rubber._inverse_mass[some]
        return B * bulk[:, None] if bulk.ndim == 2 else B @ bulk

    def pressure_changes(self, du: FloatArray) -> FloatArray:
        """Changes (m, n_elements, k) of jumping pressures with displacements (m, n_nodes, 3); after `blocks`."""
        own = du[:, self.rubber.nodes].reshape(len(du), *self.pressing.shape[:2]).swapaxes(0, 1)  # (e, m, 3 n)
        return self._times_bulk(own @ self.pressing).swapaxes(0, 1)

    def pressed(self, p: FloatArray) -> FloatArray:
        """B p, the nodal forces (m, n_nodes, 3) of jumping pressures (m, n_elements, k); after `blocks`."""
        m, n = len(p), self.rubber.nodes.shape[1]
        own = self.pressing @ p.transpose(1, 2, 0)  # (e, 3 n, m)
        nodal = self.rubber._gather @ own.reshape(-1, n, 3, m).reshape(-1, 3 * m)
        return np.ascontiguousarray(nodal.reshape(-1, 3, m).transpose(2, 0, 1))


def _by_masters(K: FloatArray, hung: FloatArray) -> FloatArray:
    """Wᵀ K W of elements K (g, n, n, 3, 3) whose nodes move as W (g, n, k) says."""
    (g, n, k), W = hung.shape, hung.swapaxes(1, 2)
    rows = (W @ K.reshape(g, n, -1)).reshape(g, k, n, 9)
    return (W[:, None] @ rows).reshape(g, k, k, 3, 3)


def _split(elements: IntArray, step: int) -> list[IntArray]:
    return [elements[first : first + step] for first in range(0, len(elements), step)]
