"""Counts to forces: what is refused, what a tare and a calibration do on the way, one scan as many."""

import sys
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from dataset import measured
from decoupler import NetworkConfig, TrainingConfig, train
from geometry.errors import FileFormatError
from hardware import Scanner, live
from hardware.boards.virtual_board import VirtualBoard
from hardware.link.frames import Info, ScanMode
from hardware.readout.calibration import Electronics, SensorCalibration
from hardware.readout.forces import ForceReader, LiveSensor
from tests.decoupler.synthetic_sensor import labelled, response, sensor
from tests.hardware.models import Unknown

INFO = Info(rows=2, cols=3, bits=16, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4_700, serial=3)
REST_OHM = np.tile([1e4, 1.4e4, 1.4e4], (2, 3, 1))
MAX_FILES = 10  #: of the product that a scan passes from its bytes to its forces, calibration included


class Shares(Unknown):
    """A model whose force is the share by which each pillar's resistance is off rest."""

    rows, cols = 2, 3

    def read_by(self, noise):
        wider = Shares(self.knows_rest)
        wider.deviations = lambda resistance_ohm, _: (noise * resistance_ohm, np.zeros((len(resistance_ohm), 6, 6)))
        return wider

    def __init__(self, knows_rest=True):
        self.knows_rest = knows_rest

    def rest_resistances(self):
        return REST_OHM if self.knows_rest else None

    def forces(self, resistance_ohm):
        return resistance_ohm / REST_OHM - 1


def counts_of(shares, electronics=None, gain=1.0):
    ohms = gain * REST_OHM * (1 + np.asarray(shares, dtype=float).reshape(-1, 1, 1, 1))
    return (electronics or Electronics()).crossbar(INFO).counts(ohms)


def test_forces_are_the_models_of_corrected_resistances():
    """1e-3: the steps of 16 bits are 1e-4 of these pillars, the crosstalk left in would be 3e-2."""
    found = ForceReader(INFO, Shares()).forces(counts_of([-0.3, 0.0, 0.1]))
    assert found.force_n == pytest.approx(
        np.array([-0.3, 0, 0.1]).reshape(-1, 1, 1, 1) * np.ones((3, 2, 3, 3)), abs=1e-3
    )
    assert not found.saturated.any()
    raw = ForceReader(INFO, Shares(), crosstalk=False).forces(counts_of([0.0]))
    assert np.abs(raw.force_n).mean() > 5e-3


def test_other_switches_are_the_calibrations():
    slow = Electronics(switch_ohm=200.0, line_ohm=20.0)
    calibration = replace(SensorCalibration.as_designed(2, 3), electronics=slow)
    counts = counts_of([-0.2], slow)
    assert ForceReader(INFO, Shares(), calibration).forces(counts).force_n == pytest.approx(-0.2, abs=1e-3)
    assert np.abs(ForceReader(INFO, Shares()).forces(counts).force_n + 0.2).max() > 0.03


def test_gain_and_tare_come_before_the_model():
    counts = counts_of([0.0, -0.2], gain=1.1)
    fresh = SensorCalibration.as_designed(2, 3)
    gained = replace(fresh, gain=np.full((2, 3, 3), 1.1))
    tared = fresh.tared(ForceReader(INFO, Shares()).measured(counts[:1])[0][0])
    for calibration in (gained, tared):
        force_n = ForceReader(INFO, Shares(), calibration).forces(counts).force_n
        assert force_n[0] == pytest.approx(0.0, abs=1e-3)
        assert force_n[1] == pytest.approx(-0.2, abs=1e-3)


def test_one_scan_as_many():
    """To a few hundredths of a converter's step, which is 1.5e-5 of full scale."""
    counts = counts_of(np.linspace(-0.4, 0.1, 40))
    together, alone = ForceReader(INFO, Shares()), ForceReader(INFO, Shares())
    one_by_one = np.concatenate([alone.forces(counts[k : k + 1]).force_n for k in range(40)])
    assert one_by_one == pytest.approx(together.forces(counts).force_n, abs=1e-5)


def test_saturation_is_told_by_pillar():
    counts = counts_of([0.0])
    counts[0, 4] = 2**INFO.bits - 1
    found = ForceReader(INFO, Shares()).forces(counts)
    assert found.saturated.sum() == 1
    assert np.isfinite(found.force_n).all()


def test_what_does_not_belong_together_is_refused():
    with pytest.raises(
        FileFormatError, match=r"board has 6 × 6 units, the model 2 × 3: take a model trained for 6 × 6"
    ):
        ForceReader(Info(), Shares())
    with pytest.raises(FileFormatError, match="made with board 9, this is board 3"):
        ForceReader(INFO, Shares(), replace(SensorCalibration.as_designed(2, 3), serial=9))
    tared = SensorCalibration.as_designed(2, 3).tared(REST_OHM)
    with pytest.raises(FileFormatError, match=r"model states no design, .*: leave the tare out"):
        ForceReader(INFO, Shares(knows_rest=False), tared)


def test_a_calibration_for_another_design_is_refused():
    model = Shares()
    model.design_hash = "one"
    known = replace(SensorCalibration.as_designed(2, 3), made_from={"design_hash": "other"})
    with pytest.raises(FileFormatError, match=r"calibration is for a sensor of design other, the model for one of one"):
        ForceReader(INFO, model, known)
    ForceReader(INFO, model, replace(known, made_from={"design_hash": "one"}))


def test_gains_are_not_taken_out_twice():
    """An identified model knows them by itself; a tare alone is welcome to it."""
    model = Shares()
    model.is_identified = True
    fresh = SensorCalibration.as_designed(2, 3)
    with pytest.raises(FileFormatError, match=r"identified .* give a calibration that only holds a tare"):
        ForceReader(INFO, model, replace(fresh, gain=np.full((2, 3, 3), 1.1)))
    ForceReader(INFO, model, fresh.tared(REST_OHM))


def test_deviations_are_given_where_the_model_knows_them():
    model = Shares()
    counts = counts_of([0.0])
    assert ForceReader(INFO, model).forces(counts).deviation_n is None
    model.knows_uncertainty, model.reading_noise = True, 0.1
    model.deviations = lambda resistance_ohm, _: (0.1 * resistance_ohm, np.zeros((len(resistance_ohm), 6, 6)))
    reader = ForceReader(INFO, model)
    found = reader.forces(counts)
    assert found.deviation_n == pytest.approx(0.1 * found.resistance_ohm)


def test_live_sensors_name_faults_of_whole_windows_a_second_apart():
    sensor, looked = LiveSensor(SimpleNamespace(info=INFO), Shares(), SensorCalibration.as_designed(2, 3)), []
    sensor._reader.fault_test = SimpleNamespace(window=3, named=lambda ohms: looked.append(ohms) or (len(looked),))
    counts = counts_of(np.linspace(-0.3, 0.0, 30))
    named = []
    for k in range(30):
        frame = SimpleNamespace(counts=counts[k], device_us=0, sequence=k)
        scan = SimpleNamespace(frame=frame, time_s=k / 8, stamp_ns=0, received_s=k / 8)
        named += sensor.forces(scan).faults or ["0"]
    assert "".join(named) == "00" + 10 * "1" + 10 * "2" + 8 * "3"
    assert looked[1] == pytest.approx(ForceReader(INFO, Shares()).forces(counts[10:13]).resistance_ohm, rel=1e-6)


def test_deviations_are_wider_where_the_board_reads_worse_than_in_training():
    """By what its converter's steps leave of a resistance at rest."""
    model = Shares()
    model.knows_uncertainty, model.reading_noise = True, 1e-4
    info = replace(INFO, scan_mode=ScanMode.DIVIDER, bits=10, sense_ohm=2_200)
    reader = ForceReader(info, model)
    found = reader.forces(Electronics().crossbar(info).counts(REST_OHM[None]))
    steps = np.median(reader.crossbar.step_deviation(REST_OHM[None]))
    assert 1e-3 < steps < 1e-1
    assert found.deviation_n == pytest.approx(steps * found.resistance_ohm)


@pytest.fixture(scope="module")
def samples():
    found = labelled(sensor(2, 3), "xyz", n_samples=400, seed=0)
    return replace(found, resistance_ohm=measured(found.resistance_ohm, 1e-3, None, np.random.default_rng(0)))


@pytest.fixture(scope="module")
def trained(samples):
    network = NetworkConfig(hidden=4, feature="inverse")
    return train(replace(samples, noise=1e-3), "all", network, TrainingConfig(), response=response(sensor(2, 3)))


@pytest.mark.parametrize(("bits", "tared"), [(16, False), (10, True)])
def test_an_untouched_board_shows_nothing_within_its_deviations(bits, tared, trained, samples):
    """Trained under load alone, far from rest, with noise of 0.1 %: 0 N lies within two standard deviations.

    Steps of 10 bits hide the same of every like pillar, which deviations take to be independent: a tare finds that.
    """
    info = replace(INFO, bits=bits)
    counts = Electronics().crossbar(info).counts(trained.rest_resistances()[None])
    reader = ForceReader(info, trained)
    with VirtualBoard(counts[0], info) as board, Scanner(board.port) as scanner:
        seen = np.stack([scanner.get(30).frame.counts for _ in range(5)])
    if tared:
        fresh = SensorCalibration.as_designed(2, 3)
        reader = ForceReader(info, trained, fresh.tared(reader.measured(seen)[0][0]))
    found = reader.forces(seen)
    assert (np.abs(found.force_n) <= 2 * found.deviation_n).all()
    assert np.abs(found.force_n).max() < 0.02 * samples.force_n.max()


def test_a_scan_passes_few_files_from_its_bytes_to_its_forces(trained):
    """Once the first one has set all up: reading, frames, reception, crosstalk, calibration and network."""
    root, entered, is_on = Path(__file__).parents[2], set(), threading.Event()

    def note(frame, event, _):
        file = frame.f_code.co_filename.removeprefix(f"{root}/")
        if is_on.is_set() and event == "call" and file.startswith(("hardware/", "decoupler/", "dataset/", "geometry/")):
            entered.add(file)

    before = sys.getprofile()
    threading.setprofile(note)  # for the scanner's thread
    sys.setprofile(note)
    try:
        with VirtualBoard(np.full(INFO.n_crossings, 2**14), INFO) as board, live(board.port, trained) as scans:
            forces = iter(scans)
            next(forces)
            is_on.set()
            for _ in range(5):
                next(forces)
            is_on.clear()
    finally:
        threading.setprofile(None)
        sys.setprofile(before)
    entered -= {"hardware/boards/virtual_board.py", "hardware/link/board_port.py"}
    assert {"hardware/link/reception.py", "decoupler/model/decoupler.py"} <= entered
    assert len(entered) <= MAX_FILES, sorted(entered)
