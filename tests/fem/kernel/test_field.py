"""Displacement and stress at points: exact where they are polynomials, whatever the elements; cells for files."""

from dataclasses import replace

import numpy as np
import pytest
from skfem import MeshTet

from fem.kernel.elements import taylor_hood
from fem.kernel.factor import Factor, checked_solve, whole
from fem.kernel.field import Field
from fem.kernel.loads import DeadLoad
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from fem.meshes.tetrahedra import Tetrahedra
from fem.pictures.parts import QUADRATIC_TETRAHEDRON, TRIQUADRATIC, quadratic
from geometry.design import Material
from tests.fem.kernel.bodies import KINDS, RUBBER, body_of, places_of

STRAIN = np.array([[0.02, 0.01, -0.03], [0.01, -0.05, 0.005], [-0.03, 0.005, 0.04]])
TURN = np.array([[0.0, 0.1, 0.2], [-0.1, 0.0, -0.3], [-0.2, 0.3, 0.0]])  #: rotation, which stresses nothing
LOCATED = [kind for kind in KINDS if not kind.startswith("mapped")]
OTHER = Material(young_mpa=20.0, poisson=0.3)
SHARED = np.random.default_rng(0).dirichlet(np.ones(4), 50)


def hooke(rubber):
    """Stress of the strain, in the order of components."""
    lame, mu = rubber.lame_mpa
    return (lame * np.trace(STRAIN) * np.eye(3) + 2 * mu * STRAIN)[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]


def field_of(kind, u, materials=(RUBBER,)):
    """A body moved by u(points)."""
    body = body_of(kind, materials)
    return Field(places=places_of(kind), body=body, displacement_mm=u(body.points_mm))


def points_in(field):
    """Points inside elements, at nodes, and on faces and edges between elements."""
    mesh = field.body.basis.mesh
    some = np.random.default_rng(1).integers(mesh.nelements, size=50)
    inside = np.einsum("pa,iap->pi", SHARED, mesh.p[:, mesh.t[:4, some]])
    on_faces = mesh.p[:, mesh.facets].mean(axis=1).T
    return np.vstack([inside, field.points_mm[::7], on_faces])


def curved(points):
    x, y, z = points.T
    return np.stack([x * y, z**2 - x, y * z + 1], axis=-1)


@pytest.mark.parametrize("kind", [*LOCATED, "flat"])
def test_quadratic_displacements_are_given_back_with_their_slopes(kind):
    """Inside, at nodes and on faces; of long flat tetrahedra the nearest middle is not that of the one at a point."""
    if kind == "flat":
        mesh = MeshTet.init_tensor(np.array([0.0, 100.0]), np.array([0.0, 1.0]), np.linspace(0, 1, 41))
        body = Rubber.of(mesh, taylor_hood(), [RUBBER])
        field = Field(places=Tetrahedra(mesh), body=body, displacement_mm=curved(body.points_mm))
    else:
        field = field_of(kind, curved)
    points = points_in(field)
    x, y, z = points.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    slopes = np.array([[y, -one, zero], [x, zero, z], [zero, 2 * z, y]]).swapaxes(1, 2)  # axis, point, component
    assert np.allclose(field.displacement_at(points), curved(points), rtol=0, atol=1e-10)
    found = field.slopes_at(points) @ field.displacement_mm
    assert np.allclose(found.reshape(slopes.shape), slopes, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_uniform_stress_is_exact_in_every_element(kind):
    """Also of several answers at a time, and at points where they are found."""
    expected = hooke(RUBBER)
    field = field_of(kind, lambda points: np.stack([points @ (STRAIN + TURN).T, points @ STRAIN.T * -2], axis=-1))
    assert np.abs(field.corner_stress[..., 0] - expected).max() < 1e-11 * np.abs(expected).max()
    if kind in LOCATED:
        assert np.abs(field.stress_at(points_in(field))[..., 1] + 2 * expected).max() < 1e-11 * np.abs(expected).max()


@pytest.mark.parametrize("poisson", [0.0, 0.4999])
@pytest.mark.parametrize("kind", ["grid 2", "mapped 2", "tetrahedra 2"])
def test_confined_compression_is_exact_at_any_incompressibility(kind, poisson):
    """A column between frictionless walls: σ_zz = −p, σ_xx = σ_yy = −p ν/(1 − ν), by solving, not by interpolating."""
    material, load = Material(poisson=poisson), DeadLoad(center_mm=(2, 2), size_mm=(4, 4), traction_mpa=(0, 0, -2.0))
    body = body_of(kind, [material])
    system = System(body, [load])
    on_walls = np.isin(body.points_mm[system.free], (0.0, 4.0)) * [True, True, False]
    free = np.concatenate([~on_walls.ravel(), np.ones(system.n_mixed, dtype=bool)])
    y = np.zeros((len(free), 1))
    matrix = whole(system.rest_matrix()).tocsr()[free][:, free]
    y[free], _ = checked_solve(Factor(matrix, definite=not system.n_mixed), system.full_loads[free])
    field = Field(places=places_of(kind), body=body, displacement_mm=system.displaced(y)[0])
    side = -2.0 * poisson / (1 - poisson)
    assert np.abs(field.corner_stress - [side, side, -2.0, 0.0, 0.0, 0.0]).max() < 1e-8  # rounding, times λ/μ = 5000


def test_the_pressure_of_a_mixed_answer_is_known_from_its_displacements():
    """∫ div u q = ∫ p q/λ is one of its equations: projecting gives the unknown itself, to rounding."""
    body = body_of("tetrahedra 2", [RUBBER, OTHER])
    system = System(body)
    forces = system.rest_loads(np.random.default_rng(0).normal(size=(1, body.n_nodes, 3)))
    y, _ = checked_solve(Factor(system.rest_matrix(), upper=True), forces)
    field = Field(places=places_of("tetrahedra 2"), body=body, displacement_mm=system.displaced(y)[0])
    given = y[3 * system.n_blocks :, 0]
    found = field._mixed_pressure(body.strain(field.displacement_mm[None]).theta[0])
    assert np.abs(found - given).max() < 1e-9 * np.abs(given).max()


@pytest.mark.parametrize("kind", KINDS)
def test_fields_of_any_order_become_quadratic_cells(kind):
    """VTK finds the body's volume in cells that are not turned inside out; nodes, displacement and stress are right."""
    field, order = field_of(kind, curved, [RUBBER, OTHER]), int(kind.split()[1])
    cell_type, ends = (QUADRATIC_TETRAHEDRON, [1, 3]) if kind.startswith("tetrahedra") else (TRIQUADRATIC, [0, 1])
    volumes = field.body.dx.sum(axis=1)
    for own in (None, field.body.region == 1):
        part, some = quadratic(field, own), np.arange(len(volumes)) if own is None else np.flatnonzero(own)
        assert (part.cell_type, len(part.cells)) == (cell_type, (8 if order > 2 else 1) * len(some))
        sizes = part.grid.compute_cell_sizes()["Volume"]
        assert sizes.min() > 0
        assert sizes.sum() == pytest.approx(volumes[some].sum(), rel=1e-9)
        assert np.allclose(part.displacement_mm, curved(part.points_mm), atol=1e-10)
        nodes = part.points_mm[part.cells]
        assert np.allclose(nodes[:, 8], nodes[:, ends].mean(axis=1))
    uniform = replace(field, displacement_mm=field.points_mm @ STRAIN.T)
    own = [hooke(rubber) for rubber in (RUBBER, OTHER)]
    part, cells = quadratic(uniform, stress=True), (8 if order > 2 else 1)
    stress = part.stress[part.cells]  # where rubbers meet it jumps
    assert np.allclose(stress, np.repeat(np.array(own)[field.body.region], cells, axis=0)[:, None], atol=1e-10)
