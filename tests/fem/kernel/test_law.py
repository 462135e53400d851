"""Laws of rubber: known deformations, stress as slope of the energy, tangents as slopes of the stress."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from common.errors import DesignError
from fem.kernel.elements import hexahedra
from fem.kernel.rubber import Rubber
from fem.meshes.grid import Grid
from geometry.design import Material
from geometry.law import LAWS

LINES = np.array([0.0, 1.0, 3.0, 4.0]), np.array([0.0, 2.0, 2.5, 4.0]), np.array([0.0, 1.5, 4.0])
RUBBER = Material(young_mpa=6.1, poisson=0.49, model="neo-hookean")
LEAN = (0.3, -0.2)
FINITE = ["neo-hookean", "mooney-rivlin", "yeoh"]
STIFFENING = 0.3  #: c₂/c₁ of Yeoh's law


def body(lean: tuple[float, float] = LEAN, **changes) -> Rubber:
    return Rubber.of(Grid(LINES, lean).mesh, hexahedra(2), [rubber(**changes)])


def rubber(**changes) -> Material:
    own = {"yeoh": {"stiffening": STIFFENING}, "mooney-rivlin": {"second_ratio": 0.3}}.get(changes.get("model", ""), {})
    return replace(RUBBER, **own, **changes)


def homogeneous(block: Rubber, F: np.ndarray) -> np.ndarray:
    """Displacements (1, n, 3) of x = F X."""
    return (block.points_mm @ (F - np.eye(3)).T)[None]


@pytest.mark.parametrize("name", LAWS)
def test_stress_and_tangent_of_a_law_are_slopes_and_hooke_s_at_small_strain(name):
    """∂ψ/∂F = P and ∂P/∂F = A, of ψ = W + p θ with p fixed; central differences of step 1e-5."""
    law, hooke = (LAWS[one].of([rubber(model=one)], np.ones((1, 1))) for one in (name, "linear"))
    rng, step = np.random.default_rng(1), 1e-5
    H, change = 0.2 * rng.standard_normal((2, 3, 3, 7))
    ahead, behind = (law.strain(H + sign * step * change) for sign in (1, -1))
    strain, p = law.strain(H), rng.standard_normal(7)
    slope = (law.energy(ahead) - law.energy(behind) + p * (ahead.theta - behind.theta)) / (2 * step)
    assert np.allclose((law.stress(strain, p) * change).sum(axis=(0, 1)), slope, atol=1e-8)
    slope = (law.stress(ahead, p) - law.stress(behind, p)) / (2 * step)
    assert np.allclose(np.einsum("iJjL...,jL...->iJ...", law.tangent(strain, p), change), slope, atol=1e-8)
    rest, zero = law.strain(np.zeros((3, 3, 1))), np.zeros(1)
    assert np.allclose(law.tangent(rest, zero), hooke.tangent(rest, zero), atol=1e-12)
    assert np.allclose(law.stress(rest, zero), 0.0)


@pytest.mark.parametrize("model", FINITE)
def test_bar_in_tension_follows_the_closed_form(model):
    """A bar of stretch s and sides a, free of stress sideways; principal stresses of the law by hand.

    Neo-Hookean: P_k = μ (λ_k − 1/λ_k) + λ (J − 1) J/λ_k. Mooney-Rivlin, with c₁ = 0.35 μ, c₂ = 0.15 μ: P_k = 2 c₁ λ_k
    + 2 c₂ λ_k (I₁ − λ_k²) − 2 (c₁ + 2 c₂)/λ_k + (λ − 4 c₂) (J − 1) J/λ_k. With c₂ = 0 the one is the other. Yeoh's is
    the neo-Hookean one of μ (1 + 2 k (I₁ − 3 − 2 ln J)).
    """
    lame, mu = RUBBER.lame_mpa
    c1, c2 = (0.35 * mu, 0.15 * mu) if model == "mooney-rivlin" else (0.5 * mu, 0.0)
    k = STIFFENING if model == "yeoh" else 0.0

    def stress(i: int, a: float, stretch: float) -> float:
        own, J = np.array([a, a, stretch]), a * a * stretch
        bent = 2 * c1 * own[i] + 2 * c2 * own[i] * ((own**2).sum() - own[i] ** 2)
        stiffer = 1 + 2 * k * ((own**2).sum() - 3 - 2 * np.log(J))
        return stiffer * (bent - 2 * (c1 + 2 * c2) / own[i]) + (lame - 4 * c2) * (J - 1) * J / own[i]

    block = body((0.0, 0.0), model=model)
    z = block.points_mm[:, 2]
    for stretch in (0.6, 2.0):
        a = brentq(lambda a, s: stress(0, a, s), 0.3, 3.0, args=(stretch,), xtol=1e-14)
        forces, strain, pressures = block.forces(homogeneous(block, np.diag([a, a, stretch])))
        assert np.allclose(forces[0, z == 4.0].sum(axis=0), [0.0, 0.0, 16.0 * stress(2, a, stretch)], atol=1e-11)
        assert np.abs(forces[0, (z > 0) & (z < 4.0)]).max() < 1e-11  # also on the sides
        assert np.allclose(pressures[0, :, 0], lame * (a * a * stretch - 1))
        assert np.allclose(strain.J, a * a * stretch)


@pytest.mark.parametrize("model", LAWS)
@pytest.mark.parametrize("poisson", [0.2, 0.4999])
def test_forces_are_slopes_of_the_energy(poisson, model):
    block = body(poisson=poisson, model=model)
    u, v = np.random.default_rng(3).normal(size=(2, block.n_nodes, 3)) * 0.03
    forces, strain, _ = block.forces(u[None])
    assert strain.J.min() > 0
    step = 1e-5
    slope = (block.energy_mj(u + step * v) - block.energy_mj(u - step * v)) / (2 * step)
    assert np.isclose((forces[0] * v).sum(), slope, rtol=1e-6)  # of the difference quotient


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"model": "yeoh", "second_ratio": 0.3}, "second_ratio=0.3 is of model = 'mooney-rivlin', not yeoh"),
        ({"model": "mooney-rivlin", "second_ratio": 1.5}, "second_ratio"),
        ({"model": "mooney-rivlin", "poisson": 0.1}, "poisson=0.1 is below 0.143, where mooney-rivlin"),
    ],
)
def test_ratios_that_make_no_sense_are_refused(given, says):
    """Below ν = r / (1 + 2 r) the coefficient λ/2 − 2 c₂ of (J − 1)² is below 0."""
    with pytest.raises(DesignError, match=says):
        Material(**given)
