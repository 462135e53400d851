"""Noise has the statistics asked for, and a converter errs by half a step at most."""

import numpy as np
import pytest

from dataset import counts_from_resistance, measured, resistance_from_counts
from dataset.measurement import SENSE_OHM, ReadingError, reading_deviation
from geometry import DesignError

RESISTANCES = np.geomspace(3e3, 30e3, 5000)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


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
    missed = (measured(even, 0.0, bits, rng()) - even) / reading_deviation(even, 0.0, bits)
    assert np.sqrt(np.mean(missed**2)) == pytest.approx(1.0, abs=0.04)  # of 4 bits, whose steps are a sixth of R
    for sense_ohm in (1e3, SENSE_OHM):
        counts = np.unique(np.linspace(1, 2**bits - 1, 1000).astype(np.int64))
        ohms = resistance_from_counts(counts, bits, sense_ohm)
        assert (np.diff(ohms) < 0).all()
        assert np.array_equal(counts_from_resistance(ohms, bits, sense_ohm), counts)
    assert counts_from_resistance(np.array([0.0, 1e12]), bits).tolist() == [2**bits - 1, 0]
    assert resistance_from_counts(np.array([0, 2**bits - 1]), bits).tolist() == [np.inf, 0.0]


@pytest.mark.parametrize("lost", [0.2, 1e9])
def test_resistance_that_a_converter_cannot_tell_is_refused(lost):
    """Or a file would hold 0 Ω or infinity, which its own reader refuses."""
    with pytest.raises(DesignError, match=r"cannot tell .* Ω: raise bits, or choose resistivity_ohm_mm"):
        measured(np.array([1e4, lost]), 0.0, 12, rng())


DRIFTING = ReadingError(drift=0.005, drift_tilt=0.01, drift_pillar=0.002, drift_offset_ohm=40.0)


def test_drifts_have_the_covariance_that_is_stated():
    """Of 40,000 draws on 3 × 4 units, all pairs of pillars: 4 % of the largest is four deviations of a covariance."""
    n, rows, cols = 40_000, 3, 4
    exact = np.linspace(9e3, 21e3, rows * cols * 3).reshape(1, rows, cols, 3)
    drifted = DRIFTING.drifted(np.tile(exact, (n, 1, 1, 1)), rng()).reshape(n, -1)
    columns = exact.reshape(1, -1)
    shared = DRIFTING.shared(columns, rows, cols)[0]
    stated = shared @ shared.T + np.diag(DRIFTING.deviation(columns)[0] ** 2)
    np.testing.assert_allclose(np.cov(drifted.T), stated, atol=0.04 * stated.max())
    np.testing.assert_allclose(DRIFTING.total(columns, rows, cols)[0] ** 2, stated.diagonal())
    corner = np.abs(shared[[0, -1], :3] / columns[0, [0, -1], None])
    np.testing.assert_allclose(corner, [[0.005, 0.01, 0.01]] * 2)  # a tilt is stated at the outermost units


def test_drift_leaves_noise_as_it_is_and_is_new_in_each_sample():
    exact = np.full((5, 2, 2, 3), 1e4)
    drift_alone = ReadingError(drift=0.005).drifted(exact, rng())
    both = ReadingError(noise=1e-3, bits=12, drift=0.005).read(exact, rng())
    assert np.array_equal(both, measured(drift_alone, 1e-3, 12, rng()))
    assert np.ptp(drift_alone, axis=(1, 2, 3)).max() == 0  # common to a sample
    assert np.ptp(drift_alone[:, 0, 0, 0]) > 0
