"""What a simulated sensor goes through: the script's forces, and a scene's pillars."""

from pathlib import Path

import numpy as np
import pytest

from dataset.resistance import rest_resistances
from fem.scene.scene_file import read_scene
from geometry.design import Array, SensorDesign
from geometry.errors import DesignError
from hardware.boards.simulated import STEP_S, PressAndSlide, scene_motion, write_truth

SCENES = Path(__file__).parents[2] / "scenes"


def test_the_script_presses_slides_and_lifts():
    """At rest nothing acts; sliding, shear is friction times pressure, along the way; the peak is under its middle."""
    design = SensorDesign(array=Array(rows=3, cols=3))
    script = PressAndSlide(peak_mpa=2.0, friction=0.25, seconds=6.0)
    traction = script.tractions(np.array([0.5, 1.5, 3.5, 5.99]), design)
    assert not traction[0].any()
    assert traction[1, 0, 2] == pytest.approx(-1.0)  # half-way down on the first unit
    assert not traction[1, :, :2].any()
    assert traction[2, 4] == pytest.approx([0.25 * 2 / np.sqrt(2), 0.25 * 2 / np.sqrt(2), -2.0])  # over the middle one
    assert np.abs(traction[3]).max() < 0.03
    assert np.abs(traction).argmax() // 27 == 2


def test_it_repeats_and_at_a_pressure_of_0_the_sensor_rests():
    design, script = SensorDesign(array=Array(rows=2, cols=2)), PressAndSlide(seconds=2.0)
    times = np.arange(0.0, 2.0, 0.1)
    assert script.tractions(times + 2.0, design) == pytest.approx(script.tractions(times, design))
    assert not PressAndSlide(peak_mpa=0.0, seconds=2.0).tractions(times, design).any()


@pytest.mark.parametrize("settings", [{"peak_mpa": -1.0}, {"peak_mpa": np.nan}, {"friction": -1.0}, {"seconds": 0.0}])
def test_a_script_that_makes_no_sense_is_refused(settings):
    with pytest.raises(DesignError, match=next(iter(settings))):
        PressAndSlide(**settings)


def test_a_scene_is_pressed_and_let_go(tmp_path):
    """At rest every pillar is as designed; at the peak the pressed unit's z pillar has given way most."""
    motion = scene_motion(read_scene(SCENES / "array.toml"), seconds=1.0)
    assert len(motion.resistance_ohm) == round(1.0 / STEP_S)
    assert motion.seconds == 1.0
    assert motion.resistance_ohm[0] == pytest.approx(np.tile(rest_resistances(motion.design), (3, 3, 1)))
    peak = motion.resistance_ohm[100, ..., 0]
    assert np.unravel_index(peak.argmin(), peak.shape) == (1, 1)
    with pytest.raises(DesignError, match="leave --truth out"):
        write_truth(motion, tmp_path / "truth.nc")


def test_a_scene_without_an_array_is_refused():
    with pytest.raises(DesignError, match=r"give a scene whose body has kind = 'array'"):
        scene_motion(read_scene(SCENES / "block-patch.toml"))
