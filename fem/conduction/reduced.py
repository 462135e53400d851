"""Conductances of thousands of deformed units: a few hundred points see the strain, a few dozen potentials suffice.

Galerkin's method on the potentials of typical deformations, compressed: what it misses in a potential enters the
conductances squared. Its stiffness is integrated by those of the mesh's points, with weights of their own, that give
the conductances of these deformations (empirical cubature: Hernández et al., Comput. Methods Appl. Mech. Eng. 313
(2017) 687). No weight is negative, so that it stays positive definite.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fem.conduction.meshes import unit_hexahedra
from fem.conduction.potentials import INERT, Conductor, Piezoresistivity, pillars_per_mm, pulled_back, unit_conductances
from fem.kernel.reference import IntArray
from geometry.design import Unit
from geometry.layout import FloatArray, pillar_vectors, pillar_volumes, pillar_widths
from geometry.prism import unit_prisms

MESH = (3, 1, True)  #: order, levels, and whether it is cut across; what it gets wrong at rest is put right
DROPPED = 2e-4  #: of the energy of the potentials' changes, by compression
POINTS = 600  #: most points of the cubature
#: rows of the cubature's equations by a deformation, beside those of conductances, and their weight: these errors enter
#: the conductances squared
RESIDUALS, RESIDUAL_WEIGHT = 12, 0.02
AT_ONCE, MAX_ROUNDS = 40, 400  #: points taken together, and how often; a hundred times are enough for 600
CANDIDATES = 12_000  #: points of the mesh from which they are taken
#: share of its volume from which a pillar's point begins to count, and from which it counts in full: rubber of ν = 0.49
#: keeps far more than either
TORN, WHOLE = 0.2, 0.8
MIN_WEIGHT = 0.5  #: share of a pillar's volume below which a state is no answer

#: points (n, 3) [mm] at rest in the unit's frame, each one's pillar and volume (n,), to deformations (n, 3, 3)
Deformations = Callable[[FloatArray, IntArray, FloatArray], Iterator[FloatArray]]


@dataclass(frozen=True, eq=False, kw_only=True)
class ReducedConduction:
    """Conductances of a unit from the deformation at points of its pillars."""

    points_mm: FloatArray  #: (n, 3), at rest in the unit's frame
    pillar: IntArray  #: number of each point's pillar, (n,)
    weight_mm3: FloatArray  #: volume that each point stands for, (n,)
    slopes: FloatArray  #: ∇φ at the points (n, 3, N) [1/mm]; the first potentials are of all electrodes but the last
    share: FloatArray  #: (k, k): conductances at rest of the two finest meshes, extrapolated, over the reduced ones

    def conductances(self, F: FloatArray, piezoresistivity: Piezoresistivity = INERT) -> FloatArray:
        """Conductances (..., k, k) between the electrodes times ρ [mm] from ∂x/∂X (..., n, 3, 3) at `points_mm`.

        Errors as of `pulled_back`.
        """
        flat = pulled_back(F.reshape(-1, *F.shape[-3:]), piezoresistivity) * self.weight_mm3[:, None, None]
        m, N = len(self.share) - 1, self.slopes.shape[2]  # the last electrode's potentials are 1 less the others'
        B = self.slopes.reshape(-1, N)
        K = np.array([B.T @ (sigma @ self.slopes).reshape(-1, N) for sigma in flat]).reshape(-1, N, N)
        G = K[:, :m, :m] - K[:, :m, m:] @ np.linalg.solve(K[:, m:, m:], K[:, m:, :m])
        whole = np.zeros((len(K), m + 1, m + 1))
        whole[:, :m, :m] = G
        whole[:, m, :m] = whole[:, :m, m] = -G.sum(axis=1)
        whole[:, m, m] = G.sum(axis=(1, 2))
        return (whole * self.share).reshape(*F.shape[:-3], *self.share.shape)

    def ratios(
        self, unit: Unit, gradient: FloatArray, electrode_mm: FloatArray, piezoresistivity: Piezoresistivity
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Resistances over eq. 1's (m, k, n_pillars) of m states of k units, and which are answers, (m,).

        By ∂u/∂X (m, k, n, 3, 3) at `points_mm` and displacements (m, k, n_upper, 3) [mm] of the upper electrodes. In an
        answer every pillar has kept `MIN_WEIGHT` of its volume; ratios of others are 1. Points under the edge of a
        plate, where coarse grids tear the rubber, are blended with the mean of their pillar.
        """
        F, kept_volume = mended(np.eye(3) + gradient, self.pillar, self.weight_mm3)
        good = np.asarray(kept_volume.all(axis=1))
        along = pillar_vectors(unit) + electrode_mm[good][..., unit.layout.pillar_top, :]
        ratios = np.ones((*electrode_mm.shape[:2], len(unit.layout.pillars)))
        per_mm = pillars_per_mm(self.conductances(F[good], piezoresistivity), unit.layout.pillar_terminals)
        ratios[good] = per_mm * pillar_volumes(unit) / (along**2).sum(axis=-1)
        return ratios, good


def mended(F: FloatArray, pillar: IntArray, weight_mm3: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Deformations (m, k, n, 3, 3) of points, torn ones blended with the mean of their pillar; which are answers."""
    share = np.clip((np.linalg.det(F) - TORN) / (WHOLE - TORN), 0.0, 1.0)
    weight = share**2 * (3 - 2 * share)  # a cubic without kinks, so that resistances have no jumps
    volume = np.eye(pillar.max() + 1)[pillar] * weight_mm3[:, None]
    total = weight @ volume  # (m, k, n_pillars)
    of_whole = (weight[..., None, None] * F).reshape(*F.shape[:3], 9).swapaxes(2, 3) @ volume  # (m, k, 9, n_pillars)
    mean = (of_whole / np.maximum(total, 1e-9)[:, :, None]).swapaxes(2, 3).reshape(*total.shape, 3, 3)[:, :, pillar]
    blended = mean + weight[..., None, None] * (F - mean)
    good = (total > MIN_WEIGHT * volume.sum(axis=0)).all(axis=2) & (np.linalg.det(blended) > 0).all(axis=2)
    return blended, np.asarray(good)


def reduced_conduction(
    unit: Unit, deformations: Deformations, piezoresistivity: Piezoresistivity = INERT
) -> ReducedConduction:
    """The reduced conduction of a unit's pillars: a minute of processor time. Errors as of `unit_hexahedra`."""
    unit = unit.body
    conductor = Conductor(unit_hexahedra(unit, *MESH))
    mesh, at_rest = conductor.mesh, conductor.at_rest
    pillar = pillars_of(unit, mesh.points_mm)
    conductivities = [np.broadcast_to(np.eye(3), (len(pillar), 3, 3))]
    potentials = [at_rest.unknowns]
    for F in deformations(mesh.points_mm, pillar, mesh.weight_mm3):
        conductivities.append(pulled_back(F, piezoresistivity))
        potentials.append(conductor.potentials(conductivities[-1]).unknowns)
    snapshots = np.hstack([(phi - potentials[0])[:, :-1] for phi in potentials[1:]])
    energies, modes = np.linalg.eigh(snapshots.T @ (at_rest.stiffness @ snapshots))
    kept = np.cumsum(energies) > DROPPED * energies.sum()
    basis = np.hstack([potentials[0][:, :-1], snapshots @ (modes[:, kept] / np.sqrt(energies[kept]))])
    slopes = conductor.mesh.gradients(basis)
    generator = np.random.default_rng(0)
    candidates = np.sort(generator.permutation(len(pillar))[:CANDIDATES])
    rows, wanted = [], []
    for sigma, phi in zip(conductivities, potentials, strict=True):
        integrands = _integrands(conductor, slopes, sigma, phi, generator)
        rows.append(integrands[:, candidates])
        wanted.append(integrands @ mesh.weight_mm3)
    among, weights = _cubature(np.concatenate(rows), np.concatenate(wanted))
    chosen = candidates[among]
    k = len(at_rest.matrix)
    made = ReducedConduction(
        points_mm=mesh.points_mm[chosen],
        pillar=pillar[chosen],
        weight_mm3=weights,
        slopes=slopes[chosen],
        share=np.ones((k, k)),
    )
    at_rest_reduced = made.conductances(np.broadcast_to(np.eye(3), (len(chosen), 3, 3)))
    return replace(made, share=unit_conductances(unit).matrix_mm / at_rest_reduced)


def _integrands(
    conductor: Conductor,
    slopes: FloatArray,
    conductivity: FloatArray,
    potentials: FloatArray,
    generator: np.random.Generator,
) -> FloatArray:
    """Values at the mesh's points (n_rows, n_points) of what a cubature must integrate, for one deformation."""
    # conductances by its own potentials, and by those at rest, which give their first derivatives; then random sums of
    # the residuals of all potentials
    own, rest = conductor.mesh.gradients(potentials), conductor.at_rest.gradients
    rows = []
    for phi in (own, rest):
        dots = np.einsum("nai,naj->ijn", phi, conductivity @ phi)
        size = np.sqrt(np.diagonal(dots @ conductor.mesh.weight_mm3))
        rows += [dots[i, j] / (size[i] * size[j]) for i, j in combinations(range(len(size)), 2)]
    flux = (conductivity @ own)[..., :-1]
    mixed = generator.standard_normal((slopes.shape[2], RESIDUALS * flux.shape[2]))
    tests = (slopes @ mixed).reshape(*slopes.shape[:2], RESIDUALS, -1)
    return np.array([*rows, *(RESIDUAL_WEIGHT * np.einsum("narj,naj->rn", tests, flux))])


def _cubature(rows: FloatArray, wanted: FloatArray) -> tuple[IntArray, FloatArray]:
    """Which points of (n_rows, n_points), and what weights above 0, give nearly the sums that are wanted (n_rows,)."""
    # non-negative least squares (Lawson & Hanson) that takes several points at once
    size = np.linalg.norm(rows, axis=0)
    chosen: IntArray = np.zeros(0, dtype=np.int64)
    weights: FloatArray = np.zeros(0)
    left = wanted
    most = min(POINTS, len(rows) // 3)
    for _ in range(MAX_ROUNDS):
        score = left @ rows / size
        score[chosen] = -np.inf
        new = np.argsort(-score, kind="stable")[: min(AT_ONCE, most - len(chosen))]
        chosen, weights = np.concatenate([chosen, new]), np.concatenate([weights, np.zeros(len(new))])
        gram, moment = rows[:, chosen].T @ rows[:, chosen], rows[:, chosen].T @ wanted
        while True:
            best = np.linalg.solve(gram, moment)
            below = best <= 0
            if not below.any():
                break
            step = np.min(weights[below] / (weights[below] - best[below]))
            weights = weights + step * (best - weights)
            kept = ~below | (weights > 1e-12 * weights.max())
            chosen, weights, gram, moment = chosen[kept], weights[kept], gram[np.ix_(kept, kept)], moment[kept]
        weights = np.asarray(best)
        left = wanted - rows[:, chosen] @ weights
        if len(chosen) >= most:
            break
    return chosen, weights


def pillars_of(unit: Unit, points_mm: FloatArray) -> IntArray:
    """The number of the pillar in which each of the points (n, 3) lies, (n,), the first one's where they meet."""
    slack = np.array(pillar_widths(unit)) * [0.05 if one.is_round else 1e-6 for one in unit.layout.pillars]
    return np.argmax([one.holds(points_mm, far) for one, far in zip(unit_prisms(unit), slack, strict=True)], axis=0)
