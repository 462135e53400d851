"""The crossbar against Kirchhoff's laws solved directly, against closed forms, and against its own inverse."""

from dataclasses import replace

import numpy as np
import pytest

from common.errors import DesignError
from dataset.imperfections import OPEN_OHM, Imperfections
from geometry.design import Electrics, SensorDesign, Unit
from geometry.layout import LAYOUTS, SONG2018, rest_lengths
from geometry.wiring import crossings, wires
from hardware.link.frames import ScanMode
from hardware.readout.crossbar import STEP_SHARE, SUITED_SENSE_OHM, Corrector, Crossbar
from hardware.readout.crossbar_readout import CrossbarReadout, shunts_of
from tests.geometry.closed_forms import crossings_from_pillars
from tests.hardware.boards import SHARED

each_mode = pytest.mark.parametrize("mode", SUITED_SENSE_OHM)
each_layout = pytest.mark.parametrize("layout", [*LAYOUTS.values(), SHARED], ids=[*LAYOUTS, "shared wires"])


def pressed(n, rows=6, cols=6, seed=0, layout=SONG2018):
    """Resistances of pillars that are up to 30 % shorter or 9 % longer than at rest."""
    strain = np.random.default_rng(seed).uniform(-0.3, 0.09, (n, rows, cols, len(layout.pillars)))
    return 1e3 * rest_lengths(Unit(layout=layout)) * (1 + strain) ** 2


def crossbar_of(mode, **settings):
    return Crossbar.suited(mode, **{"bits": 12} | settings)


def kirchhoff(crossbar, resistance_ohm):
    """Every reading of one state by a circuit of its own; wires are nodes, then come reference and ground.

    Unlike `Crossbar` it knows no admittance between ends, no rank-one update and no closed form. An amplifier holds its
    input at -1/A of its output, so to its wire it is R_s / (1 + A) to ground.
    """
    (n_rows, n_columns), layout = wires(crossbar.rows, crossbar.cols, crossbar.layout), crossbar.layout
    n_wires = n_rows + n_columns
    reference, ground = n_wires, n_wires + 1
    tapped, gain = crossbar.scan_mode == ScanMode.FOUR_WIRE, crossbar.amplifier_gain
    amplified = tapped or crossbar.scan_mode == ScanMode.ZERO_POTENTIAL
    switched_ohm, input_ohm = crossbar.switch_ohm + crossbar.line_ohm, crossbar.sense_ohm / (1 + gain)
    ends = (crossings(crossbar.rows, crossbar.cols, layout) + np.array([0, n_rows])).tolist()
    pillars_ohm, found = crossings_from_pillars(resistance_ohm, layout), []
    for row, column in ends:
        resistors = [(*pair, ohm) for pair, ohm in zip(ends, pillars_ohm, strict=True)]
        for wire in range(n_wires):
            if amplified and wire >= n_rows:
                resistors.append((wire, ground, crossbar.line_ohm + input_ohm))
            elif wire == column:
                resistors.append((wire, ground, switched_ohm + crossbar.sense_ohm))
            elif wire == row or crossbar.scan_mode != ScanMode.DIVIDER:
                resistors.append((wire, reference if wire == row else ground, switched_ohm))
        Y = np.zeros((n_wires + 2, n_wires + 2))
        for one, other, ohm in resistors:
            Y[[one, other], [one, other]] += 1 / ohm
            Y[[one, other], [other, one]] -= 1 / ohm
        # wires that nothing joins to the reference float
        everywhere = np.linalg.lstsq(Y[:n_wires, :n_wires], -Y[:n_wires, reference], rcond=None)[0]
        volts, across = everywhere[column], everywhere[row] - everywhere[column] if tapped else 1.0
        amps = volts / across / (crossbar.line_ohm + input_ohm if amplified else switched_ohm + crossbar.sense_ohm)
        found.append(amps * (gain * input_ohm if amplified else crossbar.sense_ohm))
    return np.array(found)


@each_mode
@each_layout
def test_readings_are_those_of_the_whole_circuit_and_back(mode, layout):
    crossbar = crossbar_of(mode, rows=2, cols=3, switch_ohm=70.0, line_ohm=5.0, amplifier_gain=2e3, layout=layout)
    state = pressed(1, 2, 3, layout=layout)
    assert crossbar.readings(state)[0] == pytest.approx(kirchhoff(crossbar, state[0]), rel=1e-9)
    exact = replace(crossbar, bits=None)
    assert Corrector(exact).correct(exact.readings(state)) == pytest.approx(state, rel=1e-8)


@each_mode
@pytest.mark.parametrize("switch_ohm", [0.0, 200.0])
def test_correct_undoes_exact_readings(mode, switch_ohm):
    """To the tolerance without a converter, 1e-9, times the tenfold by which the plain divider's inverse amplifies.

    A broken pillar costs no other: it is open, and open is what the inverse finds.
    """
    crossbar = crossbar_of(mode, switch_ohm=switch_ohm, bits=None)
    state = pressed(50)
    assert Corrector(crossbar).correct(crossbar.readings(state)) == pytest.approx(state, rel=1e-8)
    state[:3, 2, 3, 0] = OPEN_OHM
    found = Corrector(crossbar).correct(crossbar.readings(state[:3]))
    assert (found[:, 2, 3, 0] > 1e7).all()
    found[:, 2, 3, 0] = OPEN_OHM
    assert found == pytest.approx(state[:3], rel=1e-4)


def test_the_closed_form_is_only_taken_where_it_is_exact_enough():
    """Over three decades of everything: to the tolerance, a hundredth of a step, which the inverse amplifies."""
    generator = np.random.default_rng(0)
    for number in range(200):
        crossbar = crossbar_of(
            (ScanMode.ZERO_POTENTIAL, ScanMode.FOUR_WIRE)[number % 2],
            switch_ohm=10 ** generator.uniform(0, 2.5),
            line_ohm=10 ** generator.uniform(-3, 1),
            amplifier_gain=10 ** generator.uniform(3, 6),
        )
        state = 10 ** generator.uniform(3.3, 4.6, (1, 6, 6, 3))
        g = 1 / state
        error = np.abs(1 / Corrector(crossbar).correct(crossbar.readings(state)) - g).max() / g.max()
        assert error < 3 * STEP_SHARE / crossbar.full_scale


@each_mode
def test_errors_of_a_converter_are_as_said_and_alike_for_one_scan_and_many(mode):
    """Over many scans the errors' deviation is the one worked out, to a quarter: steps are no random numbers.

    Alone, a scan is found to a hundredth of a step; a plain divider's inverse amplifies that 20-fold.
    """
    crossbar = crossbar_of(mode)
    state = pressed(1) * np.random.default_rng(4).uniform(0.99, 1.01, (400, 6, 6, 3))
    readings, _ = crossbar.fractions(crossbar.counts(state))
    found = Corrector(crossbar).correct(readings)
    expected = crossbar.step_deviation(state[:1])
    error = found / state - 1
    assert np.sqrt((error**2).mean()) == pytest.approx(np.sqrt((expected**2).mean()), rel=0.25)
    assert np.abs(error).max() < (1e-3 if crossbar.is_amplified else 2e-2)
    alone = Corrector(crossbar)
    for k in range(10):
        assert alone.correct(readings[k : k + 1]) == pytest.approx(found[k : k + 1], rel=1e-4)


def test_data_pass_through_the_crossbar():
    """Dead pillars are open to it, all others come back; without correction they do not."""
    readout = CrossbarReadout(crossbar=crossbar_of(ScanMode.DIVIDER))
    faults = Imperfections(bits=12, dead_pillars=((1, 1, "x"),))
    state = pressed(20)
    found = faults.apply(state, np.random.default_rng(0), readout)
    dead = faults.dead_mask(6, 6)
    assert (found[:, dead] == OPEN_OHM).all()
    assert found[:, ~dead] == pytest.approx(state[:, ~dead], rel=0.02)
    raw = faults.apply(state, np.random.default_rng(0), replace(readout, corrected=False))
    assert np.abs(raw[:, ~dead] / state[:, ~dead] - 1).mean() > 0.5
    R, crossbar = np.full((1, 6, 6, 3), 1e4), crossbar_of(ScanMode.DIVIDER, bits=None)  # with 25 Ω switches: 79 %
    assert np.abs(crossbar.uncorrected(crossbar.readings(R)) / R - 1).mean() == pytest.approx(0.79, abs=0.01)


def readout_of(mode, state, **faults):
    return Imperfections(**faults).apply(state, np.random.default_rng(0), CrossbarReadout(crossbar=crossbar_of(mode)))


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: Crossbar(sense_ohm=0.0), r"sense_ohm=0.0 must be from 1 to 1e\+09; sense"),
        (lambda: Crossbar(shunt_siemens=(0.0, 2.0, 0.0)), "shunt_siemens=.* must be 3 numbers from 0 to 1"),
        (lambda: Crossbar(bits=None).counts(pressed(1)), "bits=None reads exactly and has no counts"),
        (lambda: readout_of(ScanMode.DIVIDER, pressed(1), bits=10), "bits=10, but the readout's converter has 12"),
        (
            lambda: readout_of(ScanMode.ZERO_POTENTIAL, np.full((1, 6, 6, 3), 3e3), bits=12),
            "sense_ohm=4700 cannot tell 3000 Ω in scan mode ZERO_POTENTIAL: choose",
        ),
    ],
)  # fmt: skip
def test_nonsense_is_refused_by_name(act, message):
    with pytest.raises(DesignError, match=message):
        act()


@each_mode
def test_shunts_of_units_are_part_of_the_circuit_and_of_its_correction(mode):
    """Rubber that pillars share: three more conductances a unit, and back to the pillars."""
    crossbar = crossbar_of(mode, rows=2, cols=3, bits=None, shunt_siemens=(9e-6, 8e-6, 1e-6))
    ohm = pressed(4, rows=2, cols=3)
    alone = replace(crossbar, shunt_siemens=())
    assert np.abs(crossbar.readings(ohm) / alone.readings(ohm) - 1).max() > 1e-4
    np.testing.assert_allclose(Corrector(crossbar).correct(crossbar.readings(ohm)), ohm, rtol=1e-6)
    G, row, column = crossbar.shunt_matrix, 2 * 1, 4 + 2 * 2  # of unit (1, 2)
    assert G[row, row + 1] == pytest.approx(3 * 9e-6)  # three units along a row of wires
    assert G[column, column + 1] == pytest.approx(2 * 8e-6)
    assert G[row + 1, column + 1] == pytest.approx(1e-6)
    assert np.array_equal(G, G.T)


def test_shunts_are_those_of_conduction():
    """None by eq. 1; by conduction U1 and U2 are joined past L1, and L1 and L2 past U1, by a tenth of a pillar."""
    assert shunts_of(SensorDesign()) == ()
    upper, lower, across = shunts_of(SensorDesign(electrics=Electrics(model="conduction")))
    assert upper == pytest.approx(lower, rel=1e-6)
    assert 0.05 < upper * 10e3 < 0.15
    assert 0 < across < 0.2 * upper
