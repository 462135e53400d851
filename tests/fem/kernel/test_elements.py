"""Elements filled with rubber: the patch test, scikit-fem's own assembly, rates of convergence, locking."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from skfem import BilinearForm, CellBasis, asm
from skfem.helpers import dot, grad

from fem.kernel.factor import Factor, checked_solve, whole
from fem.kernel.plates import turns
from fem.kernel.system import System
from geometry.design import Material
from geometry.law import LAWS
from tests.fem.kernel.bodies import KINDS, RUBBER, body_of, model

SLOPES = np.array([[0.05, 0.1, -0.2], [0.02, -0.1, 0.05], [-0.1, 0.05, 0.2]])  #: ∂u/∂X of a uniform deformation


def pressures_of(body, theta):
    """Pressures of a uniform change of volume, as iterates where they are continuous."""
    return np.full(body.pressures_shape, body.law.lame_mpa[0, 0] * theta) if body.is_mixed else None


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("kind", KINDS)
def test_uniform_deformation_is_exact(kind, name):
    """The patch test: no force on inner nodes, the law's P e_z A on the top, and W + λθ²/2 in every mm³."""
    body = body_of(kind, [model(name)])
    u, law = body.points_mm @ SLOPES.T, body.law.part(slice(1))
    strain = law.strain(SLOPES[..., None, None])
    theta, p = float(strain.theta[0, 0]), pressures_of(body, float(strain.theta[0, 0]))
    pressure = law.lame_mpa * theta
    P = law.stress(strain, pressure)[..., 0, 0]
    forces, found, _ = body.forces(u[None], p)
    assert np.abs(found.H - SLOPES[:, :, None, None, None]).max() < 1e-12
    inner = np.setdiff1d(np.arange(body.n_nodes), body.basis.get_dofs().all())
    assert len(inner)
    assert np.abs(forces[0, inner]).max() < 1e-11 * np.abs(P).max()
    on_top = body.points_mm[:, 2] > 4.0 - 1e-9
    assert np.allclose(forces[0, on_top].sum(axis=0), 16 * P[:, 2], atol=1e-11 * np.abs(P).max())
    energy = 64 * float((law.energy(strain) + pressure * theta / 2)[0, 0])
    assert body.energy_mj(u, p) == pytest.approx(energy, rel=1e-11)
    if body.is_mixed:
        assert np.abs(body.missing_volume(found, p)).max() < 1e-12


@pytest.mark.parametrize("kind", KINDS)
def test_turning_a_body_stores_nothing(kind):
    """By any angle at finite strain, by a small one in linear elasticity."""
    turn = turns(np.array([0.4, -1.1, 0.7]))
    for name in LAWS:
        body = body_of(kind, [model(name)])
        slopes = turn - turn.T if name == "linear" else turn
        u, p = body.points_mm @ slopes.T, pressures_of(body, 0.0)
        assert np.abs(body.forces(u[None], p)[0]).max() < 1e-11
        assert abs(body.energy_mj(u, p)) < 1e-11


@pytest.mark.parametrize("kind", ["mapped 2", "mapped 3", "tetrahedra 2"])
def test_forces_are_those_of_scikit_fem_s_own_assembly(kind):
    """K = ∫ 2μ ε:ε + Bᵀ C⁻¹ B from bilinear forms in every component, of rubbers that differ between hexahedra."""
    lines = np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 3.0]), np.array([0.0, 1.5, 3.0])
    materials = [RUBBER] if kind.startswith("tetrahedra") else [RUBBER, Material(young_mpa=2.0, poisson=0.3)]
    body = body_of(kind, materials, lines)
    mesh, order = body.basis.mesh, 2 * body.basis.elem.maxdeg + 1 - body.is_mixed
    shown, pressed = (CellBasis(mesh, elem, intorder=order) for elem in (body.basis.elem, body.pressure))
    mu, lame = body.law.mu_mpa, body.law.lame_mpa
    u = np.random.default_rng(0).normal(size=(body.n_nodes, 3))
    expected, volume = np.zeros_like(u), np.zeros(pressed.N)
    B = [asm(BilinearForm(lambda u, q, w, i=i: grad(u)[i] * q), shown, pressed) for i in range(3)]
    for i, j in product(range(3), range(3)):
        form = BilinearForm(lambda u, v, w, i=i, j=j: mu * ((i == j) * dot(grad(u), grad(v)) + grad(u)[i] * grad(v)[j]))
        expected[:, i] += asm(form, shown) @ u[:, j]
    volume = sum(B[i] @ u[:, i] for i in range(3))
    mass = asm(BilinearForm(lambda p, q, w: p * q / lame), pressed)
    p = Factor(mass.tocsr(), definite=True).solve(volume[:, None])[:, 0]
    expected += np.stack([B[i].T @ p for i in range(3)], axis=1)
    found = body.forces(u[None], p if body.is_mixed else None)[0][0]
    assert np.abs(found - expected).max() < 1e-11 * np.abs(expected).max()


def kelvin(points, poisson):
    """A displacement without forces inside (Papkovich and Neuber): (3 − 4ν) ψ − Σₖ xₖ ∇ψₖ of harmonic ψ."""
    sin, cos, exp, zero = np.sin(points), np.cos(points), np.exp(points), np.zeros_like(points[0])
    potential = np.stack([exp[0] * sin[2], exp[1] * sin[0], exp[2] * sin[1]])
    slopes = np.stack([
        np.stack([exp[0] * sin[2], zero, exp[0] * cos[2]]),
        np.stack([exp[1] * cos[0], exp[1] * sin[0], zero]),
        np.stack([zero, exp[2] * cos[1], exp[2] * sin[1]]),
    ])  # fmt: skip
    return (3 - 4 * poisson) * potential - np.einsum("k...,ki...->i...", points, slopes)


def error_of(kind, poisson, halvings):
    """L2 error of the kernel's answer in a cube whose sides move as `kelvin` says, relative; of n³ elements, halved."""
    n = 1 if kind.startswith("grid") else 2
    lines = 3 * (np.linspace(0.0, 1.0, n + 1),)
    body = body_of(kind, [Material(young_mpa=1.0, poisson=poisson)], lines, halvings)
    system = System(body)
    given = body.filled(kelvin(body.points_mm.T, poisson).T[None])[0]  # insides at rest, where they are eliminated
    misfit = system.misfit(replace(system.rest(), u=given), 0.0)
    inner = np.ones(body.n_nodes, dtype=bool)
    inner[body.basis.get_dofs().all()] = False
    kept = np.concatenate([inner[system.free].repeat(3), np.ones(system.n_mixed, dtype=bool)])
    rhs = np.concatenate([misfit.unbalanced.ravel(), misfit.pressures.ravel()[: system.n_mixed]])
    y = np.zeros((system.n_unknowns, 1))
    matrix = whole(system.rest_matrix()).tocsr()[kept][:, kept]
    y[kept], _ = checked_solve(Factor(matrix, definite=not system.n_mixed), rhs[kept, None])
    u = body.filled(system.nodal_change(system.rest().rotation, y[: 3 * system.n_blocks].reshape(1, -1, 3)) + given)[0]
    basis = CellBasis(body.basis.mesh, body.basis.elem, intorder=2 * body.basis.elem.maxdeg + 4)
    exact = kelvin(np.asarray(basis.global_coordinates()), poisson)
    off = np.stack([basis.interpolate(along) for along in u.T]) - exact
    return np.sqrt((off**2 * basis.dx).sum() / (exact**2 * basis.dx).sum())


@pytest.mark.parametrize("kind", ["grid 2", "grid 3", "grid 4", "mapped 2", "mapped 3", "tetrahedra 2"])
def test_smooth_solutions_converge_at_the_order_of_the_elements_and_do_not_lock(kind):
    """L2 errors fall as h^(k+1), less 0.5 on meshes as coarse; as much at ν = 0.4999999 as at 0.3, to a factor of 2."""
    errors = np.array([[error_of(kind, poisson, n) for n in (0, 1)] for poisson in (0.3, 0.4999999)])
    assert (np.log2(errors[:, 0] / errors[:, 1]) > int(kind.split()[1]) + 0.5).all()
    assert (errors[1] < 2 * errors[0]).all()
