"""What acts on the page's array: one pad, or a round indenter."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dataset.protocols import FRICTION
from fem.pictures.arrays import bell_pressure, indenter_tractions
from geometry.design import Array, SensorDesign
from geometry.layout import unit_centres
from tripillar.viewer.page.controls import sliders_of, traction_of
from tripillar.viewer.page.finite import FiniteAnswer
from tripillar.viewer.page.page import Page


def test_a_pad_is_pushed_down_and_dragged_in_its_direction():
    np.testing.assert_allclose(traction_of(3.0, 0.5, 90.0), [0.0, 0.5, -3.0], atol=1e-15)  # cos 90° rounds to 6e-17


@pytest.mark.parametrize("angle", [0.0, 45.0, 200.0, 355.0])
def test_a_traction_says_its_load_again(angle):
    assert sliders_of(traction_of(2.0, 0.3, angle)) == pytest.approx((2.0, 0.3, angle))


def test_what_sliders_cannot_show_is_cut():
    assert sliders_of(np.array([3.0, 0.0, 1.0])) == (0.0, 1.0, 0.0)  # pulled, and dragged too hard
    assert sliders_of(np.array([0.0, 0.0, -9.0]))[0] == 5.0


def test_friction_holds_shear_within_its_cone(subject):
    page = Page(subject)
    found = []
    for pressure in (0.0, 2.0, 4.0):
        page.set({"pad": 0, "pressure": pressure, "shear": 0.6})
        found.append(page.update()["state"]["traction_mpa"][0])
    page.close()
    assert found == [0.0, pytest.approx(2.0 * FRICTION), 0.6]


def test_an_indenter_presses_by_a_bell():
    """exp(−1/2) of its peak at one width from its middle, and drags each pad in proportion to its pressure."""
    design = SensorDesign(array=Array(rows=3, cols=3))
    traction = indenter_tractions(design, np.array([0.4, 0.0, -4.0]), (15.0, 0.0), width_mm=15.0)
    centres = unit_centres(design)
    middle = np.flatnonzero((centres == (15.0, 0.0)).all(axis=1))[0]
    beside = np.flatnonzero((centres == (0.0, 0.0)).all(axis=1))[0]
    np.testing.assert_allclose(traction[middle], [0.4, 0.0, -4.0])
    np.testing.assert_allclose(traction[beside], np.exp(-0.5) * traction[middle])


@pytest.mark.parametrize("rows", [3, 6])
def test_a_pressure_means_the_same_on_the_page_and_in_a_picture(rows):
    """5 MPa are those at the indenter's middle, whether a pad is there or not."""
    design = SensorDesign(array=Array(rows=rows, cols=rows))
    traction = indenter_tractions(design, traction_of(5.0, 0.0, 0.0), (0.0, 0.0), design.array.pitch_mm)
    np.testing.assert_allclose(traction, bell_pressure(design, 5.0), atol=1e-12)


def test_a_load_that_rests_is_shown_at_finite_strain_or_refused(subject):
    """Linear until it is solved; an answer changes the strain, a refusal leaves it and says why."""
    page = Page(replace(subject, finite=SimpleNamespace(design=subject.design)))
    page.set({"pad": 0, "pressure": 3.0})
    before = page.update()
    load = np.array(before["state"]["traction_mpa"]).reshape(-1, 3)
    page._answer = FiniteAnswer(traction_mpa=load, moved_mm=np.full((2, 2, 3), -0.1), field=subject.loads.field)
    page.scene.show = lambda *args, finite=None: page.scene.pads_bar  # its own picture is that of another test
    solved = page.update()
    page._answer = FiniteAnswer(traction_mpa=load, refusal="no equilibrium")
    refused = page.update()
    page.close()
    assert "solving" in before["strain_note"]
    assert solved["strain_note"].startswith("finite strain")
    assert solved["strain"] != before["strain"] == refused["strain"]
    assert (solved["trouble"], refused["trouble"]) == ("", "no equilibrium")
