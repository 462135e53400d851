"""The training race on a tiny network: every contender learns, and says what it took. Times are free."""

from dataclasses import asdict

import numpy as np
import pytest

from decoupler.data.usual_loads import LIGHT
from decoupler.model.settings import NetworkConfig
from studies.bench.harness import named
from studies.bench.optimisers import Problem, Scaled, Trace
from studies.bench.training import CONTENDERS, KNOWN, MSE, Race, measure
from tests.decoupler.synthetic_sensor import labelled, response, sensor

SENSOR = sensor(2, 2)
DATA = labelled(SENSOR, "x", n_samples=60, seed=0)


@pytest.mark.parametrize("one", CONTENDERS, ids=lambda one: one.name)
def test_every_contender_lowers_the_error(one):
    problem = Problem(data=DATA, component="fx", network=NetworkConfig(hidden=3, net="skip"), response=response(SENSOR))
    start = Scaled(problem).mse()
    trace = Trace(0.45 * start, 30.0)  # ends at the goal, however busy the machine is
    decoupler, reason = one.solve(problem, trace)
    iterations, seconds, mse = np.array(trace.points).T
    assert iterations[0] == 0
    if not one.name.startswith("VarPro"):  # which solves for the output weights before it looks
        assert mse[0] == pytest.approx(start, rel=1e-12)  # all start from the same error
    assert (np.diff([iterations, seconds]) >= 0).all()
    assert mse[-1] <= 0.45 * start
    assert reason == "goal"
    # the network handed back is the one whose error was recorded last
    errors = (decoupler.forces(DATA.resistance_ohm) - DATA.force_n[..., :1]).reshape(len(DATA.force_n), -1)
    found = np.mean((errors / decoupler.output_scaling.half_range) ** 2)
    if one.name == "VarPro" and not iterations[-1]:  # at the goal before its first iteration, of which it does one
        assert found <= mse[-1]
    elif one.name == KNOWN:  # what it recorded counts the light samples that it adds, too
        assert found <= (1.0 + LIGHT) * mse[-1] * (1.0 + 1e-6)
    else:
        assert found == pytest.approx(mse[-1], rel=1e-6)


def test_a_race_says_what_a_training_took(monkeypatch, tmp_path):
    """Four units in closed form."""
    monkeypatch.setenv("TRIPILLAR_CACHE", str(tmp_path))
    race = Race(
        protocol="contact-fz", component="fz", net="skip", hidden=3, samples=60, patience_s=0.3, rows=2, method="layer"
    )
    found = measure(named(CONTENDERS, "structured LM"), asdict(race), None)
    assert found.notes["steps"] > 0
    assert found.errors[MSE] == found.trace[-1][1] < 1e-2
    assert found.errors["eq. 17, test samples"] < 0.2
    assert found.size == 3 * (4 + 1) + 4 * (3 + 4 + 1)  # hidden weights, output weights with a skip
