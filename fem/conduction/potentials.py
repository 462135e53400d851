"""Conductances between terminals of a conductor by the potentials in it, at rest and deformed. Open this file first.

div(σ grad φ) = 0 with φ = 1 on one terminal and 0 on the others, insulating elsewhere. Deformation changes neither the
mesh nor the equation: σ is pulled back to the shape at rest.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from common.errors import DesignError
from fem.conduction.meshes import Hexahedra, unit_hexahedra
from fem.kernel.factor import Factor, checked_solve
from geometry.design import Electrics, Unit
from geometry.layout import FloatArray, pillar_widths

#: points (n, 3) [mm] at rest, in the unit's frame, to deformation gradients ∂x/∂X (n, 3, 3)
Deformation = Callable[[FloatArray], FloatArray]


class Accuracy(NamedTuple):
    """Two meshes of a unit, as `unit_hexahedra` takes them, and what the difference of their answers says."""

    coarse: tuple[int, int, bool, int]
    fine: tuple[int, int, bool, int]
    beyond: float  #: of the difference, what is added to the finer one's answer
    left: float  #: and what is taken for the error that this leaves


#: the limit by meshes of order 4 and 5 lies 0.13 to 0.19 beyond the finer one at rest, 0.10 to 0.15 where strained
AT_REST = Accuracy((2, 2, False, 0), (3, 3, False, 0), 0.16, 0.16)
STRAINED = Accuracy((2, 1, True, 0), (3, 2, True, 0), 0.16, 0.16)  #: strain varies across the pillars
NARROW = Accuracy((2, 1, False, 0), (3, 2, False, 0), 0.5, 0.2)  #: electrodes narrower than pillars: 0.32 to 0.68
#: electrodes' edges run through elements of round pillars: not smooth, so the whole change is the error
ROUND = Accuracy((2, 1, False, 6), (2, 2, False, 12), 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Piezoresistivity:
    """Change of an isotropic rubber's resistivity with strain, none by default.

    The resistivity tensor of the deformed rubber is ρ [1 + m₁₂ tr ε + (m₁₁ − m₁₂) ε] with the strain ε = (F Fᵀ − 1)/2:
    the two elastoresistance coefficients of an isotropic material (Mason and Thurston, J. Acoust. Soc. Am. 29 (1957)
    1096). At small strain a bar that stretches by e along the current and thins by e' changes its resistivity by
    m₁₁ e − 2 m₁₂ e' as a fraction.
    """

    along: float = 0.0  #: m₁₁, by strain along the current
    across: float = 0.0  #: m₁₂, by strain across it

    @classmethod
    def of(cls, electrics: Electrics) -> "Piezoresistivity":
        """That of a design's electrics."""
        return cls(along=electrics.elastoresistance_along, across=electrics.elastoresistance_across)


INERT = Piezoresistivity()  #: none


def pulled_back(F: FloatArray, piezoresistivity: Piezoresistivity = INERT) -> FloatArray:
    """Conductivity in the coordinates at rest, as a fraction of that at rest: (..., 3, 3), symmetric.

    J F⁻¹ F⁻ᵀ = J C⁻¹ with C = FᵀF of deformation gradients ∂x/∂X (..., 3, 3); with piezoresistivity
    J [(1 + m₁₂ tr E) C + (m₁₁ − m₁₂) C E]⁻¹, E = (C − 1)/2. A `DesignError` says that the rubber is turned inside out,
    or strained so far that its resistivity would not be above 0.

    Examples
    --------
    >>> np.diag(pulled_back(np.diag([2.0, 1.0, 1.0]))).tolist()
    [0.5, 2.0, 2.0]
    """
    J = np.linalg.det(F)
    if not np.all(J > 0):
        raise DesignError(f"a pillar is deformed inside out (J = {np.min(J):.3g}, must be above 0): lower the load.")
    C = F.swapaxes(-1, -2) @ F
    resistivity = C
    if piezoresistivity != INERT:
        along, across = piezoresistivity.along, piezoresistivity.across
        E = (C - np.eye(3)) / 2
        volumetric = np.trace(E, axis1=-2, axis2=-1)[..., None, None]
        resistivity = (1 + across * volumetric) * C + (along - across) * (C @ E)
        least = float(np.linalg.eigvalsh(resistivity).min(initial=np.inf))
        if not least > 0:
            raise DesignError(
                f"elastoresistance {along:g} along and {across:g} across leaves no resistivity above 0 at this strain: "
                "lower the load or the coefficients."
            )
    return J[..., None, None] * np.linalg.inv(resistivity)


@dataclass(frozen=True, eq=False, kw_only=True)
class Potentials:
    """Potentials in a conductor for 1 on each of n terminals and 0 on the others."""

    stiffness: sp.csr_matrix  #: of the unknowns
    unknowns: FloatArray  #: (n_unknowns, n)
    gradients: FloatArray  #: at the mesh's points, (n_points, 3, n) [1/mm]

    @cached_property
    def matrix(self) -> FloatArray:
        """Conductances between the terminals times the resistivity at rest, (n, n) [mm]; see `Conductances`."""
        return np.asarray(self.unknowns.T @ (self.stiffness @ self.unknowns))


class Conductor:
    """Potentials in a body on one mesh."""

    def __init__(self, mesh: Hexahedra) -> None:
        self.mesh = mesh

    def potentials(self, conductivity: FloatArray) -> Potentials:
        """Those of σ (n_points, 3, 3) at the mesh's points."""
        stiffness, phi = self.mesh.stiffness(conductivity), self.mesh.on_terminals.astype(np.float64)
        free = np.flatnonzero(~phi.any(axis=1))
        rows = stiffness[free]
        phi[free, :-1], _ = checked_solve(Factor(rows[:, free].tocsr(), definite=True), -(rows @ phi[:, :-1]))
        phi[free, -1] = 1 - phi[free, :-1].sum(axis=1)
        return Potentials(stiffness=stiffness, unknowns=phi, gradients=self.mesh.gradients(phi))

    def conductances(
        self, deformation: Deformation | None = None, piezoresistivity: Piezoresistivity = INERT
    ) -> FloatArray:
        """`Potentials.matrix` at rest or deformed."""
        if deformation is None:
            return self.at_rest.matrix
        return self.potentials(pulled_back(deformation(self.mesh.points_mm), piezoresistivity)).matrix

    @cached_property
    def at_rest(self) -> Potentials:
        """The potentials without deformation."""
        return self.potentials(np.broadcast_to(np.eye(3), (len(self.mesh.points_mm), 3, 3)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Conductances:
    """Conductances between a unit's n electrodes, the upper ones first, times the resistivity at rest."""

    matrix_mm: FloatArray  #: (n, n): currents into the electrodes by their potentials; symmetric, rows sum to 0
    error_estimate: FloatArray  #: relative, of the resistances of the pillars, (n_pillars,)
    pairs: Sequence[tuple[int, int]]  #: electrodes at both ends of each pillar

    @property
    def pillars_per_mm(self) -> FloatArray:
        """Resistances of the pillars over the resistivity, (n_pillars,), as an ideal crossbar reads them.

        One electrode at 1 V, the current into the other, all others and that one at 0 V: R = −1/Gᵢⱼ.
        """
        return pillars_per_mm(self.matrix_mm, self.pairs)


def pillars_per_mm(matrix_mm: FloatArray, pairs: Sequence[tuple[int, int]]) -> FloatArray:
    """Resistances of pillars over the resistivity, (..., n_pillars), from conductances (..., n, n)."""
    one, other = np.array(pairs).T
    return np.asarray(-1 / matrix_mm[..., one, other])


@dataclass(frozen=True, eq=False)
class UnitConductors:
    """A unit's pillars on a coarser and on a finer mesh, from whose answers the limit is extrapolated."""

    coarse: Conductor
    fine: Conductor
    accuracy: Accuracy

    def extrapolated(self, coarse: FloatArray, fine: FloatArray) -> FloatArray:
        """The limit of the answers on both meshes."""
        return fine + self.accuracy.beyond * (fine - coarse)

    def conductances(
        self, deformation: Deformation | None = None, piezoresistivity: Piezoresistivity = INERT
    ) -> Conductances:
        """Conductances at rest or deformed; parameters as of `unit_conductances`."""
        coarse, fine = (one.conductances(deformation, piezoresistivity) for one in (self.coarse, self.fine))
        pairs = self.fine.mesh.pairs
        change = np.abs(pillars_per_mm(coarse, pairs) / pillars_per_mm(fine, pairs) - 1)
        matrix_mm = self.extrapolated(coarse, fine)
        return Conductances(matrix_mm=matrix_mm, error_estimate=self.accuracy.left * change, pairs=pairs)


@cache
def unit_conductors(unit: Unit, strained: bool = False) -> UnitConductors:
    """The pillars of a unit without references on the meshes that they need."""
    if any(one.is_round for one in unit.layout.pillars):
        accuracy = ROUND
    elif unit.electrode_mm < max(pillar_widths(unit)):
        accuracy = NARROW
    else:
        accuracy = STRAINED if strained else AT_REST
    coarse, fine = (Conductor(unit_hexahedra(unit, *mesh)) for mesh in (accuracy.coarse, accuracy.fine))
    return UnitConductors(coarse, fine, accuracy)


def unit_conductances(
    unit: Unit, deformation: Deformation | None = None, piezoresistivity: Piezoresistivity = INERT
) -> Conductances:
    """Conductances between a unit's electrodes, references apart, at rest or deformed, extrapolated from two meshes.

    `deformation` takes points (n, 3) at rest in the unit's frame [mm] to ∂x/∂X (n, 3, 3); default: at rest. A
    `DesignError` as of `unit_hexahedra`, and if a pillar is deformed inside out.
    """
    return unit_conductors(unit.body, strained=deformation is not None).conductances(deformation, piezoresistivity)


def strain_derivatives(conductor: Conductor, piezoresistivity: Piezoresistivity = INERT) -> FloatArray:
    """First derivatives at rest of a unit's resistances over ρ by ∂uₐ/∂X_b at the mesh's points.

    Shape (n_pillars, n_points, 3, 3), volumes included: δR/ρ is their product's sum [1/mm]. R is self-adjoint:
    δ(1/R) = −∫ ∇φᵢ·δσ∇φⱼ dV, with the potentials at rest of the pillar's two electrodes.
    """
    rest, mesh, piezo = conductor.at_rest, conductor.mesh, piezoresistivity
    derivatives = []
    for i, j in mesh.pairs:
        one, other = rest.gradients[..., i], rest.gradients[..., j]
        dot = (one * other).sum(axis=1)[:, None, None]
        cross = one[:, :, None] * other[:, None, :]
        # δσ = (1 − m₁₂) tr g − (1 + (m₁₁ − m₁₂)/2) (g + gᵀ) for g = grad u
        slope = (1 - piezo.across) * dot * np.eye(3)
        slope = slope - (1 + (piezo.along - piezo.across) / 2) * (cross + cross.swapaxes(1, 2))
        derivatives.append(slope * mesh.weight_mm3[:, None, None] / rest.matrix[i, j] ** 2)
    return np.array(derivatives)


def second_derivatives(
    conductor: Conductor, gradient: FloatArray, piezoresistivity: Piezoresistivity = INERT
) -> FloatArray:
    """Second-order part of conductances, relative: −Gᵢⱼ of a pillar is that at rest times 1 + r·a + aᵀ S a.

    a are amplitudes of m displacements, whose ∂uₐ/∂X_b at the mesh's points are the gradient (n_points, 3, 3, m).
    Returns S of each pillar, symmetric, (n_pillars, m, m).

    With H the gradient, C = (1 + H)ᵀ(1 + H) and σ = (1 + tr H) [(1 + m₁₂ tr E) C + (m₁₁ − m₁₂) C E]⁻¹ = 1 + σ₁ + σ₂:
    the volume changes by div u as in linear elasticity, not by det(1 + H), whose second-order part no rubber has.
    G₂ = ∫ ∇φᵢ·σ₂∇φⱼ − r(φᵢ)ᵀ K⁻¹ r(φⱼ) with r(φ) the residual of σ₁ ∇φ and K that of the potentials between the
    terminals.
    """
    q, difference = piezoresistivity.across, piezoresistivity.along - piezoresistivity.across
    p = 1 + difference / 2
    mesh, m = conductor.mesh, gradient.shape[3]
    rest = conductor.at_rest
    slopes, weight, free = rest.gradients, mesh.weight_mm3, np.flatnonzero(~mesh.on_terminals.any(axis=1))
    S, tau = gradient + gradient.swapaxes(1, 2), np.trace(gradient, axis1=1, axis2=2)  # (n, 3, 3, m), (n, m)
    stretched = [np.einsum("nabm,nb->nam", S, slope) for slope in np.moveaxis(slopes, -1, 0)]
    turned = [np.einsum("nabm,nb->nam", gradient, slope) for slope in np.moveaxis(slopes, -1, 0)]
    fluxes = ((1 - q) * tau[:, None] * slopes[..., t, None] - p * stretched[t] for t in range(slopes.shape[2]))
    residuals, n_first = [mesh.divergence(flux)[free] for flux in fluxes], 1 + max(i for i, _ in mesh.pairs)
    inner = rest.stiffness[free][:, free].tocsr()
    solved, _ = checked_solve(Factor(inner, definite=True), np.hstack(residuals[:n_first]))
    answers = np.hsplit(solved, n_first)  # of the pillars' first ends
    found = []
    for i, j in mesh.pairs:
        dot = weight * (slopes[..., i] * slopes[..., j]).sum(axis=1)
        across = np.einsum("na,nam->nm", slopes[..., i], stretched[j])

        def product(one: FloatArray, other: FloatArray, w: FloatArray) -> FloatArray:
            return (one * w.reshape(-1, *[1] * (one.ndim - 1))).reshape(-1, m).T @ other.reshape(-1, m)

        G = -p * product(turned[i], turned[j], weight) - q / 2 * product(gradient, gradient, dot)
        G += (p**2 - difference / 2) * product(stretched[i], stretched[j], weight)
        G += (2 * p * q - q - p) * product(tau, across, weight) + (q**2 - q) * product(tau, tau, dot)
        G -= answers[i].T @ residuals[j]
        found.append((G + G.T) / 2 / rest.matrix[i, j])
    return np.array(found)
