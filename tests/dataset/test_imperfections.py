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


def applied(imperfections: Imperfections, exact_ohm: np.ndarray = EXACT, seed: int = 0) -> np.ndarray:
    return imperfections.apply(exact_ohm, np.random.default_rng(seed))


def test_the_default_is_perfect():
    assert np.array_equal(applied(Imperfections()), EXACT)
    assert not Imperfections().dead_mask(ROWS, COLS).any()


def test_factors_are_within_the_spread_and_last_for_every_sample():
    ratio = applied(Imperfections(gain_spread=0.2)) / EXACT
    assert ratio == pytest.approx(np.broadcast_to(ratio[0], ratio.shape), rel=1e-15)  # rounding
    assert (np.abs(ratio - 1.0) <= 0.2 * (1 + 1e-12)).all()  # rounding
    assert len(np.unique(ratio[0])) == ROWS * COLS * 3


def test_factors_are_uniform():
    gain, _ = Imperfections(gain_spread=0.2).gain_and_offset(100, 100)
    n = gain.size
    assert gain.mean() == pytest.approx(1.0, abs=4 * 0.2 / np.sqrt(3 * n))  # of a mean
    share = np.mean(np.abs(gain - 1.0) < 0.05)
    assert share == pytest.approx(0.25, abs=4 * np.sqrt(0.25 * 0.75 / n))  # of a count
    assert np.abs(gain - 1.0).max() > 0.1999  # 30,000 numbers come closer than 1e-4 to the end


def test_offsets_have_the_deviation_asked_and_last_for_every_sample():
    added = applied(Imperfections(offset_ohm=50.0)) - EXACT
    assert added == pytest.approx(np.broadcast_to(added[0], added.shape), abs=1e-11)  # rounding at 20 kΩ
    _, offset = Imperfections(offset_ohm=50.0).gain_and_offset(100, 100)
    assert offset.mean() == pytest.approx(0.0, abs=4 * 50.0 / np.sqrt(offset.size))  # of a mean
    assert offset.std() == pytest.approx(50.0, rel=4 / np.sqrt(2 * offset.size))  # of a deviation


def test_the_factor_acts_before_the_offset():
    real = Imperfections(gain_spread=0.2, offset_ohm=50.0)
    gain, offset = real.gain_and_offset(ROWS, COLS)
    assert applied(real) == pytest.approx(gain * EXACT + offset, rel=1e-15)  # rounding


def test_another_specimen_differs_in_every_pillar_and_noise_does_not_touch_either():
    first, again, other = (Imperfections(gain_spread=0.2, offset_ohm=50.0, specimen=s) for s in (1, 1, 2))
    for mine, same, theirs in zip(*(s.gain_and_offset(ROWS, COLS) for s in (first, again, other)), strict=True):
        assert np.array_equal(mine, same)
        assert (mine != theirs).all()
    assert np.array_equal(applied(first, seed=1), applied(first, seed=2))


def test_a_wider_spread_is_the_same_specimen_with_larger_deviations():
    narrow, wide = (Imperfections(gain_spread=s, offset_ohm=5.0).gain_and_offset(ROWS, COLS) for s in (0.1, 0.3))
    assert wide[0] - 1.0 == pytest.approx(3 * (narrow[0] - 1.0), rel=1e-12)  # rounding next to 1
    assert np.array_equal(wide[1], narrow[1])


def test_noise_acts_on_the_specimen_and_is_drawn_anew_for_every_reading():
    quiet = Imperfections(gain_spread=0.2, offset_ohm=50.0)
    error = applied(replace(quiet, noise=0.01)) / applied(quiet) - 1.0
    assert error.std() == pytest.approx(0.01, rel=4 / np.sqrt(2 * error.size))  # of a deviation
    assert len(np.unique(error)) == error.size


def test_the_converter_comes_last():
    read = applied(Imperfections(gain_spread=0.2, offset_ohm=50.0, noise=0.01, bits=10))
    counts = 1023 * SENSE_OHM / (read + SENSE_OHM)
    assert counts == pytest.approx(np.rint(counts), abs=1e-9)  # rounding
    assert len(np.unique(read)) < 1024


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
    """From the design's table: z from L1 to U1, x from L2 to U1, y from L1 to U2."""
    expected = np.zeros((ROWS, COLS, 3), dtype=bool)
    for pillar in pillars:
        expected[(*place, PILLARS.index(pillar))] = True
    broken = Imperfections(**wire)
    assert np.array_equal(broken.dead_mask(ROWS, COLS), expected)
    read = applied(broken)
    assert (read[:, expected] == OPEN_OHM).all()
    assert np.array_equal(read[:, ~expected], EXACT[:, ~expected])


def test_what_is_dead_adds_up():
    parts = [{"dead_rows": (0, 3)}, {"dead_cols": (11,)}, {"dead_pillars": ((5, 5, "z"), (0, 0, "z"))}]
    masks = [Imperfections(**part).dead_mask(ROWS, COLS) for part in parts]
    together = Imperfections(**parts[0], **parts[1], **parts[2])
    assert np.array_equal(together.dead_mask(ROWS, COLS), np.logical_or.reduce(masks))


def test_dead_pillars_leave_what_the_others_read_as_it_was():
    """The same noise and steps, to the last bit; and what a dead pillar would have been cannot stop the converter."""
    real = Imperfections(gain_spread=0.2, noise=0.01, bits=12)
    broken = replace(real, dead_pillars=((0, 0, "z"),), dead_cols=(5,))
    exact = EXACT.copy()
    exact[:, 0, 0, 0] = 1e12
    dead = broken.dead_mask(ROWS, COLS)
    read = applied(broken, exact)
    assert np.array_equal(read[:, ~dead], applied(real)[:, ~dead])
    assert (read[:, dead] == OPEN_OHM).all()


def test_given_resistances_are_not_written_on():
    exact = EXACT.copy()
    applied(Imperfections(gain_spread=0.2, noise=0.01, bits=12, dead_rows=(0,)), exact)
    assert np.array_equal(exact, EXACT)


def test_an_offset_that_outweighs_a_resistance_is_refused():
    with pytest.raises(DesignError, match=r"offset_ohm=10000 takes a pillar's resistance to -.* Ω: lower it") as caught:
        applied(Imperfections(offset_ohm=1e4))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        ({"dead_rows": (12,)}, "an array of 6 × 5 units has no row wire 12: its row wires are 0 to 11."),
        ({"dead_cols": (0, 10)}, "an array of 6 × 5 units has no column wire 10: its column wires are 0 to 9."),
        ({"dead_pillars": ((6, 0, "z"),)}, "an array of 6 × 5 units has no pillar 6,0,z: its rows are 0 to 5"),
        ({"dead_pillars": ((0, 5, "y"),)}, "an array of 6 × 5 units has no pillar 0,5,y: "),
    ],
)
def test_what_the_array_does_not_have_cannot_be_dead(broken, message):
    for look in (lambda b: b.dead_mask(6, 5), lambda b: applied(b, EXACT[:, :, :5])):
        with pytest.raises(DesignError) as caught:
            look(Imperfections(**broken))
        assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"gain_spread": -0.1}, "gain_spread=-0.1 must be from 0 to below 1"),
        ({"gain_spread": 1.0}, "gain_spread=1 must be from 0 to below 1"),
        ({"gain_spread": "wide"}, "gain_spread='wide' must be a finite number"),
        ({"offset_ohm": -5.0}, "offset_ohm=-5 must be from 0 to 1e6"),
        ({"offset_ohm": float("nan")}, "offset_ohm=nan must be a finite number"),
        ({"offset_ohm": 1e7}, "offset_ohm=1e+07 must be from 0 to 1e6"),
        ({"specimen": -1}, "specimen=-1 must be from 0"),
        ({"specimen": 2**63}, f"specimen={2**63} must be from 0 to below 2⁶³"),
        ({"specimen": 1.5}, "specimen=1.5 must be a whole number"),
        ({"dead_rows": (-1,)}, "dead_rows=(-1,) must hold numbers of wires from 0 on"),
        ({"dead_rows": 4}, "dead_rows=4 must hold numbers of wires from 0 on"),
        ({"dead_cols": (True,)}, "dead_cols=(True,) must hold numbers of wires from 0 on"),
        ({"dead_cols": ("4",)}, "dead_cols=('4',) must hold numbers of wires from 0 on"),
        ({"dead_pillars": ((0, 3, "w"),)}, "dead_pillars=((0, 3, 'w'),) must hold a row and a column from 0 on"),
        ({"dead_pillars": ((-1, 3, "z"),)}, "dead_pillars=((-1, 3, 'z'),) must hold"),
        ({"dead_pillars": ((0, "z"),)}, "dead_pillars=((0, 'z'),) must hold"),
        ({"dead_pillars": (0, 3, "z")}, "dead_pillars=(0, 3, 'z') must hold"),
    ],
)
def test_imperfections_that_make_no_sense_are_refused_by_name(changed, message):
    with pytest.raises(DesignError) as caught:
        Imperfections(**changed)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_a_place_is_read_with_and_without_blanks():
    assert place_of("0,3,z") == place_of(" 0 , 3 , z ") == (0, 3, "z")


@pytest.mark.parametrize(
    "text", ["", "z", "0,3", "0;3;z", "-1,3,z", "0,3,z,1", "0,3.5,z", "0,3,z\n4", "9" * 5000 + ",0,z"]
)
def test_what_is_no_place_is_refused_in_one_line(text):
    with pytest.raises(DesignError, match=r"is no place of a pillar: write row,col,pillar, such as 0,3,z") as caught:
        place_of(text)
    assert "\n" not in str(caught.value)
