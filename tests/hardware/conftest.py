"""Boards that tests start, and a pressed sensor; what simulates the firmware skips where its tools are missing."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dataset import measured
from decoupler import NetworkConfig, TrainingConfig, train
from hardware.boards.simavr_board import MCUS, find_tools, write_table
from hardware.readout.calibration import Electronics
from tests.decoupler.synthetic_sensor import labelled, response, sensor
from tests.hardware.boards import DISTINCT, Chip, build
from tests.hardware.models import INFO


@pytest.fixture(scope="session")
def built(tmp_path_factory):
    """The folder of the firmware for both MCUs, and of the program that runs it."""
    missing = find_tools()
    if missing:
        pytest.skip(missing)
    folder = tmp_path_factory.mktemp("built")
    build(folder, "all", "simulator")
    return folder


@pytest.fixture
def board(built, tmp_path):
    """Starts boards that read a table of counts; DISTINCT unless told. "--fast" ones wait for their reader."""

    def start(*options, mcu=MCUS[0], counts=DISTINCT, step_us=1000, elf=None, table=None):
        if table is None:
            table = tmp_path / "readings.table"
            write_table(table, counts, step_us)
        elf = elf or built / f"tripillar-{mcu}.elf"
        return Chip(built / "simavr-board", elf, mcu, table, *options)

    return start


@pytest.fixture(scope="session")
def pressed():
    """Samples of a sensor of 2 × 3 units with 0.1 % of noise, a model of them, and what a board counts under them."""
    exact = labelled(sensor(2, 3), "xyz", n_samples=400, seed=0)
    noisy = measured(exact.resistance_ohm, 1e-3, None, np.random.default_rng(0))
    samples = replace(exact, resistance_ohm=noisy, noise=1e-3)
    network = NetworkConfig(hidden=4, feature="inverse")
    model = train(samples, "all", network, TrainingConfig(), response=response(sensor(2, 3)))
    counts = Electronics().crossbar(INFO).counts(exact.resistance_ohm[:50])
    return SimpleNamespace(samples=samples, model=model, counts=counts)
