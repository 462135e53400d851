"""A training problem with a trace of its error, and other optimisers on it, full batch, set as an expert would."""

from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import median
from time import process_time

import numpy as np
import torch
from torch import Tensor

from dataset import Samples
from decoupler.data.columns import Scaling, component_named, force_columns, pillar_columns
from decoupler.model.decoupler import Decoupler
from decoupler.model.settings import NetworkConfig
from decoupler.training.network import Network
from fem.array.response import ArrayResponse

LBFGS_ROUND = 10  #: iterations between two looks at the error


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


class Ended(Exception):
    """Raised out of a training that has reached the goal, or whose time is over; its message says which."""


class Trace:
    """Hand `record` to a training as its progress: the clock, of processor time, starts when this is made.

    Parameters
    ----------
    goal_mse : float
        Mean squared error of the scaled outputs at which a training is ended.
    patience_s : float
        Time after which it is.
    """

    def __init__(self, goal_mse: float, patience_s: float) -> None:
        self.goal_mse, self.patience_s = goal_mse, patience_s
        self.points: list[tuple[int, float, float]] = []  #: iteration, seconds, error
        self.start = process_time()

    def record(self, iteration: int, mse: float) -> None:
        """Note the error after so many iterations; raises `Ended` where that is enough."""
        seconds = process_time() - self.start
        self.points.append((iteration, seconds, mse))
        if mse <= self.goal_mse:
            raise Ended("goal")
        if seconds > self.patience_s:
            raise Ended("time")

    def seconds_per_iteration(self) -> float | None:
        """Median over the recorded iterations; None before the first has ended."""
        steps = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in pairwise(self.points) if b[0] > a[0]]
        return median(steps) if steps else None

    def thinned(self) -> list[tuple[int, float, float]]:
        """Points at least 1 % of the time apart, and the last: as many as a picture can show."""
        kept = self.points[:1]
        for point in self.points[1:]:
            if point[1] >= 1.01 * kept[-1][1] or point is self.points[-1]:
                kept.append(point)
        return kept


def lbfgs(scaled: Scaled, trace: Trace) -> str:
    """`torch.optim.LBFGS` with a line search to the strong Wolfe conditions and 10 pairs."""
    optimizer = torch.optim.LBFGS(
        scaled.model.parameters(), max_iter=LBFGS_ROUND, history_size=10, tolerance_grad=0.0, tolerance_change=0.0,
        line_search_fn="strong_wolfe",
    )  # fmt: skip
    state = optimizer.state[scaled.model.hidden]

    def closure() -> float:
        optimizer.zero_grad()
        loss = scaled.loss()
        loss.backward()
        return loss.item()

    done = -1
    while state.get("n_iter", 0) > done:
        done = state.get("n_iter", 0)
        trace.record(done, scaled.mse())
        optimizer.step(closure)
    return "no step"
