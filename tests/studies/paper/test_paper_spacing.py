"""The spacing study against the layer's closed form, an actual load's resistances, and itself at other settings."""

from dataclasses import replace

import numpy as np
import pytest

from dataset.resistance import pillar_lengths, pillar_resistances
from dataset.simulation import displacements
from fem.array.closed_forms import layer_mean_compliance
from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, Material, Pad, SensorDesign
from geometry.layout import pillar_volumes
from studies.paper import spacing

PAPER = SensorDesign()
SMALL = replace(PAPER, array=Array(rows=4, cols=4))
FEW = spacing.Asked(pitches_mm=(10.0, 14.0, 20.0), wider_mm=(30.0, 40.0))


def in_closed_form(design):
    return solve_response(design, ResponseSettings(method="layer"))


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> spacing.Spacing:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TRIPILLAR_CACHE", str(tmp_path_factory.mktemp("cache")))
        return spacing.study_spacing(SMALL, FEW)


def test_a_design_is_kept_where_it_fits_and_else_as_wide_as_does():
    assert spacing.design_at(PAPER, 15.0) == PAPER
    assert spacing.design_at(PAPER, 20.0) == replace(PAPER, array=Array(pitch_mm=20.0))
    narrow = spacing.design_at(PAPER, 11.0)
    assert 10.98 < narrow.unit.footprint_mm <= 11.0  # span cut to 0.01 mm, which the oblique width doubles at most
    assert narrow.pad.size_mm == 11.0


def test_influence_on_an_endless_layer_decays_as_theory_says():
    """The whole array in closed form, with no rim; its nearest electrodes are not yet far: 6 % on λ from 4 heights."""
    one = spacing.spaced_units(in_closed_form(PAPER), noise=0.001)
    far = replace(one, on_rim=[False] * len(one.on_rim))
    assert spacing.fitted_decay_mm([far], 40.0) == pytest.approx(spacing.decay_length_mm(10.0, 0.49), rel=0.06)


def test_shares_fall_with_distance_and_pitch():
    by_pitch = [
        spacing.spaced_units(in_closed_form(spacing.design_at(PAPER, pitch)), noise=0.001)
        for pitch in (14.0, 17.0, 20.0)
    ]
    for load in spacing.LOADS:
        shares = np.array([one.reading_share[load] for one in by_pitch])
        assert (np.diff(shares, axis=1) < 0).all()
        assert (np.diff(shares[:, 1:], axis=0) < 0).all()
    conditions = [one.condition for one in by_pitch]
    assert conditions == sorted(conditions, reverse=True)
    assert all(len(one.moved) == len(one.distance_mm) == len(one.on_rim) == 72 for one in by_pitch)


def test_a_touch_on_a_pad_changes_readings_as_that_pad_does():
    """Two routes: readings by slopes, and resistances of the pillars of a loaded array in closed form.

    10 mN bend no pillar: terms beyond the slope are 1e-6 of it.
    """
    design = replace(PAPER, array=Array(rows=5, cols=5, pitch_mm=18.0), pad=Pad(size_mm=10.0))
    traction = np.zeros((3, 25, 3))
    traction[range(3), 12, range(3)] = 0.01 / 100.0
    moved = displacements(in_closed_form(design), traction)
    lengths = [pillar_lengths(u, design.unit) for u in (moved, np.zeros_like(moved))]
    loaded, rest = (pillar_resistances(one, pillar_volumes(design.unit), 4000.0) for one in lengths)
    change = np.abs(loaded / rest - 1).max(axis=(1, 2)) / 0.01
    assert spacing.strongest_reading(design, np.zeros((1, 2)), 10.0)[0] == pytest.approx(change, rel=1e-4)


def test_the_lightest_touch_is_as_light_as_the_noise_and_noise_costs_force_in_proportion():
    """Noise enters the forces' error in proportion, and nothing else."""
    once, twice = (spacing.lightest_touch(PAPER, spacing.Asked(noise=noise)) for noise in (0.001, 0.002))
    for load in spacing.LOADS:
        assert twice.worst_n[load] == pytest.approx(2 * once.worst_n[load])
        assert 0 < once.best_n[load] < once.worst_n[load]
    quiet, loud = (spacing.spaced_units(in_closed_form(PAPER), noise) for noise in (0.001, 0.002))
    assert loud.noise_n["fz"] == pytest.approx(2 * quiet.noise_n["fz"])
    assert replace(loud, noise_n=quiet.noise_n) == quiet
    loaded = np.argsort(quiet.distance_mm)[:2]
    np.testing.assert_allclose(np.array(quiet.moved)[loaded].max(), 1.0)


def test_the_study_holds_every_pitch_and_agrees_with_the_layer_inside_the_array(found):
    """The layer has no free side; inside a 4 × 4 array one is a pitch away: a tenth."""
    assert [one.pitch_mm for one in found.spaced] == [10.0, 14.0, 20.0]
    assert [one.pitch_mm for one in found.touches] == [10.0, 14.0, 20.0, 30.0, 40.0]
    for one in found.spaced:
        third = one.reading_share["normal"][spacing.RINGS.index(3)]
        assert third == 0.0  # 4 × 4 units: none so far from one in the middle
    assert spacing.spacing_cache_key(SMALL, FEW) != spacing.spacing_cache_key(SMALL, replace(FEW, noise=0.01))
    closed = spacing.spaced_units(in_closed_form(spacing.design_at(SMALL, 20.0)), noise=0.001)
    inside = ~np.array(closed.on_rim)
    np.testing.assert_allclose(np.array(found.spaced[-1].moved)[inside], np.array(closed.moved)[inside], rtol=0.1)


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49, 0.4999])
def test_far_from_a_load_the_surface_falls_as_its_decay_length_says(nu):
    """u √r falls by e over λ; 10 to 11 heights away the next term of K₀(r/λ) changes that by 1/(8 (r/λ)²) < 0.3 %."""
    material, r = Material(young_mpa=6.1, poisson=nu), np.array([100.0, 110.0])
    squares = np.column_stack([r - 1, -np.ones(2), r + 1, np.ones(2)])
    u = layer_mean_compliance(squares, [-6.0, -6.0, 6.0, 6.0], 10.0, material)[:, 2, 2]
    measured = -np.diff(r) / np.diff(np.log(np.abs(u) * np.sqrt(r)))
    assert measured[0] == pytest.approx(spacing.decay_length_mm(10.0, nu), rel=3e-3)


def test_the_decay_length_of_what_cannot_be_compressed():
    """cos x = x has the root 0.7390851332; λ is a length, so it grows with the height."""
    assert spacing.decay_length_mm(1.0, 0.5 - 1e-9) == pytest.approx(1 / 0.7390851332, rel=1e-8)
    assert spacing.decay_length_mm(7.0, 0.4) == pytest.approx(7 * spacing.decay_length_mm(1.0, 0.4))
