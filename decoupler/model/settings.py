"""Settings of a training: the form of the network, and how it is trained. Loads no torch."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

from common.errors import DesignError, TriPillarError
from common.quantity import Sound, quantity

Net = Literal["plain", "skip", "convolution"]
Feature = Literal["auto", "inverse", "root", "resistance"]
MAX_HIDDEN = 1000  #: nodes; the Gauss-Newton matrix of a 36-input network then takes 11 GB
Progress = Callable[[int, float], None]  #: called with the iteration and its mean squared error
Trainer = Literal["varpro", "lm", "momentum"]

#: classes of networks by their form, and functions that train the weights of one with a hidden layer
NETWORKS: dict[Net, str] = {
    "plain": "decoupler.training.one_layer:Plain",
    "skip": "decoupler.training.one_layer:Skip",
    "convolution": "decoupler.training.convolution:Convolution",
}
METHODS: dict[Trainer, str] = {
    "varpro": "decoupler.training.varpro:train_varpro",
    "lm": "decoupler.training.levenberg_marquardt:train_lm",
    "momentum": "decoupler.training.momentum:train_momentum",
}
_TRAINERS_OWN: dict[Trainer, dict[str, float]] = {
    "varpro": {"goal_mse": 1e-7, "max_iterations": 200, "patience": 10},
    "lm": {"goal_mse": 1e-5, "max_iterations": 200, "patience": 10},  # the paper's goal
    # first order: many cheap steps, each gaining little
    "momentum": {"goal_mse": 1e-5, "max_iterations": 5000, "patience": 500},
}


class TrainingError(TriPillarError, ArithmeticError):
    """A training that ran away."""


@dataclass(frozen=True, kw_only=True)
class NetworkConfig(Sound):
    """Form of a network with one tanh hidden layer; the data give its inputs and outputs."""

    #: 17 is the paper's best; its eq. 16 gives 10 to 19
    hidden: int = quantity(17, "number of hidden nodes", within=(0, MAX_HIDDEN))
    net: Net = quantity(
        "skip",
        "network: plain, as in the paper; with a linear skip past the hidden layer; or a convolution over units, for "
        "data without a known response",
        of=get_args(Net),
    )
    #: √R is proportional to a pillar's length; auto is the inverse of a response that explains the samples, else √R
    feature: Feature = quantity(
        "auto",
        "inputs of the network: inverse (of the known response), root (√R) or resistance; auto chooses",
        of=get_args(Feature),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.hidden and (self.net, self.feature) != ("skip", "inverse"):  # what `identify` makes
            raise DesignError("hidden=0 must be from 1 on, but of a skip net on the response's inverse.")


@dataclass(frozen=True, kw_only=True)
class TrainingConfig(Sound):
    """Settings of a training, always on the full batch; errors are of outputs scaled to [-1, 1]."""

    trainer: Trainer = quantity(
        "varpro", "method: variable projection, Levenberg-Marquardt, or the paper's momentum", of=get_args(Trainer)
    )
    goal_mse: float | None = quantity(
        None,
        "mean squared error to stop at, of forces scaled to ± 1; default: the trainer's own",
        within=(0, math.inf),
    )
    max_iterations: int = quantity(0, "largest number of iterations; 0: the trainer's own", within=(0, math.inf))
    patience: int = quantity(
        0, "stop if so many iterations have not gained least_gain; 0: the trainer's own", within=(0, math.inf)
    )
    least_gain: float = quantity(
        0.02, "smallest relative fall of the error; 0 never gives up", within=(0, 1), below=True
    )
    held_out: float = quantity(
        0.1, "share of samples that variable projection of a skip net keeps for validation", within=(0, 0.5)
    )
    seed: int = quantity(0, "seed of the random start", within=(0, math.inf))
    learning_rate: float = quantity(1.0, "α of eq. 15, momentum rule only", above_0=True)
    momentum: float = quantity(0.5, "η of eq. 15, momentum rule only", within=(0, 1), below=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, own in _TRAINERS_OWN[self.trainer].items():
            if not (name == "goal_mse" and self.goal_mse is not None):
                object.__setattr__(self, name, getattr(self, name) or own)
