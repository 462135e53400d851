"""Variable projection: the output layer is always the best one, and only the hidden layer is iterated."""

import torch
from torch import Tensor

from decoupler.damping import Outcome, Point, Progress, minimise
from decoupler.gauss_newton import Eliminated, GaussNewton, Samples
from decoupler.settings import TrainingConfig

RIDGE = 1e-9  #: on the output weights, in units of n_samples; keeps near-linear hidden nodes from cancelling


class _HiddenWeights:
    def __init__(self, samples: Samples, ridge: float, point: Point) -> None:
        self.samples, self.ridge, self.point = samples, ridge, point
        self.matrix = GaussNewton(samples, point.hidden, point.output)
        eliminated = self.matrix.eliminate(ridge)
        assert eliminated is not None  # the same matrix gave this point its output weights
        self.eliminated: Eliminated = eliminated
        self.scale = eliminated.reduced.diagonal().max().item()

    def step(self, damping: float) -> tuple[Point, float] | None:
        gradient = self.matrix.gradient_hidden
        step = self.matrix.hidden_step(self.eliminated, damping, gradient)
        if step is None:
            return None
        promised = (step * (damping * step - gradient)).sum().item() / 2
        return projected(self.samples, self.point.hidden + step, self.ridge), promised


def projected(samples: Samples, hidden: Tensor, ridge: float) -> Point:
    """Hidden weights with the output weights that are best for them; cost ½‖r‖² + ½ ridge ‖W₂‖²."""
    A = samples.activations(hidden)
    M = A.T @ A
    M.diagonal().add_(ridge)
    output = torch.cholesky_solve(A.T @ samples.targets, torch.linalg.cholesky(M)).T
    residual = A @ output.T - samples.targets
    squares = torch.sum(residual**2).item()
    cost = 0.5 * (squares + ridge * torch.sum(output**2).item())
    return Point(hidden, output, cost, squares / residual.numel())


def train_varpro(samples: Samples, hidden: Tensor, config: TrainingConfig, progress: Progress) -> tuple[Point, Outcome]:
    """Train from the given hidden weights.

    Notes
    -----
    Golub & Pereyra's functional with Kaufman's approximation of its Jacobian (BIT 15, 1975): with the output
    weights W₂(W₁) = argmin ½‖A W₂ᵀ − T‖² + ½ λ‖W₂‖², the gradient over W₁ is exact, and JᵀJ is the Schur
    complement K ∘ (ZᵀZ − C M⁻¹ Cᵀ) of the full matrix with M = AᵀA + λI.
    """
    ridge = RIDGE * len(samples.X)
    start = projected(samples, hidden, ridge)
    return minimise(start, lambda point: _HiddenWeights(samples, ridge, point), config, progress)
