"""The response as a power series in the load about a state of equilibrium: every order one more solve with one factor.

With loads f₀ + s (f − f₀) all fields are series u = Σ sᵏ uₖ, and the equations of order k are linear in uₖ with the
tangent of the base state f₀, their right-hand side made of lower orders (asymptotic numerical method: Cochelin,
Computers & Structures 53 (1994) 1181). Products and one division are all it takes: the law has no other function than
1/J in its stress. Many samples share the factor and are expanded together.
"""

from dataclasses import dataclass

import numpy as np

from fem.equations import State
from fem.finite.newton import find_equilibrium
from fem.kernel.factor import Factor
from fem.kernel.law import Strain, bilinear_cofactors, cofactors
from fem.plates import skew
from fem.rubber.body import Tangent
from fem.system import System
from geometry.layout import FloatArray

Terms = list[FloatArray]  #: coefficients of s⁰, s¹, …


@dataclass(frozen=True, eq=False)
class BaseState:
    """An equilibrium about which series are expanded: the loads of a system, and its factored tangent."""

    system: System
    state: State
    factor: Factor
    parts: Tangent  #: of the tangent
    strain: Strain
    plate_forces: FloatArray  #: internal forces of the bonded nodes, (n, 3) [N]

    @classmethod
    def of(cls, system: System) -> "BaseState":
        """The equilibrium of a system under its own loads, which may be 0; `UnreachableLoadError` if there is none.

        Loads without a potential are a `ValueError`: tangents of series are symmetric.
        """
        if not system.symmetric:
            raise ValueError(
                "series are expanded about dead loads and forces on plates only: moments and pressures turn."
            )
        factor = system.new_factor()
        return cls.about(system, find_equilibrium(system, factor).state, factor)

    @classmethod
    def about(cls, system: System, state: State, factor: Factor) -> "BaseState":
        """Any state with its tangent, which `factor` is left with; series want an equilibrium."""
        misfit = system.misfit(state, 1.0)
        blocks, parts = system.tangent(state, 1.0, misfit.reactions)
        factor.factor(system.matrix(blocks))
        internal, _, _ = system.body.internal_forces(state.u[None])
        return cls(
            system=system,
            state=state,
            factor=factor,
            parts=parts,
            strain=system.body.strain(state.u[None]),
            plate_forces=internal[0, system.plates.node],
        )

    def solve(self, unbalanced: FloatArray) -> FloatArray:
        """Change of the unknowns (m, n_blocks, 3) by forces on them, of the same shape."""
        flat = np.ascontiguousarray(unbalanced.reshape(len(unbalanced), -1).T)
        return self.factor.solve(flat).T.reshape(unbalanced.shape)

    def compliance(self) -> FloatArray:
        """Shifts and half-width times spins of the plates per newton on each of them, (6 k, 6 k) [mm/N]."""
        n = 6 * self.system.plates.count
        loads = np.zeros((self.system.n_unknowns, n))
        loads[-n:] = np.eye(n)
        return self.factor.solve(loads)[-n:]


@dataclass(frozen=True, eq=False)
class LoadSeries:
    """Coefficients of sᵏ, k = 1 … orders, of m samples; what is of the base state is not in them."""

    u: FloatArray  #: displacements, (orders, m, n_nodes, 3) [mm]
    shift: FloatArray  #: of the plates, (orders, m, k, 3) [mm]
    half_spin: FloatArray  #: vector part of the quaternion of each plate's further rotation, (orders, m, k, 3)


def load_series(base: BaseState, loads: FloatArray, orders: int) -> LoadSeries:
    """Series of the response to loads on the plates, of many samples at once.

    Loads (m, 2, k, 3) are forces and moments over half-widths of m samples, less those of the base state [N].

    Rotations are R = I + 2 q₀ [v] + 2 [v]², q₀² = 1 − |v|²: a series of v gives that of R by products and a root.
    """
    return _Expansion(base, len(loads)).expand(loads, orders)


class _Expansion:
    """The lists of coefficients as they grow, order by order."""

    def __init__(self, base: BaseState, m: int) -> None:
        self.base, self.system, self.body = base, base.system, base.system.body
        self.m, self.k = m, base.system.plates.count
        self.mu, self.functions = self.body.law.mu_mpa, self.body.reference.pressures.T
        strain, pressure = base.strain, base.state.p @ self.functions
        self.F: Terms = [strain.F]
        self.cof: Terms = [strain.cof]
        self.J: Terms = [strain.J]
        self.inverse: Terms = [1 / strain.J]
        self.s: Terms = [pressure - self.mu / strain.J]  # p − μ/J
        self.q0: Terms = [np.ones((m, self.k))]
        self.v: Terms = [np.zeros((m, self.k, 3))]
        self.arm: Terms = [self.system.plates.turned(base.state.rotation)[None]]
        self.force: Terms = [base.plate_forces[None]]

    def expand(self, loads: FloatArray, orders: int) -> LoadSeries:
        base, system, body = self.base, self.system, self.body
        rotation = np.broadcast_to(base.state.rotation, (self.m, self.k, 3, 3))
        n = len(system.free)
        found: list[tuple[FloatArray, ...]] = []
        for order in range(1, orders + 1):
            known_turn = self._known_turn(order)
            known_arm = self._turned(known_turn)
            unbalanced = np.zeros((self.m, system.n_blocks, 3))
            if order == 1:
                unbalanced[:, n:] = loads.reshape(self.m, -1, 3)
                terms = self._no_terms()
            else:
                known_u = np.zeros((self.m, body.n_nodes, 3))
                known_u[:, system.plates.node] = known_arm
                terms = self._known_terms(order, known_u)
                unbalanced -= system.gathered(body.divergence(terms[-1].copy()), rotation)
                unbalanced[:, n + self.k :] -= self._known_moments(order, known_arm)
            z = base.solve(unbalanced)
            v = z[:, n + self.k :] / system.plates.half_mm[:, None] / 2
            u = system.nodal_change(rotation, z)
            if order < orders:
                self._add(terms, u)
            u[:, system.plates.node] += known_arm
            found.append((u, z[:, n : n + self.k], v))
            self.v.append(v)
            self.arm.append(known_arm + self._turned(2 * skew(v)))
            self.q0.append(self._root(order))
        u, shift, half_spin = (np.array(part) for part in zip(*found, strict=True))
        return LoadSeries(u=u, shift=shift, half_spin=half_spin)

    def _turned(self, turn: FloatArray) -> FloatArray:
        return self.system.plates.turned(turn @ self.base.state.rotation)

    def _known_turn(self, order: int) -> FloatArray:
        """The part of this order's rotations that lower orders give, (m, k, 3, 3)."""
        turn = np.zeros((self.m, self.k, 3, 3))
        for i in range(1, order):
            turn += 2 * self.q0[i][..., None, None] * skew(self.v[order - i])
            turn += 2 * skew(self.v[i]) @ skew(self.v[order - i])
        return turn

    def _root(self, order: int) -> FloatArray:
        """This order of q₀ = √(1 − |v|²), (m, k)."""
        total = np.zeros((self.m, self.k))
        for i in range(1, order):
            total += np.einsum("mki,mki->mk", self.v[i], self.v[order - i]) + self.q0[i] * self.q0[order - i]
        return -total / 2

    def _known_moments(self, order: int, known_arm: FloatArray) -> FloatArray:
        """Moments of lower orders' forces about the plates' middles over their half-widths, (m, k, 3) [N]."""
        moments = np.cross(known_arm, self.force[0])
        for i in range(1, order):
            moments = moments + np.cross(self.arm[i], self.force[order - i])
        if not self.k:
            return np.zeros((self.m, 0, 3))
        return np.add.reduceat(moments, self.system.plates.starts, axis=1) / self.system.plates.half_mm[:, None]

    def _no_terms(self) -> tuple[FloatArray, ...]:
        at_points = (self.m, self.body.n_elements, len(self.body.reference.weights))
        H, scalar = np.zeros((3, 3, *at_points)), np.zeros(at_points)
        return H, H.copy(), scalar, scalar.copy(), scalar.copy(), H.copy()

    def _known_terms(self, order: int, known_u: FloatArray) -> tuple[FloatArray, ...]:
        """This order's F, cof F, J, 1/J, s and stress by lower orders and displacements (m, n_nodes, 3)."""
        F, cof, J = self.F, self.cof, self.J
        H = self.body.gradient(known_u)
        C = bilinear_cofactors(F[0], H)
        for i in range(1, (order + 1) // 2):
            C += bilinear_cofactors(F[i], F[order - i])
        if order % 2 == 0:
            C += cofactors(F[order // 2])
        D = np.einsum("ij...,ij...->...", cof[0], H)
        for j in range(1, order):  # J' = cof F : F'
            D += (j / order) * np.einsum("ij...,ij...->...", cof[order - j], F[j])
        total = D * self.inverse[0]
        for j in range(1, order):
            total += J[j] * self.inverse[order - j]
        inverse = -self.inverse[0] * total
        s = self.body.pressures(D) @ self.functions - self.mu * inverse
        stress = self.mu * H + self.s[0] * C + s * cof[0]
        for j in range(1, order):
            stress += self.s[j] * cof[order - j]
        return H, C, D, inverse, s, stress

    def _add(self, known: tuple[FloatArray, ...], u: FloatArray) -> None:
        """Complete this order's terms by what is linear in its displacements."""
        H, C, D, inverse, s, stress = known
        dF = self.body.gradient(u)
        dJ = np.einsum("ij...,ij...->...", self.cof[0], dF)
        dC = bilinear_cofactors(self.F[0], dF)
        d_inverse = -(self.inverse[0] ** 2) * dJ
        ds = self.body.pressures(dJ) @ self.functions - self.mu * d_inverse
        stress += self.mu * dF + self.s[0] * dC + ds * self.cof[0]
        self.F.append(H + dF)
        self.cof.append(C + dC)
        self.J.append(D + dJ)
        self.inverse.append(inverse + d_inverse)
        self.s.append(s + ds)
        self.force.append(self.body.divergence(stress)[:, self.system.plates.node])


def quaternion_rotations(half_spin: FloatArray) -> FloatArray:
    """R = I + 2 q₀ [v] + 2 [v]², (..., 3, 3), of vector parts v (..., 3) shorter than 1.

    >>> quaternion_rotations(np.array([0.0, 0.0, np.sqrt(0.5)])).round(12) @ np.array([1.0, 0.0, 0.0])
    array([0., 1., 0.])
    """
    q0 = np.sqrt(np.maximum(1 - (half_spin**2).sum(axis=-1), 0.0))[..., None, None]
    V = skew(half_spin)
    return np.eye(3) + 2 * q0 * V + 2 * V @ V
