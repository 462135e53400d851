"""From known resistances over the wire to forces, without a board."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from geometry.errors import FileFormatError
from hardware.frames import Info, ScanMode
from hardware.recording import parse_recording, read_recording, recording_from_resistances, write_recording
from hardware.replay import replay, resistances

INFO = Info(rows=2, cols=3, bits=10)


class RootModel:
    """A model whose forces are known: √R of each pillar [N], so that each can be told from all others."""

    def __init__(self, rows=2, cols=3):
        self.rows, self.cols = rows, cols

    def forces(self, resistance_ohm):
        assert resistance_ohm.shape[1:] == (self.rows, self.cols, 3)
        assert np.isfinite(resistance_ohm).all()
        assert (resistance_ohm > 0).all()
        return np.sqrt(resistance_ohm)


def resistances_of(n, rows=2, cols=3):
    return np.random.default_rng(7).uniform(3e3, 40e3, (n, rows, cols, 3))


def quantisation_bound(resistance_ohm, info):
    """Largest error of a resistance that passed the converter.

    The count rounds x = s/(R+s) to x' with |x' - x| ≤ 1/2F. As R = s(1/x - 1), |R' - R| = s|x' - x|/(x x')
    = |x' - x| a a'/s with a = R + s, so a' - a ≤ a a'/2Fs, which solved for a' gives a' - a ≤ a²/(2Fs - a).
    """
    a, F = resistance_ohm + info.sense_ohm, 2**info.bits - 1
    return a**2 / (2 * F * info.sense_ohm - a)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
@pytest.mark.parametrize("sense_ohm", [4_700, 10_000])
def test_resistances_come_back_within_the_converters_step(bits, sense_ohm):
    info = replace(INFO, bits=bits, sense_ohm=sense_ohm)
    sent = resistances_of(200)
    recording = parse_recording(recording_from_resistances(sent, info))
    received, saturated = resistances(recording.counts, recording.info)
    error = np.abs(received - sent) / quantisation_bound(sent, info)
    assert error.max() <= 1 + 1e-9  # rounding of float64
    assert error.max() > 0.9  # the bound is met: it is no loose one
    assert not saturated.any()


def test_from_resistances_to_forces_through_a_file(tmp_path):
    info = replace(INFO, bits=16)
    sent = resistances_of(50)
    path = tmp_path / "press.frames"
    write_recording(recording_from_resistances(sent, info), path)
    result = replay(read_recording(path), RootModel())
    assert result.force_n.shape == (50, 2, 3, 3)
    # |√R' - √R| = |R' - R| / (√R' + √R); at 16 bits the two roots differ by less than 0.1 %
    bound = 1.001 * quantisation_bound(sent, info) / (2 * np.sqrt(sent))
    assert (np.abs(result.force_n - np.sqrt(sent)) <= bound).all()
    assert result.time_s == pytest.approx(np.arange(50) / 150, abs=1e-6)
    assert not result.saturated.any()
    assert result.statistics.ok == 50


def test_saturated_pillars_are_flagged_and_stay_finite():
    """An open pillar reads count 0 and a short one full scale; neither has a resistance, both get a bound."""
    sent = resistances_of(4)
    sent[1, 0, 2, 1] = np.inf
    sent[3, 1, 0, 0] = 0.0
    result = replay(parse_recording(recording_from_resistances(sent, INFO)), RootModel())
    assert np.isfinite(result.force_n).all()
    assert np.argwhere(result.saturated).tolist() == [[1, 0, 2, 1], [3, 1, 0, 0]]
    assert result.force_n[1, 0, 2, 1] ** 2 == pytest.approx(10_000 * 1022)  # of count 1: R_s (F - 1)
    assert result.force_n[3, 1, 0, 0] ** 2 == pytest.approx(10_000 / 1022)  # of count F - 1


def test_counts_next_to_saturation_are_not_saturated():
    counts = np.array([[0, 1, 1022, 1023, 512, 512]])
    _, saturated = resistances(counts, Info(rows=1, cols=2))
    assert saturated.sum() == 2


def test_a_damaged_frame_is_left_out_and_its_neighbours_keep_their_time():
    stream = bytearray(recording_from_resistances(resistances_of(5), INFO))
    stream[25 + 2 * 52 + 30] ^= 0x10  # in the third data frame; 25 bytes of INFO, 52 a frame
    result = replay(parse_recording(bytes(stream)), RootModel())
    assert result.time_s == pytest.approx(np.array([0, 1, 3, 4]) / 150, abs=1e-6)
    assert result.statistics.lost == 1


def test_a_model_of_another_array_is_refused():
    recording = parse_recording(recording_from_resistances(resistances_of(2), INFO))
    with pytest.raises(FileFormatError, match=r"recording is of 2 × 3 units, the model of 6 × 6: replay with a model"):
        replay(recording, RootModel(6, 6))


def test_other_scan_modes_are_refused():
    info = replace(INFO, scan_mode=ScanMode.ZERO_POTENTIAL)
    recording = parse_recording(recording_from_resistances(resistances_of(2), info))
    with pytest.raises(FileFormatError, match=r"mode ZERO_POTENTIAL, .*: record in mode DIVIDER"):
        replay(recording, RootModel())


def test_hardware_loads_no_solver_no_cad_and_no_network():
    """A live reader starts at once; and the lower stages stay where they are."""
    heavy = {"fem", "studies", "build123d", "pyvista", "torch", "xarray"}
    code = f"import sys, hardware; print({heavy} & set(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert loaded.stdout.strip() == "set()"
