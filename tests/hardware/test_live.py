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

    def __init__(self, **known):
        vars(self).update({"rest_ohm": REST_OHM} | known)

    def read_by(self, noise):
        return Shares(deviations=self.deviations_of(noise))

    @staticmethod
    def deviations_of(noise):
        return lambda resistance_ohm, _: (noise * resistance_ohm, np.zeros((len(resistance_ohm), 6, 6)))

    def rest_resistances(self):
        return self.rest_ohm

    def forces(self, resistance_ohm):
        return resistance_ohm / REST_OHM - 1


FRESH = SensorCalibration.as_designed(2, 3)
GAINED = replace(FRESH, gain=np.full((2, 3, 3), 1.1))


def counts_of(shares, electronics=None, gain=1.0):
    ohms = gain * REST_OHM * (1 + np.asarray(shares, dtype=float).reshape(-1, 1, 1, 1))
    return (electronics or Electronics()).crossbar(INFO).counts(ohms)


def test_forces_are_the_models_of_corrected_resistances_one_scan_as_many():
    """1e-3: the steps of 16 bits are 1e-4 of these pillars, the crosstalk left in would be 3e-2.

    Scan by scan to a few hundredths of a converter's step, which is 1.5e-5 of full scale.
    """
    shares = np.linspace(-0.4, 0.1, 40)
    counts = counts_of(shares)
    reader = ForceReader(INFO, Shares())
    found = reader.forces(counts)
    assert found.force_n == pytest.approx(shares.reshape(-1, 1, 1, 1) * np.ones((40, 2, 3, 3)), abs=1e-3)
    assert not found.saturated.any()
    one_by_one = np.concatenate([reader.forces(counts[k : k + 1]).force_n for k in range(40)])
    assert one_by_one == pytest.approx(found.force_n, abs=1e-5)
    raw = ForceReader(INFO, Shares(), crosstalk=False).forces(counts_of([0.0]))
    assert np.abs(raw.force_n).mean() > 5e-3
    counts[0, 4] = 2**INFO.bits - 1
    found = reader.forces(counts)
    assert found.saturated.sum() == 1
    assert np.isfinite(found.force_n).all()


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
        assert force_n[0] == pytest.approx(0.0, abs=1e-3)
        assert force_n[1] == pytest.approx(-0.2, abs=1e-3)


OF_ONE = replace(FRESH, made_from={"design_hash": "one"})


@pytest.mark.parametrize(
    ("info", "model", "calibration", "message"),
    [
        (Info(), {}, None, r"board has 6 × 6 units, the model 2 × 3: take a model trained for 6 × 6"),
        (INFO, {}, replace(FRESH, serial=9), "made with board 9, this is board 3"),
        (INFO, {}, SensorCalibration.as_designed(3, 3), "is of 3 × 3 units, the board of 2 × 3"),
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
    """By what its converter's steps leave of a resistance at rest."""
    assert ForceReader(INFO, Shares()).forces(counts_of([0.0])).deviation_n is None
    model = Shares(knows_uncertainty=True, reading_noise=0.1, deviations=Shares.deviations_of(0.1))
    found = ForceReader(INFO, model).forces(counts_of([0.0]))
    assert found.deviation_n == pytest.approx(0.1 * found.resistance_ohm)
    info = replace(INFO, scan_mode=ScanMode.DIVIDER, bits=10, sense_ohm=2_200)
    reader = ForceReader(info, Shares(knows_uncertainty=True, reading_noise=1e-4))
    found = reader.forces(Electronics().crossbar(info).counts(REST_OHM[None]))
    steps = np.median(reader.crossbar.step_deviation(REST_OHM[None]))
    assert 1e-3 < steps < 1e-1
    assert found.deviation_n == pytest.approx(steps * found.resistance_ohm)


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
        reader = ForceReader(info, trained, FRESH.tared(reader.measured(seen)[0][0]))
    found = reader.forces(seen)
    assert (np.abs(found.force_n) <= 2 * found.deviation_n).all()
    assert np.abs(found.force_n).max() < 0.02 * samples.force_n.max()


def test_a_slice_of_forces_is_forces_with_all_that_is_known_of_them(trained, samples):
    """One scan is without the first axis; deviations are the same before and after they were asked for."""
    counts = Electronics().crossbar(INFO).counts(samples.resistance_ohm[:12])
    fresh, asked = (ForceReader(INFO, trained).forces(counts) for _ in range(2))
    assert asked.deviation_n.shape == asked.force_n.shape == (12, 2, 3, 3)
    for which in (7, slice(3, 9)):
        for part in (fresh[which], asked[which]):
            for name in ("force_n", "resistance_ohm", "saturated", "chi2", "unexplained"):
                assert np.array_equal(getattr(part, name), getattr(asked, name)[which]), name
            assert part.deviation_n == pytest.approx(asked.deviation_n[which], rel=1e-9)
            for name, values in vars(asked.wrench).items():
                assert getattr(part.wrench, name) == pytest.approx(values[which], rel=1e-6, nan_ok=True), name
    assert fresh.description is fresh[0].description


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
