"""Noise, converters, drifts and specimens have the statistics asked for, and change nothing else."""

from dataclasses import fields, replace

import numpy as np
import pytest

from dataset import (
    OPEN_OHM,
    DatasetSettings,
    Imperfections,
    counts_from_resistance,
    measured,
    resistance_from_counts,
    simulate,
)
from dataset.imperfections import place_of
from dataset.measurement import SENSE_OHM, ReadingError
from geometry import DesignError
from geometry.design import Drifts
from geometry.layout import SONG2018

RESISTANCES = np.geomspace(3e3, 30e3, 5000)
ROWS, COLS = 6, 6
EXACT = np.random.default_rng(0).uniform(5e3, 20e3, (40, ROWS, COLS, 3))
REAL = Imperfections(gain_spread=0.2, offset_ohm=50.0)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def applied(imperfections: Imperfections, exact_ohm: np.ndarray = EXACT, seed: int = 0) -> np.ndarray:
    return imperfections.apply(exact_ohm, rng(seed))


@pytest.mark.parametrize("noise", [1e-3, 0.05])
def test_noise_is_relative_and_of_the_level_asked(noise):
    n = 200_000
    exact = np.tile([5e3, 50e3], n // 2)
    error = measured(exact, noise, None, rng()) / exact - 1.0
    for part in (error[::2], error[1::2]):  # the same at 5 and at 50 kΩ
        assert part.mean() == pytest.approx(0.0, abs=4 * noise / np.sqrt(len(part)))  # of a mean
        assert part.std() == pytest.approx(noise, rel=4 / np.sqrt(2 * len(part)))  # of a deviation
    within = np.mean(np.abs(error) < noise)
    assert within == pytest.approx(0.6827, abs=4 * np.sqrt(0.68 * 0.32 / n))  # a bell's share within one deviation


def test_settings_do_not_move_the_generator():
    """So that switching noise on changes nothing but the noise; what is given is not written on."""
    after, exact = [], RESISTANCES.copy()
    for noise, bits in ((0.0, None), (0.01, None), (0.0, 12), (0.01, 12)):
        generator = rng()
        read = measured(exact, noise, bits, generator)
        after.append(generator.random())
        assert np.array_equal(read, exact) == (noise == 0.0 and bits is None)
        assert np.array_equal(exact, RESISTANCES)
    assert len(set(after)) == 1


@pytest.mark.parametrize("bits", [4, 12, 24])
def test_a_converter_errs_by_half_a_step_at_most(bits):
    """The divider's share moves by half a count; counts fall as resistance grows, and come back from it."""
    read = measured(RESISTANCES, 0.0, bits, rng())
    share_error = np.abs(SENSE_OHM / (read + SENSE_OHM) - SENSE_OHM / (RESISTANCES + SENSE_OHM))
    half_step = 0.5 / (2**bits - 1)
    assert 0.99 * half_step < share_error.max() <= half_step * (1 + 1e-8)  # reached, but for rounding
    even = np.linspace(9e3, 30e3, 200_001)  # many in each step, which holds its readings evenly
    missed = (measured(even, 0.0, bits, rng()) - even) / ReadingError(bits=bits).deviation(even)
    assert np.sqrt(np.mean(missed**2)) == pytest.approx(1.0, abs=0.04)  # of 4 bits, whose steps are a sixth of R
    for sense_ohm in (1e3, SENSE_OHM):
        counts = np.unique(np.linspace(1, 2**bits - 1, 1000).astype(np.int64))
        ohms = resistance_from_counts(counts, bits, sense_ohm)
        assert (np.diff(ohms) < 0).all()
        assert np.array_equal(counts_from_resistance(ohms, bits, sense_ohm), counts)
    assert counts_from_resistance(np.array([0.0, 1e12]), bits).tolist() == [2**bits - 1, 0]
    assert resistance_from_counts(np.array([0, 2**bits - 1]), bits).tolist() == [np.inf, 0.0]


def test_drifts_have_the_covariance_that_is_stated():
    """Of 40,000 draws on 3 × 4 units, all pairs of pillars: 4 % of the largest is four deviations of a covariance."""
    drifting = ReadingError(drift=0.005, drift_tilt=0.01, drift_pillar=0.002, drift_offset_ohm=40.0)
    n, rows, cols = 40_000, 3, 4
    exact = np.linspace(9e3, 21e3, rows * cols * 3).reshape(1, rows, cols, 3)
    drifted = drifting.drifted(np.tile(exact, (n, 1, 1, 1)), rng()).reshape(n, -1)
    columns = exact.reshape(1, -1)
    shared = drifting.shared(columns, rows, cols)[0]
    stated = shared @ shared.T + np.diag(drifting.deviation(columns)[0] ** 2)
    np.testing.assert_allclose(np.cov(drifted.T), stated, atol=0.04 * stated.max())
    np.testing.assert_allclose(drifting.total(columns, rows, cols)[0] ** 2, stated.diagonal())
    corner = np.abs(shared[[0, -1], :3] / columns[0, [0, -1], None])
    np.testing.assert_allclose(corner, [[0.005, 0.01, 0.01]] * 2)  # a tilt is stated at the outermost units


def test_drift_leaves_noise_as_it_is_and_is_new_in_each_sample():
    exact = np.full((5, 2, 2, 3), 1e4)
    drift_alone = ReadingError(drift=0.005).drifted(exact, rng())
    both = ReadingError(noise=1e-3, bits=12, drift=0.005).read(exact, rng())
    assert np.array_equal(both, measured(drift_alone, 1e-3, 12, rng()))
    assert np.ptp(drift_alone, axis=(1, 2, 3)).max() == 0  # common to a sample
    assert np.ptp(drift_alone[:, 0, 0, 0]) > 0


def test_a_specimen_is_a_factor_and_then_an_offset_for_every_sample():
    """Each pillar has its own, in every specimen, and a wider spread is the same one; by default there is none."""
    assert np.array_equal(applied(Imperfections()), EXACT)
    gain, offset = REAL.gain_and_offset(ROWS, COLS)
    np.testing.assert_allclose(applied(REAL), gain * EXACT + offset, rtol=1e-15)  # rounding
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
        expected[(*place, SONG2018.pillar_names.index(pillar))] = True
    expected[5, 5, 0] = True
    corner = ((5, 5, "z"), *wire.get("dead_pillars", ()))
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


def on_five_columns(**broken):
    return lambda: applied(Imperfections(**broken), EXACT[:, :, :5])


def test_samples_know_each_error_that_their_readings_were_drawn_with(response):
    """Whatever `ReadingError` has or comes to have; without drifts all else is left."""
    asked = {spec.name: 12 if spec.name == "bits" else 0.002 for spec in fields(ReadingError)}
    errors = simulate(response, DatasetSettings(protocol="contact", samples=3, **asked)).errors
    assert errors == ReadingError(**asked)
    for spec in fields(Drifts):
        del asked[spec.name]
    assert errors.without_drifts() == ReadingError(**asked)


def settings(**given):
    return lambda: DatasetSettings(protocol="contact", samples=1, **given)


NO_TELLING = r"cannot tell .* Ω: raise bits, or choose resistivity_ohm_mm"
NO_PLACE = r"is no place of a pillar: write row,col,pillar"


@pytest.mark.parametrize(
    ("refused", "said"),
    [
        # or a file would hold 0 Ω or infinity, which its own reader refuses
        *((lambda lost=lost: measured(np.array([1e4, lost]), 0.0, 12, rng()), NO_TELLING) for lost in (0.2, 1e9)),
        (on_five_columns(dead_rows=(12,)), "an array of 6 × 5 units has no row wire 12: its row wires are 0 to 11."),
        (on_five_columns(dead_cols=(0, 10)), "has no column wire 10: its column wires are 0 to 9."),
        (on_five_columns(dead_pillars=((0, 5, "y"),)), "has no pillar 0,5,y: its rows are 0 to 5"),
        (on_five_columns(dead_pillars=((0, 3, "w"),)), "dead_pillars=0,3,w names no pillar: write .* of z, x, y"),
        (on_five_columns(offset_ohm=1e4), "offset_ohm=10000 takes a pillar's resistance to -"),
        *((settings(dead_rows=wires), "must hold numbers of wires from 0 on") for wires in ((-1,), 4, ("4",))),
        *((settings(dead_pillars=places), "must hold a row and a column") for places in (((0, 3, 4),), (0, 3, "z"))),
        *(
            (lambda text=text: place_of(text), NO_PLACE)
            for text in ("", "0,3", "-1,3,z", "0,3,z\n4", "9" * 5000 + ",0,z")
        ),
    ],
)
def test_what_no_sensor_or_array_has_is_refused(refused, said):
    with pytest.raises(DesignError, match=said):
        refused()
    assert place_of("0,3,z") == place_of(" 0 , 3 , z ") == (0, 3, "z")
