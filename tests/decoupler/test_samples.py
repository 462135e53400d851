"""Samples that repeat each other, pillars that do not follow their loads, and scaling to [-1, 1] and back."""

from dataclasses import replace

import numpy as np
import pytest

from dataset import SampleError
from decoupler import NetworkConfig, TrainingConfig, cross_validate, evaluate, train
from decoupler.data.columns import (
    COMPONENTS,
    Columns,
    Scaling,
    component_named,
    force_columns,
    load_numbers,
    pillar_columns,
)
from decoupler.inverse.forward_model import ForwardModel
from decoupler.training.suited import suited_component, without_stuck
from geometry.errors import ArgumentError, DesignError
from geometry.layout import PILLARS
from tests.decoupler.synthetic_sensor import labelled, noisy, response, sensor

ALL = component_named("all")
SENSOR = sensor(3, 3)
RESPONSE = response(SENSOR)


def model(known, component):
    return None if known is None else ForwardModel.of(known, component)


def samples(axes="xyz", n=200, noise=0.0):
    return noisy(labelled(SENSOR, axes, n_samples=n, seed=0), noise)


def test_repeated_samples_are_dropped_and_the_first_of_each_stays_in_place():
    data = samples(n=5)
    assert Columns.of(data, ALL).distinct().tolist() == [0, 1, 2, 3, 4]
    assert Columns.of(data[[3, 1, 3, 0, 1, 1]], ALL).distinct().tolist() == [0, 1, 3]


def test_what_a_component_does_not_take_makes_no_difference():
    """Nor does what a dead pillar reads."""
    data = samples(n=5)[[0, 0, 1]]
    data.resistance_ohm[1, ..., 1:] *= 1.01  # x and y
    assert len(Columns.of(data, ALL).distinct()) == 3
    assert len(Columns.of(data, component_named("fz")).distinct()) == 2
    data = samples(n=5)[[0, 0, 1]]
    data.resistance_ohm[1, 2, 1, 0] *= 1.01
    dead = np.zeros((3, 3, 3), dtype=bool)
    dead[2, 1, 0] = True
    assert len(Columns.of(data, ALL).distinct()) == 3
    assert len(Columns.of(replace(data, dead=dead), ALL).distinct()) == 2


def test_loads_are_numbered_as_they_appear():
    force_n = np.array([[1.0, 2.0], [3.0, 4.0], [1.0, 2.0], [5.0, 6.0]])
    assert load_numbers(force_n).tolist() == [0, 1, 0, 2]


@pytest.mark.parametrize("known", [RESPONSE, None], ids=["response", "none"])
@pytest.mark.parametrize("noise", [0.0, 1e-3, 1e-2])
@pytest.mark.parametrize("n", [3, 10, 50, 1000])
@pytest.mark.parametrize("name", COMPONENTS)
def test_healthy_pillars_are_not_taken_for_stuck(known, noise, n, name):
    data = Columns.of(samples(n=n, noise=noise), component_named(name))
    assert without_stuck(data, model(known, component_named(name))) is data


@pytest.mark.parametrize("known", [RESPONSE, None], ids=["response", "none"])
@pytest.mark.parametrize(("n", "noise"), [(20, 0.0), (20, 1e-3), (50, 1e-2), (1000, 1e-2)])
@pytest.mark.parametrize("name", COMPONENTS)
def test_stuck_pillars_are_found_whatever_their_noise(known, noise, n, name):
    """Two of the 9 or 27; readings about another mean, ±1 Ω and the stated noise.

    1 % of noise hides from 20 samples whether a sheared pillar, which moves by 2 %, follows its loads.
    """
    component = component_named(name)
    data, generator = samples(n=n, noise=noise), np.random.default_rng(3)
    pillar = component.pillars[0]
    places = [(row, col, PILLARS.index(pillar)) for row, col in ((0, 1), (2, 2))]
    for place in places:
        ohm = 7000 + generator.uniform(-1, 1, n)
        data.resistance_ohm[:, *place] = ohm * (1 + noise * generator.standard_normal(n))
    masked = without_stuck(Columns.of(data, component), model(known, component))
    assert [tuple(place) for place in np.argwhere(masked.dead).tolist()] == places
    assert without_stuck(masked, model(known, component)) is masked


def test_a_unit_that_was_never_loaded_is_not_stuck():
    """Its pillar hardly moves because nothing moves it; a dead one that is stated stays so."""
    data = samples("z", n=100)
    dead = np.zeros((3, 3, 3), dtype=bool)
    dead[0, 0, 0] = True
    data.force_n[:, 1, 1] = 300.0
    data.resistance_ohm[:, 1, 1] = data.resistance_ohm[:, 1, 1].mean(axis=0)
    columns = Columns.of(replace(data, dead=dead), component_named("fz"))
    assert without_stuck(columns, None) is columns


def test_if_most_pillars_seem_stuck_it_is_the_expectation_that_is_wrong():
    """A response of a far softer sensor: refused elsewhere, for what it explains."""
    softer = replace(RESPONSE, influence_mm_per_n=-0.01 * RESPONSE.influence_mm_per_n)
    data = Columns.of(samples(n=100), ALL)
    assert without_stuck(data, model(softer, ALL)) is data


def test_forces_that_no_sensor_gives_are_named():
    data = samples(n=4)
    data.force_n[2, 1, 0, 2] = 1e300
    with pytest.raises(SampleError, match=r"force fz in row 1, col 0 of sample 2 is 1e\+300 N, must be"):
        force_columns(data.force_n, ALL)
    for ohm in (1e300, 1e-300):
        data.resistance_ohm[3, 0, 0, 1] = ohm
        with pytest.raises(SampleError, match=r"pillar x in row 0, col 0 of sample 3 is 1e[+-]300 Ω, must"):
            pillar_columns(data.resistance_ohm, ALL)


def test_range_becomes_minus_one_to_one_and_back():
    values = np.random.default_rng(0).uniform([-5.0, 1e3, 1e-6], [5.0, 1e6, 3e-6], (50, 3))
    scaling = Scaling.fitted(values)
    scaled = scaling.scale(values)
    np.testing.assert_allclose(scaled.min(axis=0), -1.0, rtol=1e-12)
    np.testing.assert_allclose(scaled.max(axis=0), 1.0, rtol=1e-12)
    np.testing.assert_allclose(scaling.unscale(scaled), values, rtol=1e-12)


@pytest.mark.parametrize("value", [0.0, 1e4, -3.7])
@pytest.mark.parametrize("jitter", [0.0, 1e-16])
def test_constant_column_becomes_zero_and_comes_back(value, jitter):
    """Rounding noise on a constant is not blown up to the full range."""
    values = value * (1 + jitter * np.random.default_rng(0).standard_normal((20, 1)))
    scaling = Scaling.fitted(values)
    assert not scaling.scale(values).any()
    np.testing.assert_allclose(scaling.unscale(np.full((1, 1), 5.0)), value, rtol=1e-14)

    tiny = Scaling.fitted(np.array([[0.0, 0.0], [1e-310, 2.0]]))  # too small to be divided by
    assert tiny.scale(np.array([[1.0, 1.0]])).tolist() == [[0.0, 0.0]]


def test_functions_find_what_suits_the_samples_and_refuse_in_one_line_what_they_cannot_take(monkeypatch):
    """``train(samples)`` alone trains; what is no argument is named with what to give."""
    monkeypatch.setattr("decoupler.evaluation.crossval.in_parallel", lambda jobs, progress: [f(*x) for f, *x in jobs])
    data, known = labelled(SENSOR, "xyz", 60, 0), response(SENSOR)
    one = replace(data, force_n=data.force_n * (0.0, 0.0, 1.0))
    assert suited_component(one) == "fz"
    quick = TrainingConfig(max_iterations=1)
    assert train(data, training=quick).component.name == "all"
    model = train(data, training=quick, response=known)
    assert model.network.feature == "inverse"
    assert all(set(fold.errors) == {"fz"} for fold in cross_validate(one, training=quick, folds=2))
    for wrong in (
        lambda: train(42),
        lambda: train(data, "all", quick),
        lambda: train(data, training=NetworkConfig()),
        lambda: evaluate(data, model),
        lambda: evaluate(model, data.force_n),
        lambda: cross_validate("data.nc"),
    ):
        with pytest.raises(ArgumentError, match=r"^\w+ is of type \w+, expected \w+: [^\n]*\.$"):
            wrong()
    with pytest.raises(DesignError, match="component='fw' is unknown; choose one of fz, fx, fy, all"):
        train(data, "fw")
