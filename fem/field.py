"""A field on the elements of a body, whatever solved it: displacement and stress at any of its points.

Elements are `Boxes` or Taylor-Hood `Elements`, both quadratic. Near ν = 0.5 the pointwise λ div u of a displacement
answer is noise: only those moments of div u that the elements constrain mean anything. In boxes, whose pressures are
linear, that is its linear part, and all strains are taken by theirs. In tetrahedra gradients are linear, and the
pressure is a field of its own, ∫ div u q − ∫ p q / λ = 0 for all q. Stresses at corners are averaged over the elements
of one region that meet, weighted by volume: across an interface of two rubbers stress may jump.

Components run xx, yy, zz, yz, xz, xy everywhere; tension is positive.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from fem.boxes.boxes import Boxes
from fem.kernel.mirrors import Mirror, Parity, sign
from fem.tetrahedra.mixed import MIN_POISSON, Elements, lame_of_regions
from geometry.design import Material
from geometry.layout import FloatArray

IntArray = NDArray[np.int64]
COMPONENTS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))  #: xx, yy, zz, yz, xz, xy
SAME_PLACE = 1e-9  #: of the body's size: how far apart rounding may put copies of a point


@dataclass(frozen=True, eq=False, kw_only=True)
class Field:
    """Displacement of a body, or c answers at a time."""

    mesh: Boxes | Elements
    displacement_mm: FloatArray  #: at the nodes, (n, 3) or (n, 3, c)
    material: Sequence[Material]  #: of each region: 0 for the body, above for what is in it
    loaded_mm: Sequence[FloatArray] = ()  #: rectangles of the top face, at whose edges stress may jump

    @property
    def points_mm(self) -> FloatArray:
        """The nodes at rest, (n, 3)."""
        return self.mesh.points_mm

    def displacement_at(self, points_mm: FloatArray, region: int | None = None) -> FloatArray:
        """Displacement at points (k, 3) of the body, or of one of its regions: (k, 3) or (k, 3, c) [mm]."""
        u = self.displacement_mm
        return np.asarray(self.mesh.at(points_mm, region) @ u.reshape(len(u), -1)).reshape(-1, *u.shape[1:])

    def slopes(self, points_mm: FloatArray) -> list[sp.csr_matrix]:
        """Matrices (k, n) that take nodal values to derivatives along x, y and z at points (k, 3) [1/mm]."""
        rows, k = self.mesh.slopes(points_mm), len(points_mm)
        return [rows[axis * k : (axis + 1) * k] for axis in range(3)]

    def stress_at(self, points_mm: FloatArray, region: int | None = None) -> FloatArray:
        """Stress at points (k, 3), on an interface that of `region`, shape (k, 6) or (k, 6, c) [MPa]."""
        element, local = self.mesh.located(points_mm, region)
        stress = self.corner_stress[self.corners[element]]
        return np.einsum("pa,pa...->p...", self.mesh.linear(local), stress, optimize=True)

    def nodal_stress(self, elements: NDArray[np.bool_]) -> FloatArray:
        """Stress at the nodes of some elements, in the order of `mesh.cells`, shape (k, 10 or 27, 6) [MPa]."""
        stress = self.corner_stress[self.corners[elements]]
        return np.einsum("av,ev...->ea...", self.mesh.linear(self.mesh.cell_places), stress)

    @cached_property
    def corners(self) -> IntArray:
        """Number of each element's corners, (m, 4 or 8): elements of one region share it at a point.

        On the top those under a load do not share it with those beside it: traction jumps at the load's edge.
        """
        nodes, points = self.mesh.corners, self.points_mm[self.mesh.corners]
        middle, loaded = points.mean(axis=1)[:, None, :2], np.reshape(self.loaded_mm, (-1, 4))
        under = ((middle > loaded[:, :2]) & (middle < loaded[:, 2:])).all(axis=2) @ np.arange(1, len(loaded) + 1)
        jumps = under[:, None] * (points[:, :, 2] == points[:, :, 2].max())
        keys = (nodes + jumps * len(self.points_mm)) * len(self.material) + self.mesh.region[:, None]
        _, numbers = np.unique(keys, return_inverse=True)
        return numbers.reshape(keys.shape)

    @cached_property
    def corner_stress(self) -> FloatArray:
        """Stress at the corners, (n_corners, 6) or (n_corners, 6, c) [MPa]."""
        average = self._summed @ sp.diags_array(np.repeat(self.mesh.volumes_mm3, self.corners.shape[1]))
        average = sp.diags_array(1 / np.asarray(average.sum(axis=1)).ravel()) @ average
        u = self.displacement_mm.reshape(len(self.displacement_mm), 3, -1)
        slopes = [average @ rows for rows in self.mesh.corner_slopes()]
        H = np.stack([(rows @ u.reshape(len(u), -1)).reshape(-1, *u.shape[1:]) for rows in slopes], axis=2)
        lame, mu = self._lame
        stress = np.stack([mu[:, None] * (H[:, i, j] + H[:, j, i]) for i, j in COMPONENTS], axis=1)
        if isinstance(self.mesh, Boxes):
            stress[:, :3] += (lame[:, None] * np.trace(H, axis1=1, axis2=2))[:, None]
        else:
            stress[:, :3] += self.mixed_pressure(u)[:, None]
        return stress.reshape(-1, 6, *self.displacement_mm.shape[2:])

    def mixed_pressure(self, u: FloatArray) -> FloatArray:
        """Pressures (n_corners, c) [MPa] of the mixed form of tetrahedra, from displacements (n, 3, c)."""
        assert isinstance(self.mesh, Elements)
        mass = self._summed @ sp.kron(sp.diags_array(self.mesh.volumes_mm3), (1 + np.eye(4)) / 20, format="csr")
        weighed = mass @ self._summed.T @ sp.diags_array(1 / self._lame[0])  # λ is one wherever a number is shared
        volume = sum(mass @ rows @ u[:, i] for i, rows in enumerate(self.mesh.corner_slopes()))
        return splu(sp.csc_matrix(weighed)).solve(volume)

    @cached_property
    def _summed(self) -> sp.csr_matrix:
        """Takes values at elements' corners to their sums, (n_corners, m·n_of_element)."""
        return sp.csr_matrix((np.ones(self.corners.size), (self.corners.ravel(), np.arange(self.corners.size))))

    @property
    def _lame(self) -> tuple[FloatArray, FloatArray]:
        """Lamé's λ and μ at the corners, (n_corners,) [MPa]."""
        region = np.empty(int(self.corners.max()) + 1, np.int64)
        region[self.corners] = self.mesh.region[:, None]
        return lame_of_regions(self.material, region, 0.0 if isinstance(self.mesh, Boxes) else MIN_POISSON)


def unfolded(
    boxes: Boxes, mirrors: Sequence[Mirror], parts: Sequence[tuple[Parity, FloatArray]], material: Sequence[Material]
) -> Field:
    """The field of a whole body from displacements (n, 3) of its part above the planes, by parity.

    Nodes in one place become one.
    """
    low, high, region, k = boxes.low, boxes.high, boxes.region, boxes.order + 1
    nodes, moved = boxes.nodes.reshape(-1, k, k, k), list(parts)
    for mirror in mirrors:
        d, plane = mirror.axis, 2 * mirror.position_mm
        image_low, image_high = low.copy(), high.copy()
        image_low[:, d], image_high[:, d] = plane - high[:, d], plane - low[:, d]
        low, high = np.vstack([low, image_low]), np.vstack([high, image_high])
        nodes, region = np.concatenate([nodes, np.flip(nodes, d + 1) + nodes.max() + 1]), np.tile(region, 2)
        signs = [np.array([sign(component, d, parity) for component in range(3)]) for parity, _ in moved]
        moved = [(parity, np.vstack([u, own * u])) for (parity, u), own in zip(moved, signs, strict=True)]
    copies = replace(boxes, low=low, high=high, region=region, nodes=nodes.reshape(len(low), -1), constraint=None)
    first, number = same_places(copies.points_mm)
    whole = replace(copies, nodes=number[copies.nodes])
    return Field(mesh=whole, displacement_mm=np.sum([u for _, u in moved], axis=0)[first], material=material)


def same_places(points_mm: FloatArray) -> tuple[IntArray, IntArray]:
    """The first of points (n, 3) in each place, and for all of them the number of their place, (n,)."""
    places = np.round(points_mm / (SAME_PLACE * np.ptp(points_mm, axis=0).max()))
    _, first, number = np.unique(places, axis=0, return_index=True, return_inverse=True)
    return first, number.reshape(-1)


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
