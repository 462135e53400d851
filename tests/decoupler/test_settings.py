"""Settings refuse nonsense by name."""

import pytest

from decoupler import NetworkConfig, TrainingConfig
from geometry import DesignError


@pytest.mark.parametrize(
    ("kind", "settings", "message"),
    [
        (NetworkConfig, {"hidden": 0}, "hidden=0 must be a whole number from 1 up"),
        (NetworkConfig, {"hidden": 2.5}, "hidden=2.5 must be a whole number"),
        (NetworkConfig, {"net": "deep"}, "net='deep' is unknown; choose one of plain, skip"),
        (NetworkConfig, {"feature": "log"}, "feature='log' is unknown"),
        (TrainingConfig, {"trainer": "adam"}, "trainer='adam' is unknown; choose one of varpro, lm, momentum"),
        (TrainingConfig, {"goal_mse": float("nan")}, "goal_mse=nan must be 0 or above"),
        (TrainingConfig, {"max_iterations": -1}, "max_iterations=-1"),
        (TrainingConfig, {"seed": True}, "seed=True"),
        (TrainingConfig, {"held_out": 0.6}, "held_out=0.6 must be from 0 to 0.5"),
        (TrainingConfig, {"least_gain": 1.0}, "least_gain=1 must be"),
        (TrainingConfig, {"learning_rate": 0.0}, "learning_rate=0 must be above 0"),
        (TrainingConfig, {"momentum": 1.0}, "momentum=1 must be"),
    ],
)
def test_nonsense_is_refused_by_name(kind, settings, message):
    with pytest.raises(DesignError, match=message):
        kind(**settings)


def test_each_trainer_has_its_own_patience():
    assert TrainingConfig(trainer="momentum").max_iterations > TrainingConfig(trainer="lm").max_iterations
    assert TrainingConfig(trainer="momentum", max_iterations=7).max_iterations == 7
