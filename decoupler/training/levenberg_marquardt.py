"""Levenberg-Marquardt on all weights at once, the paper's "LMBP", through the blocks of `gauss_newton`."""

import torch
from torch import Tensor

from decoupler.model.settings import TrainingConfig
from decoupler.training.damping import Outcome, Point, Progress, minimise
from decoupler.training.gauss_newton import GaussNewton, TrainingSet


class _AllWeights:
    def __init__(self, samples: TrainingSet, point: Point) -> None:
        self.samples, self.point = samples, point
        self.matrix = GaussNewton(samples, point.hidden, point.output)
        self.scale = self.matrix.largest_diagonal()

    def step(self, damping: float) -> tuple[Point, float] | None:
        step = self.matrix.step(damping)
        if step is None:
            return None
        gradient = (self.matrix.gradient_hidden, self.matrix.gradient_output)
        promised = sum((d * (damping * d - g)).sum().item() / 2 for d, g in zip(step, gradient, strict=True))
        return point_at(self.samples, self.point.hidden + step[0], self.point.output + step[1]), promised


def point_at(samples: TrainingSet, hidden: Tensor, output: Tensor) -> Point:
    """Weights with their cost ½‖r‖² and their mean squared error."""
    residual = samples.activations(hidden) @ output.T - samples.targets
    cost = 0.5 * torch.sum(residual**2).item()
    return Point(hidden, output, cost, 2.0 * cost / residual.numel())


def train_lm(
    samples: TrainingSet, hidden: Tensor, output: Tensor, config: TrainingConfig, progress: Progress
) -> tuple[Point, Outcome]:
    """Train from the given weights."""
    start = point_at(samples, hidden, output)
    return minimise(start, lambda point: _AllWeights(samples, point), config, progress)
