"""The trained thing: ohms in, newtons out, the same for one sample and for many."""

import subprocess
import sys

import numpy as np
import pytest

from decoupler import NetworkConfig, SampleError, TrainingConfig, train
from tests.decoupler.synthetic_sensor import labelled, sensor

SENSOR = sensor(2, 3)
DATA = labelled(SENSOR, "xyz", n_samples=101, seed=0)
FEW = TrainingConfig(max_iterations=3)


def test_what_is_no_scan_of_its_sensor_is_refused_and_what_it_does_not_take_does_no_harm():
    decoupler = train(DATA, "fz", NetworkConfig(hidden=3), FEW)
    for value in (np.nan, np.inf, -1.0, 0.0):
        R = DATA.resistance_ohm.copy()
        R[4:, 1, 2, 0] = value
        with pytest.raises(SampleError, match=r"pillar z in row 1, col 2 of sample 4 is .* must be finite and above 0"):
            decoupler.forces(R)
    with pytest.raises(SampleError, match=r"shape \(2, 3, 3\), expected \(n_samples, rows, cols, 3\)"):
        decoupler.forces(DATA.resistance_ohm[0])
    with pytest.raises(SampleError, match="of 3 × 2 units, the model's sensor has 2 × 3"):
        decoupler.forces(DATA.resistance_ohm.transpose(0, 2, 1, 3))
    assert decoupler.forces(DATA.resistance_ohm[:0]).shape == (0, 2, 3, 1)
    R = DATA.resistance_ohm.copy()
    R[..., 1:] = np.nan
    np.testing.assert_array_equal(decoupler.forces(R), decoupler.forces(DATA.resistance_ohm))


def test_using_a_model_loads_no_torch():
    """A live sensor starts in a fraction of a second; torch alone takes seconds."""
    code = "import sys, decoupler; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
