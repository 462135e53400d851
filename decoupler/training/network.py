"""The network as torch trains it, and its training set.

The network is Y = A W₂ᵀ with A = [tanh(X W₁ᵀ), X] (skip) or [tanh(X W₁ᵀ), 1] (plain), where the columns of X are the
inputs and a 1, all in float64.
"""

from functools import cached_property

import numpy as np
import torch
from torch import Tensor, nn

from decoupler.model.settings import NetworkConfig


class Network(nn.Module):
    """The weights W₁ (`hidden`) and W₂ (`output`) of a network: scaled resistances in, scaled forces out.

    It starts with hidden weights after Nguyen & Widrow (IJCNN 1990), which spread the bends of the tanh over the
    inputs' range [-1, 1] instead of piling them up at 0, as the MATLAB toolbox of the paper does; output weights are
    uniform within ±1/√(their number).
    """

    def __init__(self, config: NetworkConfig, n_in: int, n_out: int, seed: int) -> None:
        super().__init__()
        self.skip = config.net == "skip"
        generator = np.random.default_rng(seed)
        n_features = config.hidden + (n_in + 1 if self.skip else 1)
        bound = 1.0 / np.sqrt(n_features)
        self.hidden = nn.Parameter(torch.from_numpy(_nguyen_widrow(config.hidden, n_in, generator)))
        self.output = nn.Parameter(torch.from_numpy(generator.uniform(-bound, bound, (n_out, n_features))))

    def forward(self, inputs: Tensor) -> Tensor:
        X = torch.cat([inputs, torch.ones_like(inputs[:, :1])], dim=1)  # (n_samples, n_in + 1)
        linear = X if self.skip else X[:, -1:]
        return torch.cat([torch.tanh(X @ self.hidden.T), linear], dim=1) @ self.output.T


def _nguyen_widrow(n_hidden: int, n_in: int, generator: np.random.Generator) -> np.ndarray:
    """Weights of length 0.7·n_hidden^(1/n_in) in random directions, biases uniform within that length."""
    length = 0.7 * n_hidden ** (1.0 / n_in)
    weights = generator.uniform(-1.0, 1.0, (n_hidden, n_in))
    weights *= length / np.linalg.norm(weights, axis=1, keepdims=True)
    return np.hstack([weights, generator.uniform(-length, length, (n_hidden, 1))])


class TrainingSet:
    """Inputs (n, n_in) and targets (n, n_out), and products of inputs that every Gauss-Newton matrix is made of.

    With `skip` the output layer also sees the inputs themselves.
    """

    def __init__(self, inputs: Tensor, targets: Tensor, skip: bool) -> None:
        self.X = torch.cat([inputs, torch.ones_like(inputs[:, :1])], dim=1)  # (n_samples, n_in+1)
        self.targets = targets
        self.linear = self.X if skip else self.X[:, -1:]  # what A holds beside the hidden nodes

    def __getitem__(self, part: slice | Tensor) -> "TrainingSet":
        """Some of the samples, or all in another order."""
        return TrainingSet(self.X[part, :-1], self.targets[part], self.linear is self.X)

    @cached_property
    def products(self) -> Tensor:
        """Products of pairs of columns of X, (n_in+1)(n_in+2)/2 × n_samples."""
        return pair_products(self.X.T)

    def activations(self, hidden: Tensor) -> Tensor:
        """A, shape (n_samples, n_hidden + n_linear), for hidden weights of shape (n_hidden, n_in+1)."""
        return torch.cat([torch.tanh(self.X @ hidden.T), self.linear], dim=1)


def pair_products(rows: Tensor) -> Tensor:
    """Products of each pair of rows once: (n, k) -> (n(n+1)/2, k), in the order of `torch.triu_indices`."""
    i, j = torch.triu_indices(len(rows), len(rows))
    return rows[i] * rows[j]
