"""What a simulated sensor goes through: the script's forces, and the resistances that a dataset has of them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import tripillar as tp
from common.errors import DesignError
from geometry.design import Array, Electrics, SensorDesign
from hardware.boards.simulated import PressAndSlide, press_and_slide
from hardware.link.frames import ScanMode
from hardware.link.scanner import Scanner
from hardware.readout.crossbar import Crossbar
from hardware.readout.crossbar_readout import shunts_of
from hardware.virtual import VirtualSensor
from tests.decoupler.synthetic_sensor import RESPONSE, conducted


def test_the_script_presses_slides_and_lifts_over_and_over():
    """At rest nothing acts; sliding, shear is friction times pressure, along the way; the peak is under its middle."""
    design = SensorDesign(array=Array(rows=3, cols=3))
    script, times_s = PressAndSlide(pressure_mpa=2.0, friction=0.25, seconds=6.0), np.array([0.5, 1.5, 3.5, 5.99])
    traction = script.tractions(times_s, design)
    assert not traction[0].any()
    assert traction[1, 0, 2] == pytest.approx(-1.0)  # half-way down on the first unit
    assert not traction[1, :, :2].any()
    assert traction[2, 4] == pytest.approx([0.25 * 2 / np.sqrt(2), 0.25 * 2 / np.sqrt(2), -2.0])  # over the middle one
    assert np.abs(traction[3]).max() < 0.03
    assert np.abs(traction).argmax() // 27 == 2
    assert script.tractions(times_s + 6.0, design) == pytest.approx(traction)
    assert not PressAndSlide(pressure_mpa=0.0).tractions(times_s, design).any()
    with pytest.raises(DesignError, match="pressure_mpa"):
        PressAndSlide(pressure_mpa=np.nan)


@pytest.mark.parametrize("law", ["eq1", "conduction"])
def test_a_board_sends_what_the_law_of_its_design_gives(law):
    """Pillars as the other route from forces to ohms has them; by conduction what joins wires beside them, too."""
    given = conducted(0.5) if law == "conduction" else RESPONSE
    given = replace(given, design=replace(given.design, electrics=Electrics(model=law)))
    motion = press_and_slide(given, PressAndSlide(seconds=0.5))
    sensor = VirtualSensor(given.design, response=given, environments=100)
    force_n = torch.from_numpy(motion.force_n)
    assert motion.resistance_ohm == pytest.approx(sensor.resistances(force_n).numpy())
    plain = VirtualSensor(RESPONSE.design, response=RESPONSE, environments=100)
    assert sensor.strains(force_n).numpy() == pytest.approx(plain.strains(force_n).numpy())  # of bodies, by any law
    rows, cols, _ = motion.resistance_ohm.shape[1:]
    wired = Crossbar.suited(ScanMode.DIVIDER, rows=rows, cols=cols, bits=16, shunt_siemens=shunts_of(given.design))
    alone = replace(wired, shunt_siemens=()).counts(motion.resistance_ohm[:1])[0]
    expected = wired.counts(motion.resistance_ohm[:1])[0]
    assert (np.abs(expected - alone).max() > 10) == (law == "conduction")
    board = tp.board(given, chip="python", bits=16, mode="divider", pressure_mpa=0.0)
    with board as port, Scanner(port) as scanner:
        assert np.array_equal(scanner.get(10).frame.counts, expected)
