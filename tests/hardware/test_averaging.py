"""Means of many scans: what they are worth; motion meanwhile is found at every speed, and not seen in noise."""

import numpy as np
import pytest

from common.errors import FileFormatError
from geometry.design import SensorDesign
from hardware.boards.simulated import PressAndSlide
from hardware.readout.averaging import averaged, min_scans, movement, require_still
from hardware.readout.crossbar import SUITED_SENSE_OHM, Crossbar

REST_OHM = np.tile([1e4, 1.4e4, 1.4e4], (6, 6, 1))
RATE_HZ, N = 150, 300  # of the 2 s that a tare takes


@pytest.mark.parametrize("mode", SUITED_SENSE_OHM)
def test_a_quiet_converter_is_trusted_to_its_steps(mode):
    """Without scatter all that is left are steps: the true errors' median is about what is said."""
    crossbar = Crossbar.suited(mode, bits=10)
    errors, said = [], []
    for state in REST_OHM * np.random.default_rng(0).uniform(0.8, 1.05, (30, 6, 6, 3)):
        mean_ohm, noise = averaged(np.repeat(crossbar.counts(state[None]), 5, axis=0), crossbar)
        errors.append(np.abs(mean_ohm / state - 1))
        said.append(noise)
    # of an even distribution, half lies within 0.87 deviations; of a normal one, within 0.67
    assert 0.5 < np.median(errors) / np.median(said) < 1.0


def test_an_open_pillar_is_not_a_number_and_a_short_one_is_refused():
    crossbar = Crossbar(bits=10)
    state = REST_OHM.copy()
    state[1, 2, 0] = 1e9
    mean_ohm, noise = averaged(crossbar.counts(state[None]), crossbar)
    assert np.argwhere(np.isnan(mean_ohm)).tolist() == [[1, 2, 0]]
    assert np.isfinite(noise)
    state[3, 4, 1] = 3e3  # below the feedback resistor
    with pytest.raises(FileFormatError, match=r"pillar x of row 3, col 4 reads full scale, .* than 4700 Ω"):
        averaged(crossbar.counts(state[None]), crossbar)
    with pytest.raises(FileFormatError, match="every pillar reads 0, as if open"):  # with no word of numpy's before
        averaged(np.zeros((5, 108), int), crossbar)


def counts_of(ohms, crossbar, generator):
    """Of resistances (n, 6, 6, 3), with a place of each pillar within the converter's steps that is its own."""
    return crossbar.counts(ohms * generator.uniform(0.95, 1.05, (6, 6, 3)), generator)


@pytest.mark.parametrize("mode", SUITED_SENSE_OHM)
@pytest.mark.parametrize(("bits", "noise"), [(10, 3e-4), (16, 1e-4)])
def test_rest_is_rarely_taken_for_motion(mode, bits, noise):
    """One in a thousand is promised; of 200, three or more would come once in a thousand times."""
    generator = np.random.default_rng(0)
    crossbar = Crossbar.suited(mode, bits=bits, noise=noise)
    x = crossbar.readings(REST_OHM[None]) * generator.uniform(0.95, 1.05, (200, 108))
    alarms = 0
    for place in x:
        seen = place + noise * generator.standard_normal((N, 108))
        alarms += movement(np.rint(crossbar.full_scale * seen), crossbar, RATE_HZ) is not None
    assert alarms <= 2


@pytest.mark.parametrize("period_s", [0.3, 20.0])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_an_indenter_that_moves_is_seen(period_s, noise):
    """From whatever moment on, if it moves within these two seconds: by 6 % of a resistance for each MPa."""
    generator = np.random.default_rng(1)
    crossbar = Crossbar(noise=noise)
    script = PressAndSlide(seconds=period_s)
    for start_s in generator.uniform(0.0, period_s, 10):
        traction = script.tractions(start_s + np.arange(N) / RATE_HZ, SensorDesign())
        ohms = REST_OHM * (1.0 + 0.06 * traction[:, :, 2].reshape(N, 6, 6, 1))
        moved = movement(counts_of(ohms, crossbar, generator), crossbar, RATE_HZ)
        if np.ptp(traction[: N - 20, :, 2], axis=0).max() > 0.1:  # beyond its start in the last moment
            assert moved


def test_the_pillar_that_moves_most_is_named_and_noise_that_scans_share_is_no_motion():
    """The latter as of a board of 1000 Hz that averages over 5 ms."""
    ohms = np.repeat(REST_OHM[None], 400, axis=0)
    crossbar = Crossbar(noise=1e-3)
    generator = np.random.default_rng(3)
    assert movement(np.repeat(counts_of(ohms, crossbar, generator), 5, axis=0), crossbar, 1000) is None
    ohms[:, 2, 3, 1] *= np.linspace(1.0, 0.9, 400)
    counts = counts_of(ohms, Crossbar(), generator)
    with pytest.raises(FileFormatError, match=r"pillar x of row 2, col 3 changes by 9\.?\d* % within 2 s.* force=True"):
        require_still(counts, Crossbar(), RATE_HZ, 2.0)


@pytest.mark.parametrize("rate_hz", [1, 1000])
def test_so_many_scans_are_enough_and_fewer_are_refused(rate_hz):
    n, crossbar = min_scans(rate_hz), Crossbar()
    counts = crossbar.counts(REST_OHM * np.linspace(1.0, 0.9, n)[:, None, None, None])
    assert movement(counts, crossbar, rate_hz)
    with pytest.raises(FileFormatError, match=rf"{n - 1} scans within 2 s are too few .*: give seconds=\d"):
        require_still(counts[1:], crossbar, rate_hz, 2.0)
