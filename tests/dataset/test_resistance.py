"""Lengths and resistances against geometry done by hand."""

import numpy as np
import pytest

from dataset import pillar_lengths, pillar_resistances, rest_resistances
from dataset.resistance import pillar_strains
from geometry import SensorDesign, Unit
from geometry.layout import pillar_volumes, rest_lengths

Z, X, Y = range(3)
EXACT = 1e-14  # rounding


def test_u1_moves_the_z_and_x_pillars_and_u2_the_y_pillar():
    for moved_mm, lengths_mm in (
        ([[0, 0, 0], [0, 0, 0]], rest_lengths(Unit())),
        ([[0, 0, -1], [0, 0, 0]], [9.0, np.hypot(10, 9), np.hypot(10, 10)]),
        ([[0, 0, 0], [0, 0, -1]], [10.0, np.hypot(10, 10), np.hypot(10, 9)]),
    ):
        assert pillar_lengths(np.array(moved_mm), Unit()) == pytest.approx(lengths_mm, rel=EXACT)


@pytest.mark.parametrize(
    ("moved_mm", "lengths_mm"),
    [
        # x leans from L2 (+5, −5, 0) back to U1 (−5, −5, 10): dragging U1 along +x shortens it
        ((1.0, 0.0, 0.0), (np.hypot(1, 10), np.hypot(9, 10), np.sqrt(1 + 10**2 + 10**2))),
        ((-1.0, 0.0, 0.0), (np.hypot(1, 10), np.hypot(11, 10), np.sqrt(1 + 10**2 + 10**2))),
        # y leans from L1 (−5, −5, 0) on to U2 (−5, +5, 10): dragging U2 along +y lengthens it
        ((0.0, 1.0, 0.0), (np.hypot(1, 10), np.sqrt(1 + 10**2 + 10**2), np.hypot(11, 10))),
        ((0.0, 0.0, -2.0), (8.0, np.hypot(10, 8), np.hypot(10, 8))),
        ((3.0, 4.0, -2.0), (np.sqrt(9 + 16 + 64), np.sqrt(49 + 16 + 64), np.sqrt(9 + 196 + 64))),
    ],
)
def test_both_electrodes_moved_alike(moved_mm, lengths_mm):
    """Large moves: exact, not linearised."""
    assert pillar_lengths(np.array([moved_mm, moved_mm]), Unit()) == pytest.approx(lengths_mm, rel=EXACT)


def test_first_order_change_is_the_move_along_the_pillar():
    """dl = e·u with e the pillar's direction; the rest is of second order: 1e-4² / 10."""
    moved = 1e-4 * np.random.default_rng(0).normal(size=(50, 2, 3))
    e = np.array([[0, 0, 1], [-np.sqrt(0.5), 0, np.sqrt(0.5)], [0, np.sqrt(0.5), np.sqrt(0.5)]])
    along = np.stack([moved[:, 0] @ e[Z], moved[:, 0] @ e[X], moved[:, 1] @ e[Y]], axis=1)
    change = pillar_lengths(moved, Unit()) - rest_lengths(Unit())
    assert change == pytest.approx(along, abs=2e-8)


def test_papers_sensor_rests_at_10_and_14_kilohm():
    """R = ρl²/V = ρl/S: 4000 Ω mm · 10 mm / 4 mm² upright, √2 times that oblique."""
    assert rest_resistances(SensorDesign()) == pytest.approx(1e4 * np.array([1.0, np.sqrt(2), np.sqrt(2)]), rel=EXACT)


def test_resistance_goes_with_the_square_of_length():
    """At constant volume: squeezed to 0.7, a pillar has 0.49 of its resistance."""
    volumes = pillar_volumes(Unit())
    rest = pillar_resistances(rest_lengths(Unit()), volumes, 4000.0)
    assert pillar_resistances(0.7 * rest_lengths(Unit()), volumes, 4000.0) == pytest.approx(0.49 * rest, rel=EXACT)
    assert pillar_resistances(rest_lengths(Unit()), volumes, 8000.0) == pytest.approx(2 * rest, rel=EXACT)


@pytest.mark.parametrize("length_mm", [0.0, -1.0, np.nan])
def test_collapsed_pillar_is_refused(length_mm):
    lengths = np.full((2, 3), 10.0)
    lengths[1, 2] = length_mm
    with pytest.raises(ValueError, match=rf"length_mm has a value of {length_mm:g}, must be above 0: lower"):
        pillar_resistances(lengths, pillar_volumes(Unit()), 4000.0)


@pytest.mark.parametrize(
    ("axis", "moved_mm", "pillar", "length_mm", "strain"),
    [
        (2, -1.0, Z, 9.0, 0.1),
        (2, -19.0, Z, 9.0, np.inf),  # out below the base: a tenth by length alone
        (0, 20.0, X, 10 * np.sqrt(2), np.inf),  # slid along +x: leans the other way at its old length
    ],
)
def test_strain_is_that_of_the_length_until_a_pillar_turns_over(axis, moved_mm, pillar, length_mm, strain):
    """By a move of U1; U2 stays, and the y pillar with it."""
    moved = np.zeros((2, 3))
    moved[0, axis] = moved_mm
    length = pillar_lengths(moved, Unit())
    assert length[pillar] == pytest.approx(length_mm, rel=EXACT)
    strains = pillar_strains(moved, length, Unit())
    assert strains[pillar] == pytest.approx(strain, rel=1e-12)
    assert strains[Y] == 0.0
