"""Counts to forces: what is refused, what a tare and a calibration do on the way, one scan as many."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from common.errors import FileFormatError
from dataset.measurement import ReadingError
from hardware.link.frames import Info, ScanMode
from hardware.readout.calibration import Electronics, SensorCalibration
from hardware.readout.crossbar import SUITED_SENSE_OHM
from hardware.readout.forces import ForceReader, LiveSensor, replay
from hardware.recording import parse_recording
from tests.hardware.boards import recording_from_resistances
from tests.hardware.models import INFO, REST_OHM, Shares

FRESH = SensorCalibration.as_designed(2, 3)
GAINED = replace(FRESH, gain=np.full((2, 3, 3), 1.1))


def counts_of(shares, electronics=None, gain=1.0):
    ohms = gain * REST_OHM * (1 + np.asarray(shares, dtype=float).reshape(-1, 1, 1, 1))
    return (electronics or Electronics()).crossbar(INFO).counts(ohms)


ALONE = Electronics(switch_ohm=0.0, amplifier_gain=1e12)  # in ZERO_POTENTIAL each crossing is then read alone


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("sense_ohm", [1_500, 2_900])
def test_resistances_come_back_within_the_converters_step(bits, sense_ohm):
    """A count rounds x = s/R to x' with |x' - x| ≤ 1/2F; as |R' - R| = R R' |x' - x|/s, this is ≤ R²/(2Fs - R).

    An open pillar reads count 0 and a short one full scale; neither has a resistance, both get a bound.
    """
    info, full_scale = replace(INFO, bits=bits, sense_ohm=sense_ohm), 2**bits - 1
    sent = np.random.default_rng(7).uniform(3e3, 40e3, (200, 2, 3, 3))
    bound = sent**2 / (2 * full_scale * sense_ohm - sent)
    sent[1, 0, 2, 1], sent[3, 1, 0, 0] = np.inf, 0.0
    recording = parse_recording(recording_from_resistances(sent, info, electronics=ALONE))
    found = replay(recording, Shares(), replace(SensorCalibration.as_designed(2, 3), electronics=ALONE))
    assert np.argwhere(found.saturated).tolist() == [[1, 0, 2, 1], [3, 1, 0, 0]]
    bounds = sense_ohm * full_scale, sense_ohm * full_scale / (full_scale - 1)  # of counts 1 and F - 1
    assert found.resistance_ohm[found.saturated] == pytest.approx(bounds, rel=1e-5)
    error = (np.abs(found.resistance_ohm - sent) / bound)[~found.saturated]
    assert 0.9 < error.max() <= 1.02  # the bound is met; the correction ends at a hundredth of a step, half of one


@pytest.mark.parametrize("mode", SUITED_SENSE_OHM)
def test_forces_are_the_models_of_corrected_resistances_one_scan_as_many(mode):
    """Through a file; by its own calibration unless another is given.

    Steps of 16 bits are amplified to 1e-3 of these pillars at most, the crosstalk left in would be 5e-3 at least. Scan
    by scan to a few hundredths of a step, which is 1.5e-5 of full scale.
    """
    shares = np.linspace(-0.4, 0.1, 40).reshape(-1, 1, 1, 1)
    plain = parse_recording(recording_from_resistances(REST_OHM * (1 + shares), replace(INFO, scan_mode=mode)))
    found = replay(plain, Shares())
    assert found.force_n == pytest.approx(shares * np.ones((40, 2, 3, 3)), abs=1e-3)
    assert found.time_s == pytest.approx(np.arange(40) / 200, abs=1e-6)
    reader = ForceReader(plain.info, Shares())
    one_by_one = np.concatenate([reader.forces(counts[None]).force_n for counts in plain.counts])
    assert one_by_one == pytest.approx(found.force_n, abs=5e-5)
    left = np.abs(replay(plain, Shares(), crosstalk=False).force_n - shares).mean()
    assert left < 1e-4 if mode == ScanMode.FOUR_WIRE else left > 5e-3
    calibrated = replace(plain, calibration=GAINED.to_json())
    assert replay(calibrated, Shares()).force_n == pytest.approx((1 + shares) / 1.1 - 1 + 0 * REST_OHM, abs=1e-3)
    assert replay(calibrated, Shares(), FRESH).force_n == pytest.approx(found.force_n)


def test_switches_gain_and_tare_are_the_calibrations():
    slow = Electronics(switch_ohm=200.0, line_ohm=20.0)
    counts = counts_of([-0.2], slow)
    found = ForceReader(INFO, Shares(), replace(FRESH, electronics=slow)).forces(counts)
    assert found.force_n == pytest.approx(-0.2, abs=1e-3)
    assert np.abs(ForceReader(INFO, Shares()).forces(counts).force_n + 0.2).max() > 0.03
    counts = counts_of([0.0, -0.2], gain=1.1)
    tared = FRESH.tared(ForceReader(INFO, Shares()).measured(counts[:1])[0][0])
    for calibration in (GAINED, tared):
        force_n = ForceReader(INFO, Shares(), calibration).forces(counts).force_n
        assert force_n == pytest.approx(np.reshape([0.0, -0.2], (2, 1, 1, 1)) + 0 * REST_OHM, abs=1e-3)


OF_ONE = replace(FRESH, made_from={"design_hash": "one"})


@pytest.mark.parametrize(
    ("info", "model", "calibration", "message"),
    [
        (Info(), {}, None, r"board has 6 × 6 units, the model 2 × 3 units: take a model trained for this"),
        (INFO, {}, replace(FRESH, serial=9), "made with board 9, this is board 3"),
        (INFO, {"rest_ohm": None}, FRESH.tared(REST_OHM), r"model states no design, .*: leave the tare out"),
        (INFO, {"design_hash": "two"}, OF_ONE, r"is for a sensor of design one, the model for one of two"),
        (INFO, {"is_identified": True}, GAINED, r"identified .* give a calibration that only holds a tare"),
        (INFO, {"design_hash": "one"}, OF_ONE, None),
        (INFO, {"is_identified": True}, FRESH.tared(REST_OHM), None),
        (replace(INFO, serial=0), {}, replace(FRESH, serial=9), None),  # a board that has no number
    ],
)
def test_what_does_not_belong_together_is_refused(info, model, calibration, message):
    if message is None:
        ForceReader(info, Shares(**model), calibration)
        return
    with pytest.raises(FileFormatError, match=message):
        ForceReader(info, Shares(**model), calibration)


def test_deviations_are_the_models_and_wider_where_the_board_reads_worse_than_in_training():
    """By what its converter's steps leave of a resistance at rest, beside the noise: their squares add up."""
    info = replace(INFO, scan_mode=ScanMode.DIVIDER, bits=10, sense_ohm=2_200)
    for noise in (1e-4, 1e-2, 0.1):
        reader = ForceReader(info, Shares(errors=ReadingError(noise=noise, bits=16)))
        found = reader.forces(Electronics().crossbar(info).counts(REST_OHM[None]))
        steps = np.median(reader.crossbar.step_deviation(REST_OHM[None]))
        assert 1e-3 < steps < 1e-1
        assert found.deviation_n == pytest.approx(np.hypot(noise, steps) * found.resistance_ohm)


def test_live_sensors_name_faults_of_whole_windows_a_second_apart():
    sensor, looked = LiveSensor(SimpleNamespace(info=INFO), Shares(), FRESH), []
    sensor._reader.fault_test = SimpleNamespace(window=3, named=lambda ohms: looked.append(ohms) or (len(looked),))
    counts = counts_of(np.linspace(-0.3, 0.0, 30))
    named = []
    for k in range(30):
        frame = SimpleNamespace(counts=counts[k], device_us=0, sequence=k)
        scan = SimpleNamespace(frame=frame, time_s=k / 8, stamp_ns=0, received_s=k / 8)
        named += sensor.forces(scan).faults or ["0"]
    assert "".join(named) == "00" + 10 * "1" + 10 * "2" + 8 * "3"
    assert looked[1] == pytest.approx(ForceReader(INFO, Shares()).forces(counts[10:13]).resistance_ohm, rel=1e-6)


@pytest.mark.parametrize(("bits", "tared"), [(16, False), (10, True)])
def test_an_untouched_board_shows_nothing_within_its_deviations(bits, tared, pressed):
    """Trained under load alone, far from rest, with noise of 0.1 %: 0 N lies within two standard deviations.

    Steps of 10 bits hide the same of every like pillar, which deviations take to be independent: a tare finds that.
    """
    info = replace(INFO, bits=bits)
    counts = Electronics().crossbar(info).counts(pressed.model.rest_resistances()[None])
    reader = ForceReader(info, pressed.model)
    if tared:
        reader = ForceReader(info, pressed.model, FRESH.tared(reader.measured(counts)[0][0]))
    found = reader.forces(counts)
    assert (np.abs(found.force_n) <= 2 * found.deviation_n).all()
    assert np.abs(found.force_n).max() < 0.02 * pressed.samples.force_n.max()


def test_a_slice_of_forces_is_forces_with_all_that_is_known_of_them(pressed):
    """One scan is without the first axis; deviations are the same before and after they were asked for."""
    fresh, asked = (ForceReader(INFO, pressed.model).forces(pressed.counts) for _ in range(2))
    assert asked.deviation_n.shape == asked.force_n.shape == (50, 2, 3, 3)
    for which in (7, slice(3, 9)):
        for part in (fresh[which], asked[which]):
            for name in ("force_n", "resistance_ohm", "saturated", "chi2", "unexplained"):
                assert np.array_equal(getattr(part, name), getattr(asked, name)[which]), name
            assert part.deviation_n == pytest.approx(asked.deviation_n[which], rel=1e-9)
            for name, values in vars(asked.wrench).items():
                assert getattr(part.wrench, name) == pytest.approx(values[which], rel=1e-6, nan_ok=True), name
    assert fresh.description is fresh[0].description


def test_forces_of_a_recording_are_bounded_before_they_begin_and_told_as_they_come(monkeypatch):
    recording = parse_recording(recording_from_resistances(np.tile(REST_OHM, (10, 1, 1, 1)), INFO))
    monkeypatch.setattr("hardware.readout.forces.CHUNK_FRAMES", 4)
    told = []
    replay(recording, Shares(), progress=told.append)
    assert told == [4, 4, 2]
    monkeypatch.setattr("common.bounded.MEMORY_SHARE", 0.0)
    with pytest.raises(FileFormatError, match=r"forces of 10 frames take 0\.0 GB .*: record shorter pieces, or watch"):
        replay(recording, Shares(), progress=told.append)
    assert told == [4, 4, 2]
