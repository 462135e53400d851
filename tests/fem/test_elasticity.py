"""Elasticity against scikit-fem's own matrices, closed forms, manufactured solutions and its own symmetries."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from skfem import Basis, ElementTetP2, LinearForm, MeshTet

from fem.factor import Factor, whole
from fem.tetrahedra.mixed import TaylorHood, taylor_hood
from fem.tetrahedra.patch import PatchError, patch_integrals
from fem.tetrahedra.system import TetrahedralSystem
from geometry.design import Material
from tests.fem.scenes import box_mesh


def one_region(mesh: MeshTet) -> np.ndarray:
    return np.zeros(mesh.nelements, dtype=int)


def stiffness(body: TaylorHood) -> sp.csr_matrix:
    return whole(TetrahedralSystem(body, []).rest_tangent())


def solved_with(body: TaylorHood, prescribed: np.ndarray, forces: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Nodal displacements (N·3,) when those flagged in `known` are prescribed; the base is among them."""
    K = stiffness(body).tocsc()
    u = np.where(known, prescribed, 0.0)
    of_free = np.concatenate([known[body.free], np.zeros(body.n_pressure, dtype=bool)])
    start = np.concatenate([u[body.free], np.zeros(body.n_pressure)])
    rhs = np.concatenate([forces[body.free], np.zeros(body.n_pressure)]) - K @ start
    x = start.copy()
    x[~of_free] = Factor(K[~of_free][:, ~of_free].tocsr()).solve(rhs[~of_free, None])[:, 0]
    u[body.free] = x[: len(body.free)]
    return u


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


@pytest.mark.parametrize("rectangle", [[8.0, 8.0, 11.0, 9.0], [20.0, 0.0, 21.0, 1.0], [-1e-3, 0.0, 5.0, 5.0]])
def test_a_patch_off_the_body_is_refused_by_name(rectangle):
    basis = Basis(box_mesh((2, 2, 2), (10.0, 10.0, 4.0)), ElementTetP2(), intorder=2)
    with pytest.raises(PatchError, match=r"of its .* mm² on the body's top face: move or shrink it"):
        patch_integrals(basis, np.array([rectangle]))


def _manufactured(nu: float, n: int) -> float:
    """L2 error of the nodal values of a smooth field that vanishes on the boundary of a cube of side π.

    u = curl-free + divergence-free mix: u = (s, 0, 0), s = sin x sin y sin z, so that
    −div σ = −μ Δu − (λ+μ) ∇(∂ₓ s).
    """
    mesh = box_mesh((n, n, n), (np.pi, np.pi, np.pi))
    material = Material(young_mpa=1.0, poisson=nu)
    lame, mu = material.lame_mpa
    region = one_region(mesh)
    body = taylor_hood(mesh, [material], region)
    quadrature = Basis(mesh, body.basis.elem, intorder=6)
    X, Y, Z = quadrature.global_coordinates()
    s = np.sin(X) * np.sin(Y) * np.sin(Z)
    load = np.stack([
        3 * mu * s + (lame + mu) * s,
        -(lame + mu) * np.cos(X) * np.cos(Y) * np.sin(Z),
        -(lame + mu) * np.cos(X) * np.sin(Y) * np.cos(Z),
    ])  # fmt: skip
    forces = np.stack([LinearForm(lambda v, w: w.f * v).assemble(quadrature, f=along) for along in load], axis=1)
    x, y, z = body.basis.doflocs
    edge = [np.isclose(c, 0.0) | np.isclose(c, np.pi) for c in (x, y, z)]
    known = (edge[0] | edge[1] | edge[2]).repeat(3)
    u = solved_with(body, np.zeros(body.basis.N * 3), forces.ravel(), known).reshape(-1, 3)
    at_points = np.stack([quadrature.interpolate(along) for along in u.T])
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
