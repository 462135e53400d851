"""The training race on a tiny network: every trainer learns, and says what it took. Times are free."""

import numpy as np
import pytest

from decoupler.data.usual_loads import LIGHT
from decoupler.model.settings import NetworkConfig
from studies.bench.training import KNOWN, TRAINERS, Problem, Trace, by_ours
from tests.decoupler.synthetic_sensor import labelled, response, sensor

SENSOR = sensor(2, 2)
DATA = labelled(SENSOR, "x", n_samples=60, seed=0)


@pytest.mark.parametrize("name", TRAINERS)
def test_every_trainer_lowers_the_error(name):
    network = NetworkConfig(hidden=3, feature="root")
    problem = Problem(data=DATA, component="fx", network=network, response=response(SENSOR))
    begun = Trace(0.0, 0.0)
    by_ours("momentum")(problem, begun)  # which looks at the error before its first step
    goal = 0.45 * begun.points[0][2]
    trace = Trace(goal, 30.0)  # ends at the goal, however busy the machine is
    decoupler, reason = TRAINERS[name](problem, trace)
    assert reason == "goal"
    assert (np.diff([point[:2] for point in trace.points], axis=0) >= 0).all()
    assert trace.points[-1][2] <= goal
    # the network handed back is the one whose error was recorded last, or a later one
    errors = (decoupler.forces(DATA.resistance_ohm) - DATA.force_n[..., :1]).reshape(len(DATA.force_n), -1)
    found = np.mean((errors / decoupler.output_scaling.half_range) ** 2)
    light = 1.0 + LIGHT * (name == KNOWN)  # what it recorded counts the light samples that it adds, too
    assert found <= light * trace.points[-1][2] * (1.0 + 1e-6)
