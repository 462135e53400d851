"""Scenes of boxes: closed forms, mirrors, estimates, references; and how boxes are split."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from fem.boxes.boxes import Boxes
from fem.boxes.splitting import AxisTree, BoxMesh
from fem.kernel.factor import Factor
from fem.kernel.loads import DeadLoad, StiffLoad
from fem.kernel.mirrors import Mirror
from fem.methods.box_refinement import ORDER, first_mesh
from fem.methods.plan import make_plan
from fem.methods.solving import solve_scene
from fem.rubber.body import RubberBody
from fem.scene.scene import Block, Pillar, Probe, Scene
from fem.scene.solution import largest_error
from fem.system import System
from geometry.design import Material
from tests.fem.scenes import mean, pressed


def test_slender_oblique_pillar_follows_bernoulli():
    """The tip of a 30:1 cantilever at 45° to its base moves across its axis by F L³ / 3EI."""
    root = 1 / np.sqrt(2.0)
    pillar = Pillar(section_mm=(1 / root, 1.0), base_mm=(30 * root, 0.0, 0.0), top_mm=(0.0, 0.0, 30 * root))
    scene = pressed(pillar, (0.0, 0.0), pillar.section_mm, (0.0, 0.0, -1e-3), material=Material(poisson=0.3))
    u, bending = solve_scene(scene)[0].probes["patch"], 1e-3 / root * root * 30**3 / (3 * 6.1 / 12)
    # half the width over the length counts three times
    assert u @ [-root, 0.0, -root] == pytest.approx(bending, rel=0.05)
    assert abs(u @ [root, 0.0, -root]) < 0.01 * bending


@pytest.mark.parametrize(
    ("traction", "expected"), [((0.0, 0.0, -1.0), (0.0, 0.0, -0.623294559)), ((0.2, 0.0, 0.0), (0.321299361, 0.0, 0.0))]
)
def test_the_tolerance_is_met_and_the_estimate_is_above_the_error(traction, expected):
    """Against the stored references of a 10 mm patch, known to 2e-5."""
    place = (15.0, 15.0), (10.0, 10.0)
    scene = pressed(Block(size_mm=(30.0, 30.0, 10.0)), *place, traction, material=Material(), tolerance=3e-3)
    solution = solve_scene(scene)[0]
    error = largest_error(solution.probes, {"patch": np.array(expected)})
    assert error < 3e-3
    assert error < solution.error_estimate


def random_mesh(rounds: int) -> BoxMesh:
    """Boxes split at random, stops among them."""
    rng = np.random.default_rng(0)
    mesh = BoxMesh(tuple(AxisTree(np.array([0.0, 1.0, 3.0]), np.array([0.0, 0.7, 3.0])) for _ in range(3)))
    for _ in range(rounds):
        mesh.split(rng.random(mesh.boxes.shape) < 0.15)
    return mesh


def test_split_boxes_fill_the_body_and_hold_polynomials_of_their_order():
    """Where faces of two boxes meet, one holds the other; all nodes follow from the independent ones."""
    mesh = random_mesh(4)
    low, high = mesh.corners
    assert (high - low).prod(axis=1).sum() == pytest.approx(27.0, rel=1e-12)
    for axis, one, two in product(range(3), range(len(low)), range(len(low))):
        others = [d for d in range(3) if d != axis]
        start, end = np.maximum(low[one], low[two])[others], np.minimum(high[one], high[two])[others]
        if high[one, axis] == low[two, axis] and (end > start).all():
            assert any((start == low[b, others]).all() and (end == high[b, others]).all() for b in (one, two))
    boxes = mesh.filled(ORDER, (0.0, 0.0), np.zeros(len(mesh.boxes), dtype=np.int64))
    x, y, z = boxes.points_mm.T / 3
    values = (1 + x - 2 * x**4) * (0.5 - y**3 + y**4) * (2 + z - z**2 * 3 + z**4)
    assert not boxes.is_independent.all()
    found = boxes.constraint @ np.where(boxes.is_independent, values, 0.0)
    np.testing.assert_allclose(found, values, atol=1e-12)
    np.testing.assert_allclose(boxes.constraint.sum(axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize("order", [2, 4])
def test_column_without_cross_contraction_follows_hooke_on_any_boxes(order):
    """At ν = 0 the clamped base holds nothing back: u = −p z / E exactly, whatever is split, hanging nodes included."""
    mesh = random_mesh(3)
    boxes = mesh.filled(order, (0.0, 0.0), np.zeros(len(mesh.boxes), dtype=np.int64))
    load = DeadLoad(center_mm=(1.5, 1.5), size_mm=(3.0, 3.0), traction_mpa=(0.0, 0.0, -0.2))
    system = System(RubberBody.of(boxes, [Material(young_mpa=2.0, poisson=0.0)]), [load])
    forces = system.loads_on(system.rest()).reshape(-1, 1)
    y = Factor(system.matrix(system.rest_tangent()), definite=True, upper=True).solve(forces)
    inside = Probe(name="inside", kind="point", position_mm=(1.3, 0.4, 1.9))
    np.testing.assert_allclose(system.seen(inside, system.displaced(y)[0]), [0.0, 0.0, -0.2 * 1.9 / 2.0], atol=1e-9)
    # λ is taken as 1e-9 μ at least
    assert float((forces * y).sum()) / 2 == pytest.approx(0.2**2 * 27 / 2 / 2.0, rel=2e-9)


@pytest.mark.parametrize("side_mm", [pytest.param(9e-6, marks=pytest.mark.long), 1e-2])
def test_patches_down_to_a_millionth_of_the_body_sink_as_on_a_half_space(side_mm):
    """0.9461 p a (1 − ν²)/E in the mean under a square: the block's finite size takes a/h of it."""
    rubber = Material(young_mpa=1.0, poisson=0.45)
    place = (4.0, 4.0), (side_mm, side_mm)
    scene = pressed(Block(size_mm=(9.0, 8.0, 4.0)), *place, (0.0, 0.0, -1.0), material=rubber, tolerance=2e-2)
    solution, _ = solve_scene(scene)
    expected = -0.9461 * side_mm * (1 - 0.45**2)
    error = abs(solution.probes["patch"][2] / expected - 1)
    assert error <= solution.error_estimate + side_mm / 4.0
    assert solution.error_estimate <= scene.tolerance


def test_lines_that_rounding_tells_apart_are_one():
    """2.0 + 0.05 and 2.1 − 0.05 mm, as a load's end and the leaning body's, differ by rounding: no box is so thin."""
    section_mm, top_mm = (2.0793607794778306, 2.92454076851681), (-3.446131549941288, 3.1835828603223844)
    leaning = Pillar(section_mm=section_mm, base_mm=(0.0, 0.0, 0.0), top_mm=(*top_mm, 9.824752758034366))
    whole = pressed(leaning, top_mm, section_mm, (0.02, 0.0, -0.1), material=Material(poisson=0.499999))
    sides = [{"center_mm": (x, 4.0), "size_mm": (0.1, 0.1)} for x in (2.0, 2.1)]
    loads = tuple(DeadLoad(**side, traction_mpa=(0.0, 0.0, -1.0)) for side in sides)
    small = Scene(body=Block(size_mm=(9.0, 8.0, 4.0)), loads=loads, probes=(mean("one", **sides[0]),))
    for scene, least_mm in ((whole, 0.5), (small, 0.01)):
        low, high = first_mesh(scene, make_plan(scene)).corners
        assert (high - low).min() > least_mm


def test_loaded_corner_of_nearly_incompressible_rubber_is_settled():
    """NGSolve's hp-refined tetrahedra at two orders and two grids: 4e-4. A hair beside the load moves it by 3e-5."""
    hair_mm = 5e-5
    place = (9.15075 - hair_mm, 14.38265 - hair_mm), (3.8821, 4.1093)
    body, rubber = Block(size_mm=(11.0918, 16.4373, 7.9504)), Material(young_mpa=0.5351, poisson=0.4999)
    scene = pressed(body, *place, (0.8463, -0.7053, -0.4546), material=rubber, tolerance=2e-3)
    solution = solve_scene(scene)[0]
    reference = {"patch": np.array([24.4457847, -15.435013, -5.27081814])}
    assert largest_error(solution.probes, reference) <= solution.error_estimate + 4e-4 + 3e-5


@pytest.mark.parametrize(("parities", "order"), [((1, -1), 4), ((-1, 1), 2)])
def test_a_quarter_with_its_parity_is_the_whole(parities, order):
    """Loads of a parity, one on a plate across both planes, around an inclusion: seen beyond the planes, and energy."""
    line, z = np.array([-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0]), np.array([0.0, 1.0, 2.0])
    along_x, along_y = parities
    loads = [
        DeadLoad(center_mm=(x, y), size_mm=(1.0, 0.8), traction_mpa=(-sx * sy * 0.2 * x, 0.0, sx * sy))
        for x in (-2.3, 2.3)
        for y in (-2.4, 2.4)
        for sx, sy in [(along_x if x < 0 else 1, along_y if y < 0 else 1)]
    ]
    force = (float(parities == (-1, 1)), float(parities == (1, -1)), float(parities == (1, 1)))
    turn = (float(parities == (1, -1)), float(parities == (-1, 1)), float(parities == (-1, -1)))
    loads.append(StiffLoad(center_mm=(0.0, 0.0), size_mm=(2.0, 4.0), force_n=force, moment_nmm=turn))
    probes = (
        Probe(name="mean", kind="mean", center_mm=(-1.9, 0.2), size_mm=(1.0, 3.0)),
        Probe(name="point", kind="point", position_mm=(-1.2, 2.4, 1.3)),
    )
    mirrors = tuple(Mirror(axis=axis, position_mm=0.0, parities=(1, -1)) for axis in (0, 1))
    answers = []
    for lines, planes in (((line, line, z), ()), ((line[3:], line[3:], z), mirrors)):
        boxes = Boxes.between(lines, order)
        stiff = (np.abs((boxes.low + boxes.high) / 2)[:, :2] < 1.0).all(axis=1)
        body = RubberBody.of(replace(boxes, region=stiff.astype(int)), [Material(), Material(young_mpa=61.0)])
        system = System(body, loads, planes, parities if planes else None)
        factor, forces = system.new_factor(), system.loads_on(system.rest()).reshape(-1, 1)
        factor.factor(system.matrix(system.rest_tangent()))
        y = factor.solve(forces)
        u = system.displaced(y)[0]
        energy = system.copies * float((forces * y).sum())
        answers.append([*(system.seen(probe, u) for probe in probes), np.full(3, energy)])
    assert np.allclose(*answers, rtol=1e-9, atol=1e-12)
