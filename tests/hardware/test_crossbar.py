"""The crossbar against Kirchhoff's laws solved directly, against closed forms, and against its own inverse."""

from dataclasses import replace

import numpy as np
import pytest

from dataset.imperfections import OPEN_OHM, Imperfections
from geometry.design import Electrics, SensorDesign
from geometry.errors import DesignError
from geometry.wiring import crossings
from hardware.link.frames import ScanMode
from hardware.readout.crossbar import Corrector, Crossbar
from hardware.readout.crossbar_readout import CrossbarReadout, shunts_of
from tests.geometry.closed_forms import crossings_from_pillars

REST_OHM = np.array([1e4, 1e4 * np.sqrt(2), 1e4 * np.sqrt(2)])
MODES = list(ScanMode)


def pressed(n, rows=6, cols=6, seed=0):
    """Resistances of pillars that are up to 30 % shorter or 9 % longer than at rest."""
    strain = np.random.default_rng(seed).uniform(-0.3, 0.09, (n, rows, cols, 3))
    return REST_OHM * (1 + strain) ** 2


def crossbar_of(mode, **settings):
    return Crossbar.suited(mode, **{"bits": 12} | settings)


def kirchhoff(crossbar, resistance_ohm):
    """Every reading of one state by a circuit of its own: nodes are wires, their ends, and the sense node.

    Unlike `Crossbar` it knows no admittance between ends, no rank-one update and no closed form.
    """
    n_rows, n_cols = 2 * crossbar.rows, 2 * crossbar.cols
    row, column = crossings(crossbar.rows, crossbar.cols).T
    g = 1 / crossings_from_pillars(resistance_ohm)
    r = crossbar.switch_ohm + crossbar.line_ohm
    n_wires = n_rows + n_cols
    wire_end, ground, reference, sense = n_wires, 2 * n_wires, 2 * n_wires + 1, 2 * n_wires + 2
    found = []
    for selected_row, selected_column in zip(row, column, strict=True):
        resistors = [(a, n_rows + b, 1 / conductance) for a, b, conductance in zip(row, column, g, strict=True)]
        sources = []  # an amplifier's output: (node, node it follows, factor)
        for wire in range(n_wires):
            is_row, number = wire < n_rows, wire - n_rows * (wire >= n_rows)
            is_selected = number == (selected_row if is_row else selected_column)
            if crossbar.scan_mode == ScanMode.ZERO_POTENTIAL and not is_row:
                resistors.append((wire, wire_end + wire, crossbar.line_ohm))
                if is_selected:
                    resistors.append((wire_end + wire, sense, crossbar.sense_ohm))
                    sources.append((sense, wire_end + wire, -crossbar.amplifier_gain))
                else:  # its own amplifier, whose output nothing else sees
                    input_ohm = crossbar.sense_ohm / (1 + crossbar.amplifier_gain)
                    resistors.append((wire_end + wire, ground, input_ohm))
                continue
            resistors.append((wire, wire_end + wire, r))
            if is_selected:
                resistors.append((wire_end + wire, reference if is_row else sense, 0.0))
            elif crossbar.scan_mode != ScanMode.DIVIDER:
                resistors.append((wire_end + wire, ground, 0.0))
        if crossbar.scan_mode != ScanMode.ZERO_POTENTIAL:
            resistors.append((sense, ground, crossbar.sense_ohm))
        # modified nodal analysis: potentials, then the current of every resistor and source
        n_nodes, n_branches = sense + 1, len(resistors) + len(sources)
        A, b = np.zeros((n_nodes + n_branches,) * 2), np.zeros(n_nodes + n_branches)
        for k, (one, other, ohms) in enumerate(resistors):
            A[n_nodes + k, [one, other, n_nodes + k]] = 1, -1, -ohms
            A[[one, other], n_nodes + k] += 1, -1
        for k, (node, follows, factor) in enumerate(sources, start=len(resistors)):
            A[n_nodes + k, [node, follows]] += 1, -factor
            A[node, n_nodes + k] += 1
        for node, volts in ((ground, 0.0), (reference, 1.0)):
            A[node], b[node] = 0, volts
            A[node, node] = 1
        A[:n_nodes, :n_nodes] += 1e-18 * np.eye(n_nodes)  # ends that float are tied to nothing
        found.append(abs(np.linalg.solve(A, b)[sense]))
    return np.array(found)


@pytest.mark.parametrize("mode", MODES)
def test_readings_are_those_of_the_whole_circuit(mode):
    """1e-6 is what the direct solution loses: its matrix holds 1e-18 beside 1e5."""
    crossbar = crossbar_of(mode, rows=2, cols=3, switch_ohm=70.0, line_ohm=5.0, amplifier_gain=2e3)
    state = pressed(1, 2, 3)
    assert crossbar.readings(state)[0] == pytest.approx(kirchhoff(crossbar, state[0]), rel=1e-6)


def test_two_equal_resistors_in_a_ring_of_wires():
    """A 1 × 1 array is a ladder of three pillars: each is read alone, for no second way leads around it."""
    state = np.array([[[[8e3, 12e3, 15e3]]]])
    perfect = {"rows": 1, "cols": 1, "switch_ohm": 0.0, "amplifier_gain": 1e12, "bits": None}
    divider = crossbar_of(ScanMode.DIVIDER, **perfect).readings(state)[0]
    assert divider == pytest.approx(2_200 / (2_200 + state.ravel()), rel=1e-12)
    amplified = crossbar_of(ScanMode.ZERO_POTENTIAL, **perfect).readings(state)[0]
    assert amplified == pytest.approx(4_700 / state.ravel(), rel=1e-9)


def test_uncorrected_crosstalk_is_the_largest_error_of_such_sensors():
    """The issue's figure for equal pillars of 10 kΩ with 25 Ω switches: plain 79 %."""
    R = np.full((1, 6, 6, 3), 1e4)
    crossbar = crossbar_of(ScanMode.DIVIDER, bits=None)
    error = np.abs(crossbar.uncorrected(crossbar.readings(R)) / R - 1)
    assert error.mean() == pytest.approx(0.79, abs=0.01)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("switch_ohm", [0.0, 25.0, 200.0])
def test_correct_undoes_exact_readings(mode, switch_ohm):
    """To the tolerance without a converter, 1e-9, times the tenfold by which the plain divider's inverse amplifies."""
    crossbar = crossbar_of(mode, switch_ohm=switch_ohm, bits=None)
    state = pressed(50)
    assert Corrector(crossbar).correct(crossbar.readings(state)) == pytest.approx(state, rel=1e-8)


@pytest.mark.parametrize(("mode", "settings"), [
    (ScanMode.ZERO_POTENTIAL, {"amplifier_gain": 1e12}),
    (ScanMode.GROUNDED, {"switch_ohm": 0.0}),
])  # fmt: skip
def test_the_closed_form_is_exact_where_it_should_be(mode, settings):
    crossbar = crossbar_of(mode, **settings)
    state = pressed(3)
    guess, error = Corrector(crossbar)._first_guess(crossbar.apparent_conductances(crossbar.readings(state)))
    assert guess == pytest.approx(1 / crossings_from_pillars(state), rel=1e-7)
    assert (error < 1e-7).all()


def test_the_closed_forms_error_is_below_its_bound():
    """Over three decades of everything; the bound is no more than 10 times too careful."""
    generator = np.random.default_rng(0)
    for _ in range(100):
        crossbar = crossbar_of(
            ScanMode.ZERO_POTENTIAL,
            switch_ohm=10 ** generator.uniform(0, 2.5),
            line_ohm=10 ** generator.uniform(-3, 1),
            amplifier_gain=10 ** generator.uniform(3, 6),
        )
        state = 10 ** generator.uniform(3.3, 4.6, (1, 6, 6, 3))
        guess, bound = Corrector(crossbar)._first_guess(crossbar.apparent_conductances(crossbar.readings(state)))
        conductance = 1 / crossings_from_pillars(state)
        error = np.abs(guess - conductance).max() / conductance.max()
        assert 0.1 * bound[0] < error < bound[0]


@pytest.mark.parametrize("mode", MODES)
def test_what_the_steps_leave_is_as_said(mode):
    """Over many scans the errors' deviation is the one worked out, to a quarter: steps are no random numbers."""
    crossbar = crossbar_of(mode)
    state = pressed(1) * np.random.default_rng(4).uniform(0.99, 1.01, (400, 6, 6, 3))
    readings, _ = crossbar.fractions(crossbar.counts(state))
    error = Corrector(crossbar).correct(readings) / state - 1
    expected = crossbar.step_deviation(state[:1])
    assert np.sqrt((error**2).mean()) == pytest.approx(np.sqrt((expected**2).mean()), rel=0.25)


@pytest.mark.parametrize(("mode", "bound"), [(ScanMode.ZERO_POTENTIAL, 1e-3), (ScanMode.DIVIDER, 2e-2)])
def test_errors_at_12_bits_stay_below_the_issues_bounds(mode, bound):
    readout = CrossbarReadout(crossbar=crossbar_of(mode))
    state = pressed(200)
    error = np.abs(readout.measured(state, np.random.default_rng(0)) / state - 1)
    assert error.max() < bound


@pytest.mark.parametrize("mode", MODES)
def test_derivatives_are_those_of_differences(mode):
    """Central differences of 1e-5 err by some 1e-10 of the largest derivative, plus rounding."""
    crossbar = crossbar_of(mode, rows=1, cols=2, switch_ohm=300.0)
    g = 1 / crossings_from_pillars(pressed(1, 1, 2))
    _, derivatives = crossbar.apparent_and_derivatives(g)
    for p in range(6):
        step = np.zeros_like(g)
        step[0, p] = 1e-5 * g[0, p]
        difference = crossbar.apparent_of(g + step) - crossbar.apparent_of(g - step)
        found = difference[0] / (2 * step[0, p])
        assert derivatives[0, :, p] == pytest.approx(found, abs=1e-8 * np.abs(derivatives).max())


@pytest.mark.parametrize("mode", MODES)
def test_one_scan_after_another_gives_what_all_at_once_give(mode):
    """To a hundredth of a step, 2.4e-6 of full scale, for both; a plain divider's inverse amplifies it 20-fold."""
    crossbar = crossbar_of(mode)
    readings, _ = crossbar.fractions(crossbar.counts(pressed(30)))
    together, alone = Corrector(crossbar).correct(readings), Corrector(crossbar)
    for k in range(30):
        assert alone.correct(readings[k : k + 1]) == pytest.approx(together[k : k + 1], rel=1e-4)


@pytest.mark.parametrize("mode", MODES)
def test_readings_that_no_array_gives_end_in_finite_resistances(mode):
    crossbar = crossbar_of(mode)
    counts = np.random.default_rng(3).integers(0, 4096, (20, 108))
    readings, _ = crossbar.fractions(counts)
    resistance_ohm = Corrector(crossbar).correct(readings)
    assert np.isfinite(resistance_ohm).all()
    assert (resistance_ohm > 0).all()


@pytest.mark.parametrize("mode", MODES)
def test_a_broken_pillar_costs_no_other(mode):
    """Its neighbours are found as exactly as without it: it is open, and open is what the inverse finds."""
    crossbar = crossbar_of(mode, bits=None)
    state = pressed(3)
    state[:, 2, 3, 0] = OPEN_OHM
    found = Corrector(crossbar).correct(crossbar.readings(state))
    whole = np.arange(108).reshape(6, 6, 3) != np.ravel_multi_index((2, 3, 0), (6, 6, 3))
    assert found[:, whole] == pytest.approx(state[:, whole], rel=1e-4)
    assert (found[:, 2, 3, 0] > 1e7).all()


def test_saturated_counts_are_flagged_and_taken_for_their_neighbours():
    fractions, is_bound = crossbar_of(ScanMode.DIVIDER, bits=10).fractions(np.array([0, 1, 512, 1022, 1023]))
    assert is_bound.tolist() == [True, False, False, False, True]
    assert fractions * 1023 == pytest.approx([1, 1, 512, 1022, 1022])


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


def test_a_converter_that_cannot_tell_a_pillar_is_refused():
    readout = CrossbarReadout(crossbar=crossbar_of(ScanMode.ZERO_POTENTIAL))
    state = pressed(1)
    state[0, 0, 0, 0] = 3e3  # below the feedback resistor
    with pytest.raises(DesignError, match=r"sense_ohm=4700 cannot tell 3000 Ω in scan mode ZERO_POTENTIAL: choose"):
        readout.measured(state, np.random.default_rng(0))


def test_bits_must_be_those_of_the_readout():
    readout = CrossbarReadout(crossbar=crossbar_of(ScanMode.DIVIDER))
    with pytest.raises(DesignError, match=r"bits=10, but the readout's converter has 12"):
        Imperfections(bits=10).apply(pressed(1), np.random.default_rng(0), readout)


@pytest.mark.parametrize(("settings", "message"), [
    ({"sense_ohm": 0.0}, "sense_ohm=0 must be from 1 to 1e"),
    ({"switch_ohm": -1.0}, "switch_ohm=-1 must be from 0"),
    ({"amplifier_gain": np.nan}, "amplifier_gain=nan must be"),
    ({"bits": 7}, "bits=7 must be from 8 to 16"),
    ({"rows": 0}, "rows=0, cols=6 must each"),
])  # fmt: skip
def test_nonsense_is_refused_by_name(settings, message):
    with pytest.raises(DesignError, match=message):
        Crossbar(**settings)


@pytest.mark.parametrize("mode", ScanMode)
def test_shunts_of_units_are_part_of_the_circuit_and_of_its_correction(mode):
    """Rubber that pillars share: Kirchhoff's laws with three more conductances a unit, and back to the pillars."""
    crossbar = crossbar_of(mode, rows=2, cols=3, bits=None, shunt_siemens=(9e-6, 8e-6, 1e-6))
    ohm = pressed(4, rows=2, cols=3)
    alone = replace(crossbar, shunt_siemens=(0.0, 0.0, 0.0))
    assert np.abs(crossbar.readings(ohm) / alone.readings(ohm) - 1).max() > 1e-4
    np.testing.assert_allclose(Corrector(crossbar).correct(crossbar.readings(ohm)), ohm, rtol=1e-6)
    L, row, column = crossbar._laplacian(np.zeros((1, 18)))[0], 2 * 1, 4 + 2 * 2  # of unit (1, 2)
    assert L[row, row + 1] == pytest.approx(-3 * 9e-6)  # three units along a row of wires
    assert L[column, column + 1] == pytest.approx(-2 * 8e-6)
    assert L[row + 1, column + 1] == pytest.approx(-1e-6)
    np.testing.assert_allclose(L.sum(axis=1), 0.0, atol=1e-20)


def test_shunts_are_those_of_conduction():
    """None by eq. 1; by conduction U1 and U2 are joined past L1, and L1 and L2 past U1, by a tenth of a pillar."""
    assert shunts_of(SensorDesign()) == (0.0, 0.0, 0.0)
    upper, lower, across = shunts_of(SensorDesign(electrics=Electrics(model="conduction")))
    assert upper == pytest.approx(lower, rel=1e-6)
    assert 0.05 < upper * 10e3 < 0.15
    assert 0 < across < 0.2 * upper
