"""The field of a body, whatever solved it: displacement and stress at any of its points.

Near ν = 0.5 the pointwise λ div u of an answer is noise: only the pressures that the elements know mean anything.
Stress at the points of integration, of these pressures, is fitted in every element by a linear function along each
axis; at corners it is averaged over the elements of one region that meet, weighted by volume: across an interface of
two rubbers stress may jump.

Components run xx, yy, zz, yz, xz, xy everywhere; tension is positive.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from skfem import Mesh

from fem.kernel.elements import Basis
from fem.kernel.factor import Factor
from fem.kernel.mirrors import Mirror, Parity, flipped_points, sign
from fem.kernel.reference import IntArray, is_straight, local_places, tabulated
from fem.kernel.rubber import Rubber
from geometry.layout import FloatArray

COMPONENTS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))  #: xx, yy, zz, yz, xz, xy
SAME_PLACE = 1e-9  #: of the body's size: how far apart rounding may put copies of a point
AT_ONCE = 4_000_000  #: numbers in the strains of as many answers as are worked on at a time


class Places(Protocol):
    """A mesh that finds points: a `Grid` or tetrahedra."""

    @property
    def mesh(self) -> Mesh: ...

    def located(self, points_mm: FloatArray, among: NDArray[np.bool_] | None = None) -> tuple[IntArray, FloatArray]:
        """The element that holds each of points (k, 3), (k,), and where in it, (3, k); of tetrahedra some alone."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Field:
    """Displacement of a body, or c answers at a time."""

    places: Places
    body: Rubber  #: on the mesh of these places
    displacement_mm: FloatArray  #: at the nodes, (n, 3) or (n, 3, c)
    loaded_mm: Sequence[FloatArray] = ()  #: rectangles of the top face, at whose edges stress may jump

    @property
    def points_mm(self) -> FloatArray:
        """The nodes at rest, (n, 3)."""
        return self.body.points_mm

    def _located(self, points_mm: FloatArray, region: int | None) -> tuple[IntArray, FloatArray]:
        return self.places.located(points_mm, None if region is None else self.body.region == region)

    def displacement_at(self, points_mm: FloatArray, region: int | None = None) -> FloatArray:
        """Displacement at points (k, 3) of the body, or of one of its regions: (k, 3) or (k, 3, c) [mm]."""
        u = self.displacement_mm
        rows = rows_at(self.body, *self._located(points_mm, region))
        return np.asarray(rows @ u.reshape(len(u), -1)).reshape(-1, *u.shape[1:])

    def slopes_at(self, points_mm: FloatArray) -> sp.csr_matrix:
        """Rows (3 k, n_nodes) of `slopes_at` at points (k, 3) of the body."""
        return slopes_at(self.body, *self.places.located(points_mm))

    def stress_at(self, points_mm: FloatArray, region: int | None = None) -> FloatArray:
        """Stress at points (k, 3), on an interface that of `region`, shape (k, 6) or (k, 6, c) [MPa]."""
        element, local = self._located(points_mm, region)
        values, _ = tabulated(self.body.basis.mesh.elem(), local)
        return np.einsum("ap,pa...->p...", values, self.corner_stress[self.corners[element]], optimize=True)

    @cached_property
    def corners(self) -> IntArray:
        """Number of each element's corners, (m, 4 or 8): elements of one region share it at a point.

        On the top those under a load do not share it with those beside it: traction jumps at the load's edge.
        """
        mesh = self.body.basis.mesh
        nodes = mesh.t.T.astype(np.int64)
        points = mesh.p.T[nodes]
        middle, loaded = points.mean(axis=1)[:, None, :2], np.reshape(self.loaded_mm, (-1, 4))
        under = ((middle > loaded[:, :2]) & (middle < loaded[:, 2:])).all(axis=2) @ np.arange(1, len(loaded) + 1)
        jumps = under[:, None] * (points[:, :, 2] == points[:, :, 2].max())
        keys = (nodes + jumps * len(mesh.p.T)) * (int(self.body.region.max()) + 1) + self.body.region[:, None]
        return np.unique(keys, return_inverse=True)[1].reshape(keys.shape)

    @cached_property
    def corner_stress(self) -> FloatArray:
        """Stress at the corners, (n_corners, 6) or (n_corners, 6, c) [MPa]."""
        body, u = self.body, self.displacement_mm.reshape(len(self.displacement_mm), 3, -1)
        corner, _ = tabulated(body.basis.mesh.elem(), body.basis.X)  # (n_corner, q)
        fitted = np.linalg.pinv(corner * np.sqrt(body.reference.weights)).T * np.sqrt(body.reference.weights)
        volume = body.dx.sum(axis=1)
        own, count = self.corners, int(self.corners.max()) + 1
        weights = np.repeat(volume, own.shape[1])
        gather = sp.csr_matrix((weights, (own.ravel(), np.arange(own.size))), shape=(count, own.size))
        gather = sp.diags_array(1 / np.asarray(gather.sum(axis=1)).ravel()) @ gather
        found = np.empty((count, 6, u.shape[2]))
        step = max(1, AT_ONCE // (9 * body.dx.size))
        for first in range(0, u.shape[2], step):
            some = np.ascontiguousarray(u[..., first : first + step].transpose(2, 0, 1))
            strain = body.strain(some)
            if body.is_mixed:
                p = np.stack([self._mixed_pressure(theta) for theta in strain.theta])
                stress = body.law.stress(strain, np.stack([body.pressure_at(each) for each in p]))
            else:
                stress = body.stress(strain, body.pressures(strain.theta))
            at_corners = np.stack([stress[i, j] for i, j in COMPONENTS]) @ fitted.T  # (6, c, e, n_corner)
            flat = at_corners.transpose(2, 3, 0, 1).reshape(own.size, -1)
            found[:, :, first : first + step] = (gather @ flat).reshape(count, 6, -1)
        return found.reshape(count, 6, *self.displacement_mm.shape[2:])

    def _mixed_pressure(self, theta: FloatArray) -> FloatArray:
        """Continuous pressures (n_pressures,) [MPa] with ∫ p q / λ = ∫ θ q, of changes of volume (e, q)."""
        body = self.body
        moments = np.bincount(
            body.pressure_dofs.ravel(), ((theta * body.dx) @ body.reference.pressures).ravel(), body.pressures_shape[0]
        )
        return self._mass.solve(moments.astype(np.float64)[:, None])[:, 0]

    @cached_property
    def _mass(self) -> Factor:
        return Factor(self.body.pressure_mass.tocsr(), definite=True)


def rows_at(body: Rubber, element: IntArray, local: FloatArray) -> sp.csr_matrix:
    """Rows (k, n_nodes) that take nodal values to those at places (3, k) of elements (k,)."""
    return _rows(body, element, tabulated(body.basis.elem, local)[0].T)


def slopes_at(body: Rubber, element: IntArray, local: FloatArray) -> sp.csr_matrix:
    """Rows that take nodal values to derivatives there: all by x, then by y, then by z, (3 k, n_nodes) [1/mm]."""
    slopes = tabulated(body.basis.elem, local)[1]  # (3, n, k)
    mesh = body.basis.mesh
    if is_straight(mesh):
        pull = body.pull[element, 0].transpose(1, 2, 0)
    else:
        values, _ = tabulated(mesh.elem(), local)
        places = np.einsum("int,nt->it", mesh.p[:, mesh.t[:, element]], values)
        pull = local_places(mesh, element, places[..., None])[1][..., 0]
    along = np.einsum("mnk,mjk->jkn", slopes, pull)
    return sp.vstack([_rows(body, element, values) for values in along], format="csr")


def _rows(body: Rubber, element: IntArray, values: FloatArray) -> sp.csr_matrix:
    rows = np.repeat(np.arange(len(element)), values.shape[1])
    return sp.csr_matrix((values.ravel(), (rows, body.nodes[element].ravel())), shape=(len(element), body.n_nodes))


@dataclass(frozen=True, eq=False)
class Unfolded:
    """The mesh of a whole body from that of its part above mirror planes; copies of elements follow each other."""

    part: Places
    mirrors: tuple[Mirror, ...]

    @cached_property
    def mesh(self) -> Mesh:
        mesh = self.part.mesh
        points, cells = mesh.p.T, mesh.t
        for mirror in self.mirrors:
            points, cells = (
                np.vstack([points, flipped_points(points, (mirror,))]),
                np.hstack([cells, cells + len(points)]),
            )
        first, number = same_places(points)
        return type(mesh)(np.ascontiguousarray(points[first].T), number[cells])

    def located(self, points_mm: FloatArray, among: NDArray[np.bool_] | None = None) -> tuple[IntArray, FloatArray]:
        """As of the part: an image of an element has its local coordinates."""
        n = self.part.mesh.nelements
        element, local = self.part.located(folded(points_mm, self.mirrors), None if among is None else among[:n])
        for number, mirror in enumerate(self.mirrors):
            element = element + n * 2**number * (points_mm[:, mirror.axis] < mirror.position_mm)
        return element, local


def unfolded(
    part: Places, body: Rubber, mirrors: Sequence[Mirror], parts: Sequence[tuple[Parity, FloatArray]]
) -> Field:
    """The field of a whole body from displacements (n, 3) of its part above the planes, by parity."""
    if not mirrors:
        return Field(places=part, body=body, displacement_mm=np.sum([u for _, u in parts], axis=0))
    whole = Unfolded(part, tuple(mirrors))
    basis, own = Basis(whole.mesh, body.basis.elem), np.tile(np.arange(body.n_elements), 2 ** len(mirrors))
    places, found = basis.doflocs.T, np.zeros((basis.N, 3))
    _, number = same_places(np.vstack([body.points_mm, folded(places, mirrors)]))
    of_place = np.empty(int(number.max()) + 1, dtype=np.int64)
    of_place[number[: body.n_nodes]] = np.arange(body.n_nodes)
    for parity, u in parts:
        signs = np.ones((len(places), 3))
        for mirror in mirrors:
            beyond = places[:, mirror.axis] < mirror.position_mm
            signs[beyond] *= [sign(component, mirror.axis, parity) for component in range(3)]
        found += signs * u[of_place[number[body.n_nodes :]]]
    filled = Rubber(basis, body.pressure, body.law.part(own), body.region[own])
    return Field(places=whole, body=filled, displacement_mm=found)


def folded(points_mm: FloatArray, mirrors: Sequence[Mirror]) -> FloatArray:
    """Points (n, 3) of a whole body, or their images in its part above the planes."""
    image = np.array(points_mm)
    for mirror in mirrors:
        image[:, mirror.axis] = mirror.position_mm + np.abs(image[:, mirror.axis] - mirror.position_mm)
    return image


def same_places(points_mm: FloatArray) -> tuple[IntArray, IntArray]:
    """The first of points (n, 3) in each place, and for all of them the number of their place, (n,)."""
    places = np.round(points_mm / (SAME_PLACE * np.ptp(points_mm, axis=0).max()))
    order = np.lexsort(places.T)  # a third of the time of `np.unique`
    is_first = np.append(True, (np.diff(places[order], axis=0) != 0).any(axis=1))
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.cumsum(is_first) - 1
    return order[is_first], number


def von_mises(stress_mpa: FloatArray) -> FloatArray:
    """√(3/2 s:s) of stresses (..., 6), s their deviator, shape (...) [MPa].

    >>> float(von_mises(np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])))
    2.0
    """
    xx, yy, zz, yz, xz, xy = np.moveaxis(np.asarray(stress_mpa, dtype=float), -1, 0)
    normal = ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) / 2
    return np.sqrt(normal + 3 * (yz**2 + xz**2 + xy**2))


def pressure(stress_mpa: FloatArray) -> FloatArray:
    """−tr σ/3 of stresses (..., 6), positive in compression, shape (...) [MPa].

    >>> float(pressure(np.array([-1.0, -1.0, -1.0, 0.0, 0.5, 0.0])))
    1.0
    """
    return -np.asarray(stress_mpa, dtype=float)[..., :3].mean(axis=-1)
