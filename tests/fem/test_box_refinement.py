"""Boxes that are split: continuity across hanging nodes, closed forms, and answers that keep to their estimates."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from fem.discretization.box_mesh import AxisTree, BoxMesh
from fem.discretization.box_system import BoxSystem
from fem.discretization.kronecker import lobatto_points
from fem.linear.linear_solver import factorized
from fem.methods.box_refinement import ORDER, first_mesh, marked
from fem.methods.plan import make_plan
from fem.methods.solving import solve_scene
from fem.scene.scene import Block, Inclusion, Load, Pillar, Probe, Scene
from fem.scene.solution import largest_error
from geometry.design import Material

STEEP = Pillar(section_mm=(3.0, 2.0), base_mm=(1.0, 2.0, 0.0), top_mm=(10.0, 2.0, 6.0))


def random_mesh(seed: int, rounds: int = 4) -> BoxMesh:
    """Boxes split at random, stops among them."""
    rng = np.random.default_rng(seed)
    axes = tuple(AxisTree(np.array([0.0, 1.0, 3.0]), np.array([0.0, 0.7, 3.0])) for _ in range(3))
    mesh = BoxMesh(axes)
    for _ in range(rounds):
        mesh.split(rng.random(mesh.boxes.shape) < 0.15)
    return mesh


def pressed(body: Block | Pillar, **kwargs: object) -> Scene:
    """A body pressed and dragged on the middle of its top, with a probe there."""
    x, y, _ = body.outline.top_mm
    a, b = body.outline.section_mm
    share = 1.0 if isinstance(body, Pillar) else 0.4
    place = {"center_mm": (x, y), "size_mm": (share * a, share * b)}
    return Scene(
        body=body,
        loads=(Load(**place, traction_mpa=(0.02, 0.0, -0.1)),),
        probes=(Probe(name="patch", kind="mean", **place),),
        **kwargs,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("seed", range(5))
def test_split_boxes_fill_the_body_and_their_faces_do_not_cross(seed):
    """Where faces of two boxes meet, one holds the other; else no polynomial of one could serve both."""
    mesh = random_mesh(seed)
    low, high = mesh.corners
    assert (high - low).prod(axis=1).sum() == pytest.approx(27.0, rel=1e-12)
    for axis in range(3):
        others = [d for d in range(3) if d != axis]
        for one, two in product(range(len(low)), repeat=2):
            if high[one, axis] != low[two, axis]:
                continue
            start = np.maximum(low[one], low[two])[others]
            end = np.minimum(high[one], high[two])[others]
            if (end > start).all():
                whole = [(start == low[b, others]).all() and (end == high[b, others]).all() for b in (one, two)]
                assert any(whole)


@pytest.mark.parametrize("seed", range(5))
def test_hanging_nodes_hold_polynomials_of_the_elements_order(seed):
    """A polynomial of degree 4 along each axis is in the space: all its nodes follow from the independent ones."""
    mesh = random_mesh(seed)
    nodes = mesh.nodes(ORDER)
    low, high = mesh.corners
    lattice = np.array(list(product((lobatto_points(ORDER) + 1) / 2, repeat=3)))
    on_surface = ((lattice == 0) | (lattice == 1)).any(axis=1)
    at = low[:, None] + lattice[on_surface] * (high - low)[:, None]
    places = np.empty((len(nodes.independent), 3))
    places[nodes.of_elements] = at
    x, y, z = places.T / 3
    values = (1 + x - 2 * x**4) * (0.5 - y**3 + y**4) * (2 + z - z**2 * 3 + z**4)
    assert not nodes.independent.all()
    found = nodes.constraint @ np.where(nodes.independent, values, 0.0)
    np.testing.assert_allclose(found, values, atol=1e-12)
    np.testing.assert_allclose(nodes.constraint.sum(axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize("order", [2, 3, 4])
def test_column_without_cross_contraction_follows_hooke_on_any_boxes(order):
    """At ν = 0 the clamped base holds nothing back: u = −p z / E exactly, whatever is split, hanging nodes included."""
    body = Block(size_mm=(3.0, 3.0, 3.0))
    load = Load(center_mm=(1.5, 1.5), size_mm=(3.0, 3.0), traction_mpa=(0.0, 0.0, -0.2))
    inside = Probe(name="inside", kind="point", position_mm=(1.3, 0.4, 1.9))
    scene = Scene(body=body, material=Material(young_mpa=2.0, poisson=0.0), loads=(load,), probes=(inside,))
    plan = make_plan(scene, element="Q4", no_skip=["symmetry"])
    mesh = random_mesh(0, rounds=3)
    system = BoxSystem(scene, plan, mesh, (0.0, 0.0), {}, order)
    u = factorized(system.matrix, definite=True).solve(system.loads()[:, None])[:, 0]
    np.testing.assert_allclose(system.probe_rows() @ u, [[0.0, 0.0, -0.2 * 1.9 / 2.0]], atol=1e-7)  # inside: float32
    assert system.loads() @ u / 2 == pytest.approx(0.2**2 * 27 / 2 / 2.0, rel=1e-10)


def test_no_line_runs_through_the_body():
    """Edges of a region in one corner split no box in the other."""
    inclusion = Inclusion(base_mm=(3.0, 3.0, 0.0), top_mm=(3.0, 3.0, 8.0), section_mm=(2.0, 2.0))
    soft = replace(inclusion, material=Material(young_mpa=0.1, poisson=0.3))
    scene = pressed(Block(size_mm=(30.0, 30.0, 8.0)), inclusions=(soft,))
    plan = make_plan(scene, element="Q4")
    low, high = first_mesh(scene, plan, (0.0, 0.0)).corners
    assert not ((low[:, 0] == 4.0) & (low[:, 1] > 20.0)).any()
    cut = (low[:, :2] < 4.0 - 1e-9).all(axis=1) & (high[:, :2] > 2.0 + 1e-9).all(axis=1)
    assert (low[cut, :2] >= 2.0 - 1e-9).all()
    assert (high[cut, :2] <= 4.0 + 1e-9).all()


def test_marks_hold_the_share_that_is_asked():
    """The largest indicators are marked, none that the share does not need."""
    indicators = np.array([[4.0, 0.0, 1.0], [3.0, 2.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(np.argwhere(marked(indicators, 0.65)), [[0, 0], [1, 0]])


@pytest.mark.parametrize(
    ("scene", "other"),
    [
        (pressed(Block(size_mm=(20.0, 20.0, 8.0)), tolerance=3e-3), "Qp"),
        (pressed(Block(size_mm=(20.0, 20.0, 8.0)), material=Material(young_mpa=1.0, poisson=0.4999)), "Qp"),
        (pressed(Block(size_mm=(20.0, 20.0, 2.0)), material=Material(young_mpa=1.0, poisson=0.499999)), "Q2"),
        (pressed(replace(STEEP, top_mm=(4.0, 3.0, 6.0)), tolerance=3e-3), "Qp"),
    ],
)
def test_answers_agree_with_the_other_methods(scene, other):
    """Two methods that share neither grid nor solver differ by no more than both estimate."""
    ours, _ = solve_scene(scene, element="Q4")
    theirs, _ = solve_scene(scene, element=other)
    assert ours.error_estimate <= scene.tolerance
    allowed = ours.error_estimate + theirs.error_estimate
    assert largest_error(ours.probes, theirs.probes) <= allowed
    assert ours.energy_mj == pytest.approx(theirs.energy_mj, rel=2 * allowed)


def test_folding_along_mirrors_changes_nothing():
    """A quarter with planes of symmetry gives what the whole body gives, also beyond the planes, and its energy."""
    stiff = Inclusion(
        base_mm=(6.0, 6.0, 0.0), top_mm=(6.0, 6.0, 5.0), section_mm=(3.0, 3.0), material=Material(young_mpa=61.0)
    )
    place = {"center_mm": (6.0, 6.0), "size_mm": (5.0, 5.0)}
    probes = (Probe(name="patch", kind="mean", **place), Probe(name="point", kind="point", position_mm=(2.0, 9.0, 4.0)))
    for traction in ((0.0, 0.0, -0.1), (0.1, 0.0, 0.0)):
        load = Load(**place, traction_mpa=traction)
        scene = Scene(
            body=Block(size_mm=(12.0, 12.0, 6.0)), inclusions=(stiff,), loads=(load,), probes=probes, tolerance=5e-3
        )
        part, plan = solve_scene(scene, element="Q4")
        whole, _ = solve_scene(scene, element="Q4", no_skip=["symmetry"])
        assert len(plan.mirrors) == 2
        assert largest_error(part.probes, whole.probes) <= part.error_estimate + whole.error_estimate
        assert part.energy_mj == pytest.approx(whole.energy_mj, rel=1e-2)


def test_pictures_show_the_displacement_of_the_probes():
    """The field's top nodes within the patch move as its mean does, whichever part was solved."""
    scene = pressed(Block(size_mm=(12.0, 12.0, 6.0)), tolerance=1e-2)
    solution, _ = solve_scene(scene, element="Q4", field=True)
    field = solution.field
    assert field is not None
    at = field.points_mm
    middle = (np.abs(at - [6.0, 6.0, 6.0]) < 1.0).all(axis=1) & (at[:, 2] == 6.0)
    assert middle.any()
    mean = solution.probes["patch"]
    assert np.abs(field.displacement_mm[middle] - mean).max() < 0.3 * np.linalg.norm(mean)
    corner, opposite = at[field.cells[:, 0]], at[field.cells[:, 6]]
    assert np.abs((opposite - corner).prod(axis=1)).sum() == pytest.approx(12 * 12 * 6, rel=1e-12)


def test_leaning_pillar_of_two_codes_is_settled():
    """Two codes differed by 3 %; NGSolve's hp-refined tetrahedra at two orders and two grids say this, to 4e-5."""
    scene = pressed(STEEP, tolerance=2e-3)
    load = replace(scene.loads[0], traction_mpa=(0.02, 0.0, -0.1))
    scene = replace(scene, loads=(load,), material=Material(young_mpa=6.1, poisson=0.49))
    solution, plan = solve_scene(scene)
    assert plan.element == "Q4"
    reference = {"patch": np.array([22.98579, 0.0, -34.14392])}
    assert largest_error(solution.probes, reference) <= solution.error_estimate + 4e-5
    assert solution.error_estimate <= 2e-3


def test_patch_a_hair_from_the_corner_is_solved():
    """Edges 5e-5 mm from the block's sides: rounding made a preconditioner negative, and the residual complex."""
    place = {"center_mm": (9.1507, 14.3826), "size_mm": (3.8821, 4.1093)}
    scene = Scene(
        body=Block(size_mm=(11.0918, 16.4373, 7.9504)),
        material=Material(young_mpa=0.5351, poisson=0.4999),
        loads=(Load(**place, traction_mpa=(0.8463, -0.7053, -0.4546)),),
        probes=(Probe(name="patch", kind="mean", **place),),
        tolerance=1e-2,
    )
    by_order, _ = solve_scene(scene, element="Qp")
    by_splitting, _ = solve_scene(scene, element="Q4")
    assert isinstance(by_order.residual, float)
    allowed = by_order.error_estimate + by_splitting.error_estimate
    assert largest_error(by_order.probes, by_splitting.probes) <= allowed


def test_lines_that_rounding_tells_apart_are_one():
    """A load over the whole leaning top ends where the body ends, but for the last digit: no box is 1e-15 mm wide."""
    body = Pillar(
        section_mm=(2.0793607794778306, 2.92454076851681),
        base_mm=(0.0, 0.0, 0.0),
        top_mm=(-3.446131549941288, 3.1835828603223844, 9.824752758034366),
    )
    scene = pressed(body, material=Material(young_mpa=9.5, poisson=0.499999), tolerance=1e-2)
    lean = (body.top_mm[0] / body.top_mm[2], body.top_mm[1] / body.top_mm[2])
    low, high = first_mesh(scene, make_plan(scene, element="Q4"), lean).corners
    assert (high - low).min() > 0.5
    solution, _ = solve_scene(scene, element="Q4")
    assert solution.error_estimate <= 1e-2


@pytest.mark.parametrize("hair_mm", [0.0, 5e-5])
def test_loaded_corner_of_nearly_incompressible_rubber_is_settled(hair_mm):
    """NGSolve's hp-refined tetrahedra at two orders and two grids: 4e-4. A hair beside the load moves it by 3e-5."""
    place = {"center_mm": (9.15075 - hair_mm, 14.38265 - hair_mm), "size_mm": (3.8821, 4.1093)}
    scene = Scene(
        body=Block(size_mm=(11.0918, 16.4373, 7.9504)),
        material=Material(young_mpa=0.5351, poisson=0.4999),
        loads=(Load(**place, traction_mpa=(0.8463, -0.7053, -0.4546)),),
        probes=(Probe(name="patch", kind="mean", **place),),
        tolerance=2e-3,
    )
    solution, _ = solve_scene(scene, element="Q4")
    reference = {"patch": np.array([24.4457847, -15.435013, -5.27081814])}
    assert largest_error(solution.probes, reference) <= solution.error_estimate + 4e-4 + 3e-5
