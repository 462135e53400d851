"""The paper's momentum rule, its eq. 15."""

import torch
from torch import Tensor

from decoupler.model.network import Outcome
from decoupler.model.settings import TrainingConfig, TrainingError
from decoupler.training.damping import Point, Stop
from decoupler.training.weights import TrainingSet


def momentum_step(weights: Tensor, gradient: Tensor, before: Tensor, training: TrainingConfig) -> Tensor:
    """v(N+1) = v(N) + α[(1−η) g(N) + η g(N−1)], with g the negative gradient and g(−1) = 0.

    Eq. 15 of Song et al., Micromachines 2018, 9(5), 236. It averages two gradients and keeps no velocity, so it damps
    oscillations and is no faster than gradient descent downhill.
    """
    alpha, eta = training.learning_rate, training.momentum
    return weights.add(gradient, alpha=-alpha * (1.0 - eta)).add(before, alpha=-alpha * eta)


def train_momentum(samples: TrainingSet, hidden: Tensor, output: Tensor) -> tuple[Point, Outcome]:
    """Train from the given weights; a learning rate that makes the error grow without bound is a `TrainingError`."""
    training = samples.task.training
    weights, stop, iteration = [hidden, output], Stop(training), 0
    before: tuple[Tensor, ...] = (torch.zeros_like(hidden), torch.zeros_like(output))
    while True:
        with torch.enable_grad():
            hidden, output = (one.requires_grad_() for one in weights)
            loss = torch.mean((samples.activations(hidden) @ output.T - samples.targets) ** 2)
        mse = loss.item()
        samples.task.progress(iteration, mse)
        if not mse < 1e6:
            raise TrainingError(
                f"the momentum rule ran away (mean squared error {mse:.1e} after {iteration} iterations): "
                f"learning_rate was {training.learning_rate:g}, lower it."
            )
        reason = stop.reason(mse)
        if reason is not None:
            return Point(hidden.detach(), output.detach(), mse, mse), Outcome(iteration, mse, reason)
        gradients = torch.autograd.grad(loss, (hidden, output))
        with torch.no_grad():
            weights = [momentum_step(*one, training) for one in zip((hidden, output), gradients, before, strict=True)]
        before, iteration = gradients, iteration + 1
