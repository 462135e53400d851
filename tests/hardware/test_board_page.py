"""The numbers of docs/board.md are those of the crossbar's model, with the converter's 1024 steps."""

import re
from pathlib import Path

import numpy as np
import pytest

from dataset.imperfections import OPEN_OHM
from hardware.link.frames import ScanMode
from hardware.readout.crossbar import MIN_OHM, Corrector, Crossbar
from tests.geometry.closed_forms import crossings_from_pillars

PAGE = (Path(__file__).parents[2] / "docs" / "board.md").read_text()
STEPS = 1024  # of the ATmega's converter


def table(heading):
    """The rows of a section's table below its head, cell by cell; the first is the scan mode."""
    section = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    rows = [line.strip("| ").split(" | ") for line in section.splitlines() if line.startswith("|")]
    return [[ScanMode[name], *cells] for name, *cells in rows[2:]]


FIRST_CHECK = table("First check")
FULL_SCALE = table("Full scale: 1024 or 1023")


def alone(resistance_ohm):
    """An array whose crossings are empty but for one."""
    pillars = np.full((1, 6, 6, 3), OPEN_OHM)
    pillars[0, 2, 3, 1] = resistance_ohm
    return pillars


@pytest.mark.parametrize("row", FIRST_CHECK, ids=lambda row: f"{row[0].name} {row[1]}")
def test_first_check(row):
    mode, sense_ohm, *cells = row
    crossbar = Crossbar(scan_mode=mode, sense_ohm=float(sense_ohm), switch_ohm=70.0)
    for cell, resistance_ohm in zip(cells, [10e3, MIN_OHM, OPEN_OHM], strict=True):
        pillars = alone(resistance_ohm)
        here = (crossings_from_pillars(pillars) == resistance_ohm)[0]
        count = STEPS * crossbar.readings(pillars)[0, here].max()
        told = float(re.match(r"[\d.]+", cell)[0])
        assert told == pytest.approx(min(count, STEPS - 1), abs=0.1 if resistance_ohm > 1e8 else 0.051)  # one decimal
        assert ("bit 0" in cell) == (count >= STEPS - 1)


@pytest.mark.parametrize("row", FULL_SCALE, ids=lambda row: row[0].name)
def test_what_full_scale_costs(row):
    """Of a crossing that is read alone, by switches and amplifiers that are perfect."""
    mode, sense, _, low, width = row
    crossbar = Crossbar.suited(mode, rows=1, cols=1, switch_ohm=0.0, amplifier_gain=1e12)  # has no way around
    assert float(sense.split()[0]) * 1000 == crossbar.sense_ohm
    reading = crossbar.readings(np.array([[[[10e3, OPEN_OHM, OPEN_OHM]]]])).max()
    around = STEPS * reading + np.array([-0.5, 0.0, 0.5])
    most, read, least = crossbar.uncorrected(around[:, None] * np.full(3, 1 / 1023))[:, 0, 0, 0]
    assert float(low.split()[0]) == pytest.approx(10e3 - read, abs=0.051)
    assert float(width.split()[0]) == pytest.approx(most - least, abs=0.51)
    numbers = {"R": 10e3, "R_s": crossbar.sense_ohm}
    told = eval(row[2].replace("·", "*").replace("−", "-"), numbers)  # the page's own formula
    assert told == pytest.approx(read, abs=0.06)  # an empty crossing has 1 GΩ


def test_what_full_scale_costs_in_a_full_array():
    [text] = re.findall(r"in a full array at rest it is (.*?)\. The simulated", PAGE, re.DOTALL)
    told = {ScanMode[name]: float(ohm) for ohm, name in re.findall(r"(\d+) Ω in\s+(\w+)", text)}
    rest = np.broadcast_to([10e3, 10e3 * 2**0.5, 10e3 * 2**0.5], (1, 6, 6, 3))
    for mode in ScanMode:
        crossbar = Crossbar.suited(mode, switch_ohm=70.0)
        found = Corrector(crossbar).correct(crossbar.readings(rest) * STEPS / 1023)
        assert told[mode] == pytest.approx(10e3 - found[0, :, :, 0].mean(), abs=0.51)


def test_what_the_zero_potential_board_must_bear():
    """A row's twelve pillars at 5 V; 30 % shorter, R ∝ l², all of them."""
    text = " ".join(PAGE.split())
    rest_ohm = np.repeat([10e3, 10e3 * 2**0.5], 6)
    assert (5 / rest_ohm).sum() == pytest.approx(5e-3, abs=0.2e-3)
    assert (5 / (0.7**2 * rest_ohm)).sum() == pytest.approx(10.5e-3, abs=0.06e-3)
    assert "5 mA at rest (six of 10 kΩ and six of 14 kΩ; 6 mA if all had 10 kΩ), 10.5 mA when all are 30 %" in text
    assert rest_ohm[0] * 0.7**2 / 4.7e3 == pytest.approx(1.04, abs=0.005)
    assert "A z pillar of 10 kΩ is at 4.9 kΩ when 30 % shorter, 4 % above 4.7 kΩ" in text
