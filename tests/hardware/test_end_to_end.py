"""Known forces, all the way round: array, crossbar, firmware on a simulated chip, port, correction, model."""

import time
from dataclasses import replace

import numpy as np
import pytest

from dataset import DatasetSettings, measured_again, simulate
from dataset.imperfections import Imperfections
from decoupler import train
from decoupler.model.settings import NetworkConfig, TrainingConfig
from fem.array.closed_forms import layer_response
from geometry.design import SensorDesign, Unit
from geometry.layout import LAYOUTS, SONG2018
from hardware.boards.simavr_board import MCUS, find_tools
from hardware.boards.simulated import STEP_S, counts_over_time, run_board, usual_rate
from hardware.link.frames import Info, ScanMode
from hardware.link.scanner import Scanner
from hardware.readout.calibration import Electronics
from hardware.readout.forces import ForceReader
from tests.house import PATIENT_S

missing = find_tools()
pytestmark = [pytest.mark.real, pytest.mark.skipif(missing is not None, reason=str(missing))]

HOLD_STEPS = 6  #: each load lasts 30 ms: four scans at 150 Hz, at least two of them wholly within it
N_LOADS = 25
INFO = Info(scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700, bits=10)


def sensor_of(layout):
    """A sensor of 6 × 6 units, a joint net for its loads, and loads that the net has not seen."""
    response = layer_response(SensorDesign(unit=Unit(layout=layout)))
    loads = {
        split: simulate(response, DatasetSettings(protocol="contact", samples=n, seed=seed))
        for split, n, seed in (("train", 800, 1), ("test", N_LOADS, 2))
    }
    data = measured_again(loads["train"], Imperfections(bits=INFO.bits), seed=1)
    network = NetworkConfig(net="skip", feature="inverse")
    model = train(data, "all", network, TrainingConfig(), response=response)
    return loads["test"], model


def root_mean_square(error_n):
    return np.sqrt((error_n**2).mean(axis=(0, 1, 2)))


@pytest.mark.parametrize("layout", [SONG2018, LAYOUTS["six-pillar"]], ids=["paper's", "six pillars"])
def test_known_forces_come_back_through_the_firmware(layout):
    """Within 1.1 times the error of the same model fed exact resistances in the same converter's steps, no crossbar."""
    loads, model = sensor_of(layout)
    told = replace(INFO, layout=layout, rate_hz=usual_rate(36 * len(layout.pillars)))
    exact_ohm = measured_again(loads, Imperfections(), seed=2).resistance_ohm
    full_scale = 2**INFO.bits - 1
    ideal_ohm = INFO.sense_ohm * full_scale / np.rint(INFO.sense_ohm * full_scale / exact_ohm)
    bound = root_mean_square(model.forces(ideal_ohm) - loads.force_n)

    crossbar = Electronics().crossbar(told)
    counts = counts_over_time(np.repeat(exact_ohm, HOLD_STEPS, axis=0), crossbar, Imperfections())
    hold_us = 1e6 * HOLD_STEPS * STEP_S
    found = np.full((N_LOADS, 6, 6, 3), np.nan)
    with run_board(MCUS[0], told, counts, "--fast") as board, Scanner(board.port, queue=10_000) as scanner:
        reader = ForceReader(scanner.info, model)
        deadline = time.monotonic() + PATIENT_S
        for scan in scanner:
            load, since_us = divmod(scan.frame.device_us, hold_us)
            scan_ends_us = since_us + 1e6 / told.rate_hz + 1000  # the table begins up to 1 ms before the board's clock
            if since_us > 0 and scan_ends_us < hold_us and load < 2 * N_LOADS:
                found[int(load) % N_LOADS] = reader.forces(scan.frame.counts[None]).force_n[0]
            if np.isfinite(found).all() or time.monotonic() > deadline:
                break
        statistics = scanner.stats
    assert np.isfinite(found).all()
    assert statistics.lost == statistics.bad_crc == statistics.bad_cobs == statistics.overruns == 0
    error = root_mean_square(found - loads.force_n)
    assert (error < 1.1 * bound).all()
