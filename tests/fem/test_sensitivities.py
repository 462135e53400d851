"""Derivatives of the response by the design's parameters: by theory, and as differences of whole solves."""

from dataclasses import replace

import numpy as np
import pytest

from fem.array import sensitivities
from fem.array.sensitivities import response_sensitivities
from fem.array.solving import ResponseSettings, array_response, solve_response
from geometry.design import Array, Pad, SensorDesign
from geometry.tolerances import RESISTIVITY, changed, usual_deviations, value_of, with_values

SETTINGS = ResponseSettings(tolerance=5e-2)
PAIR = SensorDesign(array=Array(rows=1, cols=2))
STIFF = replace(PAIR, pad=Pad(kind="stiff"))
pytestmark = pytest.mark.usefixtures("shared_cache")  # one set of derivatives serves several tests


def test_a_softer_rubber_moves_in_proportion_and_known_parameters_are_left_out():
    """B ~ 1/E: ∂B/∂E = −B/E to rounding. Another resistivity finds the same file."""
    response, _, _ = array_response(PAIR, SETTINGS)
    found, _, _ = response_sensitivities(PAIR, SETTINGS)
    by_young = found.influence_mm_per_n[found.parameters.index("rubber.young_mpa")]
    assert np.allclose(by_young, -response.influence_mm_per_n / 6.1, rtol=1e-14, atol=0)
    again, _, reused = response_sensitivities(replace(PAIR, resistivity_ohm_mm=8000.0), SETTINGS)
    assert reused
    assert np.array_equal(found.influence_mm_per_n, again.influence_mm_per_n)
    some = found.with_tolerances({"unit.height_mm": 0.0, "pad.size_mm": 0.1})
    assert set(found.parameters) - set(some.parameters) == {"unit.height_mm"}
    assert some.deviation[some.parameters.index("pad.size_mm")] == 0.1
    assert len(some.influence_mm_per_n) == len(found.parameters) - 1


@pytest.mark.parametrize("design", [PAIR, pytest.param(STIFF, marks=pytest.mark.long)], ids=["soft", "stiff"])
def test_derivatives_are_differences_of_whole_solves(design):
    """All parameters but E moved at once by a deviation; the grids of the solves leave some per cent of it."""
    found, _, _ = response_sensitivities(design, SETTINGS)
    signs = {"rubber.poisson": 1, "unit.height_mm": -1, "unit.span_mm": 1, "pad.size_mm": 1}
    if design is PAIR:  # a plate off its middle has no quarter, and a solve takes a minute
        signs |= {"pad.offset_x_mm": 1, "pad.offset_y_mm": 1}
    moved = dict(zip(found.parameters, found.deviation, strict=True))
    moved = {name: signs.get(name, 0) * sd for name, sd in moved.items()}
    above, below = (
        solve_response(
            with_values(design, {name: value_of(design, name) + side * by for name, by in moved.items()}), SETTINGS
        ).influence_mm_per_n
        for side in (1, -1)
    )
    expected = np.tensordot(list(moved.values()), found.influence_mm_per_n, axes=1)
    assert np.linalg.norm((above - below) / 2 - expected) < 0.05 * np.linalg.norm(expected)


@pytest.mark.parametrize("kind", ["soft", "stiff"])
def test_pillars_of_nearly_the_same_rubber_change_it_as_one(kind, monkeypatch):
    """Derivatives of whole cells, pillars mixed into their boxes, add up to those of a quarter of one rubber; pillars
    of the same rubber may be of any width."""
    monkeypatch.setattr(sensitivities, "LEVEL", 1)
    monkeypatch.setattr(sensitivities, "DEGREE", 2)
    one = replace(PAIR, pad=Pad(kind=kind))
    two = replace(one, pillar_material=replace(one.pillar_material, young_mpa=6.1 * (1 + 1e-9)))
    of_one, of_two = (
        sensitivities._derivatives(
            design, {n: sd for n, sd in usual_deviations(design).items() if n != RESISTIVITY}, lambda step: None
        )
        for design in (one, two)
    )
    by_poisson = of_two.pop("pillar_material.poisson") + of_two.pop("matrix_material.poisson")
    assert np.linalg.norm(of_two.pop("unit.pillar_width_mm")) < 1e-6 * np.linalg.norm(by_poisson)
    assert of_two.pop("pillar_material.young_mpa").any()
    for name, expected in of_one.items():
        found = of_two.get(name, by_poisson)
        # steps are to one side there and to both here, the more so for offsets
        assert np.linalg.norm(found - expected) < 0.02 * np.linalg.norm(expected), name


def test_a_changed_parameter_is_that_of_the_design():
    design = changed(PAIR, "rubber.poisson", -0.01)
    assert design.is_homogeneous
    assert design.pillar_material.poisson == pytest.approx(0.48)
    other = replace(PAIR, pillar_material=replace(PAIR.pillar_material, young_mpa=8.0))
    assert {"pillar_material.young_mpa", "matrix_material.young_mpa"} < set(usual_deviations(other))
    touching = replace(PAIR, pad=Pad(size_mm=PAIR.array.pitch_mm))
    assert set(usual_deviations(PAIR)) - set(usual_deviations(touching)) == {"pad.offset_x_mm", "pad.offset_y_mm"}
    for name, sd in usual_deviations(other).items():
        assert value_of(changed(other, name, sd), name) > value_of(other, name)
