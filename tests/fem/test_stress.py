"""Stress at points: exact where it is uniform, whatever the elements; equilibrium where it is not."""

import numpy as np
import pytest
from skfem import Basis, ElementTetP2, MeshTet

from fem.boxes.boxes import Boxes
from fem.field import Field
from fem.kernel.factor import Factor, checked_solve, whole
from fem.kernel.loads import DeadLoad
from fem.rubber.body import RubberBody
from fem.system import System
from fem.tetrahedra.mixed import Elements
from geometry.design import Material

RUBBER = Material(young_mpa=6.1, poisson=0.49)
STRAIN = np.array([[0.02, 0.01, -0.03], [0.01, -0.05, 0.005], [-0.03, 0.005, 0.04]])
TURN = np.array([[0.0, 0.1, 0.2], [-0.1, 0.0, -0.3], [-0.2, 0.3, 0.0]])  #: rotation, which stresses nothing


def hooke(material, strain):
    lame, mu = material.lame_mpa
    tensor = lame * np.trace(strain) * np.eye(3) + 2 * mu * strain
    return tensor[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]


def fields(disordered_cube, u):
    """Sheared boxes and distorted tetrahedra, moved by u(points)."""
    lines = np.array([0.0, 1.0, 3.0, 4.0]), np.array([0.0, 2.0, 3.0]), np.array([0.0, 1.5, 2.0])
    meshes = [
        Boxes.between(lines, lean=(0.2, -0.1)),
        Elements.of_basis(Basis(disordered_cube, ElementTetP2()), np.zeros(disordered_cube.nelements, np.int64)),
    ]
    return [Field(mesh=mesh, displacement_mm=u(mesh.points_mm), material=[RUBBER]) for mesh in meshes]


def inner_points(field):
    share = np.random.default_rng(0).uniform(0, 1, (50, 4))
    own = field.points_mm[field.mesh.cells[np.random.default_rng(1).integers(len(field.mesh.cells), size=50), :4]]
    return np.einsum("pa,pai->pi", share / share.sum(axis=1)[:, None], own)


def test_quadratic_fields_are_given_back_at_points_with_their_slopes(disordered_cube):
    """Exact on straight-sided elements, inside, at corners and on faces."""

    def quadratic(points):
        x, y, z = points.T
        return np.stack([x * y, z**2 - x, y * z + 1], axis=-1)

    # of long flat tetrahedra the nearest centres are not those of the one that holds a point at its end
    flat = MeshTet.init_tensor(np.array([0.0, 100.0]), np.array([0.0, 1.0]), np.linspace(0, 1, 41))
    for field in (*fields(disordered_cube, quadratic), fields(flat, quadratic)[1]):
        points = np.vstack([inner_points(field), field.points_mm[::97]])
        x, y, z = points.T
        zero, one = np.zeros_like(x), np.ones_like(x)
        slopes = np.array([[y, -one, zero], [x, zero, z], [zero, 2 * z, y]]).swapaxes(1, 2)  # axis, point, component
        assert np.allclose(field.displacement_at(points), quadratic(points), rtol=0, atol=1e-10)
        assert np.allclose([rows @ field.displacement_mm for rows in field.slopes(points)], slopes, atol=1e-10)


def test_uniform_stress_is_exact_in_every_element(disordered_cube):
    def moved(points):
        u = points @ (STRAIN + TURN).T
        return np.stack([u, -2 * u], axis=-1)

    for field in fields(disordered_cube, moved):
        expected = hooke(RUBBER, STRAIN)
        assert np.abs(field.corner_stress[..., 0] - expected).max() < 1e-11 * np.abs(expected).max()
        found = field.stress_at(inner_points(field))
        assert np.abs(found[..., 1] + 2 * expected).max() < 1e-11 * np.abs(expected).max()


@pytest.mark.parametrize("poisson", [0.0, 0.4999])
def test_confined_compression_is_exact_at_any_incompressibility(poisson):
    """A column between frictionless walls: σ_zz = −p, σ_xx = σ_yy = −p ν/(1 − ν), by solving, not by interpolating."""
    boxes = Boxes.between([np.array([0.0, 1.0, 4.0]), np.array([0.0, 2.0, 4.0]), np.array([0.0, 1.0, 3.0])])
    material, load = Material(poisson=poisson), DeadLoad(center_mm=(2, 2), size_mm=(4, 4), traction_mpa=(0, 0, -2.0))
    system = System(RubberBody.of(boxes, [material]), [load])
    on_walls = np.isin(boxes.points_mm[system.free], (0.0, 4.0)) * [True, True, False]
    free = ~on_walls.ravel()
    x = np.zeros((len(free), 1))
    matrix = whole(system.matrix(system.rest_tangent()))[free][:, free]
    x[free], _ = checked_solve(Factor(matrix, definite=True), system.loads_on(system.rest()).reshape(-1, 1)[free])
    found = Field(mesh=boxes, displacement_mm=system.displaced(x)[0], material=[material]).corner_stress
    side = -2.0 * poisson / (1 - poisson)
    assert np.abs(found - [side, side, -2.0, 0.0, 0.0, 0.0]).max() < 1e-8  # rounding, times λ/μ = 5000 at ν = 0.4999
