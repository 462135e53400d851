"""The input of every contender: samples, the form of the network, and the seed of its start."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from dataset import Samples
from decoupler.data.columns import Scaling, component_named, force_columns, pillar_columns
from decoupler.model.decoupler import Decoupler
from decoupler.model.settings import NetworkConfig
from decoupler.training.network import Network
from fem.array.response import ArrayResponse


@dataclass(frozen=True, kw_only=True)
class Problem:
    """A network to be trained on data."""

    data: Samples
    component: str
    network: NetworkConfig
    seed: int = 0
    response: ArrayResponse | None = None  #: of the sensor, for whom it concerns

    def first(self, samples: int) -> "Problem":
        """The same with the first samples only."""
        return replace(self, data=self.data[:samples])


class Scaled:
    """A problem as `decoupler.training.trainer.train` prepares it: the same columns, scaling and random start."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.parts = problem, component_named(problem.component)
        columns = pillar_columns(problem.data.resistance_ohm, self.parts)
        inputs = np.sqrt(columns) if problem.network.feature == "root" else columns
        targets = force_columns(problem.data.force_n, self.parts)
        self.scalings = Scaling.fitted(inputs), Scaling.fitted(targets)
        self.x = torch.from_numpy(self.scalings[0].scale(inputs))  #: (n_samples, n_in)
        self.t = torch.from_numpy(self.scalings[1].scale(targets))  #: (n_samples, n_out)
        self.model = Network(problem.network, self.x.shape[1], self.t.shape[1], problem.seed)

    def loss(self) -> Tensor:
        """Mean squared error of the scaled outputs, with its graph."""
        return torch.mean((self.model(self.x) - self.t) ** 2)

    @torch.no_grad()
    def mse(self) -> float:
        """The same as a number."""
        return self.loss().item()

    def decoupler(self) -> Decoupler:
        """The network as it now is, with its scaling."""
        data = self.problem.data
        return Decoupler(
            component=self.parts,
            rows=data.resistance_ohm.shape[1],
            cols=data.resistance_ohm.shape[2],
            network=self.problem.network,
            input_scaling=self.scalings[0],
            output_scaling=self.scalings[1],
            hidden_weights=self.model.hidden.detach().numpy(),
            output_weights=self.model.output.detach().numpy(),
            design=data.design,
        )
