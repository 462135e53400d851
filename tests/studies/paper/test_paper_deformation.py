"""Figures 6 to 8 in numbers: superposition, Hooke's law for a pillar alone, and the cap where it is said to be."""

import numpy as np
import pytest

from fem.array.response import ArrayResponse
from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, SensorDesign
from studies.paper.deformation import CAP, LOADED, Deformation, middle_unit, pressed, study_deformation

DESIGN = SensorDesign(array=Array(rows=3, cols=4))


@pytest.fixture(scope="module")
def response() -> ArrayResponse:
    return solve_response(DESIGN, ResponseSettings(method="layer"))


@pytest.fixture(scope="module")
def found(response) -> Deformation:
    return study_deformation(response)


def test_displacement_is_in_proportion_and_compression_shortens(found):
    for loaded in LOADED:
        mine = [one for one in found.pressed if one.loaded == loaded]
        assert [one.pressure_mpa for one in mine] == [1.0, 3.0, 5.0]
        np.testing.assert_allclose([one.largest_mm / one.pressure_mpa for one in mine], mine[0].largest_mm)
        assert all(one.force_n == one.pressure_mpa * 144.0 for one in mine)
    alone = found.pressed[0]
    assert alone.largest_at == middle_unit(DESIGN)
    assert alone.strain["z"] < alone.strain["x"] < 0
    assert alone.largest_strain == pytest.approx(-alone.strain["z"])


def test_the_cap_is_reached_where_it_is_said_to_be_and_the_sample_is_within_it(response, found):
    for loaded, mpa in found.cap_mpa.items():
        assert pressed(response, loaded, mpa).largest_strain == pytest.approx(CAP, abs=1e-4)  # 1e-4 MPa of bisection
    traction = np.array(found.sample.traction_mpa)
    assert (traction[:, 2] < 0).all()
    assert np.abs(traction[:, :2]).max() > 0
    assert 0 < found.sample.sideways_mm < found.sample.largest_mm
    assert 0 < found.sample.largest_strain <= CAP


def test_a_pillar_alone_follows_equation_6(found):
    """F/S = E Δl/l: 10 N on 4 mm² of 6.1 MPa."""
    assert found.alone_strain == pytest.approx(10.0 / 4.0 / 6.1)
    assert found.alone_n == pytest.approx(0.3 * 6.1 * 4.0)
