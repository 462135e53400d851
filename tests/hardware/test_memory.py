"""A board's rubber that remembers: followed live as in a replay, over gaps and restarts, with deviations."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from common.errors import FileFormatError
from dataset.memory import broken_contacts, log_rise
from decoupler.rubber.belief import READ_S, SensorFilter
from geometry.design import Memory
from hardware.readout.calibration import SensorCalibration
from hardware.readout.forces import ForceReader, LiveSensor, replay
from hardware.readout.memory import MemoryReader
from hardware.recording import parse_recording
from tests.hardware.boards import recording_from_resistances
from tests.hardware.models import INFO, REST_OHM, Shares
from tripillar.terminal.force_view import memory_line

MEMORY = Memory(direction="loading", a=(0.5, 0.2), b_lengthen=2.5, b_shorten=9.0, tau_s=(2.0, 150.0), g1=2.0)


FOLLOWED = SensorFilter(memory=MEMORY, is_tested=True)  #: of a sensor whose design states this rubber


@pytest.fixture(scope="module")
def held():
    """Strains of a press to 10 % that is held for 2 s, what pillars show of it, and its recording at 200 Hz."""
    strain = -0.1 * np.interp(np.arange(500) / 200, [0.1, 0.6], [0.0, 1.0])
    risen = log_rise(strain, broken_contacts(-strain, 1 / 200, MEMORY), MEMORY)
    ohms = REST_OHM * np.exp(2 * np.log1p(strain) + risen).reshape(-1, 1, 1, 1)
    return SimpleNamespace(strain=strain, recording=parse_recording(recording_from_resistances(ohms, INFO)))


def scans(recording, run=0, later_s=0.0):
    """Scans of a recording as they come; `run` counts the board's starts."""
    for k, counts in enumerate(recording.counts):
        frame = SimpleNamespace(counts=counts, device_us=int(recording.device_us[k]), sequence=k)
        at_s = later_s + float(recording.time_s[k])
        yield SimpleNamespace(frame=frame, time_s=at_s, stamp_ns=0, received_s=at_s, run=run)


def sensor_of(causal):
    return LiveSensor(SimpleNamespace(info=INFO), Shares(), SensorCalibration.as_designed(2, 3), causal)


def test_memory_is_taken_out_of_readings_and_said(held):
    """Forces are those of the strain alone, (1 + ε)² − 1: while all move but for the doubt in the law, a fifth of what
    ignoring memory costs, and for what a press by 0.2/s goes on between two readings of the law; held for
    1.4 s to the doubt that is left, 12 %, and the band of 0.003.
    """
    wanted = ((1 + held.strain) ** 2 - 1).reshape(-1, 1, 1, 1)
    plain, found = replay(held.recording, Shares()), replay(held.recording, Shares(), causal=FOLLOWED)
    ignoring = np.abs(plain.force_n - wanted).max()
    assert ignoring > 0.05
    assert np.abs(found.force_n - wanted).max() < 0.2 * ignoring + 0.2 * READ_S
    assert np.abs(found.force_n - wanted)[-100:].max() < 0.12 * ignoring + 0.003
    assert plain.memory_rise is None
    read = np.log(plain.resistance_ohm / found.resistance_ohm)
    assert found.memory_rise == pytest.approx(read, abs=1e-12)
    assert (np.abs(np.log(found.resistance_ohm / REST_OHM / (wanted + 1))) < 2 * found.memory_deviation).all()


def test_a_files_memory_is_not_taken_out_before_it_is_tested(held):
    """Two seconds of a hold cannot tell contacts that heal from a load that creeps where all pillars feel the same."""
    plain, found = (replay(held.recording, Shares(), causal=each) for each in (None, SensorFilter(memory=MEMORY)))
    assert found.force_n == pytest.approx(plain.force_n, abs=1e-12)
    assert not found.memory_tested.any()
    assert memory_line(found) == "memory: none taken out: no hold or rest has tested the rubber's law yet"
    late = replace(found, memory_tested=np.arange(500) >= 400)
    assert "none before frame 401" in memory_line(late)
    assert memory_line(late[450]).startswith("memory: 0.0 % of the readings")


def test_live_follows_as_a_replay_does(held):
    sensor, found = sensor_of(FOLLOWED), replay(held.recording, Shares(), causal=FOLLOWED)
    live = [sensor.forces(scan) for scan in scans(held.recording)]
    assert np.stack([each.force_n for each in live]) == pytest.approx(found.force_n, abs=1e-4)
    assert np.stack([each.memory_rise for each in live]) == pytest.approx(found.memory_rise, abs=1e-4)
    assert found[3].memory_rise == pytest.approx(found.memory_rise[3])


def test_memory_heals_by_the_clock_over_gaps_and_restarts(held):
    """Contacts heal while nobody looks: 100 s later, over a restart of the board too, the held press is read as such.

    The board's clock starts again at 0 after a restart: the host's tells how long it was away.
    """
    for run in (0, 1):
        sensor = sensor_of(FOLLOWED)
        for scan in scans(held.recording):
            sensor.forces(scan)
        settled = np.exp(2 * np.log1p(-0.1) + log_rise(np.array(-0.1), healed(held.strain, 100.0), MEMORY))
        one = parse_recording(recording_from_resistances(REST_OHM * settled.reshape(1, 1, 1, 1), INFO))
        if run == 0:
            one = replace(one, device_us=one.device_us + np.uint32(102.5e6))
        (late,) = scans(one, run, later_s=102.5)
        assert sensor.forces(late).force_n == pytest.approx(0.9**2 - 1, abs=0.01)


def healed(strain, seconds):
    """Broken contacts of a press so long after its last strain."""
    left = broken_contacts(-strain, 1 / 200, MEMORY)[:, -1]
    return left * np.exp(-seconds / np.array(MEMORY.tau_s))


def test_a_model_without_a_design_knows_no_rest_and_no_memory():
    with pytest.raises(FileFormatError, match="leave the rubber out"):
        ForceReader(INFO, Shares(rest_ohm=None), causal=FOLLOWED)


def test_contacts_remember_nothing_and_open_pillars_stay_open():
    ohms = np.full((1, 2, 3, 3), 1.2e4)
    ohms[0, 0, 0, 0] = np.inf
    reader = MemoryReader(FOLLOWED, REST_OHM + 600.0, 600.0)
    found = reader.settled(ohms, np.zeros(1))
    assert np.isinf(found["resistance_ohm"][0, 0, 0, 0])
    resting = MemoryReader(FOLLOWED, REST_OHM + 600.0, 600.0).settled(REST_OHM[None] + 600.0, np.zeros(1))
    assert resting["resistance_ohm"][0] == pytest.approx(REST_OHM + 600.0)


def test_deviations_of_memory_go_through_the_decoder(pressed):
    """Errors of readings that are known to err by so much more: ∂F/∂R to first order, in forces and in their sums."""
    model, ohms = pressed.model, pressed.samples.resistance_ohm[:4]
    weights = np.ones((18, 1))
    plain, wide = (model.deviations(ohms, weights, own)[0] for own in (None, np.full(ohms.shape, 0.02)))
    slopes = model.derivatives(model.columns(ohms))
    more = np.sqrt(((slopes * (0.02 * model.columns(ohms))[:, None]) ** 2).sum(axis=2)).reshape(wide.shape)
    assert wide == pytest.approx(np.hypot(plain, more), rel=1e-6)
    net = [model.deviations(ohms, weights, own)[1] for own in (None, np.full(ohms.shape, 0.02))]
    summed = (slopes.sum(axis=1) * 0.02 * model.columns(ohms)) ** 2
    assert (net[1] - net[0])[:, 0, 0] == pytest.approx(summed.sum(axis=1), rel=1e-6)
