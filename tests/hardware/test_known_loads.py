"""Typed weights, and the calibrations that follow from them or are refused."""

import numpy as np
import pytest

from common.errors import FileFormatError
from dataset.imperfections import Imperfections
from decoupler.data.columns import component_named, force_columns
from decoupler.data.pairs import Pairs
from decoupler.inverse.sensor_model import SensorModel
from geometry import Array, SensorDesign
from hardware.readout.averaging import averaged
from hardware.readout.calibration import Electronics
from hardware.readout.crossbar import Crossbar
from hardware.readout.known_loads import calibrated, weight
from tests.dataset.conftest import made_up_response

RESPONSE = made_up_response(SensorDesign(array=Array(rows=2, cols=3)))
PAD_MM2 = RESPONSE.design.pad.size_mm**2
NOTHING, KILOS = "0 0 0", "0 1 5000"
CHANGED = "load '{}' changed the resistances by [0-9]+ % of what it should"


def measured(told, acting=None, times=1.0, noise=3e-4, seed=0):
    """Pairs of what was told and what a sensor as made shows under what acts, averaged over 150 scans of 12 bits."""
    generator, everything = np.random.default_rng(seed), component_named("all")
    crossbar = Crossbar(rows=2, cols=3, bits=12, noise=noise)
    gain, offset_ohm = Imperfections(gain_spread=0.2, offset_ohm=200.0, specimen=seed).gain_and_offset(2, 3)
    acting_n = np.stack([weight(text, 2, 3, PAD_MM2).force_n for text in acting or told])
    designed = SensorModel.of(RESPONSE, everything).resistances(force_columns(acting_n, everything))
    ohms = gain * designed.reshape(-1, 2, 3, 3) + offset_ohm
    means, noises = zip(
        *(averaged(crossbar.counts(np.repeat(state[None], 150, axis=0), generator), crossbar) for state in ohms),
        strict=True,
    )
    return Pairs(
        names=tuple(told),
        force_n=np.stack([weight(text, 2, 3, PAD_MM2).force_n for text in told]),
        resistance_ohm=times * np.stack(means),
        noise=float(np.median(noises)),
    )


def fitted(pairs, **options):
    return calibrated(pairs, RESPONSE, Electronics(), serial=0, **options)


@pytest.mark.parametrize("told", [[NOTHING, KILOS, "1 2 5000"], [KILOS, "1 2 5000"]])
def test_weights_as_told_are_taken(told):
    found, residual = fitted(measured(told, noise=1e-3))
    assert residual < 1e-3
    assert 0.7 < found.gain.min() < found.gain.max() < 1.3


def test_gains_and_offsets_are_found():
    """Kilograms on every pad change a resistance by some percent: noise of 3e-4 leaves a percent of a gain open."""
    told = [NOTHING, *(f"{unit // 3} {unit % 3} {grams}" for unit in range(6) for grams in (10000, 20000))]
    pairs = measured(told, noise=0.0)
    pairs.resistance_ohm[:, 1, 2, 0] = np.nan
    found, _ = fitted(pairs)
    gain, offset_ohm = Imperfections(gain_spread=0.2, offset_ohm=200.0, specimen=0).gain_and_offset(2, 3)
    assert (abs(found.gain[1, 2, 0] - 1) < 0.1, found.offset_ohm[1, 2, 0]) == (True, 0.0)  # what all pillars share
    gain[1, 2, 0], offset_ohm[1, 2, 0] = found.gain[1, 2, 0], 0.0
    assert np.sqrt(np.mean((found.gain / gain - 1) ** 2)) < 0.02
    assert np.sqrt(np.mean((found.offset_ohm - offset_ohm) ** 2)) < 200.0


@pytest.mark.parametrize(
    ("told", "acting", "times", "says"),
    [
        ([NOTHING], None, 1.0, "1 measured, all of the same forces, .* at least two loads that differ"),
        ([NOTHING, KILOS], [NOTHING, NOTHING], 1.0, CHANGED.format(KILOS)),
        ([NOTHING, KILOS, "1 2 5000"], [NOTHING, "1 2 5000", KILOS], 1.0, CHANGED.format(".*")),
        ([NOTHING, "0 1 50000"], [NOTHING, "0 1 50"], 1.0, CHANGED.format("0 1 50000")),
        ([NOTHING, "0 1 500"], [NOTHING, "0 1 4903"], 1.0, ".*; all loads seem to be too small by 9.8, as kgf are. Or"),
        ([NOTHING, "0 1 5"], [NOTHING, "0 1 5000"], 1.0, r"no load is large enough .* newtons, weights in grams"),
        ([NOTHING, KILOS], None, 1e-3, "resistances are 0.001.* times those of the design: .* 1000 is kΩ for Ω"),
        ([NOTHING, KILOS], None, 3.0, r"resistances are 3\.?\d* times those of the design: check .*resistivity\. Or"),
    ],
)
def test_what_cannot_be_is_refused_unless_forced(told, acting, times, says):
    pairs = measured(told, acting, times)
    with pytest.raises(FileFormatError, match=says) as refused:
        fitted(pairs)
    assert str(refused.value).endswith("Or write it as it is with force=True.")
    assert not {"\n", "?"} & {*str(refused.value)}
    fitted(pairs, force=True)
