"""Means of many scans: what they are worth, and what is refused."""

import numpy as np
import pytest

from geometry.errors import FileFormatError
from hardware.link.frames import ScanMode
from hardware.readout.averaging import averaged
from hardware.readout.crossbar import Corrector, Crossbar

REST_OHM = np.tile([1e4, 1.4e4, 1.4e4], (6, 6, 1))


@pytest.mark.parametrize("mode", list(ScanMode))
def test_a_quiet_converter_is_trusted_to_its_steps(mode):
    """Without scatter all that is left are steps: the true errors' median is about what is said."""
    crossbar = Crossbar.suited(mode, bits=10)
    states = REST_OHM * np.random.default_rng(0).uniform(0.8, 1.05, (30, 6, 6, 3))
    errors, said = [], []
    for state in states:
        counts = np.repeat(crossbar.counts(state[None]), 5, axis=0)
        mean_ohm, noise = averaged(counts, crossbar)
        errors.append(np.abs(mean_ohm / state - 1))
        said.append(noise)
    # of an even distribution, half lies within 0.87 deviations; of a normal one, within 0.67
    assert 0.5 < np.median(errors) / np.median(said) < 1.0


def test_scatter_counts_as_far_as_scans_do_not_average_it_out():
    crossbar = Crossbar(bits=16, noise=1e-3)
    counts = crossbar.counts(np.repeat(REST_OHM[None], 400, axis=0), np.random.default_rng(0))
    mean_ohm, noise = averaged(counts, crossbar)
    single = np.median(Corrector(crossbar).correct(crossbar.fractions(counts)[0]).std(axis=0) / REST_OHM)
    assert noise == pytest.approx(single / np.sqrt(200), rel=0.1)  # of the last 200
    assert mean_ohm == pytest.approx(REST_OHM, rel=6 * noise)


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
