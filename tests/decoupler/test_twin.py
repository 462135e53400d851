"""A sensor from pairs: parameters, deviations that hold, the load to measure next, the twin's file and its samples."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.errors import DesignError, FileFormatError
from common.storage.seal import BLANK, MARK, sealed
from dataset import DatasetSettings, simulate
from dataset.measurement import ReadingError
from dataset.simulation import BLOCK
from decoupler import train
from decoupler.data.pairs import Pairs
from decoupler.model_file import require_same_sensor, write_model
from decoupler.twin import identify, read_twin, simulate_twin, write_twin
from decoupler.twin.expectation import Expectation
from decoupler.twin.identification import readings_of
from decoupler.twin.next_load import KITCHEN, Knowledge, as_columns, choose, loads_at_hand
from decoupler.twin.posterior import without_each
from fem.array.closed_forms import layer_response
from geometry.design import Array, SensorDesign
from geometry.design_file import read_design, write_design
from geometry.layout import pillar_volumes
from geometry.tolerances import usual_deviations, with_values
from tests.decoupler.synthetic_sensor import ALL, layer_sensitivities, response, sensor, softness

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


def asked(samples, seed, protocol="three-axis"):
    read = {"noise": NOISE, "gain_spread": 0.1, "offset_ohm": 100.0, "specimen": 1}
    return DatasetSettings(protocol=protocol, samples=samples, seed=seed, **read)


@cache
def measured(name, samples, seed, protocol="three-axis"):
    """Samples of a sensor, each pillar with a gain and offset, that state the design as meant."""
    return replace(simulate(layer_response(SENSORS[name]), asked(samples, seed, protocol)).labels(), design=DESIGN)


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
    best = errors_n(train(simulate(made, asked(1000, 4)), "all", response=made), test)
    assert (errors_n(twin_of("made", 5).decoder, test) < 2.0 * best).all()
    assert (errors_n(twin_of("made", 100).decoder, test) < 1.15 * best).all()


TOLD = [("made", 3), ("made", 10), ("made", 100), ("pads", 10), ("pads", 56), ("pitch", 10), ("rubber", 10)]


@pytest.mark.parametrize(("name", "n"), [*TOLD, ("thickness", 56)])
def test_deviations_hold_on_a_sensor_unlike_the_design(name, n):
    test, model = measured(name, 200, 2), twin_of(name, n).decoder
    off = np.abs(model.forces(test.resistance_ohm) - test.force_n)
    one, two = model.half_widths(test.resistance_ohm)
    assert 0.65 < (off < one).mean() < 0.78  # errors of one sensor go together
    assert (off < two).mean() > 0.93


def test_a_pair_left_out_errs_as_if_the_others_alone_were_measured():
    """The formula of one fit beside fits to all other pairs; widths alone, which those estimate anew, may differ."""
    pairs = Pairs.of(measured("made", 10, 3))
    whole = readings_of(pairs, ALL)
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
    ohms, force_n = np.concatenate([pairs.resistance_ohm, plate.resistance_ohm]), np.concatenate([pairs.force_n, even])
    both = Pairs(resistance_ohm=ohms, force_n=force_n, unknown_n=(*pairs.unknown_n, unknown), noise=NOISE)
    alone, (young_mpa, together) = twin_of("made", 3), identified(both).parameters["rubber.young_mpa"]
    assert together < alone.parameters["rubber.young_mpa"][1]
    assert abs(young_mpa - OFF["rubber.young_mpa"]) < 3.5 * together


def test_a_pillar_that_was_not_read_is_left_out():
    dead = np.zeros((2, 3, 3), dtype=bool)
    dead[1, 2, 0] = True
    model, test = identified(Pairs.of(replace(measured("made", 20, 3), dead=dead))).decoder, measured("made", 100, 2)
    whole = model.forces(test.resistance_ohm)
    assert np.array_equal(model.forces(np.where(dead, np.nan, test.resistance_ohm)), whole)
    off = np.sqrt(np.mean((whole - test.force_n) ** 2, axis=0))
    assert off[0, 0, 2] < 0.5 * off[1, 2, 2]


NINE = sensor(3, 3)
EXPECTED = Expectation.of(response(NINE), softness(NINE), ALL)
BEFORE = Knowledge.before(EXPECTED, EXPECTED.mean(), ReadingError(noise=1e-3, bits=12))
LOADS = {load.name: as_columns(load, ALL) for load in loads_at_hand(KITCHEN, NINE)}
USUAL_N = np.random.default_rng(0).uniform(0.0, 1.0, (30, 27)) * np.tile([140.0, 140.0, 700.0], 9)


def test_pairs_one_by_one_are_pairs_at_once():
    """The covariance after two pairs is (1 + Σ Hᵀ Σ⁻¹ H)⁻¹, whatever their order."""
    loads = [LOADS["15kg on 0 1"][0], LOADS["string 3kg along x, 15kg on 1 0"][0]]
    precision = np.eye(len(BEFORE.covariance))
    for force_n in loads:
        H, _, deviation = BEFORE.derivatives(force_n)
        precision += (H / deviation[:, None] ** 2).T @ H
    exact = np.zeros((0, 27))
    after = BEFORE.after(loads[1], exact).after(loads[0], exact)
    assert after.covariance == pytest.approx(np.linalg.inv(precision), rel=1e-8, abs=1e-8)


def test_derivatives_are_those_of_the_readings():
    """By the rubber's modulus, the resistivity, a gain, an offset and a force, against differences."""
    force_n, state, step = USUAL_N[0], BEFORE.state, 1e-5
    by_unknown, by_force, _ = BEFORE.derivatives(force_n)
    own, shared = np.zeros((2, *state.own.shape)), np.zeros((2, len(state.shared)))
    own[[0, 1], 0, [0, 1]] = shared[[0, 1], [0, 1]] = step
    moved = [replace(state, shared=each) for each in shared] + [replace(state, own=each) for each in own]
    pressed = [(other, force_n) for other in moved] + [(state, force_n + step * np.eye(27)[0])]
    here, *there = (EXPECTED.sensor(each).resistances(given[None])[0] for each, given in [(state, force_n), *pressed])
    derivatives = [*by_unknown[:, [0, 1, 2, 29]].T, by_force[:, 0]]
    for derivative, ohms, error in zip(derivatives, there, [1e-2] * 4 + [1e-4], strict=True):
        assert derivative == pytest.approx((ohms - here) / step, rel=1e-3, abs=error)


def test_what_is_not_known_of_a_load_tells_nothing_and_chosen_loads_tell_more_than_random_ones():
    """Five chosen ones leave a smaller expected error than any of ten random fives; none is chosen twice."""
    T, (force_n, unknown_n) = BEFORE.error_matrix(USUAL_N), LOADS["60kg on 1 1"]
    errors = [np.sum(T * BEFORE.after(force_n, times * unknown_n).covariance) for times in (0.0, 1.0, 100.0)]
    assert errors[0] < errors[1] < errors[2] < np.sum(T * BEFORE.covariance)
    candidates = list(LOADS.values())
    numbers, errors = choose(BEFORE, candidates, USUAL_N, 5)
    assert len(set(numbers)) == 5
    assert errors == sorted(errors, reverse=True)
    for seed in range(10):
        known = BEFORE
        for number in np.random.default_rng(seed).choice(len(candidates), 5, replace=False):
            known = known.after(*candidates[number])
        assert np.sqrt(np.sum(T * known.covariance)) > errors[-1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("twin")
    write_model(twin_of("made", 20).decoder, path / "own.safetensors")
    write_twin(twin_of("made", 20), path / "twin.toml", path / "own.safetensors")
    return path


def test_a_twin_is_a_design_at_its_most_probable_values(folder):
    """People read in it what was found; what is computed with is the design and the decoder that it names."""
    twin, design, whole = read_twin(folder / "twin.toml"), read_design(folder / "twin.toml"), twin_of("made", 20)
    assert twin.design == design
    told, found = twin.told, whole.posterior
    for name, (value, deviation) in whole.parameters.items():
        assert told["parameters"][name] == pytest.approx([value, deviation], rel=1e-2)
    assert design.unit.height_mm == pytest.approx(whole.parameters["unit.height_mm"][0])
    assert np.array(list(told["correlations"].values())).diagonal() == pytest.approx(1.0)
    for name in ("gain", "gain_deviation", "offset_ohm", "offset_deviation_ohm"):
        by_pillar = np.stack([told[name][pillar] for pillar in "zxy"], axis=-1)
        assert by_pillar.ravel() == pytest.approx(getattr(found, name), rel=1e-5)
    assert (found.gain_deviation < found.expected.widths.gain).all()  # the pairs have told something
    c = found.gain * np.tile(design.resistivity_ohm_mm / pillar_volumes(design.unit), 6)
    assert np.allclose(c, twin.read_decoder().inverse.forward.ohm_per_mm2, rtol=1e-3)  # volumes to first order
    write_design(DESIGN, folder / "design.toml")
    assert read_twin(folder / "design.toml") is None


def test_samples_of_a_twin_show_what_is_unknown(folder):
    """The true sensor reads as far from the most probable one as the draws do, some per mille."""
    twin = read_twin(folder / "twin.toml")
    response, many = layer_response(twin.design), DatasetSettings(protocol="three-axis", samples=BLOCK + 40, seed=5)
    samples, decoder = simulate_twin(twin, response, many), twin.read_decoder()
    require_same_sensor(decoder, samples, folder / "own.safetensors", folder / "samples.nc")
    apart, off = (
        data.resistance_ohm.reshape(len(data), -1)
        / decoder.inverse.forward.resistances(data.force_n.reshape(len(data), -1))
        - 1.0
        for data in (samples, measured("made", 200, 3))
    )
    assert 0 < np.sqrt(np.mean(apart**2)) < 0.02
    assert np.sqrt(np.mean(off**2)) < 3 * np.sqrt(np.mean(apart**2) + 0.001**2)
    part = simulate_twin(twin, response, many, numbers=range(BLOCK, BLOCK + 40))
    few = simulate_twin(twin, response, replace(many, samples=30))  # fewer than sensors
    for each, same in ((part, samples[BLOCK:]), (few, samples[:30])):  # draws are in single precision
        assert each.resistance_ohm == pytest.approx(same.resistance_ohm, rel=1e-6)
    with pytest.raises(DesignError, match=r"gain_spread=0\.1: a twin has its own"):
        simulate_twin(twin, response, replace(many, gain_spread=0.1))


@settings(max_examples=40, deadline=None)
@given(at=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7), cut=st.booleans())
def test_a_damaged_twin_is_refused(folder, at, bit, cut):
    """A flipped bit anywhere, and a file that lost its end, but for its first line, which states the hash."""
    whole = (folder / "twin.toml").read_bytes()
    place = max(int(at * len(whole)), cut * (whole.index(b"\n") + 1))
    other = whole[:place] if cut else whole[:place] + bytes([whole[place] ^ 1 << bit]) + whole[place + 1 :]
    (folder / "damaged.toml").write_bytes(other)
    with pytest.raises((DesignError, FileFormatError)):
        read_twin(folder / "damaged.toml")


def test_another_decoder_is_refused(folder, tmp_path):
    text = (folder / "twin.toml").read_bytes()
    (tmp_path / "twin.toml").write_bytes(text)
    decoder = read_twin(folder / "twin.toml").read_decoder()
    write_model(replace(decoder, made_from={"other": "pairs"}), tmp_path / "own.safetensors")
    with pytest.raises(DesignError, match="not the decoder that the twin was written with"):
        read_twin(tmp_path / "twin.toml").read_decoder()
    none = re.sub(MARK + b"[0-9a-f]{64}", BLANK, text.replace(b"decoder_hash =", b"# decoder_hash ="))
    (tmp_path / "twin.toml").write_bytes(b"".join(sealed(none)))  # as if it had been written so
    with pytest.raises(DesignError, match=r"\[twin\] names no decoder"):
        read_twin(tmp_path / "twin.toml")
