"""Levenberg-Marquardt on all weights at once, the paper's "LMBP".

The Gauss-Newton matrix is put together from its exact blocks; the Jacobian, which has samples · outputs rows, is never
formed.
"""

import torch
from torch import Tensor

from decoupler.model.network import Outcome
from decoupler.training.damping import Point, Quadratic, minimise
from decoupler.training.weights import TrainingSet, pair_products


def _pair_index(n: int) -> Tensor:
    """Places of a symmetric n × n matrix's entries in the list of its pairs, flattened."""
    i, j = torch.triu_indices(n, n)
    index = torch.empty(n, n, dtype=torch.long)
    index[i, j] = index[j, i] = torch.arange(len(i))
    return index.reshape(-1)


class GaussNewton(Quadratic):
    """JᵀJ and Jᵀr of the squared error ½‖A W₂ᵀ − T‖² at one point, block by block.

    Notes
    -----
    With s = 1 − tanh², Z the row-wise Khatri-Rao product of s and X (one column s_j·x_a for every hidden
    weight), C = ZᵀA and K = W₂ᵀW₂ over the hidden nodes, JᵀJ has the blocks K ∘ ZᵀZ (hidden; K_jj' multiplies
    the whole block of nodes j and j'), I ⊗ AᵀA (output) and W₂[k, j] C[(j, a), b] between them. The damped
    step (JᵀJ + μI) d = −Jᵀr goes through the Schur complement of the output block, K ∘ (ZᵀZ − C M⁻¹ Cᵀ) + μI
    with M = AᵀA + μI: only (n_in+1)·n_hidden unknowns are factored, however many outputs there are.

    Both symmetries of ZᵀZ, Σ s_j s_j' x_a x_a', are used: the pairs of inputs are multiplied once a training,
    the pairs of nodes once an iteration, and one matrix product of a quarter of the size is left.
    """

    def __init__(self, samples: TrainingSet, point: Point) -> None:
        super().__init__(samples, point)
        h, p = point.hidden.shape
        self.gradient_output = self.residual.T @ self.A  # (n_out, n_hidden + n_linear)
        self.AtA = self.A.T @ self.A
        Z = (self.s[:, :, None] * samples.X[:, None, :]).reshape(len(self.s), h * p)
        self.C = Z.T @ self.A
        pairs = pair_products(self.s.T.contiguous()) @ samples.products.T
        blocks = pairs.index_select(1, _pair_index(p)).index_select(0, _pair_index(h))
        self.ZtZ = blocks.view(h, h, p, p).permute(0, 2, 1, 3).reshape(h * p, h * p)

        diagonal = self.ZtZ.diagonal() * self.K.diagonal().repeat_interleave(p)  # of JᵀJ, hidden weights
        self.scale = max(diagonal.max().item(), self.AtA.diagonal().max().item())

    def step(self, damping: float) -> tuple[Point, float] | None:
        step = self.direction(damping)
        if step is None:
            return None
        gradient = (self.gradient, self.gradient_output)
        promised = sum((d * (damping * d - g)).sum().item() / 2 for d, g in zip(step, gradient, strict=True))
        hidden, output = self.point.hidden + step[0], self.point.output + step[1]
        return Point.at(self.samples, self.samples.activations(hidden), hidden, output), promised

    def direction(self, damping: float) -> tuple[Tensor, Tensor] | None:
        """Damped step (JᵀJ + damping·I) d = −Jᵀr as (hidden, output); None if singular to rounding."""
        h, p = self.gradient.shape
        M = self.AtA.clone()
        M.diagonal().add_(damping)
        M_factor, info = torch.linalg.cholesky_ex(M)
        if info.item():
            return None
        G = torch.linalg.solve_triangular(M_factor, self.C.T, upper=False)  # C M⁻¹ Cᵀ = GᵀG
        S = torch.addmm(self.ZtZ, G.T, G, alpha=-1.0).view(h, p, h, p) * self.K[:, None, :, None]
        S = S.view(h * p, h * p)
        S.diagonal().add_(damping)
        S_factor, info = torch.linalg.cholesky_ex(S)
        if info.item():
            return None
        C = self.C.view(h, p, -1)  # (h, p, n_hidden + n_linear)
        solved = torch.cholesky_solve(self.gradient_output.T, M_factor)
        reduced = self.gradient - torch.einsum("jaq,qj->ja", C, solved @ self.W2)
        hidden = -torch.cholesky_solve(reduced.reshape(-1, 1), S_factor).view(h, p)
        coupled = torch.einsum("jaq,ja->qj", C, hidden) @ self.W2.T
        return hidden, -torch.cholesky_solve(self.gradient_output.T + coupled, M_factor).T


def train_lm(samples: TrainingSet, hidden: Tensor, output: Tensor) -> tuple[Point, Outcome]:
    """Train from the given weights."""
    start = Point.at(samples, samples.activations(hidden), hidden, output)
    return minimise(start, lambda point: GaussNewton(samples, point), samples.task)
