"""Settings of samples, networks and trainings refuse nonsense by name: one table, by field and what it allows."""

import math

import pytest

from dataset import DatasetSettings
from decoupler import NetworkConfig, TrainingConfig
from geometry import DesignError

WIRES, PLACES = "must hold numbers of wires from 0 on", "must hold a row and a column from 0 on"
SEED, FINITE, WHOLE = "must be from 0 to 9.22337e+18", "must be a finite number", "must be a whole number"
REFUSED = {
    DatasetSettings: {
        "protocol": {"must be one of independent-fz, ": ["contact-fy"]},
        "samples": {"must be from 1 to 1e+09": [0, 2**31], WHOLE: [2.5, True, "10"]},
        "seed": {SEED: [-1, 2**63], WHOLE: [1.5]},
        "cap": {"must be above 0": [0.0], "must be from 0 to below 1": [1.0], FINITE: [math.nan]},
        "noise": {"must be from 0": [-0.001], "must be from 0 to 0.1": [0.11], FINITE: ["loud"]},
        "bits": {"must be from 4 to 24": [3, 25], WHOLE: [12.5]},
        "drift": {"must be from 0 to 0.5": [-0.001, 0.51], FINITE: [math.nan, "much"]},
        "gain_spread": {"must be from 0 to below 1": [-0.1, 1.0], FINITE: ["wide"]},
        "offset_ohm": {"must be from 0 to 1e+06": [-5.0, 1e7]},
        "specimen": {SEED: [-1, 2**63]},
        "dead_rows": {WIRES: [(-1,), 4]},
        "dead_cols": {WIRES: [(True,), ("4",)]},
        "dead_pillars": {PLACES: [((0, 3, "w"),), ((-1, 3, "z"),), ((0, "z"),), (0, 3, "z")]},
    },
    NetworkConfig: {
        "hidden": {"must be from 1 on": [0], WHOLE: [2.5], "must be from 0 to 1000": [1001]},
        "net": {"must be one of plain, skip": ["deep"]},
        "feature": {"must be one of resistance, root, inverse": ["log"]},
    },
    TrainingConfig: {
        "trainer": {"must be one of varpro, lm, momentum": ["adam"]},
        "goal_mse": {FINITE: [math.nan], "must be from 0": [-1.0]},
        "max_iterations": {"must be from 0": [-1]},
        "patience": {WHOLE: [0.5]},
        "seed": {WHOLE: [True]},
        "held_out": {"must be from 0 to 0.5": [0.6, -0.1]},
        "least_gain": {"must be from 0 to below 1": [1.0]},
        "learning_rate": {"must be above 0": [0.0]},
        "momentum": {"must be from 0 to below 1": [1.0]},
    },
}
OTHERWISE = {DatasetSettings: {"protocol": "contact", "samples": 10}}


@pytest.mark.parametrize(
    ("kind", "name", "value", "allowed"),
    [
        (kind, name, value, allowed)
        for kind, fields in REFUSED.items()
        for name, bounds in fields.items()
        for allowed, values in bounds.items()
        for value in values
    ],
)
def test_nonsense_is_refused_by_name(kind, name, value, allowed):
    """Each message begins with the setting as it was given, and says what is allowed."""
    with pytest.raises(DesignError) as caught:
        kind(**OTHERWISE.get(kind, {}) | {name: value})
    message = str(caught.value)
    assert message.startswith((f"{name}={value!r} ", f"{name}={value:g} " if isinstance(value, float) else "\0"))
    assert allowed in message
    assert "\n" not in message


def test_each_trainer_has_its_own_patience():
    assert TrainingConfig(trainer="momentum").max_iterations > TrainingConfig(trainer="lm").max_iterations
    assert TrainingConfig(trainer="momentum", max_iterations=7).max_iterations == 7
