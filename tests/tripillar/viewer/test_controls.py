"""What acts on the page's array: one pad, or a round indenter."""

import numpy as np
import pytest

from dataset.protocols import FRICTION
from fem.fields.pad_loads import bell_pressure
from geometry.design import Array, SensorDesign
from geometry.errors import DesignError
from geometry.layout import unit_centres
from tripillar.viewer.page.controls import Indenter, PadLoad

DESIGN = SensorDesign(array=Array(rows=3, cols=3))


def test_a_pad_is_pushed_down_and_dragged_in_its_direction():
    load = PadLoad(pressure_mpa=3.0, shear_mpa=0.5, angle_deg=90.0)
    np.testing.assert_allclose(load.traction_mpa, [0.0, 0.5, -3.0], atol=1e-15)  # cos 90° rounds to 6e-17


@pytest.mark.parametrize("angle", [0.0, 45.0, 200.0, 355.0])
def test_a_traction_says_its_load_again(angle):
    load = PadLoad(pressure_mpa=2.0, shear_mpa=0.3, angle_deg=angle)
    found = PadLoad.of(load.traction_mpa)
    assert (found.pressure_mpa, found.shear_mpa) == (2.0, pytest.approx(0.3))
    assert found.angle_deg == pytest.approx(angle)


def test_what_sliders_cannot_show_is_cut():
    assert PadLoad.of(np.array([3.0, 0.0, 1.0])) == PadLoad(shear_mpa=1.0)  # pulled, and dragged too hard
    assert PadLoad.of(np.array([0.0, 0.0, -9.0])).pressure_mpa == 5.0


def test_friction_holds_shear_within_its_cone():
    loads = [PadLoad(pressure_mpa=p, shear_mpa=0.6).within_cone() for p in (0.0, 2.0, 4.0)]
    assert [load.shear_mpa for load in loads] == [0.0, pytest.approx(2.0 * FRICTION), 0.6]


@pytest.mark.parametrize("values", [{"pressure_mpa": -1.0}, {"pressure_mpa": 6.0}, {"shear_mpa": np.nan}])
def test_nonsense_is_refused(values):
    with pytest.raises(DesignError, match="must be from 0 to"):
        PadLoad(**values)


def test_an_indenter_presses_by_a_bell():
    """exp(−1/2) of its peak at one width from its middle, and drags each pad in proportion to its pressure."""
    indenter = Indenter(load=PadLoad(pressure_mpa=4.0, shear_mpa=0.4), x_mm=15.0, y_mm=0.0, width_mm=15.0)
    traction = indenter.tractions(DESIGN)
    centres = unit_centres(DESIGN)
    middle = np.flatnonzero((centres == (15.0, 0.0)).all(axis=1))[0]
    beside = np.flatnonzero((centres == (0.0, 0.0)).all(axis=1))[0]
    np.testing.assert_allclose(traction[middle], [0.4, 0.0, -4.0])
    np.testing.assert_allclose(traction[beside], np.exp(-0.5) * traction[middle])


@pytest.mark.parametrize("rows", [3, 6])
def test_a_pressure_means_the_same_on_the_page_and_in_a_picture(rows):
    """5 MPa are those at the indenter's middle, whether a pad is there or not."""
    design = SensorDesign(array=Array(rows=rows, cols=rows))
    indenter = Indenter(load=PadLoad(pressure_mpa=5.0), width_mm=design.array.pitch_mm)
    np.testing.assert_allclose(indenter.tractions(design), bell_pressure(design, 5.0), atol=1e-12)
