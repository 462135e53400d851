"""Decoders of any layout meet what its readings allow; where its pillars hardly tell a force, deviations say so."""

from dataclasses import replace

import numpy as np
import pytest

from dataset import DatasetSettings, pillar_lengths, simulate
from dataset.measurement import ReadingError
from decoupler import NetworkConfig, assess, read_model, train, write_model
from decoupler.data.columns import Columns, force_columns
from decoupler.data.pairs import Pairs
from decoupler.evaluation.plausibility import doubt
from decoupler.inverse.limits import cramer_rao
from decoupler.inverse.sensor_model import ENOUGH, ModelInverse, SensorModel
from decoupler.readings import Pillars
from decoupler.touch.sensing import Sensing
from decoupler.twin import identify
from decoupler.twin.expectation import Expectation, State
from decoupler.twin.identification import readings_of
from decoupler.twin.linearised import Linear
from decoupler.twin.next_load import Knowledge
from fem.array.closed_forms import layer_response
from fem.array.solving import array_response
from geometry.design import Pad
from geometry.layout import LAYOUTS
from tests.decoupler.synthetic_sensor import ALL, EVERY, labelled, noisy, response, sensor, softness
from tests.decoupler.test_finite_strain import SIZES, law

BITS = 12
TELLING = ("song2018", "six-pillar", "eight-pillar", "reference")  #: layouts whose pillars tell three forces apart


def sampled(given, n, seed, **read):
    return simulate(given, DatasetSettings(protocol="three-axis", samples=n, seed=seed, **read))


def back_again(given, n, **read):
    """Errors of forces on 200 samples behind a converter, by a network that learned from n."""
    model = train(sampled(given, n, 1, **read), response=given)
    return assess(model, sampled(given, 200, 2, **read), given)


@pytest.mark.parametrize("layout", TELLING)
def test_forces_come_back_within_the_converters_own_error(layout):
    """Times 1.1: the converter's own is what its steps, each even in its width, make of the best unbiased estimate."""
    for one in back_again(layer_response(sensor(2, 3, layout)), 1500, bits=BITS).values():
        assert one.ratio < 1.1


@pytest.mark.long
@pytest.mark.parametrize("kind", ["soft", "stiff"])
@pytest.mark.parametrize("layout", TELLING)
def test_forces_of_a_whole_array_come_back_within_the_converters_own_error(layout, kind, shared_cache):
    design = replace(sensor(6, 6, layout), pad=Pad(kind=kind))
    for one in back_again(array_response(design)[0], 5000, bits=BITS).values():
        print(layout, kind, one.errors.rmse_n, one.limits.cramer_rao_n, one.ratio, one.coverage)
        assert one.ratio < 1.1


def test_more_pillars_than_forces_tell_a_drift_of_all_readings_from_loads():
    """A drift of 1 % of all resistances passes for pressure with three pillars; six, or a reference, divide it out."""
    three, six, beside = (
        back_again(layer_response(sensor(2, 3, layout)), 1500, noise=1e-3, bits=BITS, drift=0.01)["fz"]
        for layout in ("song2018", "six-pillar", "reference")
    )
    assert max(six.errors.rmse_n, beside.errors.rmse_n) < 0.15 * three.errors.rmse_n


@pytest.mark.parametrize("layout", EVERY)
def test_more_pillars_than_forces_are_inverted_and_bounded_by_all_they_tell(layout):
    """(Jᵀ Σ⁻¹ J)⁻¹; of shared errors, too. Exact readings lead back as near as corrections are to come."""
    design = sensor(2, 3, layout)
    forward, data = SensorModel.of(response(design), ALL), labelled(design, "xyz", 10, seed=0)
    force_n, errors = force_columns(data.force_n, ALL), ReadingError(noise=1e-3, bits=BITS, drift=0.01)
    if layout in TELLING:
        inverse = ModelInverse.about(forward, force_n, np.ones(forward.n_pillars, dtype=bool), noise=0.0)
        missed_n = inverse.values(Columns.of(data, ALL).resistance_ohm) - force_n
        assert np.std(missed_n) < ENOUGH * np.std(force_n)
    found = cramer_rao(forward, force_n[:2], errors, (2, 3))
    lengths, J = forward.jacobian(force_n[:2])
    ohm = forward.ohm_per_mm2 * lengths**2
    S = errors.shared(ohm, 2, 3) @ errors.shared(ohm, 2, 3).swapaxes(1, 2)
    S += errors.deviation(ohm)[..., None] ** 2 * np.eye(ohm.shape[1])
    J = J * (2 * forward.ohm_per_mm2 * lengths)[..., None]
    bound = np.linalg.inv(J.swapaxes(1, 2) @ np.linalg.solve(S, J))
    assert found == pytest.approx(np.sqrt(np.einsum("nii->ni", bound)), rel=1e-6)


@pytest.mark.parametrize("layout", EVERY)
def test_a_wrong_order_of_pillars_is_named(layout):
    design = sensor(3, 3, layout)
    forward, names = SensorModel.of(response(design), ALL), design.unit.layout.pillar_names
    data = noisy(labelled(design, "xyz", 30, seed=1), 1e-3)
    assert doubt(data, ALL, forward) is None
    order = [1, *range(2, len(names)), 0]
    said = doubt(replace(data, resistance_ohm=data.resistance_ohm[..., order]), ALL, forward)
    assert f"in the order {', '.join(names[k] for k in order)}: a file's are {', '.join(names)}" in said


@pytest.mark.parametrize("layout", EVERY)
def test_touch_reads_squared_lengths_by_every_electrode(layout):
    """And by conduction the sum of its components' squares, with their signs."""
    design = sensor(2, 3, layout)
    sensing = Sensing(design=design, pillars=Pillars.designed(design))
    moved = np.random.default_rng(0).uniform(-1.0, 1.0, (4, design.n_units, len(design.unit.layout.upper), 3))
    squares = pillar_lengths(moved, design.unit).reshape(4, -1) ** 2
    assert sensing.reading(moved.reshape(4, -1)) == pytest.approx(squares - sensing.rest_mm2, abs=1e-12)
    rest_mm, m = np.random.default_rng(1).uniform(1.0, 9.0, (5, squares.shape[1])), np.sin(np.arange(5.0))[:, None]
    conducting = replace(sensing.pillars, rest_mm=rest_mm, sign=np.where(rest_mm < 3.0, -1.0, 1.0))
    sensing = Sensing(design=design, pillars=conducting)
    changed = conducting.squares((rest_mm + m)[None]) - sensing.rest_mm2
    assert sensing.reading(np.tile(m.T, squares.shape[1])) == pytest.approx(changed, abs=1e-11)


def test_what_pairs_leave_open_of_a_sensor_moves_no_reference():
    """Corrections of influence are of the others alone, and as wide as without it; pairs then tell its gain."""
    design, paper = sensor(2, 2, "reference"), sensor(2, 2)
    expected, own = (Expectation.of(response(one), softness(one), ALL) for one in (design, paper))
    assert expected.sizes[::4] == pytest.approx(own.sizes[::3])
    assert expected.near_mm_per_n == pytest.approx(own.near_mm_per_n)
    generator, mean = np.random.default_rng(0), expected.mean()
    drawn = State(shared=generator.standard_normal(mean.shared.shape), own=generator.standard_normal(mean.own.shape))
    moved = expected.sensor(drawn).by_component.reshape(4, 4, 3, 12)
    assert not moved[:, 3].any()
    assert moved[:, :3].all()
    data = labelled(design, "xyz", 40, seed=0)
    gain = 1.0 + 0.2 * generator.uniform(-1.0, 1.0, (2, 2, 4))
    data = noisy(replace(data, resistance_ohm=data.resistance_ohm * gain), 1e-3)
    linear = Linear(expected, readings_of(Pairs.of(data), ALL), mean)
    slopes = np.array([np.abs(linear.pillar(p).J[:, 2:]).max() for p in range(16)]).reshape(4, 4)
    assert ((slopes > 0) == [True, True, True, False]).all()
    found = identify(Pairs.of(data), response=response(design), sensitivities=softness(design))
    forward = found.decoder.inverse.forward
    assert not forward.by_component.reshape(4, 4, 3, 12)[:, 3].any()
    told = forward.at_rest_ohm().reshape(2, 2, 4)[..., 3] / (4000.0 * np.sqrt(300.0) / 9.0)
    assert told == pytest.approx(gain[..., 3], rel=1e-3)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_states_at_finite_strain_see_how_the_first_and_the_last_electrode_move(layout):
    design = sensor(1, 2, layout)
    linear, state_n = SensorModel.of(response(design), ALL), labelled(design, "xyz", 4, seed=0).force_n.reshape(4, -1)
    moved = (state_n @ linear.influence).reshape(4, 3, 2, -1)
    expected = [state_n.reshape(4, 2, 3), *(moved[..., electrode].swapaxes(1, 2) for electrode in (0, -1))]
    found = law(0.0, linear).maps.own(state_n) * SIZES
    assert found == pytest.approx(np.concatenate(expected, axis=2))


def test_a_model_without_a_design_keeps_its_layout_and_a_load_tells_of_every_pillar(tmp_path):
    design = sensor(1, 2, "six-pillar")
    data = labelled(design, "xyz", 60, seed=0)
    model = train(replace(data, design=None), "all", NetworkConfig(hidden=4))
    write_model(model, tmp_path / "a.safetensors")
    again = read_model(tmp_path / "a.safetensors")
    assert (again.design, again.layout) == (None, design.unit.layout)
    assert np.array_equal(again.forces(data.resistance_ohm), model.forces(data.resistance_ohm))
    expected = Expectation.of(response(design), None, ALL)
    before = Knowledge.before(expected, expected.mean(), ReadingError(noise=1e-3))
    force_n = force_columns(data.force_n, ALL)
    T = before.error_matrix(force_n)
    after = before.after(force_n[0], np.zeros((0, 6)))
    assert 0 < np.sum(T * after.covariance) < np.sum(T * before.covariance)
