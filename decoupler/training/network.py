"""The network as torch trains it: one tanh hidden layer, a linear output, all in float64."""

import numpy as np
import torch
from torch import Tensor, nn

from decoupler.model.settings import NetworkConfig


class Network(nn.Module):
    """Y = A W₂ᵀ with A = [tanh(X W₁ᵀ), X] for a skip net, [tanh(X W₁ᵀ), 1] for a plain one, X = [inputs, 1].

    Parameters
    ----------
    config : NetworkConfig
    n_in, n_out : int
        Scaled resistances in, scaled forces out.
    seed : int
        Of the start: hidden weights after Nguyen & Widrow (IJCNN 1990), which spread the bends of the tanh
        over the inputs' range [-1, 1] instead of piling them up at 0, as the MATLAB toolbox of the paper
        does; output weights uniform within ±1/√(their number).
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
