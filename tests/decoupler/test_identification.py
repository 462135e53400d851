"""Identification of a sensor from pairs: parameters, deviations that hold, and forces near what the readings allow."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dataset import DatasetSettings, simulate
from dataset.measurement import ReadingError
from decoupler import component_named, train
from decoupler.data.pairs import Pairs
from decoupler.twin import identify
from decoupler.twin.identification import readings_of
from decoupler.twin.posterior import without_each
from fem.array.closed_forms import layer_response
from geometry.design import Array, SensorDesign
from geometry.tolerances import usual_deviations, with_values
from tests.decoupler.synthetic_sensor import layer_sensitivities

DESIGN = SensorDesign(array=Array(rows=2, cols=3))
NOISE = 0.001
#: softer, higher and its pads off their place; and sensors outside the model, 3 to 7 tolerances off
OFF = {"rubber.young_mpa": 5.5, "unit.height_mm": 10.2, "pad.size_mm": 12.3, "pad.offset_x_mm": 0.4}
SENSORS = {
    "made": with_values(DESIGN, OFF),
    "pads": replace(DESIGN, pad=replace(DESIGN.pad, size_mm=10.0)),
    "pitch": replace(DESIGN, array=replace(DESIGN.array, pitch_mm=14.0)),
    "thickness": replace(DESIGN, unit=replace(DESIGN.unit, height_mm=11.0)),
    "rubber": with_values(DESIGN, {"rubber.young_mpa": 4.3, "rubber.poisson": 0.46}),
}


def settings(samples, seed, protocol="three-axis"):
    return DatasetSettings(
        protocol=protocol, samples=samples, seed=seed, noise=NOISE, gain_spread=0.1, offset_ohm=100.0, specimen=1
    )


@cache
def measured(name, samples, seed, protocol="three-axis"):
    """Samples of a sensor, each pillar with a gain and offset, that state the design as meant."""
    return replace(simulate(layer_response(SENSORS[name]), settings(samples, seed, protocol)).labels(), design=DESIGN)


@cache
def known():
    return layer_response(DESIGN), layer_sensitivities(DESIGN)


def identified(pairs):
    return identify(pairs, *known())


@cache
def twin_of(name, n):
    return identified(Pairs.of(measured(name, n, 3)))


def errors_n(model, test):
    return np.sqrt(np.mean((model.forces(test.resistance_ohm) - test.force_n) ** 2, axis=(0, 1, 2)))


def test_pairs_tell_the_parameters_and_bring_errors_near_those_of_the_true_response():
    """Few pairs decide little, many all: errors fall towards those of a decoder that is given the truth."""
    for name in ("rubber.young_mpa", "unit.height_mm", "pad.offset_x_mm"):
        mean, deviation = twin_of("made", 10).parameters[name]
        assert abs(mean - OFF[name]) < 3.5 * deviation
        assert deviation < 0.7 * usual_deviations(DESIGN)[name]  # the pairs have told something
    made, test = layer_response(SENSORS["made"]), measured("made", 200, 2)
    best = errors_n(train(simulate(made, settings(1000, 4)), "all", response=made), test)
    assert (errors_n(twin_of("made", 5).decoder, test) < 2.0 * best).all()
    assert (errors_n(twin_of("made", 100).decoder, test) < 1.15 * best).all()


@pytest.mark.parametrize(
    ("name", "n", "most"),
    [
        *[("made", 3, 0.8), ("made", 10, 0.8), ("made", 100, 0.8), ("pads", 10, 0.85), ("pads", 56, 0.85)],
        *[("pitch", 10, 0.85), ("thickness", 56, 0.85), ("rubber", 10, 0.85)],
    ],
)
def test_deviations_hold_on_a_sensor_unlike_the_design(name, n, most):
    test, model = measured(name, 200, 2), twin_of(name, n).decoder
    off = np.abs(model.forces(test.resistance_ohm) - test.force_n)
    one, two = model.half_widths(test.resistance_ohm)
    assert 0.6 < (off < one).mean() < most
    assert (off < two).mean() > 0.9


def test_a_pair_left_out_errs_as_if_the_others_alone_were_measured():
    """The formula of one fit beside fits to all other pairs; widths alone, which those estimate anew, may differ."""
    pairs = Pairs.of(measured("made", 10, 3))
    whole = readings_of(pairs, component_named("all"))
    error_ohm, covariance = without_each(twin_of("made", 10).posterior, whole, np.arange(2))
    for k in range(2):
        others = identified(pairs[np.delete(np.arange(10), k)]).posterior
        refitted = whole.resistance_ohm[k] - others.sensor.resistances(whole.force_n[[k]])[0]
        assert np.linalg.norm(error_ohm[k] - refitted) < 0.2 * np.linalg.norm(refitted)
        deviation = np.sqrt(covariance[k].diagonal() + (NOISE * whole.resistance_ohm[k]) ** 2)
        assert 0.5 < np.sqrt(np.mean((error_ohm[k] / deviation) ** 2)) < 2.0


def test_draws_read_as_the_pairs_do_whatever_the_offsets():
    """Gain and offset of a pillar are known together far better than each: draws must not mix them up."""
    samples = measured("made", 60, 3)
    offset_ohm = np.random.default_rng(0).uniform(0.0, 2e4, samples.resistance_ohm.shape[1:])
    pairs = Pairs.of(replace(samples, resistance_ohm=samples.resistance_ohm + offset_ohm))
    model, columns_ohm = identified(pairs).decoder, pairs.resistance_ohm.reshape(60, -1)
    errors = ReadingError(), ReadingError(noise=NOISE)
    of_draws, of_noise = (model.read_by(each).noise_variance(columns_ohm).mean() for each in errors)
    assert of_draws < 0.5 * of_noise


def test_a_pair_whose_load_was_another_is_trusted_less():
    """One of ten loads was twice what was written down: errors stay near those without that pair."""
    pairs, test = Pairs.of(measured("made", 10, 3)), measured("made", 200, 2)
    without = errors_n(identified(pairs[1:]).decoder, test)
    doubled = pairs.force_n * np.where(np.arange(10) == 0, 2.0, 1.0)[:, None, None, None]
    assert (errors_n(identified(replace(pairs, force_n=doubled)).decoder, test) < 1.5 * without).all()


def test_a_weight_on_a_plate_tells_its_sum():
    """A plate spreads a known weight over all pads in an unknown way; with it the parameters are known better."""
    pairs, plate = Pairs.of(measured("made", 3, 3)), Pairs.of(measured("made", 1, 5, "independent-fz"))
    total_n = plate.force_n[0, ..., 2].sum()
    even, unknown = np.zeros((1, 2, 3, 3)), np.zeros((7, 2, 3, 3))
    even[..., 2] = total_n / 6
    unknown[:6, ..., 2] = 0.5 * total_n / 6 * (np.zeros((6, 6)) + np.eye(6) - 1 / 6).reshape(6, 2, 3)
    unknown[6, ..., 2] = 0.01 * total_n / 6
    both = Pairs(
        resistance_ohm=np.concatenate([pairs.resistance_ohm, plate.resistance_ohm]),
        force_n=np.concatenate([pairs.force_n, even]),
        unknown_n=(*pairs.unknown_n, unknown),
        noise=NOISE,
    )
    alone, (young_mpa, together) = (
        each.parameters["rubber.young_mpa"] for each in (twin_of("made", 3), identified(both))
    )
    assert together < alone[1]
    assert abs(young_mpa - OFF["rubber.young_mpa"]) < 3.5 * together


def test_a_pillar_that_was_not_read_is_left_out():
    dead = np.zeros((2, 3, 3), dtype=bool)
    dead[1, 2, 0] = True
    model = identified(Pairs.of(replace(measured("made", 20, 3), dead=dead))).decoder
    test = measured("made", 100, 2)
    whole = model.forces(test.resistance_ohm)
    assert np.array_equal(model.forces(np.where(dead, np.nan, test.resistance_ohm)), whole)
    off = np.sqrt(np.mean((whole - test.force_n) ** 2, axis=0))
    assert off[0, 0, 2] < 0.5 * off[1, 2, 2]
