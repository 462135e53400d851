"""Settings of a training: the form of the network, and how it is trained. Loads no torch."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

from geometry.errors import DesignError, TriPillarError

Net = Literal["plain", "skip"]
Feature = Literal["resistance", "root", "inverse"]
MAX_HIDDEN = 1000  #: nodes; the Gauss-Newton matrix of a 36-input network then takes 11 GB
Progress = Callable[[int, float], None]  #: called with the iteration and its mean squared error
Trainer = Literal["varpro", "lm", "momentum"]

#: functions of `decoupler.training` that train all weights at once
METHODS = {"lm": "levenberg_marquardt:train_lm", "momentum": "momentum:train_momentum"}
_TRAINERS_OWN = {
    "varpro": {"goal_mse": 1e-7, "max_iterations": 200, "patience": 10},
    "lm": {"goal_mse": 1e-5, "max_iterations": 200, "patience": 10},  # the paper's goal
    "momentum": {
        "goal_mse": 1e-5,
        "max_iterations": 5000,
        "patience": 500,
    },  # first order: many cheap steps, each gaining little
}


class TrainingError(TriPillarError, ArithmeticError):
    """A training that ran away."""


def _require_one_of(name: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise DesignError(f"{name}={value!r} is unknown; choose one of {', '.join(allowed)}.")


def _require_whole(name: str, value: int, lowest: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or value < lowest:
        raise DesignError(f"{name}={value!r} must be a whole number from {lowest} up.")


@dataclass(frozen=True, kw_only=True)
class NetworkConfig:
    """Form of a network with one tanh hidden layer; the data give its inputs and outputs."""

    hidden: int = 17  #: hidden nodes; the paper's best (its eq. 16 gives 10 to 19); 0 is what `identify` makes
    net: Net = "skip"  #: "plain" is the paper's; "skip" adds a linear map of the inputs
    feature: Feature = "root"  #: inputs R, √R (proportional to a pillar's length), or the response's own inverse

    def __post_init__(self) -> None:
        _require_whole("hidden", self.hidden, 1 if (self.net, self.feature) != ("skip", "inverse") else 0)
        if self.hidden > MAX_HIDDEN:
            raise DesignError(f"hidden={self.hidden} must be at most {MAX_HIDDEN}; its matrix grows with the square.")
        _require_one_of("net", self.net, get_args(Net))
        _require_one_of("feature", self.feature, get_args(Feature))


@dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """Settings of a training, always on the full batch; errors are of outputs scaled to [-1, 1]."""

    trainer: Trainer = "varpro"  #: variable projection, Levenberg-Marquardt, or the paper's momentum rule
    goal_mse: float | None = None  #: stop when reached; None: the trainer's own
    max_iterations: int = 0  #: stop at the latest then; 0: the trainer's own
    patience: int = 0  #: stop if so many iterations have not gained `least_gain`; 0: the trainer's own
    least_gain: float = 0.02  #: smallest relative fall of the error; 0 never gives up
    held_out: float = 0.1  #: share of samples that variable projection of a skip net keeps for validation
    seed: int = 0  #: seed of the random start
    learning_rate: float = 1.0  #: α of eq. 15, momentum rule only
    momentum: float = 0.5  #: η of eq. 15, momentum rule only

    def __post_init__(self) -> None:
        _require_one_of("trainer", self.trainer, get_args(Trainer))
        for name in ("max_iterations", "patience", "seed"):
            _require_whole(name, getattr(self, name), 0)
        own = _TRAINERS_OWN[self.trainer]
        for name in ("max_iterations", "patience"):
            object.__setattr__(self, name, getattr(self, name) or own[name])
        if self.goal_mse is None:
            object.__setattr__(self, "goal_mse", own["goal_mse"])
        assert self.goal_mse is not None
        if not (math.isfinite(self.goal_mse) and self.goal_mse >= 0):
            raise DesignError(f"goal_mse={self.goal_mse:g} must be 0 or above; the paper uses 1e-5.")
        if not 0 <= self.least_gain < 1:
            raise DesignError(f"least_gain={self.least_gain:g} must be from 0 to below 1; 0 never gives up.")
        if not 0 <= self.held_out <= 0.5:
            raise DesignError(f"held_out={self.held_out:g} must be from 0 to 0.5; 0.1 is usual.")
        if not (math.isfinite(self.learning_rate) and self.learning_rate > 0):
            raise DesignError(f"learning_rate={self.learning_rate:g} must be above 0.")
        if not 0 <= self.momentum < 1:
            raise DesignError(f"momentum={self.momentum:g} must be from 0 to below 1.")
