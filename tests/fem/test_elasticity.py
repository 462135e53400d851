"""Elasticity against scikit-fem's own matrices, closed forms, manufactured solutions and its own symmetries."""

from dataclasses import replace

import numpy as np
import pytest
from skfem import Basis, ElementTetP2, LinearForm

from fem.kernel.factor import Factor, whole
from fem.tetrahedra.mixed import taylor_hood
from fem.tetrahedra.patch import PatchError, patch_integrals
from fem.tetrahedra.system import TetrahedralSystem
from geometry.design import Material
from tests.fem.scenes import box_mesh

RECTANGLES = np.array([[0.0, 0.0, 10.0, 10.0], [1.3, 2.1, 4.7, 9.9], [4.9, 4.9, 5.1, 5.1], [0.0, 9.0, 10.0, 10.0]])


def test_polynomials_are_integrated_exactly_over_rectangles_of_the_top_face():
    """∫ xᵃ yᵇ by its closed form, for every power an element can hold, to rounding; nodes below have no part in it."""
    basis = Basis(box_mesh((4, 5, 2), (10.0, 10.0, 3.0)), ElementTetP2(), intorder=2)
    integrals = patch_integrals(basis, RECTANGLES)
    x, y, z = basis.doflocs
    x0, y0, x1, y1 = RECTANGLES.T
    for a in range(3):
        for b in range(3 - a):
            exact = (x1 ** (a + 1) - x0 ** (a + 1)) / (a + 1) * (y1 ** (b + 1) - y0 ** (b + 1)) / (b + 1)
            assert np.allclose(integrals @ (x**a * y**b * (z == 3.0)), exact, rtol=1e-12)
            assert np.allclose(integrals @ (x**a * y**b), exact, rtol=1e-12)
    with pytest.raises(PatchError, match=r"of its .* mm² on the body's top face: move or shrink it"):
        patch_integrals(basis, np.array([[-1e-3, 0.0, 5.0, 5.0]]))


def _manufactured(nu: float, n: int) -> float:
    """L2 error of u = (s, 0, 0), s = sin x sin y sin z, 0 on a cube's sides: −div σ = −μ Δu − (λ+μ) ∇(∂ₓ s)."""
    mesh = box_mesh((n, n, n), (np.pi, np.pi, np.pi))
    material = Material(young_mpa=1.0, poisson=nu)
    lame, mu = material.lame_mpa
    body = taylor_hood(mesh, [material], np.zeros(mesh.nelements, dtype=int))
    quadrature = Basis(mesh, body.basis.elem, intorder=6)
    X, Y, Z = quadrature.global_coordinates()
    s = np.sin(X) * np.sin(Y) * np.sin(Z)
    load = np.stack([
        3 * mu * s + (lame + mu) * s,
        -(lame + mu) * np.cos(X) * np.cos(Y) * np.sin(Z),
        -(lame + mu) * np.cos(X) * np.sin(Y) * np.cos(Z),
    ])  # fmt: skip
    forces = np.stack([LinearForm(lambda v, w: w.f * v).assemble(quadrature, f=along) for along in load], axis=1)
    inside = ~np.any([np.isclose(c, 0.0) | np.isclose(c, np.pi) for c in body.basis.doflocs], axis=0).repeat(3)
    kept = np.concatenate([inside[body.free], np.ones(body.n_pressure, dtype=bool)])
    rhs = np.concatenate([forces.ravel()[body.free], np.zeros(body.n_pressure)])[kept, None]
    K = whole(TetrahedralSystem(body, []).rest_tangent()).tocsc()[kept][:, kept]
    u = np.zeros(body.basis.N * 3)
    u[inside] = Factor(K.tocsr()).solve(rhs)[: -body.n_pressure, 0]
    at_points = np.stack([quadrature.interpolate(along) for along in u.reshape(-1, 3).T])
    at_points[0] -= s
    return float(np.sqrt((at_points**2 * quadrature.dx).sum()))


def test_manufactured_solution_converges_at_the_right_rate():
    """L2 error falls as h³, without locking near ν = 0.5; coarse meshes must show at least a rate of 2.65."""
    ratio = _manufactured(0.4999, 3) / _manufactured(0.4999, 5)
    assert np.log(ratio) / np.log(5 / 3) > 2.65


def test_the_tangent_is_the_derivative_of_the_forces(disordered_cube):
    """At finite strain and in two rubbers: central differences of 1e-5 mm, whose own error is some 1e-9."""
    rubbers = [Material(model="neo-hookean"), Material(young_mpa=2.0, poisson=0.3, model="neo-hookean")]
    body = taylor_hood(disordered_cube, rubbers, np.arange(disordered_cube.nelements) % 2)
    rng = np.random.default_rng(0)
    system = TetrahedralSystem(body, [])
    u, p = system.displaced(0.05 * rng.normal(size=(body.n_unknowns, 1)))[0], rng.normal(size=body.n_pressure)
    direction = rng.normal(size=(body.n_unknowns, 1))
    along, of_p = system.displaced(direction)[0], direction[len(body.free) :, 0]
    found = []
    for sign in (-1, 1):
        forces, volumes, least = body.internal_forces(u + sign * 1e-5 * along, p + sign * 1e-5 * of_p)
        assert least > 0
        found.append(np.concatenate([forces.ravel()[body.free], volumes]))
    state = replace(system.rest(), u=u, p=p)
    expected = whole(system.tangent(state, 0.0, np.zeros_like(u))) @ direction[:, 0]
    assert np.abs((found[1] - found[0]) / 2e-5 - expected).max() < 1e-6 * np.abs(expected).max()
