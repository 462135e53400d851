"""The forward model and its inverse, of any layout: against the dataset's own lengths and what readings allow."""

from dataclasses import replace

import numpy as np
import pytest

from dataset import DatasetSettings, pillar_lengths, simulate
from dataset.measurement import ReadingError
from dataset.resistance import conducted_lengths
from decoupler import NetworkConfig, SampleError, assess, component_named, read_model, train, write_model
from decoupler.data.columns import COMPONENTS, Columns, force_columns
from decoupler.data.pairs import Pairs
from decoupler.evaluation.plausibility import doubt
from decoupler.inverse.limits import cramer_rao
from decoupler.inverse.sensor_model import ENOUGH_UNDER_LOAD, ModelInverse, SensorModel
from decoupler.readings import Pillars
from decoupler.touch.sensing import Sensing
from decoupler.training.suited import explaining, suited
from decoupler.twin import identify
from decoupler.twin.expectation import Expectation, State
from decoupler.twin.identification import readings_of
from decoupler.twin.linearised import Linear
from decoupler.twin.next_load import Knowledge
from fem.array.closed_forms import layer_response
from fem.array.solving import array_response
from geometry.design import Pad
from geometry.layout import LAYOUTS
from tests.decoupler import synthetic_sensor as made_up
from tests.decoupler.synthetic_sensor import ALL, RESPONSE, SMALL, conducted, labelled, noisy, response, sensor
from tests.decoupler.test_finite_strain import SIZES, law

BY_LAW = pytest.mark.parametrize("given", [RESPONSE, conducted(0.5)], ids=["eq. 1", "conduction"])
DATA = labelled(SMALL, "xyz", n_samples=300, seed=0)
FORWARD = SensorModel.of(RESPONSE, ALL)
READABLE = np.ones(FORWARD.n_pillars, dtype=bool)
TRAINING = Columns.of(DATA, ALL)
COLUMNS, FORCES = TRAINING.resistance_ohm, TRAINING.force_n
SHUFFLED = np.random.default_rng(0).permutation(DATA.force_n)  #: resistances of other loads


@pytest.mark.parametrize("name", COMPONENTS)
def test_gives_the_resistances_that_the_dataset_has(name):
    """Two routes from forces to ohms; by conduction in components that are those of eq. 1 as well. Rounding only."""
    component = component_named(name)
    data = labelled(SMALL, "".join(component.axes), n_samples=20, seed=0)
    force_n, expected = force_columns(data.force_n, component), Columns.of(data, component).resistance_ohm
    for given in (RESPONSE, conducted(0.0)):
        forward = SensorModel.of(given, component)
        np.testing.assert_allclose(forward.resistances(force_n), expected, rtol=1e-13)
    np.testing.assert_allclose(forward.lengths_of(expected) ** 2 * forward.ohm_per_mm2, expected, rtol=1e-14)


@BY_LAW
def test_derivatives_of_lengths_are_those_of_the_forces(given):
    """Central differences of a step of 1e-3 N err by its square times the third derivative: far below 1e-8."""
    forward, force = SensorModel.of(given, ALL), FORCES[:5]
    lengths, J = forward.jacobian(force)
    np.testing.assert_array_equal(lengths, forward.lengths(force))
    along = np.random.default_rng(1).standard_normal(force.shape)
    differences = (forward.lengths(force + 1e-3 * along) - forward.lengths(force - 1e-3 * along)) / 2e-3
    np.testing.assert_allclose(np.einsum("npf,nf->np", J, along), differences, rtol=0, atol=1e-8)
    if given.conducted is not None:
        newtons = DATA.force_n.reshape(len(DATA), -1, 3) * np.array([1.0, 1.0, -1.0])
        by_dataset = conducted_lengths(given.conducted, newtons).reshape(len(DATA), -1)
        np.testing.assert_allclose(by_dataset, forward.lengths(FORCES), rtol=1e-12)


@BY_LAW
def test_what_readings_err_by_is_what_squares_err_by(given):
    """As differences of squares of lengths that resistances stand for, which are linear in these: rounding only."""
    errors, deviation_ohm = ReadingError(noise=1e-3, bits=12, drift=0.005), np.full(FORWARD.n_pillars, 30.0)
    sensor = replace(SensorModel.of(given, ALL), deviation_ohm=deviation_ohm)
    at = sensor.at(FORCES[:4])
    ohms, (own, shared) = at.resistance_ohm, sensor.errors_mm2(at.resistance_ohm, errors, DATA.shape)
    np.testing.assert_allclose(sensor.squares_of(ohms), at.squares, rtol=1e-14)
    off_ohm = np.hypot(errors.deviation(ohms), deviation_ohm)
    np.testing.assert_allclose(own, sensor.squares_of(ohms + off_ohm) - at.squares, rtol=1e-9)
    drifted = ohms + errors.shared(ohms, *DATA.shape)[..., 0]
    np.testing.assert_allclose(shared[..., 0], sensor.squares_of(drifted) - at.squares, rtol=1e-9)


@pytest.mark.parametrize("name", ["fz", "all"])
def test_a_sensor_that_conducts_is_identified_whatever_its_forces(name):
    """By one axis, whose pillar alone has components, as by all: twice the 1.6 N that noise leaves of up to 720 N."""
    given, component = conducted(0.5), component_named(name)
    data = labelled(SMALL, "".join(component.axes), 60, seed=0)
    ohms = SensorModel.of(given, ALL).resistances(data.force_n.reshape(60, -1)).reshape(data.resistance_ohm.shape)
    data = noisy(replace(data, resistance_ohm=1.1 * ohms), 1e-3)
    found = identify(Pairs.of(data[:20]), given, made_up.softness(SMALL), name).decoder
    off_n = found.forces(data[20:].resistance_ohm)[..., -1] - data[20:].force_n[..., 2]
    assert np.sqrt(np.mean(off_n**2)) < 3.0


@pytest.mark.parametrize("noise", [0.0, 1e-2])
def test_corrections_come_near_the_forces_and_are_right_at_rest(noise):
    """A linear estimate is percents off; for loads that they never saw, the corrections leave 1 % of that."""
    inverse = ModelInverse.about(FORWARD, FORCES[:200], READABLE, noise)
    touches = np.vstack([np.zeros(FORWARD.n_forces), 10.0 * np.eye(FORWARD.n_forces)])
    assert np.abs(inverse.values(FORWARD.resistances(touches)) - touches).max() < 0.05  # fitted to 144 to 720 N
    if noise == 0.0:
        others, columns = FORCES[200:], COLUMNS[200:]
        linear = inverse.centre_n + (FORWARD.lengths_of(columns) - inverse.centre_mm) @ inverse.correctors[0]
        assert np.std(linear - others) > 0.01 * others.std()
        assert np.std(inverse.values(columns) - others) < 0.01 * np.std(linear - others)


def test_the_feature_needs_a_response_that_explains_the_data():
    """A body half as stiff is another, and so are resistances of other loads."""
    softer = replace(RESPONSE, influence_mm_per_n=0.5 * RESPONSE.influence_mm_per_n)
    unpaired = replace(TRAINING, force_n=SHUFFLED.reshape(FORCES.shape))
    for given, data, said in (
        (None, TRAINING, "needs the array's response"),
        (response(sensor(2, 2)), TRAINING, "the response is of 12 pillars, the samples of 18"),
        (RESPONSE, unpaired, r"explains .* of the resistances' variance"),
        (softer, TRAINING, r"explains .* of the resistances' variance"),
    ):
        with pytest.raises(SampleError, match=said):
            explaining(given, data)
    for data, net, given, feature in (
        (DATA, "skip", RESPONSE, "inverse"),
        (DATA, "plain", RESPONSE, "root"),
        (DATA, "skip", None, "root"),
        (replace(DATA, force_n=SHUFFLED), "skip", RESPONSE, "root"),
    ):
        assert suited(data, "all", NetworkConfig(net=net), None, given).form.feature == feature


BITS = 12
THREE_AXES = tuple(name for name in made_up.EVERY if name != "single")
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
        assert one.ratio < 1.1


def test_more_pillars_than_forces_tell_a_drift_of_all_readings_from_loads():
    """A drift of 1 % of all resistances passes for pressure with three pillars; six, or a reference, divide it out."""
    three, six, beside = (
        back_again(layer_response(sensor(2, 3, layout)), 1500, noise=1e-3, bits=BITS, drift=0.01)["fz"]
        for layout in ("song2018", "six-pillar", "reference")
    )
    assert max(six.errors.rmse_n, beside.errors.rmse_n) < 0.15 * three.errors.rmse_n


@pytest.mark.parametrize("layout", THREE_AXES)
def test_more_pillars_than_forces_are_inverted_and_bounded_by_all_they_tell(layout):
    """(Jᵀ Σ⁻¹ J)⁻¹; of shared errors, too. Exact readings lead back as near as corrections are to come."""
    design = sensor(2, 3, layout)
    forward, data = SensorModel.of(response(design), ALL), labelled(design, "xyz", 10, seed=0)
    force_n, errors = force_columns(data.force_n, ALL), ReadingError(noise=1e-3, bits=BITS, drift=0.01)
    if layout in TELLING:
        inverse = ModelInverse.about(forward, force_n, np.ones(forward.n_pillars, dtype=bool), noise=0.0)
        missed_n = inverse.values(Columns.of(data, ALL).resistance_ohm) - force_n
        assert np.std(missed_n) < ENOUGH_UNDER_LOAD * np.std(force_n)
    found = cramer_rao(forward, force_n[:2], errors, (2, 3))
    lengths, J = forward.jacobian(force_n[:2])
    ohm = forward.ohm_per_mm2 * lengths**2
    S = errors.shared(ohm, 2, 3) @ errors.shared(ohm, 2, 3).swapaxes(1, 2)
    S += errors.deviation(ohm)[..., None] ** 2 * np.eye(ohm.shape[1])
    J = J * (2 * forward.ohm_per_mm2 * lengths)[..., None]
    bound = np.linalg.inv(J.swapaxes(1, 2) @ np.linalg.solve(S, J))
    assert found == pytest.approx(np.sqrt(np.einsum("nii->ni", bound)), rel=1e-6)


@pytest.mark.parametrize("layout", THREE_AXES)
def test_a_wrong_order_of_pillars_is_named(layout):
    design = sensor(3, 3, layout)
    forward, names = SensorModel.of(response(design), ALL), design.unit.layout.pillar_names
    data = noisy(labelled(design, "xyz", 30, seed=1), 1e-3)
    assert doubt(data, ALL, forward) is None
    order = [1, *range(2, len(names)), 0]
    said = doubt(replace(data, resistance_ohm=data.resistance_ohm[..., order]), ALL, forward)
    assert f"in the order {', '.join(names[k] for k in order)}: a file's are {', '.join(names)}" in said


@pytest.mark.parametrize("layout", made_up.EVERY)
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
    expected, own = (Expectation.of(response(one), made_up.softness(one), ALL) for one in (design, paper))
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
    found = identify(Pairs.of(data), response=response(design), sensitivities=made_up.softness(design))
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
