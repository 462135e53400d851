"""What a simulated sensor goes through: the script's forces."""

import numpy as np
import pytest

from geometry.design import Array, SensorDesign
from geometry.errors import DesignError
from hardware.boards.simulated import PressAndSlide


def test_the_script_presses_slides_and_lifts_over_and_over():
    """At rest nothing acts; sliding, shear is friction times pressure, along the way; the peak is under its middle."""
    design = SensorDesign(array=Array(rows=3, cols=3))
    script, times_s = PressAndSlide(peak_mpa=2.0, friction=0.25, seconds=6.0), np.array([0.5, 1.5, 3.5, 5.99])
    traction = script.tractions(times_s, design)
    assert not traction[0].any()
    assert traction[1, 0, 2] == pytest.approx(-1.0)  # half-way down on the first unit
    assert not traction[1, :, :2].any()
    assert traction[2, 4] == pytest.approx([0.25 * 2 / np.sqrt(2), 0.25 * 2 / np.sqrt(2), -2.0])  # over the middle one
    assert np.abs(traction[3]).max() < 0.03
    assert np.abs(traction).argmax() // 27 == 2
    assert script.tractions(times_s + 6.0, design) == pytest.approx(traction)
    assert not PressAndSlide(peak_mpa=0.0).tractions(times_s, design).any()


@pytest.mark.parametrize("settings", [{"peak_mpa": -1.0}, {"peak_mpa": np.nan}, {"friction": -1.0}])
def test_a_script_that_makes_no_sense_is_refused(settings):
    with pytest.raises(DesignError, match=next(iter(settings))):
        PressAndSlide(**settings)
