"""Samples that repeat each other, pillars that do not follow their loads, and scaling to [-1, 1] and back."""

from dataclasses import replace

import numpy as np
import pytest

from common.errors import ArgumentError, DesignError
from dataset import SampleError
from decoupler import TrainingConfig, cross_validate, evaluate, train
from decoupler.data.columns import COMPONENTS, Columns, Scaling, acting_component, component_named, load_numbers
from decoupler.inverse.sensor_model import SensorModel
from decoupler.training.suited import without_stuck
from tests.decoupler.synthetic_sensor import labelled, noisy, response, sensor

ALL = component_named("all")
SENSOR = sensor(3, 3)
RESPONSE = response(SENSOR)
KNOWN = pytest.mark.parametrize("known", [RESPONSE, None], ids=["response", "none"])


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
NONE_GIVEN = r"^\w+ is of type \w+, expected \w+: [^\n]*\.$"


def with_value(name, value):
    values = getattr(DATA, name).copy()
    values[2, 1, 0, 2] = value
    return replace(DATA, **{name: values})


def test_functions_find_what_suits_the_samples(monkeypatch):
    """``train(samples)`` alone trains."""
    monkeypatch.setattr("decoupler.evaluation.crossval.in_parallel", lambda jobs, progress: [f(*x) for f, *x in jobs])
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
        *(
            (
                lambda ohm=ohm: train(with_value("resistance_ohm", ohm)),
                SampleError,
                r"sample 2, row 1, col 0, pillar y; it",
            )
            for ohm in (1e300, np.nan, 0.0)
        ),
        (
            lambda: train(with_value("force_n", 1e300)),
            SampleError,
            r"force_n is 1e\+300 at sample 2, row 1, col 0, axis z",
        ),
    ],
)
def test_what_cannot_be_learned_from_is_named_with_what_to_give(wrong, error, said):
    with pytest.raises(error, match=said):
        wrong()
