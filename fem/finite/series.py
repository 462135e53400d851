"""The response as a power series in the load: every order one more solve with the factor of the body at rest.

With loads s f, all fields are series u = Σ sᵏ uₖ, and the equations of order k are linear in uₖ with the tangent at
rest, their right-hand side made of lower orders (the asymptotic numerical method: Cochelin, Computers & Structures 53
(1994) 1181). Stresses need products and one division alone: the rubber's law has no other function but 1/J in it.
Only dead tractions and forces on plates are expanded: their tangent at rest is symmetric.
"""

from dataclasses import dataclass

import numpy as np

from fem.finite.loads import skew
from fem.finite.rubber_body import PRESSURES, bilinear_cofactors, cofactors
from fem.finite.system import FiniteSystem
from fem.linear.refactored import RepeatedFactor
from geometry.layout import FloatArray


@dataclass(frozen=True, eq=False)
class LoadSeries:
    """Coefficients of sᵏ, k = 1 … orders, of m samples."""

    u: FloatArray  #: displacements, (orders, m, n_nodes, 3) [mm]
    p: FloatArray  #: pressures, (orders, m, n_elements, 4) [MPa]
    shift: FloatArray  #: of the plates, (orders, m, k, 3) [mm]
    half_spin: FloatArray  #: vector part of the plates' quaternions, (orders, m, k, 3)


def load_series(
    system: FiniteSystem, factor: RepeatedFactor, forces_n: FloatArray, orders: int, dead_n: FloatArray | None = None
) -> LoadSeries:
    """Series of the response to forces on the plates, of many samples at once.

    Parameters
    ----------
    system : FiniteSystem
    factor : RepeatedFactor
        Of the system's tangent at rest.
    forces_n : array, shape (m, k, 3)
        Forces on the plates of m samples [N].
    orders : int
    dead_n : array, shape (m, n_nodes, 3), optional
        Dead nodal forces [N].

    Notes
    -----
    Rotations are R = I + 2 q₀ [v] + 2 [v]² with q₀² = 1 − |v|²: a series of v gives that of R by products and a root.
    """
    body, plates = system.body, system.plates
    m, k, n = len(forces_n), plates.count, len(system.free)
    mu = body.mu_mpa[:, None]
    F, cof, J, over, s, P_f = [], [], [], [], [], []
    at_points = (m, body.n_elements, 27)
    unit = np.zeros((3, 3, 1, 1, 1))
    unit[range(3), range(3)] = 1.0
    s0 = np.broadcast_to(-mu, at_points)
    u, p, shift, v, R, q0 = [], [], [], [], [], [np.ones((m, k))]
    for order in range(1, orders + 1):
        # what lower orders say of this one: rotations of the plates, then stresses
        known_R = 2 * sum((q0[i][..., None, None] * skew(v[order - i - 1]) for i in range(1, order)), np.zeros((m, k, 3, 3)))
        for i in range(1, order):
            known_R = known_R + 2 * skew(v[i - 1]) @ skew(v[order - i - 1])
        known = np.zeros((m, body.n_nodes, 3))
        known[:, plates.node] = plates.turned(known_R)
        rhs = np.zeros((m, system.n_blocks, 3))
        if order == 1:
            if dead_n is not None:
                rhs += system.gathered(dead_n, np.broadcast_to(np.eye(3), (m, k, 3, 3)))
            rhs[:, n : n + k] += forces_n
            H = np.zeros((3, 3, *at_points))
            C, D = H.copy(), np.zeros(at_points)
            inverse, stretch, stress = D.copy(), D.copy(), H.copy()
            pressure = np.zeros((m, body.n_elements, 4))
        else:
            H = body.gradient(known)
            C = _crossed_with_unit(H)
            for i in range(1, (order + 1) // 2):
                C += bilinear_cofactors(F[i - 1], F[order - i - 1])
            if order % 2 == 0:
                C += cofactors(F[order // 2 - 1])
            D = H[0, 0] + H[1, 1] + H[2, 2]
            for j in range(1, order):
                D += (j / order) * np.einsum("ij...,ij...->...", cof[order - j - 1], F[j - 1])
            pressure = body.dilated(D)
            inverse = -D - sum(J[j - 1] * over[order - j - 1] for j in range(1, order))
            stretch = pressure @ PRESSURES.T - mu * inverse
            stress = mu * H + s0 * C
            for j in range(1, order):
                stress += s[j - 1] * cof[order - j - 1]
            for i in range(3):
                stress[i, i] += stretch
            forces = body.divergence(stress.copy())
            rhs -= system.gathered(forces, np.broadcast_to(np.eye(3), (m, k, 3, 3)))
            for i in range(1, order):
                moments = np.cross(plates.turned(R[i - 1]), P_f[order - i - 1])
                if k:
                    rhs[:, n + k :] -= np.add.reduceat(moments, plates.starts, axis=1) / plates.half_mm[:, None]
        z = factor.solve(np.ascontiguousarray(rhs.reshape(m, -1).T)).T.reshape(m, -1, 3)
        own_v = z[:, n + k :] / plates.half_mm[:, None] / 2
        change = system.nodal_change(np.broadcast_to(np.eye(3), (m, k, 3, 3)), z)
        u.append(known + change)
        shift.append(z[:, n : n + k])
        v.append(own_v)
        R.append(known_R + 2 * skew(own_v))
        q0.append(-sum((np.einsum("mki,mki->mk", v[i - 1], v[order - i - 1]) + q0[i] * q0[order - i] for i in range(1, order)), np.zeros((m, k))) / 2)
        # now that this order is known, the rest of its strains and stresses
        dH = body.gradient(change)
        dC = _crossed_with_unit(dH)
        dD = dH[0, 0] + dH[1, 1] + dH[2, 2]
        dp = body.dilated(dD)
        ds = dp @ PRESSURES.T + mu * dD
        p.append(pressure + dp)
        if order == orders:
            break
        stress += mu * dH + s0 * dC
        for i in range(3):
            stress[i, i] += ds
        P_f.append(body.divergence(stress)[:, plates.node])
        F.append(H + dH)
        cof.append(C + dC)
        J.append(D + dD)
        over.append(inverse - dD)
        s.append(stretch + ds)
    return LoadSeries(u=np.array(u), p=np.array(p), shift=np.array(shift), half_spin=np.array(v))


def _crossed_with_unit(H: FloatArray) -> FloatArray:
    """tr H I − Hᵀ, the change of the cofactors of I with H (3, 3, ...)."""
    C = -H.swapaxes(0, 1)
    trace = H[0, 0] + H[1, 1] + H[2, 2]
    for i in range(3):
        C[i, i] += trace
    return C


def quaternion_rotations(half_spin: FloatArray) -> FloatArray:
    """R = I + 2 q₀ [v] + 2 [v]², (..., 3, 3), of vector parts v (..., 3) shorter than 1."""
    q0 = np.sqrt(1 - (half_spin**2).sum(axis=-1))[..., None, None]
    V = skew(half_spin)
    return np.eye(3) + 2 * q0 * V + 2 * V @ V
