"""What is said of a sensor once."""

import json
from dataclasses import replace

import numpy as np
import pytest

from decoupler.model.ensemble import Ensemble
from hardware.readout.description import describe
from tests.hardware.streams.conftest import INFO


def test_it_states_places_signs_range_and_whose_it_is(pressed):
    found = describe(pressed.model, INFO)
    pitch_mm = pressed.samples.design.array.pitch_mm
    assert found.position_mm[1, 2].tolist() == [pitch_mm, pitch_mm / 2, 0.0]
    assert found.signs == (1.0, 1.0, -1.0)
    force_n = pressed.samples.force_n
    assert found.range_n[..., 0] == pytest.approx(force_n.min(axis=0), abs=1e-9)
    assert found.range_n[..., 1] == pytest.approx(force_n.max(axis=0), abs=1e-9)
    assert found.design_hash == pressed.model.design_hash
    assert found.model_hash == pressed.model.made_from["recipe"]
    assert not found.dead.any()
    assert found.twin_deviation is None
    plain = found.plain()
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain


def test_dead_pillars_and_the_twins_deviations_are_stated(pressed):
    """Gains of two draws are 1 % and 3 % off: √5 % together; an offset of 1 % of R adds its square."""
    dead = np.zeros((2, 3, 3), dtype=bool)
    dead[1, 0, 2] = True
    gain = np.array([[0.01] * 18, [-0.03] * 18])
    offset_ohm = np.zeros((2, 18))
    offset_ohm[0, 0] = 0.01 * pressed.model.rest_resistances()[0, 0, 0]
    draws = Ensemble(
        resistance=gain, offset_ohm=offset_ohm, rest_mm=np.zeros((2, 18, 3)), influence=np.zeros((2, 18, 3, 18))
    )
    found = describe(replace(pressed.model, dead=dead, ensemble=draws), INFO)
    assert np.argwhere(found.dead).tolist() == [[1, 0, 2]]
    expected = np.full((2, 3, 3), np.sqrt(5e-4))
    expected[0, 0, 0] = np.sqrt((0.02**2 + 0.03**2) / 2)
    assert found.twin_deviation == pytest.approx(expected)
