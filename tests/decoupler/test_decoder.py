"""What a decoder refuses, what rest is, and that it loads no torch."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from dataset import measured
from decoupler import NetworkConfig, SampleError, TrainingConfig, train, write_model
from decoupler.data.columns import Resting
from tests.decoupler.synthetic_sensor import labelled, response, sensor

SENSOR = sensor(2, 3)
RNG = np.random.default_rng(0)
EXACT = labelled(SENSOR, "z", n_samples=300, seed=0)
DATA = replace(EXACT, resistance_ohm=measured(EXACT.resistance_ohm, 0.0, 12, RNG), bits=12)


@pytest.fixture(scope="module")
def model():
    return train(DATA, "fz", NetworkConfig(hidden=4, feature="inverse"), TrainingConfig(), response=response(SENSOR))


def test_what_is_no_scan_of_its_sensor_is_refused_and_what_it_does_not_take_does_no_harm(model):
    R = DATA.resistance_ohm.copy()
    R[4:, 1, 2, 0] = -1.0
    for ohms, said in (
        (R, "resistance_ohm is -1.0 at sample 4, row 1, col 2, pillar z; it must be finite, 1e-09 to"),
        (R[0], r"shape \(2, 3, 3\), expected \(n_samples, rows, cols, 3\)"),
        (R[:4].transpose(0, 2, 1, 3), "of 3 × 2 units, the model's sensor has 2 × 3"),
    ):
        with pytest.raises(SampleError, match=said):
            model.forces(ohms)
    assert model.forces(R[:0]).shape == (0, 2, 3, 1)
    R = DATA.resistance_ohm.copy()
    R[..., 1:] = np.nan
    np.testing.assert_array_equal(model.forces(R), model.forces(DATA.resistance_ohm))


def test_a_sensor_at_rest_reads_nothing_though_each_pillar_is_half_a_step_off(model):
    """10 kΩ before 10 kΩ is the worst place, between two counts. The calibration of 300 samples leaves a fifth.

    Where most of a scan is loaded, none of it is taken to rest.
    """
    rest_ohm = np.full((1, 2, 3, 3), 1e4)
    read_ohm = measured(rest_ohm, 0.0, 12, RNG)
    assert np.abs(read_ohm - rest_ohm).min() > 4.8
    front = model.front
    plain = replace(model, front=replace(front, resting=Resting.read_with(front.resting.rest_ohm, None)))
    assert np.abs(model.forces(read_ohm)).max() < 0.2 * np.abs(plain.forces(read_ohm)).max()
    read_ohm[:, 0] *= 0.95
    read_ohm[:, 1, 0] *= 0.95
    np.testing.assert_array_equal(model.forces(read_ohm), plain.forces(read_ohm))


def test_using_a_model_loads_no_torch_and_nothing_that_solves(model, tmp_path):
    """A live sensor starts in a fraction of a second; torch alone takes seconds."""
    write_model(model, tmp_path / "model.safetensors")
    code = (
        "import sys, pathlib, tripillar; tripillar.read_model(pathlib.Path(sys.argv[1])); "
        "sys.exit(bool({'torch', 'skfem', 'fem'} & {name.split('.')[0] for name in sys.modules}))"
    )
    arguments = [sys.executable, "-c", code, tmp_path / "model.safetensors"]
    assert subprocess.run(arguments, check=False).returncode == 0
