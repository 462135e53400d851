"""First and second derivatives of a unit's resistances by the displacement gradient in its pillars, at rest."""

import numpy as np
import scipy.sparse as sp

from fem.conduction.conductivity import Piezoresistivity
from fem.conduction.potentials import Conductor
from fem.factor import Factor, checked_solve
from geometry.layout import FloatArray


def strain_derivatives(conductor: Conductor, piezoresistivity: Piezoresistivity | None = None) -> FloatArray:
    """First derivatives at rest of a unit's resistances over ρ by displacement gradients at the mesh's points.

    R is self-adjoint: δ(1/R) = −∫ ∇φᵢ·δσ∇φⱼ dV, with the potentials at rest of the pillar's two electrodes.

    Returns
    -------
    array, shape (n_pillars, n_points, 3, 3)
        By ∂uₐ/∂X_b at each point, volumes included: δR/ρ is their product's sum [1/mm].
    """
    rest, mesh, piezo = conductor.at_rest, conductor.mesh, piezoresistivity or Piezoresistivity()
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
    conductor: Conductor, gradient: FloatArray, piezoresistivity: Piezoresistivity | None = None
) -> FloatArray:
    """Second-order part of conductances, relative: −Gᵢⱼ of a pillar is that at rest times 1 + r·a + aᵀ S a.

    Parameters
    ----------
    conductor : Conductor
        The pillars of a unit.
    gradient : array, shape (n_points, 3, 3, m)
        ∂uₐ/∂X_b of m displacements at the mesh's points; a are their amplitudes.
    piezoresistivity : Piezoresistivity, optional

    Returns
    -------
    array, shape (n_pillars, m, m)
        S of each pillar, symmetric.

    Notes
    -----
    With H the gradient, C = (1 + H)ᵀ(1 + H) and σ = (1 + tr H) [(1 + m₁₂ tr E) C + (m₁₁ − m₁₂) C E]⁻¹ = 1 + σ₁ + σ₂:
    the volume changes by div u as in linear elasticity, not by det(1 + H), whose second-order part no rubber has.
    G₂ = ∫ ∇φᵢ·σ₂∇φⱼ − r(φᵢ)ᵀ K⁻¹ r(φⱼ) with r(φ) the residual of σ₁ ∇φ and K that of the potentials between the
    terminals.
    """
    piezo = piezoresistivity or Piezoresistivity()
    q, difference = piezo.across, piezo.along - piezo.across
    p = 1 + difference / 2
    mesh, m = conductor.mesh, gradient.shape[3]
    rest = conductor.at_rest
    phi, slopes, weight = rest.potentials, rest.gradients, mesh.weight_mm3
    free = np.flatnonzero(~((phi == 0) | (phi == 1)).all(axis=1))
    S, tau = gradient + gradient.swapaxes(1, 2), np.trace(gradient, axis1=1, axis2=2)  # (n, 3, 3, m), (n, m)
    stretched = [np.einsum("nabm,nb->nam", S, slope) for slope in np.moveaxis(slopes, -1, 0)]
    turned = [np.einsum("nabm,nb->nam", gradient, slope) for slope in np.moveaxis(slopes, -1, 0)]
    n_elements, n = mesh.elements.shape
    gather = sp.csr_matrix((np.ones(mesh.elements.size), (mesh.elements.ravel(), np.arange(mesh.elements.size))))
    gather = (mesh.constraint.T @ gather)[free]
    by_element = mesh.gradient.reshape(n_elements, -1, n).swapaxes(1, 2)

    def residual(t: int) -> FloatArray:
        flux = weight[:, None, None] * ((1 - q) * tau[:, None] * slopes[..., t, None] - p * stretched[t])
        return np.asarray(gather @ (by_element @ flux.reshape(n_elements, -1, m)).reshape(-1, m))

    residuals, n_first = [residual(t) for t in range(slopes.shape[2])], 1 + max(i for i, _ in mesh.pairs)
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
