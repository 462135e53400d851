"""Straight-sided tetrahedra, and rubber that fills them: displacement P2, pressure P1 (Taylor-Hood), at any strain.

Find u, vanishing on the base, and p with

    ∫ P(H, p) : ∇v = external forces      for all v,        P = ∂W/∂F + p ∂θ/∂F of a `Law`,
    ∫ (θ − p/λ) q = 0                     for all q,

so that p → λ θ. Displacement-only elements of low order lock as λ/μ grows (49 at ν = 0.49); this pair does not, for any
ν up to the incompressible limit. The tangent is symmetric, and quasi-definite where the body is stable: factoring it
needs no pivoting. Meshes, shape functions and points of integration are scikit-fem's.

Pressures are continuous within a region and jump between regions, as the true one does: a continuous one would spoil
the order of convergence.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skfem import Basis, Element, ElementTetP1, ElementTetP2, MeshTet

from fem.kernel.law import LAWS, Law, Strain
from geometry.design import Material
from geometry.layout import FloatArray

IntArray = NDArray[np.int64]
MIN_POISSON = 1e-6  #: to which ν is raised: 1/λ grows without bound as ν → 0; changes no stress by more than that share
AT_ONCE = 8_000  #: elements whose matrices are made at a time: some 60 MB
PAIRS = tuple((i, j) for i in range(3) for j in range(i, 3))
NEAREST = 16  #: elements by distance of their centres, tried before all of them are
ON_ELEMENT = 1e-9  #: by which rounding may put a point outside, as a share of the element


@dataclass(frozen=True, eq=False)
class Elements:
    """m tetrahedra of k nodes; corners come first, in scikit-fem's order."""

    element: Element  #: scikit-fem's, of one displacement component
    points_mm: FloatArray  #: (n, 3), positions of the nodes
    nodes: NDArray[np.int64]  #: (m, k), numbers of the nodes
    region: NDArray[np.int64]  #: (m,)
    cell_type = 24  #: VTK's number of quadratic tetrahedra

    @classmethod
    def of_basis(cls, basis: Basis, region: NDArray[np.int64]) -> "Elements":
        """The elements of a scikit-fem basis; `region` (m,)."""
        return cls(basis.elem, basis.doflocs.T.copy(), basis.element_dofs.T.astype(np.int64), region)

    @property
    def corners(self) -> NDArray[np.int64]:
        """Numbers of the corner nodes, shape (m, 4)."""
        return self.nodes[:, :4]

    @cached_property
    def inverse_jacobian(self) -> FloatArray:
        """∂ξ/∂x of every element, shape (m, 3, 3): [k, i]; constant because sides are straight."""
        corners = self.points_mm[self.corners]
        return np.asarray(np.linalg.inv((corners[:, 1:] - corners[:, :1]).swapaxes(1, 2)), np.float64)

    @cached_property
    def volumes_mm3(self) -> FloatArray:
        """Shape (m,)."""
        return 1 / np.abs(np.linalg.det(self.inverse_jacobian)) / 6

    def located(self, points_mm: FloatArray, region: int | None = None) -> tuple[NDArray[np.int64], FloatArray]:
        """The element that holds each of the points (k, 3), shape (k,), and where in it, shape (k, 3) in 0..1.

        A point in none, or in none of `region` if that is given, goes to the element that it misses by least, and may
        be outside of it.
        """
        among = np.arange(len(self.nodes)) if region is None else np.flatnonzero(self.region == region)
        centres = self.points_mm[self.corners[among]].mean(axis=1)
        _, near = cKDTree(centres).query(points_mm, k=min(NEAREST, len(among)))
        found, local, inside = self._best(points_mm, among[near.reshape(len(points_mm), -1)])
        lost = np.flatnonzero(inside < -ON_ELEMENT)
        for some in np.array_split(lost, 1 + len(lost) * len(among) // 2_000_000):  # bounds the memory
            everywhere = np.broadcast_to(among, (len(some), len(among)))
            found[some], local[some], _ = self._best(points_mm[some], everywhere)
        return found, local

    def _best(
        self, points_mm: FloatArray, candidates: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
        """The candidate (k, c) that each point is deepest in, its place there, and its depth (< 0: outside)."""
        origin = self.points_mm[self.nodes[candidates, 0]]
        local = np.einsum("pcki,pci->pck", self.inverse_jacobian[candidates], points_mm[:, None] - origin)
        inside = np.minimum(local.min(axis=2), 1 - local.sum(axis=2))
        best = inside.argmax(axis=1)
        each = np.arange(len(points_mm))
        return candidates[each, best], local[each, best], inside[each, best]

    def at(self, points_mm: FloatArray, region: int | None = None) -> sp.csr_matrix:
        """Rows that take nodal values to those at points (k, 3), found as by `located`, shape (k, n)."""
        found, local = self.located(points_mm, region)
        return self._rows(found, shape_values(self.element, local.T))

    def slopes(self, points_mm: FloatArray) -> sp.csr_matrix:
        """Rows that take nodal values to derivatives at points (k, 3): all by x, then by y, then by z, (3 k, n)."""
        found, local = self.located(points_mm)
        slopes = shape_gradients(self.element, local.T) @ self.inverse_jacobian[found]
        return sp.vstack([self._rows(found, slopes[..., axis]) for axis in range(3)], format="csr")

    @property
    def cells(self) -> NDArray[np.int64]:
        """Nodes as VTK orders them, which is scikit-fem's order, (m, k)."""
        return self.nodes

    @property
    def cell_places(self) -> FloatArray:
        """Where they lie in an element, (k, 3) in 0..1."""
        return np.asarray(self.element.doflocs, np.float64)

    def linear(self, local: FloatArray) -> FloatArray:
        """Linear functions of the corners at places (k, 3) in 0..1, shape (k, 4)."""
        return np.column_stack([1 - local.sum(axis=1), local])

    @cached_property
    def _corner_slopes(self) -> FloatArray:
        """Derivatives of an element's functions at its corners, (m, 4, k, 3) [1/mm]."""
        return shape_gradients(self.element, self.element.doflocs[:4].T) @ self.inverse_jacobian[:, None]

    def corner_slopes(self) -> list[sp.csr_matrix]:
        """Derivatives along x, y and z at elements' corners, from nodal values, (4 m, n)."""
        m = len(self.nodes)
        slopes = self._corner_slopes.reshape(4 * m, -1, 3)
        return [self._rows(np.repeat(np.arange(m), 4), slopes[..., axis]) for axis in range(3)]

    def corner_gradients(self, u: FloatArray) -> FloatArray:
        """∂ⱼuᵢ at elements' corners, [e, v, i, j], of displacements (n, 3): shape (m, 4, 3, 3)."""
        return u[self.nodes].swapaxes(1, 2)[:, None] @ self._corner_slopes

    def _rows(self, found: NDArray[np.int64], values: FloatArray) -> sp.csr_matrix:
        rows = np.repeat(np.arange(len(found)), values.shape[1])
        shape = (len(found), len(self.points_mm))
        return sp.csr_matrix((values.ravel(), (rows, self.nodes[found].ravel())), shape=shape)


def shape_values(element: Element, local: FloatArray) -> FloatArray:
    """Shape functions at local points (3, n), shape (n, k)."""
    values = [np.broadcast_to(element.lbasis(local, a)[0], local.shape[1]) for a in range(len(element.doflocs))]
    return np.stack(values, axis=-1)


def shape_gradients(element: Element, local: FloatArray) -> FloatArray:
    """Their gradients by local coordinates, shape (n, k, 3)."""
    slopes = [
        np.broadcast_to(np.asarray(element.lbasis(local, a)[1]).reshape(3, -1), local.shape)
        for a in range(len(element.doflocs))
    ]
    return np.stack(slopes).transpose(2, 0, 1)


@dataclass(frozen=True, eq=False)
class TaylorHood:
    """A meshed body of rubber, its base z = 0 clamped.

    Displacement degrees of freedom interleave: component i of node n is 3 n + i. Unknowns are the free ones, then the
    pressures. States are displacements (n_nodes, 3) [mm] and pressures (n_pressure,) [MPa].
    """

    basis: Basis  #: scikit-fem's, of one component of the displacement
    region: IntArray  #: the rubber of each element, (m,)
    law: Law  #: its λ and μ of shape (m, 1)

    @property
    def mesh(self) -> MeshTet:
        return self.basis.mesh

    @cached_property
    def elements(self) -> Elements:
        """The same elements, to find points and their functions in."""
        return Elements.of_basis(self.basis, self.region)

    @cached_property
    def corners(self) -> IntArray:
        """Number of the pressure at each corner of each element, (4, m)."""
        return pressure_dofs(self.mesh, self.region)

    @property
    def points_mm(self) -> FloatArray:
        """Positions of the nodes at rest, (n_nodes, 3)."""
        return self.basis.doflocs.T

    @property
    def centres_mm(self) -> FloatArray:
        """Middles of the elements at rest, (m, 3)."""
        return self.mesh.p.T[self.mesh.t.T].mean(axis=1)

    @property
    def n_nodes(self) -> int:
        return int(self.basis.N)

    @cached_property
    def n_pressure(self) -> int:
        return int(self.corners.max()) + 1

    @cached_property
    def _free_nodes(self) -> IntArray:
        return np.flatnonzero(self.basis.doflocs[2] != 0.0)

    @cached_property
    def free(self) -> IntArray:
        """Displacement degrees of freedom off the base."""
        return (3 * self._free_nodes[:, None] + np.arange(3)).ravel()

    @property
    def n_unknowns(self) -> int:
        return len(self.free) + self.n_pressure

    # elements

    @cached_property
    def slopes(self) -> FloatArray:
        """∂φ/∂X at the points of integration, (m, q, 10, 3) [1/mm]."""
        return np.stack([functions[0].grad for functions in self.basis.basis]).transpose(2, 3, 0, 1)

    @cached_property
    def _of_pressure(self) -> FloatArray:
        """P1 functions at the points of integration, (q, 4)."""
        X = self.basis.quadrature[0]
        return np.stack([ElementTetP1().lbasis(X, corner)[0] for corner in range(4)], axis=1)

    def strain(self, u: FloatArray) -> Strain:
        """Deformation at the points of integration, (…, m, q)."""
        own = u[self.basis.element_dofs.T].swapaxes(1, 2)[:, None]  # (m, 1, 3, 10)
        return self.law.strain(np.ascontiguousarray((own @ self.slopes).transpose(2, 3, 0, 1)))

    def _pressing(self, p: FloatArray) -> FloatArray:
        return p[self.corners.T] @ self._of_pressure.T  # (m, q)

    def internal_forces(self, u: FloatArray, p: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """∫ P : ∇v (n_nodes, 3) [N], ∫ (θ − p/λ) q (n_pressure,) [mm³], and the least J; at or below 0: meaningless."""
        strain, dx, pressing = self.strain(u), self.basis.dx, self._pressing(p)
        with np.errstate(divide="ignore", invalid="ignore"):
            P = (self.law.stress(strain, pressing) * dx).transpose(2, 3, 1, 0)
        own = (self.slopes @ P).sum(axis=1)  # (m, 10, 3)
        nodes = self.basis.element_dofs.T.ravel()
        forces = np.stack([np.bincount(nodes, own[..., i].ravel(), self.n_nodes) for i in range(3)], axis=1)
        volume = ((strain.theta - pressing / self.law.lame_mpa) * dx) @ self._of_pressure
        missing = np.bincount(self.corners.T.ravel(), volume.ravel(), self.n_pressure)
        return np.asarray(forces, np.float64), np.asarray(missing, np.float64), float(strain.J.min())

    def energy_mj(self, u: FloatArray, p: FloatArray) -> float:
        """Stored energy, ∫ W + p²/(2 λ)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            stored = self.law.energy(self.strain(u)) + self._pressing(p) ** 2 / (2 * self.law.lame_mpa)
        return float((stored * self.basis.dx).sum())

    @property
    def chunks(self) -> list[slice]:
        """Elements whose matrices are made at a time."""
        return [slice(first, first + AT_ONCE) for first in range(0, len(self.region), AT_ONCE)]

    def blocks(self, u: FloatArray, p: FloatArray) -> Iterator[tuple[slice, FloatArray, FloatArray]]:
        """Chunks of elements, their ∫ ∂φₐ A ∂φ_b (e, 10, 10, 3, 3) [a, b, i, j], and ∫ ψ cof ∂φ_b (e, 4, 10, 3)."""
        strain, pressing = self.strain(u), self._pressing(p)
        for some in self.chunks:
            part = Strain(H=strain.H[:, :, some], C=strain.C[:, :, some], theta=strain.theta[some])
            G, dx = self.slopes[some], self.basis.dx[some]
            A = self.law.part(some).tangent(part, pressing[some]) * dx
            e, q, n, _ = G.shape
            right = np.ascontiguousarray(G.transpose(0, 1, 3, 2)).reshape(e, 3 * q, n)
            K = np.empty((e, n, n, 3, 3))
            for i, j in PAIRS:
                left = G @ A[i, :, j].transpose(2, 3, 0, 1)  # (e, q, a, L)
                K[..., i, j] = left.transpose(0, 2, 1, 3).reshape(e, n, 3 * q) @ right
                if i != j:
                    K[..., j, i] = K[..., i, j].swapaxes(1, 2)
            pull = (G @ (part.cof * dx).transpose(2, 3, 1, 0)).reshape(e, q, 3 * n)
            yield some, K, (self._of_pressure.T @ pull).reshape(e, 4, n, 3)

    def compliance(self) -> sp.csr_matrix:
        """∫ p q / λ, both triangles, (n_pressure, n_pressure)."""
        mass = np.einsum("qa,qb,q->ab", self._of_pressure, self._of_pressure, self.basis.quadrature[1] * 6)
        bulk = self.basis.dx.sum(axis=1) / self.law.lame_mpa[:, 0]
        rows, cols = np.broadcast_arrays(self.corners.T[:, :, None], self.corners.T[:, None, :])
        entries = (bulk[:, None, None] * mass).ravel(), (rows.ravel(), cols.ravel())
        return sp.csr_matrix(entries, shape=(self.n_pressure, self.n_pressure))


def taylor_hood(mesh: MeshTet, materials: Sequence[Material], region: IntArray) -> TaylorHood:
    """A mesh of which each element (m,) holds the material that its region numbers; all are of one model."""
    raised = [replace(rubber, poisson=max(rubber.poisson, MIN_POISSON)) for rubber in materials]
    shares = (region == np.arange(len(materials))[:, None])[..., None].astype(float)
    law = LAWS[materials[0].model].of(raised, shares)
    return TaylorHood(Basis(mesh, ElementTetP2(), intorder=2), region, law)


def pressure_dofs(mesh: MeshTet, region: IntArray) -> IntArray:
    """Number of the pressure at each corner of each element, (4, m): elements of one region share it at a point."""
    keys = mesh.t.astype(np.int64) * (int(region.max()) + 1) + region
    _, numbers = np.unique(keys, return_inverse=True)
    return numbers.reshape(keys.shape)


def lame_of_regions(
    material: Sequence[Material], region: IntArray, min_poisson: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Lamé's λ and μ of each element, shapes (n_elements,) [MPa]."""
    table = np.array([Material(young_mpa=m.young_mpa, poisson=max(m.poisson, min_poisson)).lame_mpa for m in material])
    return table[region, 0], table[region, 1]
