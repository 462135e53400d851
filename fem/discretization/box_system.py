"""Elasticity on boxes of one order: each condensed to its surface, all assembled into one sparse matrix.

The volume change of every box is projected to polynomials of two degrees less, as mixed elements do: they stay stable
for flat and slender boxes beside large ones, whatever ν (Schötzau, Schwab and Stenberg, "Mixed hp-FEM on anisotropic
meshes II", Numer. Math. 83 (1999)). Projected to one degree less, at ν = 0.4999 and beside boxes 10⁵ times as long as
wide, pressures and the indicators by them grew with each splitting.
"""

from collections.abc import Sequence
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre
from numpy.typing import NDArray

from fem.discretization.box_mesh import BoxMesh, IntArray
from fem.discretization.lagrange import (
    cube_functions,
    cube_products,
    element_terms,
    gauss_points,
    interval_integral,
    lobatto_points,
    shape_functions,
    term_scales,
)
from fem.discretization.mirrors import (
    Mirror,
    folded_integrals,
    folded_point,
    held_components,
    parities,
)
from fem.discretization.plate import Plate, folded_plates
from fem.scene.loads import Rectangle
from fem.scene.scene import Probe, Region, Scene, regions_at
from geometry.design import Material
from geometry.layout import FloatArray

CHUNK = 48  #: boxes condensed at once: some 60 MB
DIVERGENCE_WEIGHT = 0.25  #: of pressures beside shear strains in the indicator of the error


@cache
def node_places(order: int) -> tuple[IntArray, IntArray]:
    """Numbers of an element's nodes on its surface and inside it, in lexicographic order."""
    inside = (np.indices((order + 1,) * 3).reshape(3, -1) % order != 0).all(axis=0)
    return np.flatnonzero(~inside), np.flatnonzero(inside)


@cache
def divergence_modes(order: int) -> FloatArray:
    """Legendre coefficients of ∂φ/∂k up to degree order − 2 along each axis, orthonormal; shape (3, n_modes, n)."""
    x, weights = gauss_points(order + 1)
    normal = legendre.legvander(x, order - 2) * np.sqrt(np.arange(order - 1) + 0.5)
    one = [np.einsum("q,qm,qa->ma", weights, normal, values) for values in shape_functions(order, x)]
    modes = [[one[int(k == d)] for d in range(3)] for k in range(3)]
    return np.stack([np.einsum("ad,be,cf->abcdef", *each).reshape((order - 1) ** 3, -1) for each in modes])


@lru_cache(maxsize=16)
def box_terms(order: int, material: Material, lean: tuple[float, float]) -> tuple[list[tuple[int, int]], FloatArray]:
    """`lagrange.element_terms` of boxes, shape (n_terms, 3n, 3n): nodes on the surface first, then components."""
    modes = divergence_modes(order)
    projected = np.einsum("kma,lmb->klab", modes, modes)
    pairs, terms = element_terms(material, lean, projected, cube_products(order, order + 1))
    by_place = np.concatenate(node_places(order))
    return pairs, terms[:, by_place][:, :, :, by_place].reshape(len(pairs), 3 * len(by_place), -1)


class Condensed(NamedTuple):
    """An element whose inside is eliminated."""

    stiffness: FloatArray  #: on its surface, (n_surface·3, the same)
    inner: NDArray[np.float32]  #: (n_inner·3, n_surface·3): displacements inside, from those of the surface


Kind = tuple[float, ...]  #: size of a box relative to the body's height, and its region


class BoxSystem:
    """The equations of a scene on a mesh of boxes, for displacements of one parity in each of the mirrors.

    Unknowns are displacements of the independent nodes above the base: node, then component. Elements of an
    earlier mesh are taken from `condensed`, by size and region, and new ones kept there.
    """

    def __init__(
        self,
        scene: Scene,
        regions: Sequence[Region],
        mirrors: tuple[Mirror, ...],
        mesh: BoxMesh,
        condensed: dict[Kind, Condensed],
        order: int,
    ) -> None:
        self.scene, self.mirrors, self.mesh, self.lean = scene, mirrors, mesh, scene.outline.lean
        (self.parity,) = parities(mirrors)
        self.order = order
        self._surface, self._inside = node_places(order)
        self.materials = [scene.material, *(material for _, material in regions)]
        self.low, self.high = mesh.corners
        self.size = self.high - self.low
        self.region = regions_at((self.low + self.high) / 2, regions)
        #: boxes of one size and rubber are alike; sizes that only rounding tells apart are one
        self._kinds = [
            (*size, region)
            for size, region in zip((self.size / scene.height_mm).round(12).tolist(), self.region.tolist(), strict=True)
        ]
        self._terms = [box_terms(order, material, self.lean) for material in self.materials]

        nodes = mesh.nodes(order)
        self._nodes = nodes
        free = nodes.independent & (nodes.vertex[:, 2] != mesh.axes[2].first)
        self._number = np.where(free, np.cumsum(free) - 1, -1)
        self._free = np.flatnonzero(free)
        self.n_nodes = len(self._free)
        first = nodes.vertex[free][:, :2] == [axis.first for axis in mesh.axes[:2]]
        #: components that vanish on a mirror plane, shape (n_nodes, 3)
        self.held = np.zeros((self.n_nodes, 3), dtype=bool)
        for mirror in mirrors:
            self.held |= first[:, mirror.axis, None] & held_components(mirror.axis, self.parity)
        self._weights = [self._element_weights(number) for number in range(len(mesh.boxes))]
        self._condense(condensed)
        self._condensed = [condensed[kind] for kind in self._kinds]
        self.matrix = self._assembled()

    @property
    def n_unknowns(self) -> int:
        return 3 * self.n_nodes

    @property
    def share(self) -> float:
        """The solved part's share of the whole body."""
        return 0.5 ** len(self.mirrors)

    def _element_weights(self, number: int) -> tuple[FloatArray | None, IntArray, NDArray[np.bool_] | None]:
        """Independent nodes behind the surface nodes of an element: weights (n_surface, k) of nodes (k,).

        Where all are independent, the weights are None and the third value says which of them are not on the base.
        """
        own = self._nodes.of_elements[number]
        if self._nodes.independent[own].all():
            numbers = self._number[own]
            return None, numbers[numbers >= 0], numbers >= 0
        rows = self._nodes.constraint[own]
        columns = np.unique(rows.indices)
        columns = columns[self._number[columns] >= 0]
        return rows[:, columns].toarray(), self._number[columns], None

    def _stiffness(self, elements: IntArray) -> FloatArray:
        """Stiffness of whole elements, shape (n, 3·(order + 1)³, the same), their surfaces first."""
        n = 3 * (self.order + 1) ** 3
        K = np.empty((len(elements), n, n))
        for region, (pairs, terms) in enumerate(self._terms):
            mine = self.region[elements] == region
            K[mine] = np.tensordot(term_scales(pairs, self.size[elements[mine]]), terms, 1)
        return K

    def _condense(self, known: dict[Kind, Condensed]) -> None:
        """Bring what is known up to the mesh: its new kinds of boxes with their insides eliminated, and no others."""
        for kind in known.keys() - set(self._kinds):
            del known[kind]
        first = {kind: element for element, kind in enumerate(self._kinds) if kind not in known}
        new = np.array(list(first.values()), dtype=np.int64)
        m = 3 * len(self._surface)
        for start in range(0, len(new), CHUNK):
            elements = new[start : start + CHUNK]
            K = self._stiffness(elements)
            recovered = np.linalg.solve(K[:, m:, m:], K[:, m:, :m])
            for element, own, inner in zip(elements, K, recovered, strict=True):
                stiffness = own[:m, :m] - own[m:, :m].T @ inner
                # seven digits of what only indicators, pictures and points inside need
                known[self._kinds[element]] = Condensed(stiffness, -inner.astype(np.float32))

    def _assembled(self) -> sp.bsr_matrix:
        """The stiffness matrix in blocks of 3 × 3; held components are 1 on the diagonal and 0 beside it."""
        keys = []
        for _, numbers, _ in self._weights:
            i, j = _upper_pairs(numbers)
            keys.append(numbers[i] * self.n_nodes + numbers[j])
        ends = np.cumsum([len(key) for key in keys])
        places, inverse = np.unique(np.concatenate(keys), return_inverse=True)
        del keys
        data = np.zeros((len(places), 3, 3))
        for condensed, (weights, numbers, kept), end in zip(self._condensed, self._weights, ends, strict=True):
            K = condensed.stiffness.reshape(len(self._surface), 3, -1, 3)
            if weights is None:
                K = K[kept][:, :, kept]
            else:
                K = np.tensordot(np.tensordot(weights, K, (0, 0)), weights, (2, 0)).transpose(0, 1, 3, 2)
            i, j = _upper_pairs(numbers)
            data[inverse[end - len(i) : end]] += K[i, :, j, :]
        rows, columns = places // self.n_nodes, places % self.n_nodes
        data *= ~self.held[rows][:, :, None] & ~self.held[columns][:, None, :]
        diagonal = rows == columns
        data[diagonal] += self.held[:, :, None] * np.eye(3)
        indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=self.n_nodes))])
        shape = (self.n_unknowns,) * 2
        upper = sp.bsr_matrix((data, columns, indptr), shape=shape)
        beyond = sp.bsr_matrix((data * ~diagonal[:, None, None], columns, indptr), shape=shape)
        return (upper + beyond.T).tobsr((3, 3))

    def loads(self) -> FloatArray:
        """Nodal forces of the scene's loads on what is solved, shape (n_unknowns,)."""
        forces = np.zeros((self.n_nodes, 3))
        for load in self.scene.dead_loads:
            forces += self.share * self._integrals(load.rectangle) * np.array(load.traction_mpa)
        return np.where(self.held, 0.0, forces).ravel()

    def plates(self) -> list[tuple[IntArray, FloatArray]]:
        """Unknowns bonded to each plate of the scene and its motions there, as `plate.tied` wants them."""
        at = (lobatto_points(self.order) + 1) / 2
        lattice = np.stack(np.unravel_index(self._surface, (self.order + 1,) * 3), axis=1)
        points = np.empty((len(self._number), 3))
        points[self._nodes.of_elements] = self.low[:, None] + at[lattice] * self.size[:, None]
        places = points[self._free].T
        lines = [np.unique(axis) for axis in places]
        shift = np.tile(self.scene.height_mm * np.array(self.lean), 2)
        free, found = np.flatnonzero(~self.held), []
        rectangles = self.scene.plate_rectangles_mm - shift
        for plate, parity in folded_plates(rectangles, self.scene.height_mm, self.mirrors, self.parity):
            corners = plate.rectangle_mm.copy()
            for side in range(4):  # edges a hair from a face are on its line: see `box_refinement.first_mesh`
                line = lines[side % 2]
                nearest = line[np.abs(line - corners[side]).argmin()]
                if line[0] <= corners[side] <= line[-1]:
                    corners[side] = nearest
            found.append(Plate(corners, self.scene.height_mm).followers(free, places, parity))
        return found

    def probe_rows(self) -> FloatArray:
        """Rows that take unknowns to the probes' displacements, shape (n_probes, 3, n_unknowns)."""
        rows = np.zeros((len(self.scene.probes), 3, self.n_nodes, 3))
        for row, probe in zip(rows, self.scene.probes, strict=True):
            if probe.kind == "mean":
                x0, y0, x1, y1 = probe.rectangle
                weights = self._integrals(probe.rectangle) / ((x1 - x0) * (y1 - y0))
                for a in range(3):
                    row[a, :, a] = weights[:, a]
            else:
                self._add_point(row, probe)
        return np.where(self.held, 0.0, rows).reshape(len(rows), 3, -1)

    def _integrals(self, rectangle: Rectangle) -> FloatArray:
        """∫ of the top's functions over a rectangle anywhere on the body, for each component, shape (n_nodes, 3)."""
        return folded_integrals(self._integral, np.array(rectangle), self.mirrors, self.parity)

    def _integral(self, rectangle: FloatArray) -> FloatArray:
        shift = self.scene.height_mm * np.array(self.lean)
        low, high = self.low[:, :2], self.high[:, :2]
        start, end = np.maximum(low, rectangle[:2] - shift), np.minimum(high, rectangle[2:] - shift)
        at_top = self.high[:, 2] == self.mesh.axes[2].high[self.mesh.axes[2].last]
        top = np.arange((self.order + 1) ** 3).reshape((self.order + 1,) * 3)[:, :, -1].ravel()
        columns = np.searchsorted(self._surface, top)
        total = np.zeros(len(self._number))
        for e in np.flatnonzero(at_top & (end > start).all(axis=1)):
            along = [interval_integral(self.order, low[e, d], high[e, d], start[e, d], end[e, d]) for d in range(2)]
            total[self._nodes.of_elements[e, columns]] += np.multiply.outer(*along).ravel()
        return (self._nodes.constraint.T @ total)[self._free]

    def _add_point(self, row: FloatArray, probe: Probe) -> None:
        """Add the functions at a point, anywhere on the body, to a probe's rows, shape (3, n_nodes, 3)."""
        point = np.array(probe.position_mm)
        point[:2] -= np.array(self.lean) * point[2]
        point, signs = folded_point(point, self.mirrors, self.parity)
        element = int(np.argmin(np.maximum(self.low - point, point - self.high).max(axis=1)))
        values = self._functions(element, point[None])[0]
        recovered = self._condensed[element].inner.reshape(len(self._inside), 3, len(self._surface), 3)
        weights, numbers, kept = self._weights[element]
        for a in range(3):
            functions = np.einsum("i,inb->nb", values[self._inside], recovered[:, a])
            functions[:, a] += values[self._surface]
            functions = functions[kept] if weights is None else weights.T @ functions
            row[a, numbers] += signs[a] * functions

    def _functions(self, element: int, points_mm: FloatArray) -> FloatArray:
        """An element's functions at points (k, 3) in it, shape (k, (order + 1)³)."""
        return cube_functions(self.order, 2 * (points_mm - self.low[element]) / self.size[element] - 1)

    def at(self, element: int, points_mm: FloatArray, u: FloatArray) -> FloatArray:
        """Displacements of a solution u (n_unknowns,) at points (k, 3) of an element, shape (k, 3)."""
        return self._functions(element, points_mm) @ self.element_values(element, u[:, None])[:, :, 0]

    def element_values(self, element: int, u: FloatArray) -> FloatArray:
        """Displacements at all nodes of an element, shape ((self.order + 1)³, 3, k), of solutions u (n_unknowns, k)."""
        weights, numbers, kept = self._weights[element]
        free = u.reshape(self.n_nodes, 3, -1)[numbers]
        if weights is None:
            on_surface = np.zeros((len(self._surface), *free.shape[1:]))
            on_surface[kept] = free
        else:
            on_surface = np.tensordot(weights, free, (1, 0))
        values = np.empty(((self.order + 1) ** 3, *free.shape[1:]))
        values[self._surface] = on_surface
        recovered = self._condensed[element].inner @ on_surface.reshape(3 * len(self._surface), -1)
        values[self._inside] = recovered.reshape(len(self._inside), 3, -1)
        return values

    def indicators(self, u: FloatArray, duals: FloatArray, scales: FloatArray) -> FloatArray:
        """Share of each element, along each axis, in the errors of the probes, up to a constant; shape (n, 3).

        Parameters
        ----------
        u : array, shape (n_unknowns,)
            The answer.
        duals : array, shape (n_unknowns, k)
            Answers to unit loads on the probes.
        scales : array, shape (k,)
            Size of each probe's displacement [mm].

        Notes
        -----
        What the highest degree along an axis adds to u and to a dual, multiplied as strain energies are: the order of
        the displacement by μ |∂u|², two less of the pressure by p²/μ. Without the pressure the estimate
        at a loaded corner, ν = 0.4999, was 0.8 times the error, with it 1.3 times.
        """
        n = self.order + 1
        nodes = lobatto_points(self.order)
        to_highest = np.linalg.inv(legendre.legvander(nodes, self.order))[self.order]
        lumped = 2 / (self.order * n * legendre.legval(nodes, np.eye(n)[self.order]) ** 2)
        across = np.multiply.outer(lumped, lumped)
        slope = 1 + np.array([*self.lean, 0.0]) ** 2  # |∇ξ|² of the sheared coordinates
        lame = np.array([material.lame_mpa for material in self.materials])[self.region]
        pull = np.eye(3)
        pull[:2, 2] = -np.array(self.lean)
        modes = divergence_modes(self.order)
        degree = np.array(np.unravel_index(np.arange(modes.shape[1]), (n - 2,) * 3)).T
        toward = (degree == n - 3) / (degree == n - 3).sum(axis=1, keepdims=True).clip(1)
        both = np.column_stack([u, duals])
        found = np.zeros((len(self.size), 3))
        for element, size in enumerate(self.size):
            lam, mu = lame[element]
            volume = size.prod() / 8
            values = self.element_values(element, both)
            lattice = values.reshape(n, n, n, 3, -1)
            for d in range(3):
                top = np.abs(np.tensordot(to_highest, lattice, (0, d)))
                energy = np.einsum("jk,jka,jkam->m", across, top[..., 0], top[..., 1:])
                found[element, d] = (
                    slope[d] * mu * (2 / size[d]) ** 2 * volume * self.order * n * (energy / scales).sum()
                )
            derived = np.einsum("ka,nac->knc", pull * (2 / size)[:, None], values)
            divergence = np.tensordot(modes, derived, ((0, 2), (0, 1)))
            products = np.abs(divergence[:, :1] * divergence[:, 1:]) @ (1 / scales)
            found[element] += DIVERGENCE_WEIGHT * lam**2 / mu * volume * (products @ toward)
        return found


def _upper_pairs(numbers: IntArray) -> tuple[IntArray, IntArray]:
    """Places of all pairs of numbers that are in order, each number with itself included."""
    rank = np.argsort(numbers)
    i, j = _upper(len(numbers))
    return rank[i], rank[j]


@cache
def _upper(n: int) -> tuple[IntArray, IntArray]:
    """Rows and columns of the upper triangle, the diagonal included."""
    return np.triu_indices(n)
