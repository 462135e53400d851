"""The paper's sensor on an ATmega board, and a joint net for it: what benches and pictures show."""

from dataset import DatasetSettings, measured_again, simulate
from dataset.imperfections import Imperfections
from decoupler.model.decoupler import Decoupler
from decoupler.model.settings import NetworkConfig, TrainingConfig
from fem.array.response import ArrayResponse
from hardware.boards.simavr_board import CHIP_BITS
from hardware.link.frames import Info, ScanMode
from hardware.readout.crossbar import SUITED_SENSE_OHM

SAMPLES = 2000
SEED = 1


def board_info(mode: ScanMode, rate_hz: int = 150) -> Info:
    """Of an ATmega board whose sense resistor suits the paper's pillars."""
    return Info(bits=CHIP_BITS, scan_mode=mode, sense_ohm=round(SUITED_SENSE_OHM[mode]), rate_hz=rate_hz)


def joint_net(response: ArrayResponse) -> Decoupler:
    """A net for all forces, trained on contact loads through a converter of as many bits."""
    from decoupler import train

    loads = simulate(response, DatasetSettings(protocol="contact", samples=SAMPLES, seed=SEED))
    data = measured_again(loads, Imperfections(bits=CHIP_BITS), seed=SEED)
    model = train(data, "all", NetworkConfig(net="skip", feature="inverse"), TrainingConfig(), response=response)
    return model
