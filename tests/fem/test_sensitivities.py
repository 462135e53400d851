"""Derivatives of the response by the design's parameters: by theory, and as differences of whole solves."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fem.array.sensitivities import response_sensitivities
from fem.array.solving import ResponseSettings, array_response, solve_response
from geometry.design import Array, Pad, SensorDesign
from geometry.tolerances import value_of, with_values

SETTINGS = ResponseSettings(tolerance=5e-2)
PAIR = SensorDesign(array=Array(rows=1, cols=2))


def test_a_softer_rubber_moves_in_proportion_and_known_parameters_are_left_out(shared_cache):
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


@pytest.mark.parametrize("kind", ["soft", pytest.param("stiff", marks=pytest.mark.long)])
def test_derivatives_are_differences_of_whole_solves(kind, shared_cache):
    """All parameters but E moved at once by a deviation; the grids of the solves leave some per cent of it."""
    design = replace(PAIR, pad=Pad(kind=kind))
    found, _, _ = response_sensitivities(design, SETTINGS)
    signs = {"rubber.poisson": 1, "unit.height_mm": -1, "unit.span_mm": 1, "pad.size_mm": 1}
    if kind == "soft":  # a plate off its middle has no quarter, and a solve takes a minute
        signs |= {"pad.offset_x_mm": 1, "pad.offset_y_mm": 1}
    moved = [signs.get(name, 0) * sd for name, sd in zip(found.parameters, found.deviation, strict=True)]
    above, below = (
        with_values(design, {n: value_of(design, n) + side * by for n, by in zip(found.parameters, moved, strict=True)})
        for side in (1, -1)
    )
    above, below = (solve_response(one, SETTINGS).influence_mm_per_n for one in (above, below))
    expected = np.tensordot(moved, found.influence_mm_per_n, axes=1)
    assert np.linalg.norm((above - below) / 2 - expected) < 0.05 * np.linalg.norm(expected)


@pytest.mark.parametrize("kind", ["soft", "stiff"])
def test_pillars_of_nearly_the_same_rubber_change_it_as_one(kind, monkeypatch):
    """Derivatives of whole cells, pillars mixed into their boxes, add up to those of a quarter of one rubber; pillars
    of the same rubber may be of any width."""
    monkeypatch.setattr("fem.array.sensitivities.LEVEL", 1)
    monkeypatch.setattr("fem.array.sensitivities.DEGREE", 2)
    one = SensorDesign(array=Array(rows=1, cols=1), pad=Pad(kind=kind))
    two = replace(one, pillar_material=replace(one.pillar_material, young_mpa=6.1 * (1 + 1e-9)))
    nothing = SimpleNamespace(influence_mm_per_n=np.zeros((1, 1, 2, 3, 1, 1, 3)))  # the response is not looked at
    monkeypatch.setattr("fem.array.sensitivities.array_response", lambda *_: (nothing, None, False))
    of_one, of_two = (
        dict(zip(found.parameters, found.influence_mm_per_n, strict=True))
        for found, _, _ in map(response_sensitivities, (one, two))
    )
    by_poisson = of_two["pillar_material.poisson"] + of_two["matrix_material.poisson"]
    assert np.linalg.norm(of_two["unit.pillar_width_mm"]) < 1e-6 * np.linalg.norm(by_poisson)
    assert of_two["pillar_material.young_mpa"].any()
    for name in set(of_one) - {"rubber.young_mpa"}:
        found = of_two.get(name, by_poisson)
        # steps are to one side there and to both here, the more so for offsets
        assert np.linalg.norm(found - of_one[name]) < 0.02 * np.linalg.norm(of_one[name]), name
