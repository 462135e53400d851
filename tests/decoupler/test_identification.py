"""Identification of a sensor from pairs: parameters, deviations that hold, and forces near what the readings allow."""

from dataclasses import replace

import numpy as np
import pytest

from dataset import DatasetSettings, Samples, simulate
from dataset.measurement import ReadingError
from decoupler import train
from decoupler.data.pairs import Pairs
from decoupler.twin import identify
from decoupler.twin.identification import readings_of
from decoupler.twin.posterior import predicted, without_each
from fem.array.closed_forms import layer_response
from fem.array.sensitivities import ResponseSensitivities
from geometry.design import Array, SensorDesign
from geometry.tolerances import RESISTIVITY, changed, usual_deviations, with_values

DESIGN = SensorDesign(array=Array(rows=2, cols=3))
NOISE = 0.001


@pytest.fixture(scope="module")
def response():
    return layer_response(DESIGN)


@pytest.fixture(scope="module")
def sensitivities():
    """Derivatives of the closed form, by central differences."""
    deviations = {name: sd for name, sd in usual_deviations(DESIGN).items() if name != RESISTIVITY}
    by = [
        (
            layer_response(changed(DESIGN, name, 0.1 * sd)).influence_mm_per_n
            - layer_response(changed(DESIGN, name, -0.1 * sd)).influence_mm_per_n
        )
        / (0.2 * sd)
        for name, sd in deviations.items()
    ]
    return ResponseSensitivities(
        design=DESIGN,
        parameters=tuple(deviations),
        deviation=np.array(list(deviations.values())),
        influence_mm_per_n=np.stack(by),
    )


@pytest.fixture(scope="module")
def made():
    """Another sensor than the design: softer, higher, its pads off their place, each pillar with a gain and offset."""
    values = {"rubber.young_mpa": 5.5, "unit.height_mm": 10.2, "pad.size_mm": 12.3, "pad.offset_x_mm": 0.4}
    return layer_response(with_values(DESIGN, values))


def measured(truth, samples: int, seed: int, protocol: str = "three-axis") -> Samples:
    settings = DatasetSettings(
        protocol=protocol, samples=samples, seed=seed, noise=NOISE, gain_spread=0.1, offset_ohm=100.0, specimen=1
    )
    return replace(simulate(truth, settings).labels(), design=DESIGN)


def errors_n(model, test: Samples):
    return np.sqrt(np.mean((model.forces(test.resistance_ohm) - test.force_n) ** 2, axis=(0, 1, 2)))


def test_ten_pairs_tell_the_parameters_within_their_deviations(response, sensitivities, made):
    twin = identify(Pairs.of(measured(made, 10, 3)), response, sensitivities)
    found = twin.parameters
    for name, value in {"rubber.young_mpa": 5.5, "unit.height_mm": 10.2, "pad.offset_x_mm": 0.4}.items():
        mean, deviation = found[name]
        assert abs(mean - value) < 3.5 * deviation
        assert deviation < 0.7 * usual_deviations(DESIGN)[name]  # the pairs have told something


def test_pairs_bring_errors_near_those_of_the_true_response(response, sensitivities, made):
    """Few pairs decide little, many all: errors fall towards those of a decoder that is given the truth."""
    test = measured(made, 200, 2)
    pairs = Pairs.of(measured(made, 100, 3))
    few, many = (identify(pairs[:n], response, sensitivities).decoder for n in (5, 100))
    settings = DatasetSettings(
        protocol="three-axis", samples=1000, seed=4, noise=NOISE, gain_spread=0.1, offset_ohm=100.0, specimen=1
    )
    best = errors_n(train(simulate(made, settings), "all", response=made), test)
    assert (errors_n(few, test) < 2.0 * best).all()
    assert (errors_n(many, test) < 1.15 * best).all()


@pytest.mark.parametrize("n", [3, 10, 50])
def test_deviations_hold_on_a_sensor_unlike_the_design(response, sensitivities, made, n):
    test = measured(made, 300, 2)
    model = identify(Pairs.of(measured(made, n, 3)), response, sensitivities).decoder
    off = np.abs(model.forces(test.resistance_ohm) - test.force_n)
    one, two = model.half_widths(test.resistance_ohm)
    assert 0.6 < (off < one).mean() < 0.8
    assert (off < two).mean() > 0.9


#: sensors outside the model, 3 to 7 tolerances off: other pads, another mould and another rubber than were stated
OTHERS = {
    "pads": replace(DESIGN, pad=replace(DESIGN.pad, size_mm=10.0)),
    "pitch": replace(DESIGN, array=replace(DESIGN.array, pitch_mm=14.0)),
    "thickness": replace(DESIGN, unit=replace(DESIGN.unit, height_mm=11.0)),
    "rubber": with_values(DESIGN, {"rubber.young_mpa": 4.3, "rubber.poisson": 0.46}),
}


@pytest.mark.parametrize("n", [10, 56])
@pytest.mark.parametrize("name", OTHERS)
def test_deviations_hold_where_the_design_is_another_sensor(response, sensitivities, name, n):
    other = layer_response(OTHERS[name])
    test = measured(other, 100, 2)
    model = identify(Pairs.of(measured(other, n, 3)), response, sensitivities).decoder
    off = np.abs(model.forces(test.resistance_ohm) - test.force_n)
    one, two = model.half_widths(test.resistance_ohm)
    print(name, n, "pairs: within", (off < one).mean(), (off < two).mean())
    assert 0.6 < (off < one).mean() < 0.85
    assert (off < two).mean() > 0.9


def test_a_pair_left_out_errs_as_if_the_others_alone_were_measured(response, sensitivities, made):
    """The formula of one fit beside fits to all other pairs; widths alone, which those estimate anew, may differ."""
    pairs = Pairs.of(measured(made, 12, 3))
    whole = readings_of(pairs, [0, 1, 2], [0, 1, 2])
    found = identify(pairs, response, sensitivities).posterior
    error_ohm, covariance = without_each(found, whole, np.arange(3))
    for k in range(3):
        others = identify(pairs[np.delete(np.arange(12), k)], response, sensitivities).posterior
        refitted = whole.resistance_ohm[k] - predicted(others, whole.force_n[[k]])[0]
        assert np.linalg.norm(error_ohm[k] - refitted) < 0.2 * np.linalg.norm(refitted)
        deviation = np.sqrt(covariance[k].diagonal() + (NOISE * whole.resistance_ohm[k]) ** 2)
        assert 0.5 < np.sqrt(np.mean((error_ohm[k] / deviation) ** 2)) < 2.0


def test_draws_read_as_the_pairs_do_whatever_the_offsets(response, sensitivities, made):
    """Gain and offset of a pillar are known together far better than each: draws must not mix them up."""
    samples = measured(made, 60, 3)
    offset_ohm = np.random.default_rng(0).uniform(0.0, 2e4, samples.resistance_ohm.shape[1:])
    pairs = Pairs.of(replace(samples, resistance_ohm=samples.resistance_ohm + offset_ohm))
    model = identify(pairs, response, sensitivities).decoder
    columns_ohm = pairs.resistance_ohm.reshape(60, -1)
    errors = ReadingError(), ReadingError(noise=NOISE)
    of_draws, of_noise = (model.noise_variance(columns_ohm, each).mean() for each in errors)
    assert of_draws < 0.5 * of_noise


def test_a_pair_whose_load_was_another_is_trusted_less(response, sensitivities, made):
    """One of ten loads was twice what was written down: errors stay near those without that pair."""
    pairs, test = Pairs.of(measured(made, 10, 3)), measured(made, 200, 2)
    without = errors_n(identify(pairs[1:], response, sensitivities).decoder, test)
    pairs.force_n[0] *= 2.0
    assert (errors_n(identify(pairs, response, sensitivities).decoder, test) < 1.5 * without).all()


def test_without_a_design_many_pairs_decide_everything(made):
    """R = g |d + B F|² + o is all that is assumed: noise-free pairs of it determine the inverse."""
    exact = simulate(made, DatasetSettings(protocol="three-axis", samples=400, seed=1))
    model = identify(Pairs.of(exact[:300])).decoder
    assert model.design is None
    assert (errors_n(model, exact[300:]) < 5e-4 * exact.force_n.max(axis=(0, 1, 2))).all()


def test_a_weight_on_a_plate_tells_its_sum(response, sensitivities, made):
    """A plate spreads a known weight over all pads in an unknown way; with it the parameters are known better."""
    pairs = Pairs.of(measured(made, 3, 3))
    plate = Pairs.of(measured(made, 1, 5, "independent-fz"))
    total_n = plate.force_n[0, ..., 2].sum()
    shares = np.zeros((6, 6)) + np.eye(6) - 1 / 6
    unknown = np.zeros((7, 2, 3, 3))
    unknown[:6, ..., 2] = 0.5 * total_n / 6 * shares.reshape(6, 2, 3)
    unknown[6, ..., 2] = 0.01 * total_n / 6
    even = np.zeros((1, 2, 3, 3))
    even[..., 2] = total_n / 6
    plate = replace(plate, force_n=even, unknown_n=(unknown,))
    both = Pairs(
        resistance_ohm=np.concatenate([pairs.resistance_ohm, plate.resistance_ohm]),
        force_n=np.concatenate([pairs.force_n, plate.force_n]),
        unknown_n=(*pairs.unknown_n, *plate.unknown_n),
        noise=NOISE,
    )
    alone, together = (identify(given, response, sensitivities) for given in (pairs, both))
    name = "rubber.young_mpa"
    assert together.parameters[name][1] < alone.parameters[name][1]
    assert abs(together.parameters[name][0] - 5.5) < 3.5 * together.parameters[name][1]


def test_a_pillar_that_was_not_read_is_left_out(response, sensitivities, made):
    pairs = Pairs.of(measured(made, 20, 3))
    pairs.resistance_ohm[:, 1, 2, 0] = np.nan
    model = identify(pairs, response, sensitivities).decoder
    test = measured(made, 100, 2)
    whole = model.forces(test.resistance_ohm)
    broken = test.resistance_ohm.copy()
    broken[:, 1, 2, 0] = np.nan
    assert np.array_equal(model.forces(broken), whole)
    off = np.sqrt(np.mean((whole - test.force_n) ** 2, axis=0))
    assert off[0, 0, 2] < 0.5 * off[1, 2, 2]
