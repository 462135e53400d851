"""The plan sees what a scene needs and says why."""

import pytest

from fem.methods.plan import make_plan
from fem.methods.solving import solve_scene
from fem.scene.scene_file import scene_from_toml
from tests.fem.scenes import ARRAY, BLOCK, PILLAR

UPRIGHT = BLOCK.replace("base_mm = [10.0", "base_mm = [15.0").replace("top_mm = [20.0", "top_mm = [15.0")
PLAIN = BLOCK.replace("young_mpa = 61.0\npoisson = 0.3", "young_mpa = 6.1\npoisson = 0.49")
ONE_RUBBER = ARRAY.replace("61.0", "6.1")
OFF_CENTRE = PLAIN.replace("center_mm = [15.0, 15.0]\nsize_mm = [10", "center_mm = [14.0, 15.0]\nsize_mm = [10")
EVEN, ODD, BOTH = (1,), (-1,), (1, -1)
OTHER = "[[load]]\ncenter_mm = [{}, 15.0]\nsize_mm = [4.0, 4.0]\ntraction_mpa = [0.0, 0.0, {}]\n"
PAIRS = ((-1.0, EVEN), (1.0, BOTH))  # with an even load in the middle, an odd pair is of both parities
CROSSING = """
[[inclusion]]
base_mm = [25.0, 4.0, 0.0]
top_mm = [5.0, 4.0, 10.0]
section_mm = [2.0, 2.0]
young_mpa = 61.0
poisson = 0.3
"""
UNIT = ARRAY.replace('"array"', '"unit"').replace("7.5, 7.5", "0, 0").replace("2.5, 2.5", "-5, -5")


@pytest.mark.parametrize(
    ("text", "method", "regions"),
    [
        (BLOCK, "boxes", 1),
        (BLOCK.replace("base_mm = [10.0", "base_mm = [3.0").replace("top_mm = [20.0", "top_mm = [27.0"), "boxes", 1),
        (
            BLOCK.replace("base_mm = [10.0", "base_mm = [2.0").replace("top_mm = [20.0", "top_mm = [28.0"),
            "tetrahedra",
            1,
        ),
        (BLOCK + CROSSING, "tetrahedra", 2),  # lines along both would meet
        (UPRIGHT, "boxes", 1),
        (PLAIN, "boxes", 0),  # an oblique inclusion of the body's own rubber is none
        (PILLAR, "boxes", 0),  # sheared as one
        (ONE_RUBBER, "cells", 0),
        (ARRAY, "cells", 108),
        (UNIT, "cells", 3),
        (BLOCK.replace("-1.0]", "0.0]"), "nothing", 1),
    ],
)
def test_every_scene_gets_its_method(text, method, regions):
    plan = make_plan(scene_from_toml(text))
    assert (plan.method, len(plan.regions)) == (method, regions)


@pytest.mark.parametrize(
    ("text", "parities"),
    [
        (PLAIN, {0: EVEN, 1: EVEN}),
        (PLAIN.replace("[0.0, 0.0, -1.0]", "[1.0, 0.0, 0.0]"), {0: ODD, 1: EVEN}),  # dragged along x
        (OFF_CENTRE, {0: BOTH, 1: EVEN}),
        *((PLAIN + OTHER.format(5.0, -1.0) + OTHER.format(25.0, z), {0: p, 1: EVEN}) for z, p in PAIRS),
        (UPRIGHT.replace("[15.0, 15.0, ", "[15.0, 14.0, ", 2), {0: EVEN}),  # the inclusion stands aside
        (PILLAR, {1: EVEN}),  # it leans along x
    ],
)
def test_mirror_planes_are_found(text, parities):
    plan = make_plan(scene_from_toml(text))
    assert {mirror.axis: mirror.parities for mirror in plan.mirrors} == parities


def test_nothing_moves_what_nothing_loads():
    solution, plan = solve_scene(scene_from_toml(BLOCK.replace("-1.0]", "0.0]")))
    assert plan.lines[1] == "mesh: none, nothing loads the body, so nothing moves"
    assert [u.tolist() for u in solution.probes.values()] == [[0.0, 0.0, 0.0]] * 2
    assert (solution.energy_mj, solution.unknowns, solution.error_estimate) == (0.0, 0, 0.0)
