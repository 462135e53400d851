"""Variable projection: the output layer is always the best one, and only the hidden layer is iterated."""

from dataclasses import replace

import torch
from torch import Tensor

from decoupler.model.network import Outcome
from decoupler.training.damping import Point, Quadratic, minimise
from decoupler.training.weights import TrainingSet

CLOSE_ENOUGH = 0.1  #: relative residual at which conjugate gradients end; 0.3 stalls sooner, 0.03 costs more
MAX_PRODUCTS = 40  #: with the matrix in a step


class Projected(Quadratic):
    """The quadratic that variable projection sees near a point, as products with its matrix, never formed.

    Notes
    -----
    Golub & Pereyra's functional with Kaufman's approximation of its Jacobian (BIT 15, 1975): with the output weights
    W₂(W₁) = argmin ½‖A W₂ᵀ − T‖² + ½ λ‖W₂‖², the gradient over W₁ is exact, and JᵀJ = K ∘ (ZᵀZ − C M⁻¹ Cᵀ) is the
    Schur complement of the full matrix (see `levenberg_marquardt`) with M = AᵀA + λI. Its product with a direction V
    (n_hidden, n_in+1) takes four thin products: D = (X Vᵀ) ∘ s, what A can follow taken from D, times K, then
    (· ∘ s)ᵀ X. Its diagonal blocks, one a hidden node, precondition conjugate gradients that stop early: a third of
    the time of a factored step at 36 nodes and 36 inputs, and as many steps.
    """

    def __init__(self, samples: TrainingSet, ridge: float, point: Point) -> None:
        super().__init__(samples, point)
        self.ridge, A, X, (h, p) = ridge, self.A, samples.X, point.hidden.shape
        M = gram(A)
        M.diagonal().add_(ridge)
        L = torch.linalg.cholesky(M)
        self.Q = torch.linalg.solve_triangular(L, A.T, upper=False).T  # A M⁻¹ Aᵀ = Q Qᵀ
        self.blocks = torch.empty(h, p, p, dtype=X.dtype)
        roots, Z = self.s.sqrt(), torch.empty_like(X)  # one array for all nodes: new ones take as long as the products
        for j in range(h):
            skipped = gram(torch.mul(roots[:, j : j + 1], X, out=Z)) if samples.linear is X else None
            torch.mul(self.s[:, j : j + 1], X, out=Z)
            AtZ = torch.cat([A[:, :h].T @ Z, samples.linear.T @ Z if skipped is None else skipped])
            followed = torch.linalg.solve_triangular(L, AtZ, upper=False)  # Qᵀ Z
            self.blocks[j] = self.K[j, j] * (gram(Z) - followed.T @ followed)
        self.scale = self.blocks.diagonal(dim1=1, dim2=2).max().item()

    def product(self, direction: Tensor) -> Tensor:
        """JᵀJ times a direction, both (n_hidden, n_in+1)."""
        D = (self.samples.X @ direction.T) * self.s
        D = D - self.Q @ (self.Q.T @ D)
        return ((D @ self.K) * self.s).T @ self.samples.X

    def direction(self, damping: float, close_enough: float, most_products: int) -> Tensor | None:
        """Solve (JᵀJ + damping·I) d = −gradient nearly; None if singular to rounding."""
        shifted = self.blocks.clone()
        shifted.diagonal(dim1=1, dim2=2).add_(damping)
        factors, info = torch.linalg.cholesky_ex(shifted)
        if info.any():
            return None

        def preconditioned(residual: Tensor) -> Tensor:
            return torch.cholesky_solve(residual[:, :, None], factors)[:, :, 0]

        found = torch.zeros_like(self.gradient)
        residual = -self.gradient
        towards = z = preconditioned(residual)
        energy = first = torch.sum(residual * z)
        for _ in range(most_products):
            if energy <= close_enough**2 * first:
                break
            image = self.product(towards) + damping * towards
            length = energy / torch.sum(towards * image)
            found = found + length * towards
            residual = residual - length * image
            z = preconditioned(residual)
            before, energy = energy, torch.sum(residual * z)
            towards = z + (energy / before) * towards
        return found

    def step(self, damping: float) -> tuple[Point, float] | None:
        direction = self.direction(damping, CLOSE_ENOUGH, MAX_PRODUCTS)
        if direction is None:
            return None
        promised = (direction * (damping * direction - self.gradient)).sum().item() / 2  # true of every CG iterate
        return projected(self.samples, self.point.hidden + direction, self.ridge), promised


def gram(Z: Tensor) -> Tensor:
    """ZᵀZ by numpy, which multiplies half of it."""
    columns = Z.numpy()
    return torch.from_numpy(columns.T @ columns)


def projected(samples: TrainingSet, hidden: Tensor, ridge: float) -> Point:
    """Hidden weights with the output weights that are best for them."""
    A = samples.activations(hidden)
    M = gram(A)
    M.diagonal().add_(ridge)
    output = torch.cholesky_solve(A.T @ samples.targets, torch.linalg.cholesky(M)).T
    return Point.at(samples, A, hidden, output, ridge)


def train_varpro(samples: TrainingSet, hidden: Tensor, output: Tensor) -> tuple[Point, Outcome]:
    """Train from the given hidden weights (n_hidden, n_in+1); what the output layer starts from is not looked at.

    Samples that the task holds out are kept for validation. The hidden layer with the lowest validation error is
    returned, which may be that of weights 0, a linear map. The output layer is then fitted to all samples.
    """
    task, n = samples.task, len(samples.X)
    ridge, held_out, samples = task.ridge, len(task.held_out), samples[task.order]
    if not held_out:
        start = projected(samples, hidden, ridge)
        return minimise(start, lambda point: Projected(samples, ridge, point), task)
    fitted, judging = samples[: n - held_out], samples[n - held_out :]
    share = ridge * (n - held_out) / n

    def judge(point: Point) -> float:
        return torch.mean((judging.activations(point.hidden) @ point.output.T - judging.targets) ** 2).item()

    start = projected(fitted, hidden, share)
    best, outcome = minimise(start, lambda point: Projected(fitted, share, point), task, judge)
    linear = projected(fitted, torch.zeros_like(hidden), share)
    found = projected(samples, linear.hidden if judge(linear) <= judge(best) else best.hidden, ridge)
    return found, replace(outcome, mse=found.mse)
