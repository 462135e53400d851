"""A specimen's factors and offsets are its own and last; dead wires kill what the wiring says; nothing else changes."""

from dataclasses import replace

import numpy as np
import pytest

from dataset import OPEN_OHM, Imperfections
from dataset.imperfections import place_of
from dataset.measurement import SENSE_OHM
from geometry import DesignError
from geometry.layout import PILLARS

ROWS, COLS = 6, 6
EXACT = np.random.default_rng(0).uniform(5e3, 20e3, (40, ROWS, COLS, 3))
REAL = Imperfections(gain_spread=0.2, offset_ohm=50.0)


def applied(imperfections: Imperfections, exact_ohm: np.ndarray = EXACT, seed: int = 0) -> np.ndarray:
    return imperfections.apply(exact_ohm, np.random.default_rng(seed))


def test_a_specimen_is_a_factor_and_then_an_offset_for_every_sample():
    """Each pillar has its own, in every specimen, and a wider spread is the same one; by default there is none."""
    assert np.array_equal(applied(Imperfections()), EXACT)
    gain, offset = REAL.gain_and_offset(ROWS, COLS)
    assert applied(REAL) == pytest.approx(gain * EXACT + offset, rel=1e-15)  # rounding
    assert np.array_equal(applied(REAL, seed=1), applied(REAL, seed=2))
    assert len(np.unique(gain)) == len(np.unique(offset)) == ROWS * COLS * 3
    for mine, theirs in zip((gain, offset), replace(REAL, specimen=1).gain_and_offset(ROWS, COLS), strict=True):
        assert (mine != theirs).all()
    wide, same = replace(REAL, gain_spread=0.6).gain_and_offset(ROWS, COLS)
    assert wide - 1.0 == pytest.approx(3 * (gain - 1.0), rel=1e-12)  # rounding next to 1
    assert np.array_equal(offset, same)


def test_factors_are_uniform_and_offsets_normal():
    gain, offset = REAL.gain_and_offset(100, 100)
    n = gain.size
    assert gain.mean() == pytest.approx(1.0, abs=4 * 0.2 / np.sqrt(3 * n))  # of a mean
    share = np.mean(np.abs(gain - 1.0) < 0.05)
    assert share == pytest.approx(0.25, abs=4 * np.sqrt(0.25 * 0.75 / n))  # of a count
    assert 0.1999 < np.abs(gain - 1.0).max() <= 0.2  # 30,000 numbers come closer than 1e-4 to the end
    assert offset.mean() == pytest.approx(0.0, abs=4 * 50.0 / np.sqrt(n))  # of a mean
    assert offset.std() == pytest.approx(50.0, rel=4 / np.sqrt(2 * n))  # of a deviation


def test_noise_acts_on_the_specimen_anew_for_every_reading_and_the_converter_comes_last():
    error = applied(replace(REAL, noise=0.01)) / applied(REAL) - 1.0
    assert error.std() == pytest.approx(0.01, rel=4 / np.sqrt(2 * error.size))  # of a deviation
    assert len(np.unique(error)) == error.size
    counts = 1023 * SENSE_OHM / (applied(replace(REAL, noise=0.01, bits=10)) + SENSE_OHM)
    assert counts == pytest.approx(np.rint(counts), abs=1e-9)  # rounding


@pytest.mark.parametrize(
    ("wire", "place", "pillars"),
    [
        ({"dead_rows": (4,)}, np.s_[2, :], "zx"),  # U1 of array row 2
        ({"dead_rows": (5,)}, np.s_[2, :], "y"),  # U2
        ({"dead_cols": (6,)}, np.s_[:, 3], "zy"),  # L1 of array column 3
        ({"dead_cols": (7,)}, np.s_[:, 3], "x"),  # L2
        ({"dead_pillars": ((2, 3, "x"),)}, np.s_[2, 3], "x"),
    ],
)
def test_dead_wires_kill_the_pillars_between_their_electrodes(wire, place, pillars):
    """From the design's table: z from L1 to U1, x from L2 to U1, y from L1 to U2. What is dead adds up."""
    expected = np.zeros((ROWS, COLS, 3), dtype=bool)
    for pillar in pillars:
        expected[(*place, PILLARS.index(pillar))] = True
    assert np.array_equal(Imperfections(**wire).dead_mask(ROWS, COLS), expected)
    corner = ((5, 5, "z"), *wire.get("dead_pillars", ()))
    expected[5, 5, 0] = True
    assert np.array_equal(Imperfections(**wire | {"dead_pillars": corner}).dead_mask(ROWS, COLS), expected)


def test_dead_pillars_leave_what_the_others_read_as_it_was():
    """The same noise and steps, to the last bit; and what a dead pillar would have been cannot stop the converter."""
    real = Imperfections(gain_spread=0.2, noise=0.01, bits=12)
    broken = replace(real, dead_pillars=((0, 0, "z"),), dead_cols=(5,))
    exact = EXACT.copy()
    exact[:, 0, 0, 0] = 1e12
    given, dead = exact.copy(), broken.dead_mask(ROWS, COLS)
    read = applied(broken, exact)
    assert np.array_equal(read[:, ~dead], applied(real)[:, ~dead])
    assert (read[:, dead] == OPEN_OHM).all()
    assert np.array_equal(exact, given)  # and is not written on


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        ({"dead_rows": (12,)}, "an array of 6 × 5 units has no row wire 12: its row wires are 0 to 11."),
        ({"dead_cols": (0, 10)}, "an array of 6 × 5 units has no column wire 10: its column wires are 0 to 9."),
        ({"dead_pillars": ((0, 5, "y"),)}, "an array of 6 × 5 units has no pillar 0,5,y: its rows are 0 to 5"),
        ({"offset_ohm": 1e4}, "offset_ohm=10000 takes a pillar's resistance to -"),
    ],
)
def test_what_does_not_fit_the_array_is_refused(broken, message):
    with pytest.raises(DesignError) as caught:
        applied(Imperfections(**broken), EXACT[:, :, :5])
    assert str(caught.value).startswith(message)


def test_a_place_is_read_with_and_without_blanks_and_nothing_else():
    assert place_of("0,3,z") == place_of(" 0 , 3 , z ") == (0, 3, "z")
    for text in ("", "z", "0,3", "-1,3,z", "0,3,z,1", "0,3.5,z", "0,3,z\n4", "9" * 5000 + ",0,z"):
        with pytest.raises(DesignError, match=r"is no place of a pillar: write row,col,pillar"):
            place_of(text)
