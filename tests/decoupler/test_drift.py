"""Drifts of the readings: what a design states is weighed against the loads and carried into every deviation."""

from dataclasses import replace

import numpy as np
import pytest

from dataset import DatasetSettings, simulate
from dataset.samples import joined
from decoupler import SampleError, component_named, train
from decoupler.data.columns import force_columns
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model_file import require_same_sensor
from geometry.design import Electrics
from tests.decoupler.synthetic_sensor import response, sensor

DRIFTS = {"drift": 0.005, "drift_tilt": 0.005, "drift_pillar": 0.002, "drift_offset_ohm": 50.0}
SENSOR = sensor(3, 3)
PLAIN = response(SENSOR)
STATED = replace(PLAIN, design=replace(SENSOR, electrics=Electrics(**DRIFTS)))
ALL = component_named("all")
NET = np.tile([[0.0], [0.0], [1.0]], (9, 1))  #: weights of the net Fz


def samples(own, n, seed, **drifts):
    settings = DatasetSettings(protocol="three-axis", samples=n, seed=seed, noise=1e-3, bits=12, **drifts)
    return simulate(own, settings).labels()


@pytest.fixture(scope="module")
def test_data():
    return samples(STATED, 600, 2, **DRIFTS)


@pytest.fixture(scope="module")
def model():
    return train(samples(STATED, 1000, 1), response=STATED)


def least_net_deviation(data):
    """Of the net Fz [N], of the linear-Gaussian posterior about each load: C − C Jᵀ (J C Jᵀ + Σ)⁻¹ J C."""
    forward = SensorModel.of(PLAIN, ALL)
    C = np.cov(force_columns(samples(PLAIN, 2000, 3).force_n, ALL).T)
    variance = []
    for force_n in force_columns(data.force_n, ALL)[:200, None]:
        length, J = forward.jacobian(force_n)
        ohm = forward.ohm_per_mm2 * length**2
        J = (2.0 * ohm / length)[0, :, None] * J[0]
        shared = data.errors.shared(ohm, *data.shape)[0]
        S = J @ C @ J.T + np.diag(data.errors.deviation(ohm)[0] ** 2) + shared @ shared.T
        posterior = C - C @ J.T @ np.linalg.solve(S, J @ C)
        variance.append((NET.T @ posterior @ NET).item())
    return np.sqrt(np.mean(variance))


def test_deviations_hold_the_net_force_and_a_decoder_that_knows_no_drift_is_surer_and_wrong(model, test_data):
    """Data without drifts, a design that states them: few errors of the net force are avoidable, to a tenth.

    Of the other decoder it errs by several of its deviations, and no load test sees it: these are readings of a load.
    """
    surer = train(samples(PLAIN, 1000, 1), response=PLAIN)
    net_n, deviation = [], []
    for one in (model, surer):
        error_n = (one.forces(test_data.resistance_ohm) - test_data.force_n).reshape(len(test_data), -1)
        net_n.append((error_n @ NET)[:, 0])
        deviation.append(np.sqrt(one.deviations(test_data.resistance_ohm, NET)[1][:, 0, 0]))
    assert np.mean(np.abs(net_n[0]) <= 2.0 * deviation[0]) >= 0.92
    size, stated = (np.sqrt(np.mean(np.square(each), axis=1)) for each in (net_n, deviation))
    assert size[0] < min(1.1 * least_net_deviation(test_data), size[1])
    assert stated[1] < 0.3 * size[1]
    assert stated[0] > 0.8 * size[0]
    assert np.greater(*model.consistency(test_data.resistance_ohm)).mean() <= 0.01


def test_a_model_knows_the_drifts_and_takes_data_of_a_design_that_states_others(model, test_data):
    assert model.errors == test_data.errors
    require_same_sensor(model, samples(PLAIN, 2, 0), "model", "data")
    with pytest.raises(SampleError, match="another drift"):
        joined([samples(PLAIN, 2, 0), samples(PLAIN, 2, 0, drift=0.01)])
