"""The spacing study against the layer's closed form, an actual load's resistances, and itself at other settings."""

from dataclasses import replace

import numpy as np
import pytest

from dataset.loads import displacements
from dataset.resistance import pillar_lengths, pillar_resistances
from fem.array.closed_forms import layer_mean_compliance
from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, Material, Pad, SensorDesign
from geometry.layout import pillar_volumes
from studies.paper import spacing

PAPER = SensorDesign()


def in_closed_form(design):
    return solve_response(design, ResponseSettings(method="layer"))


def test_a_touch_on_a_pad_changes_readings_as_that_pad_does():
    """Two routes: readings by slopes, and resistances of a loaded array: 10 mN are 1e-6 beyond the slope."""
    design = replace(PAPER, array=Array(rows=5, cols=5, pitch_mm=18.0), pad=Pad(size_mm=10.0))
    traction = np.zeros((3, 25, 3))
    traction[range(3), 12, range(3)] = 0.01 / 100.0
    moved = displacements(in_closed_form(design), traction)
    lengths = [pillar_lengths(u, design.unit) for u in (moved, np.zeros_like(moved))]
    loaded, rest = (pillar_resistances(one, pillar_volumes(design.unit), 4000.0) for one in lengths)
    change = np.abs(loaded / rest - 1).max(axis=(1, 2)) / 0.01
    assert spacing.strongest_reading(design, np.zeros((1, 2)), 10.0)[0] == pytest.approx(change, rel=1e-4)


def test_the_lightest_touch_is_as_light_as_the_noise():
    once, twice = (spacing.lightest_touch(PAPER, spacing.Asked(noise=noise)) for noise in (0.001, 0.002))
    for load in spacing.LOADS:
        assert twice.worst_n[load] == pytest.approx(2 * once.worst_n[load])
        assert once.worst_n[load] > 0


@pytest.mark.parametrize("nu", [0.0, 0.4999])
def test_far_from_a_load_the_surface_falls_as_its_decay_length_says(nu):
    """u √r falls by e over λ; 10 to 11 heights away the next term of K₀(r/λ) changes that by 1/(8 (r/λ)²) < 0.3 %."""
    material, r = Material(young_mpa=6.1, poisson=nu), np.array([100.0, 110.0])
    squares = np.column_stack([r - 1, -np.ones(2), r + 1, np.ones(2)])
    u = layer_mean_compliance(squares, [-6.0, -6.0, 6.0, 6.0], 10.0, material)[:, 2, 2]
    measured = -np.diff(r) / np.diff(np.log(np.abs(u) * np.sqrt(r)))
    assert measured[0] == pytest.approx(spacing.decay_length_mm(10.0, nu), rel=3e-3)
