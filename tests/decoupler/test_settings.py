"""Settings of samples, networks and trainings refuse nonsense by name: one table, by field and what it allows."""

import math

import pytest

from dataset import DatasetSettings
from decoupler import NetworkConfig, TrainingConfig
from geometry import DesignError

WIRES, PLACES = "must hold numbers of wires from 0 on", "must hold a row and a column from 0 on"
SEED = "must be from 0 to below 2⁶³"
REFUSED = {
    DatasetSettings: {
        "protocol": {"is unknown; known are independent-fz, ": ["contact-fy"]},
        "samples": {"must be from 1 to 10000000": [0], "must be a whole number": [2.5, True, "10"]},
        "seed": {SEED: [-1, 2**63], "must be a whole number": [1.5]},
        "cap": {"must be above 0 and below 1; the paper": [0.0, 1.0], "must be a finite number": [math.nan]},
        "noise": {"must be a finite number": [-0.001, "loud"], "must be from 0 to 0.1": [0.11]},
        "bits": {"must be a whole number from 4 to 24": [3, 25, 12.5]},
        "drift": {"must be from 0 to 0.5": [-0.001, 0.51], "must be a finite number": [math.nan, "much"]},
        "gain_spread": {"must be from 0 to below 1": [-0.1, 1.0], "must be a finite number": ["wide"]},
        "offset_ohm": {"must be from 0 to 1e6": [-5.0, 1e7], "must be a finite number": [math.nan]},
        "specimen": {SEED: [-1, 2**63], "must be a whole number": [1.5]},
        "dead_rows": {WIRES: [(-1,), 4]},
        "dead_cols": {WIRES: [(True,), ("4",)]},
        "dead_pillars": {PLACES: [((0, 3, "w"),), ((-1, 3, "z"),), ((0, "z"),), (0, 3, "z")]},
    },
    NetworkConfig: {
        "hidden": {"must be a whole number from 1 up": [0, 2.5], "must be at most 1000": [1001]},
        "net": {"is unknown; choose one of plain, skip": ["deep"]},
        "feature": {"is unknown; choose one of resistance, root, inverse": ["log"]},
    },
    TrainingConfig: {
        "trainer": {"is unknown; choose one of varpro, lm, momentum": ["adam"]},
        "goal_mse": {"must be 0 or above": [math.nan, -1.0]},
        "max_iterations": {"must be a whole number from 0 up": [-1]},
        "patience": {"must be a whole number from 0 up": [0.5]},
        "seed": {"must be a whole number from 0 up": [True]},
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
