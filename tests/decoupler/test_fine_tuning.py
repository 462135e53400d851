"""From the sensor as designed to another one: what pairs buy, and what calibration finds."""

from dataclasses import replace

import numpy as np
import pytest

from decoupler import NetworkConfig, SampleError, TrainingConfig, evaluate, fine_tune, train
from decoupler.data.columns import Calibration
from tests.decoupler.synthetic_sensor import labelled, response, sensor, split

SENSOR = sensor(2, 3)
RESPONSE = response(SENSOR)
TRAIN, REST = split(labelled(SENSOR, "xyz", n_samples=500, seed=0), 300)
GAIN = np.random.default_rng(1).uniform(0.8, 1.2, (2, 3, 3))
OFFSET_OHM = np.random.default_rng(2).normal(0.0, 200.0, (2, 3, 3))
NOISE = 1e-3


def measured(data):
    noise = np.random.default_rng(3).standard_normal(data.resistance_ohm.shape)
    return replace(data, resistance_ohm=(GAIN * data.resistance_ohm + OFFSET_OHM) * (1 + NOISE * noise), noise=NOISE)


PAIRS, TEST = split(measured(REST), 100)


def test_calibration_finds_gain_and_offset():
    """Fitted to exact readings: priors pull by (noise/spread)² of what little the resistances leave open."""
    modelled = REST.resistance_ohm.reshape(200, -1)
    found = Calibration.fitted(GAIN.reshape(-1) * modelled + OFFSET_OHM.reshape(-1), modelled, noise=0.0)
    np.testing.assert_allclose(found.gain, GAIN.reshape(-1), atol=1e-3)
    np.testing.assert_allclose(
        found.modelled(GAIN.reshape(-1) * modelled + OFFSET_OHM.reshape(-1)), modelled, rtol=1e-3
    )


def test_a_sensor_as_designed_keeps_its_calibration():
    modelled = REST.resistance_ohm.reshape(200, -1)
    found = Calibration.fitted(modelled, modelled, noise=0.0)
    np.testing.assert_array_equal(found.gain, 1.0)
    np.testing.assert_array_equal(found.offset_ohm, 0.0)


@pytest.mark.parametrize("feature", ["inverse", "root"])
def test_pairs_bring_the_error_down(feature):
    """Untouched the model is useless; one pair helps, and a hundred bring back what it could do on its own sensor."""
    noisy = replace(TRAIN, noise=NOISE)
    model = train(noisy, "all", NetworkConfig(hidden=6, feature=feature), TrainingConfig(), response=RESPONSE)
    own = evaluate(model, REST)
    before = evaluate(model, TEST)
    one = evaluate(fine_tune(model, PAIRS[:1], RESPONSE), TEST)
    all_ = evaluate(fine_tune(model, PAIRS, RESPONSE), TEST)
    for name in before:
        assert one[name].rmse_n < before[name].rmse_n / 3
        assert all_[name].rmse_n < before[name].rmse_n / 10
        assert all_[name].rmse_n < own[name].rmse_n + 6.0  # newtons: what 0.1 % noise costs on this sensor


def test_pairs_fewer_than_weights_do_not_spoil_the_output_layer():
    """Any ten pairs can be met by an output layer of 19 inputs; it is taken only if it foretells pairs left out."""
    network = NetworkConfig(hidden=18, net="plain", feature="resistance")
    model = train(TRAIN, "all", network, TrainingConfig(trainer="lm", max_iterations=20), response=RESPONSE)
    nine, ten = (evaluate(fine_tune(model, PAIRS[:n], RESPONSE), TEST) for n in (9, 10))
    for name in nine:
        assert ten[name].rmse_n < 1.05 * nine[name].rmse_n  # one pair more moves calibrations a little


def test_uncertainty_grows_with_few_pairs():
    model = train(TRAIN, "all", NetworkConfig(hidden=6, feature="inverse"), TrainingConfig(), response=RESPONSE)
    few, many = (fine_tune(model, PAIRS[:n], RESPONSE) for n in (2, 100))
    assert few.half_widths(TEST.resistance_ohm)[0].mean() > many.half_widths(TEST.resistance_ohm)[0].mean()
    inside = np.abs(many.forces(TEST.resistance_ohm) - TEST.force_n) <= many.half_widths(TEST.resistance_ohm)[0]
    assert 0.6 < inside.mean() < 0.76  # 1800 forces, a hundred at a time from one load: 68 % to a few percent


def test_pairs_given_ten_times_are_ten_times_the_same():
    model = train(TRAIN, "all", NetworkConfig(hidden=6, feature="inverse"), TrainingConfig(), response=RESPONSE)
    few = PAIRS[:12]
    once, often = (fine_tune(model, few[np.tile(np.arange(12), k)], RESPONSE) for k in (1, 10))
    R = TEST.resistance_ohm
    assert np.array_equal(once.forces(R), often.forces(R))
    assert np.array_equal(once.half_widths(R), often.half_widths(R))


@pytest.mark.parametrize("n", [5, 100])
def test_a_pillar_that_has_come_to_be_stuck_is_refused_by_name(n):
    """Its gain would be nearly 0 and whatever it reads a wild force; one that the model does not look at may be so."""
    config = NetworkConfig(hidden=6, feature="inverse")
    model = train(TRAIN, "all", config, TrainingConfig(), response=RESPONSE)
    stuck = PAIRS[np.arange(n)]
    stuck.resistance_ohm[:, 1, 2, 0] = 9000.0
    with pytest.raises(SampleError, match=r"pillar 1,2,z does not follow .* name 1,2,z among their dead_pillars"):
        fine_tune(model, stuck, RESPONSE)
    dead = np.zeros((2, 3, 3), dtype=bool)
    dead[1, 2, 0] = True
    masked = train(replace(TRAIN, dead=dead), "all", config, TrainingConfig(), response=RESPONSE)
    assert np.isfinite(fine_tune(masked, stuck, RESPONSE).forces(TEST.resistance_ohm)).all()


def test_what_the_model_came_from_is_kept():
    model = train(TRAIN, "all", NetworkConfig(hidden=2, feature="inverse"), TrainingConfig(), response=RESPONSE)
    tuned = fine_tune(model, PAIRS, None)  # it holds the response itself
    assert tuned.made_from["data_hash"] == TRAIN.content_hash
    assert tuned.made_from["fine_tuned_on"] == PAIRS.content_hash
    assert tuned.made_from["recipe"] != model.made_from["recipe"]


def test_without_a_response_it_is_refused():
    model = train(TRAIN, "all", NetworkConfig(hidden=2), TrainingConfig(max_iterations=2))
    with pytest.raises(SampleError, match="needs the array's response"):
        fine_tune(model, PAIRS, None)


def test_only_a_model_of_one_sensor_is_fine_tuned():
    """Trained on the sensor as designed, noise and all, it may be given a calibration; otherwise it knows the gains."""
    network, quick = NetworkConfig(hidden=4, feature="inverse"), TrainingConfig(max_iterations=2)
    noisy = NOISE * np.random.default_rng(4).standard_normal(TRAIN.resistance_ohm.shape)
    designed = replace(TRAIN, resistance_ohm=TRAIN.resistance_ohm * (1 + noisy), noise=NOISE)
    model = train(designed, "all", network, quick, response=RESPONSE)
    assert not model.is_fine_tuned
    assert fine_tune(model, PAIRS[:1], RESPONSE).is_fine_tuned
    own = train(measured(TRAIN), "all", network, quick, response=RESPONSE)
    assert own.is_fine_tuned
