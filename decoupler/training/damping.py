"""The quadratic that Levenberg-Marquardt and variable projection see, and their damped iteration, after Nielsen."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from decoupler.model.network import Outcome, Reason, Task
from decoupler.model.settings import TrainingConfig
from decoupler.training.weights import TrainingSet

FIRST_DAMPING = 1e-3  #: over the largest diagonal entry of JᵀJ
MAX_DAMPING = 1e12  #: in the same unit; no step is found by damping more


@dataclass(frozen=True)
class Point:
    """Weights and what they cost."""

    hidden: Tensor  #: (n_hidden, n_in+1)
    output: Tensor  #: (n_out, n_hidden + n_linear)
    cost: float  #: the function that is minimised
    mse: float  #: mean squared error, which is reported

    @classmethod
    def at(cls, samples: TrainingSet, A: Tensor, hidden: Tensor, output: Tensor, ridge: float = 0.0) -> "Point":
        """Weights whose activations of the samples are A; cost ½‖r‖² + ½ ridge ‖W₂‖²."""
        residual = A @ output.T - samples.targets
        squares = torch.sum(residual**2).item()
        cost = 0.5 * (squares + ridge * torch.sum(output**2).item())
        return cls(hidden, output, cost, squares / residual.numel())


class Quadratic(ABC):
    """The squared error near a point as a quadratic, with A, s = 1 − tanh² and K = W₂ᵀW₂ over the hidden nodes."""

    scale: float  #: size of the matrix's diagonal, the unit of the first damping

    def __init__(self, samples: TrainingSet, point: Point) -> None:
        self.samples, self.point, h = samples, point, len(point.hidden)
        self.A = samples.activations(point.hidden)
        self.s = 1.0 - self.A[:, :h] ** 2
        self.W2 = point.output[:, :h]
        self.K = self.W2.T @ self.W2
        self.residual = self.A @ point.output.T - samples.targets  # (n_samples, n_out)
        self.gradient = ((self.residual @ self.W2) * self.s).T @ samples.X  # (n_hidden, n_in+1)

    @abstractmethod
    def step(self, damping: float) -> tuple[Point, float] | None:
        """The point after a damped step and the fall in cost the quadratic promises; None if singular."""


class Stop:
    """Decides after every iteration whether to stop, and why."""

    def __init__(self, config: TrainingConfig) -> None:
        self.config = config
        self.errors: list[float] = []

    def reason(self, mse: float) -> Reason | None:
        self.errors.append(mse)
        if self.config.goal_mse is not None and mse <= self.config.goal_mse:
            return "goal"
        if len(self.errors) > self.config.max_iterations:
            return "iterations"
        if len(self.errors) > self.config.patience:
            before = self.errors[-1 - self.config.patience]
            if mse > (1.0 - self.config.least_gain) * before:
                return "stagnation"
        return None


def minimise(
    start: Point, linearise: Callable[[Point], Quadratic], task: Task, judge: Callable[[Point], float] | None = None
) -> tuple[Point, Outcome]:
    """Follow damped Gauss-Newton steps downhill from `start`.

    `judge` gives the validation error of a point. The point where it is lowest is the result, and the descent ends when
    half of the patience has passed without a better one.

    Notes
    -----
    Damping after Nielsen (Madsen, Nielsen, Tingleff, *Methods for non-linear least squares problems*, 2004,
    sec. 3.2): ρ compares the fall in cost with the promised one; after a good step μ shrinks smoothly, by 3
    at most, after each step uphill it grows by 2, 4, 8 ... A step uphill costs a factorisation, not a new
    matrix, and is no iteration.
    """
    config, point, stop, iteration = task.training, start, Stop(task.training), 0
    best, error, waited = start, math.inf, 0
    damping, growth = 0.0, 2.0

    def ended(reason: Reason) -> tuple[Point, Outcome]:
        return best, Outcome(iteration, best.mse, reason)

    while True:
        task.progress(iteration, point.mse)
        judged = -math.inf if judge is None else judge(point)
        waited += 1
        if judge is None or judged < error:
            best, error, waited = point, judged, 0
        reason = stop.reason(point.mse) or ("validation" if waited >= max(1, config.patience // 2) else None)
        if reason is not None:
            return ended(reason)
        model = linearise(point)
        damping = damping or FIRST_DAMPING * model.scale
        while True:
            trial = model.step(damping)
            if trial is not None and trial[0].cost < point.cost:
                break
            damping, growth = damping * growth, growth * 2.0
            if damping > MAX_DAMPING * model.scale:
                return ended("stagnation")
        rho = (point.cost - trial[0].cost) / trial[1]
        damping, growth = damping * max(1.0 / 3.0, 1.0 - (2.0 * rho - 1.0) ** 3), 2.0
        point, iteration = trial[0], iteration + 1
