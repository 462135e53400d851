"""Lengths and resistances against geometry done by hand."""

import numpy as np
import pytest

from dataset import pillar_lengths, pillar_resistances, rest_resistances
from dataset.resistance import pillar_strains
from geometry import SensorDesign, Unit
from geometry.layout import pillar_volumes, rest_lengths

Z, X, Y = range(3)
EXACT = 1e-14  # rounding
STAY = (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("u1_mm", "u2_mm", "lengths_mm"),
    [
        (STAY, STAY, rest_lengths(Unit())),
        (STAY, (0, 0, -1), (10.0, np.hypot(10, 10), np.hypot(10, 9))),
        # x leans from L2 (+5, −5, 0) back to U1 (−5, −5, 10): dragging U1 along +x shortens it
        ((1, 0, 0), (1, 0, 0), (np.hypot(1, 10), np.hypot(9, 10), np.sqrt(1 + 10**2 + 10**2))),
        # y leans from L1 (−5, −5, 0) on to U2 (−5, +5, 10): dragging U2 along +y lengthens it
        ((0, 1, 0), (0, 1, 0), (np.hypot(1, 10), np.sqrt(1 + 10**2 + 10**2), np.hypot(11, 10))),
        ((3, 4, -2), (3, 4, -2), (np.sqrt(9 + 16 + 64), np.sqrt(49 + 16 + 64), np.sqrt(9 + 196 + 64))),
    ],
)
def test_lengths_are_those_between_the_moved_electrodes(u1_mm, u2_mm, lengths_mm):
    """Large moves: exact, not linearised. At constant volume resistances go with their squares."""
    length_mm = pillar_lengths(np.array([u1_mm, u2_mm], dtype=float), Unit())
    assert length_mm == pytest.approx(lengths_mm, rel=EXACT)
    squares = (length_mm / rest_lengths(Unit())) ** 2
    ohms = pillar_resistances(length_mm, pillar_volumes(Unit()), 4000.0)
    assert ohms == pytest.approx(rest_resistances(SensorDesign()) * squares, rel=EXACT)


def test_papers_sensor_rests_at_10_and_14_kilohm_and_a_collapsed_pillar_is_refused():
    """R = ρl²/V = ρl/S: 4000 Ω mm · 10 mm / 4 mm² upright, √2 times that oblique."""
    assert rest_resistances(SensorDesign()) == pytest.approx(1e4 * np.array([1.0, np.sqrt(2), np.sqrt(2)]), rel=EXACT)
    for length_mm in (0.0, np.nan):
        with pytest.raises(ValueError, match=rf"length_mm has a value of {length_mm:g}, must be above 0: lower"):
            pillar_resistances(np.array([10.0, 10.0, length_mm]), pillar_volumes(Unit()), 4000.0)


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
