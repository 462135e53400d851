"""What a second pair of wires buys: contacts that each pillar has alone drop out, those that pillars share do not."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dataset import DatasetSettings, simulate
from fem.array.closed_forms import layer_response
from geometry import Array, SensorDesign
from geometry.design import Electrics
from geometry.layout import SONG2018
from hardware.boards.simulated import PressAndSlide, press_and_slide
from hardware.link.frames import ScanMode
from hardware.readout.crossbar import Corrector, Crossbar
from hardware.readout.crossbar_readout import CrossbarReadout, seen_by
from hardware.virtual import VirtualSensor

PLAIN = SensorDesign(array=Array(rows=1, cols=2))
TOUCHED = replace(PLAIN, electrics=Electrics(contact_ohm=500.0, contact_spread=0.5))
FOUR = Crossbar.suited(ScanMode.FOUR_WIRE, rows=1, cols=2, bits=None)


def test_contacts_show_by_two_wires_and_not_by_four():
    """In files, in simulations of others and to boards; what is left of the bulk's crosstalk is corrected."""
    asked = DatasetSettings(protocol="three-axis", samples=40, seed=2)
    bulk = simulate(layer_response(PLAIN), asked)
    by = {
        mode: simulate(layer_response(TOUCHED), asked, readout=CrossbarReadout(crossbar=replace(FOUR, scan_mode=mode)))
        for mode in (ScanMode.ZERO_POTENTIAL, ScanMode.FOUR_WIRE)
    }
    four, two = by[ScanMode.FOUR_WIRE], by[ScanMode.ZERO_POTENTIAL]
    assert four.resistance_ohm == pytest.approx(bulk.resistance_ohm, rel=1e-7)
    assert (two.resistance_ohm - bulk.resistance_ohm).mean() == pytest.approx(1000.0, rel=0.3)
    assert four.design == PLAIN
    assert two.design == TOUCHED
    sensor = VirtualSensor(TOUCHED, crossbar=FOUR, response=layer_response(TOUCHED))
    force_n = torch.tensor(bulk.force_n[:1])
    assert sensor.read(sensor.resistances(force_n)).numpy() == pytest.approx(bulk.resistance_ohm[:1], rel=1e-7)
    motions = [press_and_slide(layer_response(each), PressAndSlide()) for each in (PLAIN, seen_by(FOUR, TOUCHED))]
    assert np.array_equal(motions[0].resistance_ohm, motions[1].resistance_ohm)


def test_what_four_wires_leave_is_the_columns_own_resistance_and_no_switch_shows():
    """r (G − g), r that of an amplifier's input, G of a column; 50 Ω taken for 25 Ω cost zero potential 2.5 %."""
    crossbar, state = Crossbar.suited(ScanMode.FOUR_WIRE, bits=None), np.full((1, 6, 6, 3), 1e4)
    left = crossbar.uncorrected(crossbar.readings(state)) / state - 1.0
    others = np.array([11, 5, 11])  # pillars of a column beside z, x and y
    expected = 4700 / 100_001 * others * 1e-4 + 1e-5  # and what the amplifier's gain lacks
    assert left == pytest.approx(np.broadcast_to(expected, left.shape), rel=3e-2)  # idle rows rise by 2 % of that
    for mode, error in ((ScanMode.FOUR_WIRE, 0.0), (ScanMode.ZERO_POTENTIAL, 0.025)):
        built = Crossbar.suited(mode, bits=None, switch_ohm=50.0)
        found = Corrector(replace(built, switch_ohm=25.0)).correct(built.readings(state)) / state - 1.0
        assert np.abs(found).mean() == pytest.approx(error, abs=1e-5)


def test_contacts_that_pillars_share_show_by_four_wires_too():
    """The whole circuit of 6 × 6 units with one contact an electrode: shares of the contact that readings err by."""
    found = shared_contacts(Crossbar(), 300.0)
    assert found["two wires"] == pytest.approx(3.5, abs=0.1)
    assert found["a tap a wire"] == pytest.approx(1.6, abs=0.1)
    assert found["a switched tap an electrode"] == pytest.approx(0.75, abs=0.1)


def shared_contacts(array: Crossbar, contact_ohm: float) -> dict[str, float]:
    """Mean errors of resistances over a contact, of pillars whose electrodes touch a wire, and a tap, by one contact.

    Rows stand at 1 V in turn, all other wires at 0 V; a column's current is that of its amplifier.
    """
    rows, cols, ends = array.rows, array.cols, SONG2018.pillar_terminals
    ohms = (
        1e4 * np.array([1.0, 2**0.5, 2**0.5]) * (1 + np.random.default_rng(0).uniform(-0.3, 0.05, (rows, cols, 3))) ** 2
    )
    n, wires = 4 * rows * cols, 2 * (rows + cols)
    errors: dict[str, list[float]] = {"two wires": [], "a tap a wire": [], "a switched tap an electrode": []}
    for has_taps in (False, True):
        G = np.zeros((n + 2 * wires,) * 2)
        places = []
        for i, j in np.ndindex(rows, cols):
            electrode, wire = 4 * (i * cols + j), (2 * i, 2 * i + 1, 2 * rows + 2 * j, 2 * rows + 2 * j + 1)
            joined = [(electrode + top, electrode + foot, R) for (top, foot), R in zip(ends, ohms[i, j], strict=True)]
            places += [(*one, wire[top], wire[foot]) for one, (top, foot) in zip(joined, ends, strict=True)]
            joined += [(electrode + k, n + wire[k], contact_ohm) for k in range(4)]
            joined += [(electrode + k, n + wires + wire[k], contact_ohm) for k in range(4 * has_taps)]
            for one, other, R in joined:
                G[[one, other], [one, other]] += 1 / R
                G[[one, other], [other, one]] -= 1 / R
        driven = np.arange(n, n + wires)
        free = np.r_[:n, n + wires : n + 2 * wires] if has_taps else np.arange(n)
        volts = np.zeros((n + 2 * wires, 2 * rows))
        volts[n + np.arange(2 * rows), np.arange(2 * rows)] = 1.0
        volts[free] = np.linalg.solve(G[np.ix_(free, free)], -G[np.ix_(free, driven)] @ volts[driven])
        amps = -(G @ volts)[driven]
        for top, foot, R, row, column in places:
            V, current = volts[:, row], amps[column, row]
            if has_taps:
                errors["a tap a wire"].append((V[n + wires + row] - V[n + wires + column]) / current - R)
            else:
                errors["two wires"].append(1.0 / current - R)
                errors["a switched tap an electrode"].append((V[top] - V[foot]) / current - R)
    return {name: float(np.mean(each)) / contact_ohm for name, each in errors.items()}
