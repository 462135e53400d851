"""First and second derivatives of an array's displacements by the forces on its plates, about an equilibrium.

The third derivative of the energy is symmetric, so that the answer of order two to a pair of forces needs no solve of
its own: with the first-order answers uᵢ, also to moments on the plates, a plate's motion o has the second derivative

    −∫ [s c(Fᵢ, Fⱼ, Fₒ) + tₒ b(Fᵢ, Fⱼ) + tᵢ b(Fⱼ, Fₒ) + tⱼ b(Fᵢ, Fₒ) − 2 μ/J³ Jᵢ Jⱼ Jₒ] and what finite rotations add,

where c and b are the third derivative of det F and its second one at F₀, s = p − μ/J, and t and J with an index are the
first-order changes of s and of J. Within a unit the fields of all forces have few modes, since those of far ones are
alike there: the integral is taken of these.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fem.finite.loads import skew
from fem.finite.preloads import PreloadedArray
from fem.finite.rubber_body import PRESSURES, SLOPES, WEIGHTS, bilinear_cofactors
from fem.finite.series import BaseState
from geometry.layout import FloatArray

WEAKEST = 1e-3  #: of the modes of all fields in a unit that are kept, relative to the strongest
#: ε_acm ε_bdn as (9, 9, 9): the matrix of F ↦ [A ↦ bilinear cofactors of F and A], both as nine components
_LEVI = np.zeros((3, 3, 3))
_LEVI[[0, 1, 2], [1, 2, 0], [2, 0, 1]], _LEVI[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = 1.0, -1.0
COFACTORS = np.einsum("acm,bdn->mnabcd", _LEVI, _LEVI).reshape(9, 81)


@dataclass(frozen=True, eq=False)
class SecondOrder:
    """d(f₀ + g) = d(f₀) + A g + B(g, g) of the electrodes of k units, in mm and newtons."""

    at_rest: FloatArray  #: d(f₀), (6 k,)
    first: FloatArray  #: A, (6 k, 3 k)
    second: FloatArray  #: B, half the second derivative, symmetric in its first two axes, (3 k, 3 k, 6 k)


def second_order(array: PreloadedArray, preload_mpa: float) -> SecondOrder:
    """Derivatives of an array of one rubber about a uniform pressure on all pads.

    Raises
    ------
    UnreachableLoadError
        If there is no equilibrium under it.
    """
    base, k = array.base(preload_mpa), array.design.n_units
    n = 3 * k  # forces; of 2 n fields the others are by moments over half-widths
    z = _unit_answers(base)
    v = z[:, -k:] / base.system.plates.half_mm[:, None] / 2  # half spins (2 n, k, 3)
    nodal = base.system.nodal_change(base.state.rotation[None], z)
    second = -_of_strain(array, base, nodal) - _of_rotation(base, nodal, v[:n], z)
    moves, half_spins = second[..., :n], second[..., n:] / np.repeat(base.system.plates.half_mm, 3) / 2
    arm = np.einsum("kij,ej->kei", base.state.rotation, array.arm)

    def electrodes(shift: FloatArray, half_spin: FloatArray) -> FloatArray:
        shift, half_spin = (part.reshape(*part.shape[:-1], k, 1, 3) for part in (shift, half_spin))
        return shift + 2 * np.cross(half_spin, arm)

    of_pairs = electrodes(moves, half_spins)  # (n, n, k, 2, 3)
    for unit in range(k):
        turn = skew(v[:n, unit])
        pairs = np.einsum("iab,jbc,ec->ijea", turn, turn, arm[unit])
        of_pairs[:, :, unit] += pairs + pairs.swapaxes(0, 1)
    first = electrodes(z[:n, -2 * k : -k].reshape(n, -1), v[:n].reshape(n, -1))
    at_rest = array.electrodes(base.state.shift[None], base.state.rotation[None])
    return SecondOrder(at_rest=at_rest.ravel(), first=first.reshape(n, -1).T.copy(), second=of_pairs.reshape(n, n, -1))


def _unit_answers(base: BaseState) -> FloatArray:
    """Changes of the unknowns (6 k, n_blocks, 3) by a newton on each plate along each axis, then by each moment."""
    n = 6 * base.system.plates.count
    loads = np.zeros((base.system.n_unknowns, n))
    loads[-n:] = np.eye(n)
    return np.ascontiguousarray(base.factor.solve(loads).T).reshape(n, -1, 3)


def _of_strain(array: PreloadedArray, base: BaseState, nodal: FloatArray) -> FloatArray:
    """The integral over the rubber, halved, of forces i, j and fields o: (n, n, 2 n)."""
    design, body, n = array.design, base.system.body, len(nodal) // 2
    rows, cols = design.array.rows, design.array.cols
    column, row = np.floor(body.centres_mm[:, :2] / design.array.pitch_mm + np.array([cols, rows]) / 2).T
    unit = (row * cols + column).astype(np.int64)
    out = np.zeros((n, n, 2 * n))
    for own in range(design.n_units):
        elements = np.flatnonzero(unit == own)
        E = _gradients(base, nodal[:, body.nodes[elements]], elements)
        flat = E.reshape(-1, 2 * n) / np.resize(np.append(np.ones(9), body.mu_mpa.max()), len(elements) * 270)[:, None]
        strength, modes = np.linalg.eigh(flat.T @ flat)
        modes = modes[:, strength > WEAKEST**2 * strength[-1]]
        products = _products(base, E @ modes, elements)
        by_force = np.tensordot(modes[:n], np.tensordot(modes[:n], products, (1, 1)), (1, 1))
        out += by_force @ modes.T
    return out


def _gradients(base: BaseState, u: FloatArray, elements: NDArray[np.int64]) -> FloatArray:
    """Nine components of F and t at the points of some elements, (e, points, 10, m), of displacements (m, e, 27, 3)."""
    body, m = base.system.body, len(u)
    own = u.transpose(1, 0, 3, 2)  # (e, m, 3, 27)
    E = np.empty((len(elements), WEIGHTS.size, 10, m))
    for d in range(3):
        slope = (own @ SLOPES[d]) * body.scale[d][elements][:, None, None, None]
        E[:, :, d:9:3] = slope.transpose(0, 3, 2, 1)
    dJ = (_at(base.strain.cof, elements) * E[:, :, :9]).sum(axis=2)
    sums = np.einsum("qk,eqm->ekm", WEIGHTS[:, None] * PRESSURES, dJ)
    bulk = body.bulk[elements] * body.volume_mm3[elements, None, None] / 8
    inverse = 1 / base.strain.J[0, elements]
    E[:, :, 9] = PRESSURES @ (bulk @ sums) + (body.mu_mpa[elements] * inverse**2)[..., None] * dJ
    return E


def _products(base: BaseState, E: FloatArray, elements: NDArray[np.int64]) -> FloatArray:
    """The integral over some elements, halved, of fields with gradients (e, points, 10, r): (r, r, r)."""
    body, r = base.system.body, E.shape[-1]
    F0, cof0, mu = _at(base.strain.F, elements), _at(base.strain.cof, elements), body.mu_mpa[elements]
    inverse = 1 / base.strain.J[0, elements]
    s = base.state.p[elements] @ PRESSURES.T - mu * inverse
    dJ = (cof0 * E[:, :, :9]).sum(axis=2)
    of_rest = (F0[..., 0] @ COFACTORS).reshape(*F0.shape[:2], 9, 9)
    direct = 2 * mu * inverse**3
    weight = WEIGHTS * body.volume_mm3[elements, None] / 16
    out = np.empty((r, r, r))
    flat = E.reshape(-1, r)
    for i in range(r):
        M = np.zeros((*F0.shape[:2], 10, 10))
        of_field = (E[:, :, :9, i] @ COFACTORS).reshape(of_rest.shape)
        M[..., :9, :9] = s[..., None, None] * of_field + E[:, :, 9, i, None, None] * of_rest
        M[..., :9, :9] -= (direct * dJ[..., i])[..., None, None] * cof0 * cof0.swapaxes(2, 3)
        M[..., :9, 9] = M[..., 9, :9] = (of_rest @ E[:, :, :9, i, None])[..., 0]
        M *= weight[..., None, None]
        out[i, i:] = (M @ E[..., i:]).reshape(-1, r - i).T @ flat
        out[i:, i] = out[i, i:]
    return out


def _at(values: FloatArray, elements: NDArray[np.int64]) -> FloatArray:
    """Matrices (3, 3, 1, all elements, points) of some elements as columns, (e, points, 9, 1)."""
    return values[:, :, 0, elements].reshape(9, len(elements), -1).transpose(1, 2, 0)[..., None]


def _of_rotation(base: BaseState, nodal: FloatArray, v: FloatArray, z: FloatArray) -> FloatArray:
    """What second-order rotations of plates add for forces i, j and fields o, (n, n, 2 n); half spins v (n, k, 3).

    A bonded node at a from its plate's middle moves by h = vⱼ (vᵢ · a) + vᵢ (vⱼ · a) − 2 a (vᵢ · vⱼ) to second order.
    """
    plates, n, k = base.system.plates, len(v), base.system.plates.count
    arm = plates.turned(base.state.rotation)
    forces = np.concatenate([base.plate_forces[None], _forces_on_plates(base, nodal)])
    S = np.add.reduceat(arm[:, :, None] * forces[:, :, None, :], plates.starts, axis=1)  # Σ a ⊗ r, (1 + 2 n, k, 3, 3)
    of_base, S = S[0], S[1:]
    spin = z[:, -k:] / plates.half_mm[:, None]  # (2 n, k, 3)
    out = np.zeros((n, n, 2 * n))
    for plate in range(k):
        own, across = v[:, plate], np.einsum("ij,kj->ik", v[:, plate], v[:, plate])
        trace = np.einsum("oaa->o", S[:, plate])
        pairs = np.einsum("ia,oab,jb->ijo", own, S[:, plate], own, optimize=True)
        pairs = pairs + pairs.swapaxes(0, 1) - 2 * across[..., None] * trace
        turned = own @ of_base[plate]  # S₀ᵀ v
        moment = np.cross(own[None], turned[:, None])
        direct = S[:n, plate] @ own.T  # (j, 3, i)
        moment += direct.transpose(2, 0, 1) - own[:, None] * trace[:n, None]
        moment = moment + moment.swapaxes(0, 1)
        first = np.array(
            [
                of_base[plate][1, 2] - of_base[plate][2, 1],
                of_base[plate][2, 0] - of_base[plate][0, 2],
                of_base[plate][0, 1] - of_base[plate][1, 0],
            ]
        )  # Σ a × r, which equilibrium leaves near 0
        moment -= 2 * across[..., None] * first
        out += pairs + moment @ spin[:, plate].T
    return out


def _forces_on_plates(base: BaseState, nodal: FloatArray) -> FloatArray:
    """First-order forces of the bonded nodes (m, n, 3) by displacements (m, n_nodes, 3) [N]."""
    body, plates = base.system.body, base.system.plates
    out = np.empty((len(nodal), len(plates.node), 3))
    pressure = base.state.p @ PRESSURES.T
    F0, cof0, inverse = base.strain.F, base.strain.cof, 1 / base.strain.J
    s = pressure - body.mu_mpa * inverse
    for number, u in enumerate(nodal):
        dF = body.gradient(u[None])
        dJ = np.einsum("ij...,ij...->...", cof0, dF)
        ds = body.dilated(dJ) @ PRESSURES.T + body.mu_mpa * inverse**2 * dJ
        stress = body.mu_mpa * dF + s * bilinear_cofactors(F0, dF) + ds * cof0
        out[number] = body.divergence(stress)[0, plates.node]
    return out
