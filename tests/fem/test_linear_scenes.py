"""Scenes of linear rubber: closed forms, references and estimates, plates as cells bond them."""

from dataclasses import replace

import numpy as np
import pytest

from fem.array.solving import ResponseSettings, solve_response
from fem.kernel.loads import DeadLoad, StiffLoad
from fem.methods.box_refinement import first_mesh
from fem.methods.plan import make_plan
from fem.methods.solving import follow, solve_scene
from fem.scene.scene import Block, Pillar, Scene, Sensor
from fem.scene.solution import largest_error
from geometry.design import Array, Material, Pad, SensorDesign
from geometry.layout import electrode_squares
from tests.fem.scenes import mean, pressed

ALONE = SensorDesign(array=Array(rows=1, cols=1), pad=Pad(kind="stiff"))


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


@pytest.mark.parametrize("force_n", [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
def test_boxes_bond_plates_as_cells_do(force_n):
    """A quarter of a unit by its parity, the whole of it and its cell: one answer to the sum of the estimates."""
    squares = electrode_squares(ALONE)
    probes = [mean(str(k), ((a + c) / 2, (b + d) / 2), (c - a, d - b)) for k, (a, b, c, d) in enumerate(squares)]
    load = StiffLoad(center_mm=(0.0, 0.0), size_mm=(12.0, 12.0), force_n=force_n)
    scene = Scene(
        body=Sensor(design=ALONE), material=ALONE.matrix_material, loads=(load,), probes=probes, tolerance=2e-2
    )
    plan = make_plan(scene, field=True)  # boxes, as no cell knows the displacement of the whole body
    assert plan.method == "boxes"
    assert [len(mirror.parities) for mirror in plan.mirrors] == [1, 1]
    quarter, whole = follow(plan, scene), follow(replace(plan, mirrors=()), replace(scene, tolerance=6e-2))
    cell = solve_response(ALONE, ResponseSettings(tolerance=1e-2))
    found = np.array(list(quarter.probes.values()))
    for other, estimate in (
        (np.array(list(whole.probes.values())), whole.error_estimate),
        (cell.influence_mm_per_n[0, 0, :, :, 0, 0, :] @ force_n, cell.error_estimate),
    ):
        off = np.linalg.norm(found - other, axis=1).max() / np.linalg.norm(other, axis=1).min()
        assert off < quarter.error_estimate + estimate
