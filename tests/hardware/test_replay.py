"""From known resistances over the wire to forces, without a board."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from hardware.link.frames import Info, ScanMode
from hardware.readout.calibration import Electronics, SensorCalibration
from hardware.readout.forces import replay
from hardware.recording import parse_recording
from tests.hardware.boards import recording_from_resistances
from tests.hardware.models import PillarModel

INFO = Info(rows=2, cols=3, bits=10, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=2_900)


def root(resistance_ohm):
    """√R of each pillar [N], so that each force can be told from all others."""
    assert np.isfinite(resistance_ohm).all()
    assert (resistance_ohm > 0).all()
    return np.sqrt(resistance_ohm)


MODEL = PillarModel(root, 2, 3)


def resistances_of(n, rows=2, cols=3):
    return np.random.default_rng(7).uniform(3e3, 40e3, (n, rows, cols, 3))


ALONE = Electronics(switch_ohm=0.0, amplifier_gain=1e12)  # in ZERO_POTENTIAL each crossing is then read alone


def quantisation_bound(resistance_ohm, info):
    """Largest error of a resistance that passed the converter of an ideal zero-potential board.

    The count rounds x = s/R to x' with |x' - x| ≤ 1/2F. As R = s/x, |R' - R| = R R' |x' - x|/s ≤ R R'/2Fs, which solved
    for R' gives |R' - R| ≤ R²/(2Fs - R).
    """
    F = 2**info.bits - 1
    return resistance_ohm**2 / (2 * F * info.sense_ohm - resistance_ohm)


@pytest.mark.parametrize("bits", [8, 10, 16])
@pytest.mark.parametrize("sense_ohm", [1_500, 2_900])
def test_resistances_come_back_within_the_converters_step(bits, sense_ohm):
    info = replace(INFO, bits=bits, sense_ohm=sense_ohm)
    sent = resistances_of(200)
    recording = parse_recording(recording_from_resistances(sent, info, electronics=ALONE))
    found = replay(recording, MODEL, SensorCalibration.as_designed(2, 3, ALONE))
    error = np.abs(found.resistance_ohm - sent) / quantisation_bound(sent, info)
    assert error.max() <= 1.02  # the correction ends at a hundredth of a step, the bound is half of one
    assert error.max() > 0.9  # the bound is met: it is no loose one
    assert not found.saturated.any()


@pytest.mark.parametrize("mode", list(ScanMode))
def test_from_resistances_to_forces_by_the_recordings_own_calibration_or_another(mode):
    """What the crossbar does on the way is undone: with 16 bits, √R comes back to the amplified step."""
    sent = resistances_of(50)
    plain = parse_recording(recording_from_resistances(sent, replace(INFO, bits=16, scan_mode=mode)))
    found = replay(plain, MODEL)
    assert found.force_n == pytest.approx(np.sqrt(sent), rel=3e-3)
    assert found.time_s == pytest.approx(np.arange(50) / 150, abs=1e-6)
    own = replace(SensorCalibration.as_designed(2, 3), offset_ohm=np.full((2, 3, 3), 500.0))
    calibrated = replace(plain, calibration=own.to_json())
    assert replay(calibrated, MODEL).force_n == pytest.approx(np.sqrt(sent - 500.0), rel=3e-3)
    assert replay(calibrated, MODEL, SensorCalibration.as_designed(2, 3)).force_n == pytest.approx(found.force_n)


def test_saturated_pillars_are_flagged_and_stay_finite():
    """An open pillar reads count 0 and a short one full scale; neither has a resistance, both get a bound."""
    sent = resistances_of(4)
    sent[1, 0, 2, 1] = np.inf
    sent[3, 1, 0, 0] = 0.0
    recording = parse_recording(recording_from_resistances(sent, INFO, electronics=ALONE))
    result = replay(recording, MODEL, SensorCalibration.as_designed(2, 3, ALONE))
    assert np.isfinite(result.force_n).all()
    assert np.argwhere(result.saturated).tolist() == [[1, 0, 2, 1], [3, 1, 0, 0]]
    assert result.force_n[1, 0, 2, 1] ** 2 == pytest.approx(2_900 * 1023, rel=1e-5)  # of count 1: R_s F
    assert result.force_n[3, 1, 0, 0] ** 2 == pytest.approx(2_900 * 1023 / 1022, rel=1e-5)  # of count F - 1


def test_hardware_loads_no_solver_no_cad_and_no_network():
    """A live reader starts at once; and the lower stages stay where they are."""
    heavy = {"fem", "studies", "build123d", "pyvista", "torch", "xarray"}
    code = f"import sys, hardware; print({heavy} & set(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert loaded.stdout.strip() == "set()"
