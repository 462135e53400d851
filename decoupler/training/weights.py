"""The weights of a network with one hidden layer as torch trains them, and the samples that it learns.

The network is Y = A W₂ᵀ with A = [tanh(X W₁ᵀ), X] (skip) or [tanh(X W₁ᵀ), 1] (plain), where the columns of X are the
inputs and a 1, all in float64.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from decoupler.model.network import Task


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """One torch thread meanwhile, without gradients: on matrices this small, two are slower if a core is shared."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.no_grad():
            yield
    finally:
        torch.set_num_threads(threads)


class TrainingSet:
    """Inputs (n, n_in) and targets (n, n_out), and products of inputs that every Gauss-Newton matrix is made of.

    With `skip` the output layer also sees the inputs themselves.
    """

    def __init__(self, task: Task, skip: bool) -> None:
        inputs, self.task = torch.from_numpy(task.inputs), task
        self.X = torch.cat([inputs, torch.ones_like(inputs[:, :1])], dim=1)  # (n_samples, n_in+1)
        self.targets = torch.from_numpy(task.targets)
        self.linear = self.X if skip else self.X[:, -1:]  # what A holds beside the hidden nodes

    def __getitem__(self, part: slice | NDArray[np.int64]) -> "TrainingSet":
        """Some of the samples, or all in another order."""
        task = self.task
        inputs, targets = (np.ascontiguousarray(values[part]) for values in (task.inputs, task.targets))
        some = replace(task, inputs=inputs, targets=targets, load=task.load[part])
        return TrainingSet(some, self.linear is self.X)

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


def starting_weights(samples: TrainingSet) -> tuple[Tensor, Tensor]:
    """Weights W₁ and W₂ to start from, of a network for such samples.

    Hidden weights after Nguyen & Widrow (IJCNN 1990), which spread the bends of the tanh over the inputs' range [-1, 1]
    instead of piling them up at 0, as the MATLAB toolbox of the paper does; output weights uniform within ±1/√(their
    number), or 0 where the inputs are forces already.
    """
    task, n_in, n_out = samples.task, samples.X.shape[1] - 1, samples.targets.shape[1]
    n_hidden, generator = task.form.hidden, np.random.default_rng(task.training.seed)
    length = 0.7 * n_hidden ** (1.0 / n_in)
    weights = generator.uniform(-1.0, 1.0, (n_hidden, n_in))
    weights *= length / np.linalg.norm(weights, axis=1, keepdims=True)
    hidden = np.hstack([weights, generator.uniform(-length, length, (n_hidden, 1))])
    n_features = n_hidden + samples.linear.shape[1]
    bound = 0.0 if task.is_known else 1.0 / np.sqrt(n_features)
    return torch.from_numpy(hidden), torch.from_numpy(generator.uniform(-bound, bound, (n_out, n_features)))
