"""Pictures of arrays at finite strain: of two grids, put right by the linear picture; stopped where one wants."""

from dataclasses import replace

import numpy as np
import pytest

from fem.finite.solving import solve_finite
from fem.kernel.newton import Stopped
from fem.methods.plan import make_plan
from fem.pictures.arrays import pressed_sensor
from fem.pictures.parts import solve_scene_parts
from fem.pictures.pressed import FIRST_STEP, Watch
from fem.scene.scene import Scene
from geometry.design import Array, Material, SensorDesign, with_model
from tests.fem.scenes import coarse_cells

DESIGN = with_model(SensorDesign(array=Array(rows=1, cols=1)), "neo-hookean")


@pytest.fixture
def scene(monkeypatch) -> Scene:
    """A unit pressed to a fifth of its height, on a coarse cell."""
    coarse_cells(monkeypatch)
    return pressed_sensor(DESIGN, "uniform", 2.0)


def pad_mm(parts) -> np.ndarray:
    """Mean displacement of the pads, (3,)."""
    return np.average(parts["pads"].displacement_mm, axis=0, weights=parts["pads"].sizes)


def test_a_picture_is_the_solved_scene_to_what_it_states(scene):
    """Both are of the pad's mean, the scene's to its estimate."""
    said: list[str] = []
    moved = pad_mm(solve_scene_parts(scene, stress=False, watch=Watch(say=said.append)))
    solved = solve_finite(replace(scene, tolerance=1e-2), make_plan(scene).mirrors)
    assert moved[2] < -0.15 * DESIGN.unit.height_mm
    assert abs(moved[2] / solved.probes["pad"][2] - 1) < 0.02 + solved.error_estimate
    assert "unknowns, about" in said[0]
    assert said[-1].startswith("finite strain, right to about ")


def test_a_search_that_is_stopped_shows_the_last_load_step_and_says_so(scene):
    """Before the first step has converged there is nothing."""
    said: list[str] = []
    steps: list[str] = []
    watch = Watch(progress=steps.append, say=said.append, is_stopped=lambda: any("25%" in step for step in steps))
    moved = pad_mm(solve_scene_parts(scene, stress=False, watch=watch))
    whole = pad_mm(solve_scene_parts(scene.under(FIRST_STEP), stress=False))
    assert watch.load_factor == FIRST_STEP
    assert moved == pytest.approx(whole, rel=0.03, abs=1e-3)  # the coarse grid alone
    assert "stopped: 25% of the load is shown" in said[-1]
    with pytest.raises(Stopped):
        solve_scene_parts(scene, stress=False, watch=Watch(is_stopped=lambda: True))


@pytest.mark.long
def test_two_rubbers_are_drawn_on_the_same_grids():
    """Small loads move the array as the linear picture has it, whose cell is of tetrahedra."""
    soft = replace(DESIGN, matrix_material=Material(young_mpa=1.0, model="neo-hookean"))
    moved = solve_scene_parts(pressed_sensor(soft, "uniform", 1e-4), stress=False)
    linear = solve_scene_parts(pressed_sensor(with_model(soft, "linear"), "uniform", 1e-4), stress=False)
    for name, part in linear.items():
        if name == "matrix":  # points within pillars are drawn as what is around them has it, or is not
            continue
        off = np.abs(moved[name].displacement_mm - part.displacement_mm).max()
        assert off < 0.02 * np.abs(part.displacement_mm).max()
