"""Conductances of thousands of deformed units: a few hundred points see the strain, a few dozen potentials suffice.

Galerkin's method on the potentials of random deformations, compressed: what it misses in a potential enters the
conductances squared. The conductivity between the points is interpolated, so that the stiffness of the few potentials
is linear in the conductivity at the points.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.polynomial import legendre

from fem.boxes.boxes import gauss_points
from fem.conduction.meshes import unit_hexahedra
from fem.conduction.potentials import Conductor, Piezoresistivity, pulled_back, unit_conductances
from geometry.design import Unit
from geometry.layout import FloatArray, pillar_ends, pillar_sections

ALONG, ACROSS = 8, 3  #: points along a pillar, and along each side of its section
MESH = (2, 1)  #: order and levels; what it gets wrong at rest is put right
SNAPSHOTS = 28  #: random deformations whose potentials are compressed
#: largest relative error that few potentials and points add to a resistance: measured to 0.27 % at strains of 20 %, and
#: under a stiff plate at 2 MPa, whose edge they do not resolve
REDUCED_ERROR = 3e-3
STRAIN = 0.2  #: size of their displacement gradients
DROPPED = 1e-5  #: of the energy of the potentials' changes, by compression
PARTS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))  #: of a symmetric tensor


@dataclass(frozen=True, eq=False, kw_only=True)
class ReducedConduction:
    """Conductances of a unit from the deformation at points of its pillars."""

    points_mm: FloatArray  #: (n, 3), at rest in the unit's frame
    stiffness: FloatArray  #: (6 n, pairs of potentials i ≤ j), by `PARTS` of the conductivity at each point
    n_potentials: int  #: the first are of all electrodes but the last at rest
    share: FloatArray  #: (n, n): conductances at rest of the two finest meshes, extrapolated, over the reduced ones

    def conductances(self, F: FloatArray, piezoresistivity: Piezoresistivity | None = None) -> FloatArray:
        """Conductances (..., n, n) between the electrodes times ρ [mm] from ∂x/∂X (..., n_points, 3, 3) at `points_mm`.

        Raises
        ------
        DesignError
            As of `pulled_back`.
        """
        flat = F.reshape(-1, *F.shape[-3:])
        sigma = pulled_back(flat, piezoresistivity)
        parts = np.stack([sigma[..., a, b] for a, b in PARTS], axis=-1).reshape(len(flat), len(self.stiffness))
        return (self._reduced(parts) * self.share).reshape(*F.shape[:-3], *self.share.shape)

    def _reduced(self, parts: FloatArray) -> FloatArray:
        n = self.n_potentials
        K = np.empty((len(parts), n, n))
        i, j = np.triu_indices(n)
        K[:, i, j] = K[:, j, i] = parts @ self.stiffness
        m = len(self.share) - 1  # the last electrode's potentials are 1 less the others'
        G = K[:, :m, :m] - K[:, :m, m:] @ np.linalg.solve(K[:, m:, m:], K[:, m:, :m])
        whole = np.zeros((len(parts), m + 1, m + 1))
        whole[:, :m, :m] = G
        whole[:, m, :m] = whole[:, :m, m] = -G.sum(axis=1)
        whole[:, m, m] = G.sum(axis=(1, 2))
        return whole


@cache
def reduced_conduction(unit: Unit) -> ReducedConduction:
    """The reduced conduction of a unit's pillars: seconds, once a process."""
    conductor = Conductor(unit_hexahedra(unit, *MESH))
    mesh = conductor.mesh
    pillar, local = _places(unit, mesh.points_mm)
    points = _points(unit)
    to_points = _interpolation(local)
    at_rest = conductor.at_rest.potentials[:, :-1]
    changes = []
    for number in range(SNAPSHOTS):
        F = random_deformation(np.random.default_rng(number), pillar, local)
        changes.append(conductor.potentials(conductor.stiffness(pulled_back(F)))[:, :-1] - at_rest)
    snapshots = np.hstack(changes)
    energies, modes = np.linalg.eigh(snapshots.T @ (conductor.at_rest.stiffness @ snapshots))
    missing = np.cumsum(energies) / energies.sum()
    kept = missing > DROPPED
    basis = np.hstack([at_rest, snapshots @ (modes[:, kept] / np.sqrt(energies[kept]))])
    stiffness = _stiffness(conductor, basis, pillar, to_points)
    exact = unit_conductances(unit).matrix_mm
    made = ReducedConduction(
        points_mm=points, stiffness=stiffness, n_potentials=basis.shape[1], share=np.ones(exact.shape)
    )
    return replace(made, share=exact / made.conductances(np.broadcast_to(np.eye(3), (len(points), 3, 3))))


def _stiffness(conductor: Conductor, basis: FloatArray, pillar: FloatArray, to_points: FloatArray) -> FloatArray:
    slopes, weight = conductor.gradients(basis), conductor.mesh.weight_mm3
    i, j = np.triu_indices(basis.shape[1])
    n, n_pillars = to_points.shape[1], pillar.max() + 1
    stiffness = np.zeros((n_pillars, n, len(PARTS), len(i)))
    for number in range(n_pillars):
        own = np.flatnonzero(pillar == number)
        shares = (to_points[own] * weight[own, None]).T
        for part, (a, b) in enumerate(PARTS):
            products = slopes[own, a][:, i] * slopes[own, b][:, j]
            if a != b:
                products += slopes[own, b][:, i] * slopes[own, a][:, j]
            stiffness[number, :, part] = shares @ products
    return stiffness.reshape(n_pillars * n * len(PARTS), -1)


def _places(unit: Unit, points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The number of each point's pillar, and its place in it in [-1, 1] along x, y and z."""
    pillar, local = np.full(len(points_mm), -1), np.zeros((len(points_mm), 3))
    for number, ((base, top), section) in enumerate(zip(pillar_ends(unit), pillar_sections(unit), strict=True)):
        share = points_mm[:, 2] / unit.height_mm
        off = points_mm[:, :2] - base[:2] - share[:, None] * (top - base)[:2]
        place = np.column_stack([2 * off / section, 2 * share - 1])
        own = (pillar < 0) & (np.abs(place) < 1 + 1e-6).all(axis=1)
        pillar[own], local[own] = number, place[own]
    return pillar, local


def _points(unit: Unit) -> FloatArray:
    x, z = gauss_points(ACROSS)[0], gauss_points(ALONG)[0]
    place = np.stack(np.meshgrid(x, x, z, indexing="ij"), axis=-1).reshape(-1, 3)
    share = (place[:, 2:] + 1) / 2
    return np.concatenate([
        base + share * (top - base) + place * (*(section / 2), 0.0)
        for (base, top), section in zip(pillar_ends(unit), pillar_sections(unit), strict=True)
    ])  # fmt: skip


def _interpolation(local: FloatArray) -> FloatArray:
    """Values at places (m, 3) of a pillar from those at its points, (m, ACROSS² ALONG)."""
    sides = []
    for axis, count in enumerate((ACROSS, ACROSS, ALONG)):
        nodes = gauss_points(count)[0]
        sides.append(
            legendre.legvander(local[:, axis], count - 1) @ np.linalg.inv(legendre.legvander(nodes, count - 1))
        )
    return np.einsum("mi,mj,mk->mijk", *sides).reshape(len(local), -1)


def random_deformation(generator: np.random.Generator, pillar: FloatArray, local: FloatArray) -> FloatArray:
    """Smooth random deformation gradients (m, 3, 3) that keep the volume, each pillar's its own."""
    along = legendre.legvander(local[:, 2], 4) / (1 + np.arange(5.0)) ** 2
    across = np.column_stack([np.ones(len(local)), local[:, :2] / 5, local[:, 0] * local[:, 1] / 10])
    terms = (along[:, :, None] * across[:, None]).reshape(len(local), -1)
    F = np.empty((len(local), 3, 3))
    for number in range(pillar.max() + 1):
        own = pillar == number
        size = STRAIN * generator.uniform()
        H = size * np.einsum("mt,tab->mab", terms[own], generator.standard_normal((terms.shape[1], 3, 3)))
        while True:
            J = np.linalg.det(np.eye(3) + H)
            if (J > 0.2).all():
                break
            H *= 0.8
        F[own] = (np.eye(3) + H) / np.cbrt(J)[:, None, None]
    return F
