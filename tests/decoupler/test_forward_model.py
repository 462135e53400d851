"""The forward model against the dataset's own lengths, and its derivatives against differences."""

import numpy as np
import pytest

from decoupler import component_named
from decoupler.data.columns import force_columns, pillar_columns
from decoupler.inverse.forward_model import ForwardModel
from tests.decoupler.synthetic_sensor import labelled, response, sensor

SENSOR = sensor(2, 3)
RESPONSE = response(SENSOR)


@pytest.mark.parametrize(("name", "axes"), [("fx", "x"), ("fy", "y"), ("fz", "z"), ("all", "xyz")])
def test_gives_the_resistances_that_the_dataset_has(name, axes):
    """Two routes from forces to ohms; rounding only."""
    component = component_named(name)
    data = labelled(SENSOR, axes, n_samples=20, seed=0)
    forward = ForwardModel.of(RESPONSE, component)
    found = forward.resistances(force_columns(data.force_n, component))
    np.testing.assert_allclose(found, pillar_columns(data.resistance_ohm, component), rtol=1e-13)
    np.testing.assert_allclose(forward.lengths_of(found) ** 2 * forward.ohm_per_mm2, found, rtol=1e-14)


def test_derivatives_are_those_of_the_lengths():
    """Central differences of a step of 1e-3 N err by its square times the third derivative: far below 1e-8."""
    forward = ForwardModel.of(RESPONSE, component_named("all"))
    force = np.random.default_rng(0).uniform(10.0, 300.0, (3, forward.n_forces))
    lengths, J = forward.jacobian(force)
    np.testing.assert_array_equal(lengths, forward.lengths(force))
    along = np.random.default_rng(1).standard_normal(force.shape)
    step = 1e-3 * along
    differences = (forward.lengths(force + step) - forward.lengths(force - step)) / 2e-3
    np.testing.assert_allclose(np.einsum("npf,nf->np", J, along), differences, rtol=0, atol=1e-8)
