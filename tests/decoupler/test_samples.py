"""What is learned from samples: repeated ones, stuck pillars, scaling, a draw of many, folds that each test once."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from common.errors import ArgumentError, DesignError
from dataset import DatasetSettings, SampleError, read_samples, simulate
from dataset.samples import drawn, joined
from decoupler import NetworkConfig, TrainingConfig, assess, cross_validate, evaluate, train
from decoupler.data.columns import COMPONENTS, Columns, Scaling, acting_component, component_named, load_numbers
from decoupler.evaluation.crossval import jobs_of, split_folds, summary
from decoupler.evaluation.metrics import component_errors
from decoupler.inverse.sensor_model import SensorModel
from decoupler.training.suited import without_stuck
from tests.decoupler.synthetic_sensor import ALL, labelled, noisy, response, sensor

SENSOR = sensor(3, 3)
RESPONSE = response(SENSOR)
KNOWN = pytest.mark.parametrize("known", [RESPONSE, None], ids=["response", "none"])
FOLDED = labelled(sensor(2, 3), "x", n_samples=53, seed=0)
NETWORK, FEW = NetworkConfig(hidden=3), TrainingConfig(max_iterations=3, seed=4)


@pytest.fixture(autouse=True)
def one_process(monkeypatch):
    """Processes of their own load torch for seconds; the pool has tests of its own."""
    monkeypatch.setattr("decoupler.evaluation.crossval.in_parallel", lambda jobs, progress: [f(*x) for f, *x in jobs])


def model(known, component):
    return None if known is None else SensorModel.of(known, component)


def samples(axes="xyz", n=200, noise=0.0):
    return noisy(labelled(SENSOR, axes, n_samples=n, seed=0), noise)


def test_repeated_samples_are_dropped_and_what_a_component_does_not_take_makes_no_difference():
    """The first of each stays in place; nor does what a dead pillar reads. Loads are numbered as they appear."""
    assert Columns.of(samples(n=5)[[3, 1, 3, 0, 1, 1]], ALL).distinct().tolist() == [0, 1, 3]
    data = samples(n=5)[[0, 0, 1]]
    data.resistance_ohm[1, 2, 1, 1:] *= 1.01  # x and y
    dead = np.zeros((3, 3, 3), dtype=bool)
    dead[2, 1, 1:] = True
    others = (data, ALL), (data, component_named("fz")), (replace(data, dead=dead), ALL)
    assert [len(Columns.of(*one).distinct()) for one in others] == [3, 2, 2]
    assert load_numbers(np.array([[1.0, 2.0], [3.0, 4.0], [1.0, 2.0], [5.0, 6.0]])).tolist() == [0, 1, 0, 2]


@KNOWN
@pytest.mark.parametrize(("n", "noise"), [(3, 0.0), (20, 1e-3), (1000, 1e-2)])
@pytest.mark.parametrize("name", COMPONENTS)
def test_stuck_pillars_are_found_whatever_their_noise_and_healthy_ones_are_not(known, noise, n, name):
    """Two of the 9 or 27; readings about another mean, ±1 Ω and the stated noise. Three samples are too few to tell."""
    component = component_named(name)
    data, generator = samples(n=n, noise=noise), np.random.default_rng(3)
    healthy = Columns.of(data, component)
    assert without_stuck(healthy, model(known, component)) is healthy
    if n == 3:
        return
    places = [(row, col, component.pillars(data.layout)[0]) for row, col in ((0, 1), (2, 2))]
    for place in places:
        ohm = 7000 + generator.uniform(-1, 1, n)
        data.resistance_ohm[:, *place] = ohm * (1 + noise * generator.standard_normal(n))
    masked = without_stuck(Columns.of(data, component), model(known, component))
    assert [tuple(place) for place in np.argwhere(masked.dead).tolist()] == places
    assert without_stuck(masked, model(known, component)) is masked


def test_a_unit_that_was_never_loaded_is_not_stuck_nor_are_most_pillars():
    """Its pillar hardly moves because nothing moves it. If most seem stuck, it is the expectation that is wrong."""
    data = samples("z", n=100)
    data.force_n[:, 1, 1] = 300.0
    data.resistance_ohm[:, 1, 1] = data.resistance_ohm[:, 1, 1].mean(axis=0)
    columns = Columns.of(data, component_named("fz"))
    assert without_stuck(columns, None) is columns
    softer = replace(RESPONSE, influence_mm_per_n=-0.01 * RESPONSE.influence_mm_per_n)
    columns = Columns.of(samples(n=100), ALL)
    assert without_stuck(columns, model(softer, ALL)) is columns


def test_range_becomes_minus_one_to_one_and_a_constant_zero_and_back():
    """Rounding noise on a constant is not blown up to the full range, nor is what is too small to be divided by."""
    generator = np.random.default_rng(0)
    values = generator.uniform([-5.0, 1e3, 1e-6], [5.0, 1e6, 3e-6], (50, 3))
    values = np.column_stack([values, 1e4 * (1 + 1e-16 * generator.standard_normal(50)), np.zeros(50)])
    values[0, 4] = 1e-310
    scaling = Scaling.fitted(values)
    scaled = scaling.scale(values)
    np.testing.assert_allclose([scaled.min(axis=0), scaled.max(axis=0)], np.outer([-1, 1], [1, 1, 1, 0, 0]), rtol=1e-12)
    np.testing.assert_allclose(scaling.unscale(scaled), values, rtol=1e-12, atol=1e-300)


QUICK = TrainingConfig(max_iterations=1)
DATA = samples(n=60)
BAD = "sample 2, row 1, col 0, pillar y; it"
NONE_GIVEN = r"^\w+ is of type \w+, expected \w+: [^\n]*\.$"


def with_value(name, value):
    values = getattr(DATA, name).copy()
    values[2, 1, 0, 2] = value
    return replace(DATA, **{name: values})


def test_functions_find_what_suits_the_samples():
    """``train(samples)`` alone trains."""
    one = replace(DATA, force_n=DATA.force_n * (0.0, 0.0, 1.0))
    assert acting_component(one.force_n) == "fz"
    assert train(DATA, training=QUICK).component.name == "all"
    assert train(DATA, training=QUICK, response=RESPONSE).form.feature == "inverse"
    assert all(set(fold.errors) == {"fz"} for fold in cross_validate(one, training=QUICK, folds=2))


@pytest.mark.parametrize(
    ("wrong", "error", "said"),
    [
        (lambda: train(42), ArgumentError, NONE_GIVEN),
        (lambda: train(DATA, "all", QUICK), ArgumentError, NONE_GIVEN),
        (lambda: evaluate(DATA, DATA), ArgumentError, NONE_GIVEN),
        (lambda: cross_validate("data.nc"), ArgumentError, NONE_GIVEN),
        (lambda: train(DATA, "fw"), DesignError, "component='fw' is unknown; choose one of fz, fx, fy, all"),
        *((lambda ohm=ohm: train(with_value("resistance_ohm", ohm)), SampleError, BAD) for ohm in (1e300, np.nan, 0.0)),
        (lambda: train(with_value("force_n", 1e300)), SampleError, r"force_n is 1e\+300 at sample 2, row 1, col 0"),
    ],
)
def test_what_cannot_be_learned_from_is_named_with_what_to_give(wrong, error, said):
    with pytest.raises(error, match=said):
        wrong()


MANY = 3000  #: more samples are not held together


def test_few_are_all_and_many_a_random_draw_from_memory_and_disk_alike(tmp_path, monkeypatch):
    """The draw trains to the bit; errors are those on all samples. Sums over blocks round otherwise: by 1e-12."""
    own = response(sensor(1, 2))
    for module in ("metrics", "assessment"):
        monkeypatch.setattr(f"decoupler.evaluation.{module}.ENOUGH", MANY)
    monkeypatch.setattr(drawn, "__defaults__", (0, MANY))
    many = simulate(own, DatasetSettings(protocol="three-axis", samples=MANY + 7000, noise=1e-3)).labels()
    many.write(tmp_path / "many.zarr")
    stored = read_samples(tmp_path / "many.zarr")
    assert np.array_equal(drawn(many[:50]).force_n, many.force_n[:50])
    one, same, other = drawn(many, 1), drawn(stored, 1), drawn(many, 2)
    assert np.array_equal(one.force_n, same.force_n)
    assert not np.array_equal(one.force_n, other.force_n)
    assert len(np.unique(one.force_n.reshape(MANY, -1), axis=0)) == MANY  # none twice
    with pytest.raises(ArgumentError, match="samples is of type list"):
        drawn([1, 2])
    drifting = simulate(own, DatasetSettings(protocol="three-axis", samples=2, noise=1e-3, drift=0.01)).labels()
    with pytest.raises(SampleError, match="another drift"):
        joined([one[:2], drifting])
    asked = "all", replace(NETWORK, feature="inverse"), TrainingConfig(max_iterations=5, seed=1)
    model, again, of_draw = (train(data, *asked, response=own) for data in (stored, many, one))
    for each in (again, of_draw):
        assert np.array_equal(each.network.output, model.network.output)
        assert np.array_equal(each.uncertainty.inverse_matrix, model.uncertainty.inverse_matrix)
    assert model.made_from["n_samples"] == MANY
    assert model.made_from["data_hash"] == stored.content_hash
    expected = component_errors(model.forces(many.resistance_ohm), many, ALL)
    for found in (evaluate(model, stored), {name: one.errors for name, one in assess(model, stored, own).items()}):
        for name, errors in expected.items():
            assert found[name].rmse_n == pytest.approx(errors.rmse_n, rel=1e-12)
            assert found[name].full_scale_pct == pytest.approx(errors.full_scale_pct, rel=1e-12)
            assert found[name].rel_err == (errors.rel_err and pytest.approx(errors.rel_err, rel=1e-12))


def test_folds_part_the_samples_and_impossible_ones_are_refused():
    parts = split_folds(53, 10, seed=1)
    assert sorted(np.concatenate(parts)) == list(range(53))
    assert {len(part) for part in parts} == {5, 6}
    assert not np.array_equal(parts[0], split_folds(53, 10, seed=2)[0])
    for folds in (1, 27):
        with pytest.raises(SampleError, match=f"folds={folds} must be from 2 to 26"):
            split_folds(53, folds, seed=0)
    with pytest.raises(SampleError, match="needs the array's response"):
        cross_validate(FOLDED, "fx", NetworkConfig(feature="inverse"), FEW, folds=2)


def test_a_fold_is_a_network_trained_on_the_rest_which_never_saw_its_scaling():
    """To the bit, in order; the test samples hold the largest forces and resistances by far."""
    parts = split_folds(53, 4, FEW.seed)
    wild = replace(FOLDED, force_n=FOLDED.force_n.copy(), resistance_ohm=FOLDED.resistance_ohm.copy())
    wild.force_n[parts[0]] *= 100.0
    wild.resistance_ohm[parts[0]] *= 100.0
    tested = cross_validate(wild, "fx", NETWORK, FEW, folds=4)
    for fold, part in zip(tested, parts, strict=True):
        model = train(wild[np.setdiff1d(np.arange(53), part)], "fx", NETWORK, FEW)
        assert fold.errors == evaluate(model, wild[part])
        assert fold.iterations == model.made_from["outcome"]["iterations"]
    rel_err, found = [fold.errors["fx"].rel_err for fold in tested], summary(tested)
    assert [fold["rel_err"] for fold in found["folds"]] == rel_err
    assert found["mean_rel_err"] == pytest.approx(np.mean(rel_err))
    assert found["spread_rel_err"] == pytest.approx(np.std(rel_err))


def test_copies_and_readings_of_one_load_come_into_one_fold():
    """No load of a test set is among those of training; a copy of a sample counts once."""
    twice = FOLDED[np.concatenate([np.arange(53), np.arange(53), np.arange(20)])]
    twice.resistance_ohm[106:] *= 1 + 1e-3 * np.random.default_rng(0).standard_normal((20, 2, 3, 3))
    tested = []
    jobs = pickle.loads(pickle.dumps(list(jobs_of(twice, "fx", NETWORK, FEW, 4, None))))  # for another process
    for _, data, *_, trained_on, tested_on in jobs:
        assert len(data.force_n) == 73
        assert not np.isin(data.force_n[tested_on, 0, 0, 0], data.force_n[trained_on, 0, 0, 0]).any()
        assert sorted([*trained_on, *tested_on]) == list(range(73))
        tested += [*tested_on]
    assert sorted(tested) == list(range(73))
