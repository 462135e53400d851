"""Hexahedra on graded grids: elements, closed forms, mirrors, refinement and its estimate."""

from dataclasses import replace

import numpy as np
import pytest
from skfem import Basis, ElementHex2, ElementVector, MeshHex
from skfem.models.elasticity import linear_elasticity

from fem.discretization.grid import Attractor, Grid, graded_lines
from fem.discretization.hexahedra import GridBasis, grid_body, grid_stiffness
from fem.linear.linear_solver import checked_solve, factorized
from fem.methods.richardson import error_after, next_level
from fem.methods.solving import solve_scene
from fem.scene.scene import Block, Inclusion, Load, Pillar, Probe, Scene
from fem.scene.solution import largest_error
from geometry.design import Material

LINES = {"x": np.array([0.0, 1.0, 3.0]), "y": np.array([0.0, 2.0, 2.5]), "z": np.array([0.0, 1.5, 4.0])}


def mean(name, centre, size):
    return Probe(name=name, kind="mean", center_mm=centre, size_mm=size)


def pressed(traction=(0.0, 0.0, -1.0), poisson=0.49, centre=(15.0, 15.0), **changes):
    """The 30 × 30 × 10 mm block under a 10 mm patch."""
    scene = Scene(
        body=Block(size_mm=(30.0, 30.0, 10.0)),
        material=Material(poisson=poisson),
        loads=(Load(center_mm=centre, size_mm=(10.0, 10.0), traction_mpa=traction),),
        probes=(mean("patch", centre, (10.0, 10.0)),),
    )
    return replace(scene, **changes)


def test_full_integration_is_scikit_fem_s_own_stiffness():
    """With ν = 0 the λ part vanishes and the rest is integrated fully: the stock form, to rounding."""
    basis = GridBasis(Grid(**LINES))
    K = grid_stiffness(basis, [Material(young_mpa=2.0, poisson=0.0)])
    stock_basis = Basis(MeshHex.init_tensor(*LINES.values()), ElementVector(ElementHex2()), intorder=5)
    stock = linear_elasticity(0.0, 1.0).assemble(stock_basis)
    nodes = [tuple(np.round(p, 6)) for p in basis.doflocs.T]
    place = {node: n for n, node in enumerate(nodes)}
    order = np.empty(stock.shape[0], dtype=int)
    for dof, point in enumerate(np.round(stock_basis.doflocs.T, 6)):
        axis = next(i for i in range(3) if dof in AXES_OF[i](stock_basis))
        order[dof] = place[tuple(point)] * 3 + axis
    assert np.abs(K[order][:, order] - stock).max() < 1e-12 * np.abs(stock).max()


AXES_OF = [lambda basis, i=i: set(np.concatenate([d.ravel() for d in _dofs(basis, i)])) for i in range(3)]


def _dofs(basis, axis):
    """Every entity's degrees of freedom along one axis."""
    for dofs in (basis.nodal_dofs, basis.edge_dofs, basis.facet_dofs, basis.interior_dofs):
        yield dofs[axis::3]


@pytest.mark.parametrize("element", ["Q2", "S2"])
@pytest.mark.parametrize("lean", [(0.0, 0.0), (0.7, -0.3)])
def test_uniform_strain_and_rigid_motion_on_sheared_boxes(element, lean):
    """Patch test: a linear field has the energy of its strain; a rigid one has none."""
    grid = Grid(**LINES, lean=lean)
    basis = GridBasis(grid, element)
    K = grid_stiffness(basis, [Material(young_mpa=3.0, poisson=0.4)])
    gradient = np.array([[0.1, 0.2, -0.1], [0.0, -0.3, 0.4], [0.2, 0.1, 0.3]])
    u = (basis.doflocs.T @ gradient.T).ravel()
    lame, mu = Material(young_mpa=3.0, poisson=0.4).lame_mpa
    strain = (gradient + gradient.T) / 2
    density = lame * np.trace(strain) ** 2 / 2 + mu * (strain**2).sum()
    assert np.isclose(u @ (K @ u) / 2, density * 3.0 * 2.5 * 4.0, rtol=1e-12)
    spin = (basis.doflocs.T @ (gradient - gradient.T).T).ravel()
    assert np.abs(K @ spin).max() < 1e-12 * np.abs(K).max()


def test_rectangles_are_integrated_wherever_lines_lie():
    basis = GridBasis(Grid(**LINES))
    area = basis.patch_integrals(np.array([[0.3, 0.4, 2.9, 2.2]]))
    assert np.isclose(area.sum(), 2.6 * 1.8)
    x = basis.doflocs[0]
    assert np.isclose((area @ x**2)[0], 1.8 * (2.9**3 - 0.3**3) / 3)


def test_points_are_interpolated():
    basis = GridBasis(Grid(**LINES, lean=(0.5, 0.0)), "S2")
    points = np.array([[1.3, 0.7, 2.0], [0.0, 0.0, 0.0], [5.0, 2.5, 4.0]])
    assert np.allclose(basis.values(points) @ basis.doflocs.T, points)


def test_lines_crowd_at_attractors_and_levels_contain_each_other():
    attractors = [Attractor(3.0, 5.0), Attractor(10.0, 5.0, 0.5)]
    one, two = (graded_lines([0.0, 3.0, 10.0], attractors, level) for level in (2, 4))
    assert {0.0, 3.0, 10.0} <= set(one.round(9))
    assert np.isin(one.round(6), two.round(6)).all()
    assert np.diff(two)[np.searchsorted(two, 3.0)] < 0.2 * np.diff(two).max()


@pytest.mark.parametrize("element", ["Qp", "Q2"])
def test_a_sheet_under_its_whole_face_follows_hooke(element):
    """With ν = 0 a fully loaded block is in uniaxial compression: u_z = −p h / E, exact on any grid."""
    block = pressed(
        poisson=0.0,
        loads=(Load(center_mm=(15.0, 15.0), size_mm=(30.0, 30.0), traction_mpa=(0.0, 0.0, -2.0)),),
        probes=(mean("top", (7.0, 12.0), (3.0, 5.0)), Probe(name="in", kind="point", position_mm=(3.0, 28.0, 5.0))),
    )
    solution, _ = solve_scene(block, element=element)
    assert np.allclose(solution.probes["top"], [0.0, 0.0, -2.0 * 10.0 / 6.1], atol=1e-9)
    assert np.allclose(solution.probes["in"], [0.0, 0.0, -2.0 * 5.0 / 6.1], atol=1e-9)
    assert np.isclose(solution.energy_mj, 0.5 * 2.0**2 / 6.1 * 9000.0)


@pytest.mark.parametrize("element", ["Qp", "Q2"])
@pytest.mark.parametrize(
    ("traction", "poisson", "expected"),
    [((0.0, 0.0, -1.0), 0.49, (0.0, 0.0, -0.623294559)), ((0.2, 0.0, 0.0), 0.49, (0.321299361, 0.0, 0.0))],
)
def test_the_tolerance_is_met_and_the_estimate_is_near_the_error(traction, poisson, expected, element):
    """Against the stored references, known to 2e-5."""
    solution, _ = solve_scene(pressed(traction, poisson, tolerance=3e-3), element=element)
    error = largest_error(solution.probes, {"patch": np.array(expected)})
    assert error < 3e-3
    assert solution.error_estimate / 3 < error < 3 * solution.error_estimate


@pytest.mark.parametrize("element", ["Qp", "Q2"])
@pytest.mark.parametrize("centre", [(15.0, 15.0), (13.0, 11.0)])
def test_mirrors_change_nothing(element, centre):
    """A quarter, its even and odd parts, the whole: one answer but for the grids, which are not the same."""
    scene = pressed(
        (0.2, 0.1, -1.0),
        centre=centre,
        probes=(mean("off", (10.0, 20.0), (4.0, 4.0)), Probe(name="p", kind="point", position_mm=(9.0, 22.0, 6.0))),
        tolerance=1e-2,
    )
    folded, plan = solve_scene(scene, element=element)
    assert len(plan.mirrors) == 2
    whole, plan = solve_scene(scene, no_skip=["symmetry"], element=element)
    assert not plan.mirrors
    for name in folded.probes:
        assert np.allclose(folded.probes[name], whole.probes[name], rtol=2e-2, atol=1e-3)
    assert np.isclose(folded.energy_mj, whole.energy_mj, rtol=1e-2)


@pytest.mark.parametrize("element", ["Qp", "Q2"])
def test_the_field_of_the_whole_body_agrees_with_its_probes(element):
    point = (9.0, 22.0, 10.0)
    scene = pressed((0.2, 0.0, 0.0), probes=(Probe(name="p", kind="point", position_mm=point),), tolerance=0.5)
    solution, _ = solve_scene(scene, field=True, element=element)
    field = solution.field
    assert np.isclose(field.points_mm[:, 0].min(), 0.0)
    assert np.isclose(field.points_mm[:, 0].max(), 30.0)
    near = np.linalg.norm(field.points_mm - point, axis=1).argmin()
    assert np.allclose(field.displacement_mm[near], solution.probes["p"], atol=0.05)


@pytest.mark.parametrize("element", ["Qp", "Q2"])
def test_a_slender_pillar_bends_like_timoshenko_s_beam(element):
    """Tip deflection F L³/(3 E I) + F L/(κ G A), κ = 5/6; what clamping adds goes with width/length: 3 % at 1:20."""
    pillar = Scene(
        body=Pillar(section_mm=(1.0, 1.0), base_mm=(0.0, 0.0, 0.0), top_mm=(0.0, 0.0, 20.0)),
        material=Material(young_mpa=6.1, poisson=0.3),
        loads=(Load(center_mm=(0.0, 0.0), size_mm=(1.0, 1.0), traction_mpa=(1e-4, 0.0, 0.0)),),
        probes=(mean("top", (0.0, 0.0), (1.0, 1.0)),),
    )
    solution, _ = solve_scene(pillar, element=element)
    force, G = 1e-4, 6.1 / 2.6
    beam = force * 20.0**3 / (3 * 6.1 / 12) + force * 20.0 / (5 / 6 * G)
    assert np.isclose(solution.probes["top"][0], beam, rtol=0.03)


@pytest.mark.parametrize("element", ["Qp", "Q2"])
def test_an_inclusion_of_the_body_s_own_rubber_changes_nothing_and_a_stiff_one_stiffens(element):
    column = Inclusion(base_mm=(15.0, 15.0, 0.0), top_mm=(15.0, 15.0, 10.0), section_mm=(4.0, 4.0), material=Material())
    plain, _ = solve_scene(pressed(tolerance=1e-2), element=element)
    same, _ = solve_scene(pressed(tolerance=1e-2, inclusions=(column,)), element=element)
    assert np.array_equal(plain.probes["patch"], same.probes["patch"])
    stiff = replace(column, material=Material(young_mpa=61.0))
    held, plan = solve_scene(pressed(tolerance=1e-2, inclusions=(stiff,)), element=element)
    assert plan.method == "grid"
    assert abs(held.probes["patch"][2]) < 0.9 * abs(plain.probes["patch"][2])


def test_nearly_incompressible_blocks_are_met_as_well():
    loose, _ = solve_scene(pressed(poisson=0.499999, tolerance=1e-2))
    tight, _ = solve_scene(pressed(poisson=0.499999, tolerance=2e-3))
    assert largest_error(loose.probes, tight.probes) < 1e-2


def test_every_solver_gives_the_same_answer():
    scene = pressed(tolerance=0.1)
    direct, iterative = (solve_scene(scene, solver=name)[0] for name in ("superlu", "multigrid"))
    assert np.allclose(direct.probes["patch"], iterative.probes["patch"], rtol=1e-7)


def test_a_clean_rate_is_recognised():
    exact = [3 * level**-3.5 for level in (2, 3, 5)]
    changes = [exact[0] - exact[1], exact[1] - exact[2]]
    assert np.isclose(error_after([2, 3, 5], changes), exact[2])
    assert next_level(4, 1e-3, 1e-3) == 5
    assert next_level(4, 1.0, 1e-6) == 6  # never more than half as much again


def test_one_factor_serves_many_loads():
    basis = GridBasis(Grid(**LINES))
    body = grid_body(basis, grid_stiffness(basis, [Material()]))
    rhs = np.random.default_rng(0).normal(size=(body.matrix.shape[0], 3))
    x, residual = checked_solve(body.matrix, factorized(body.matrix, definite=True), rhs)
    assert residual < 1e-10
    assert np.allclose(body.matrix @ x, rhs)
