"""Networks with one hidden layer of tanh nodes: the paper's, and one that sees its inputs past them as well."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from decoupler.data.columns import namespace, rowwise
from decoupler.model.network import Network, Outcome, Task, named
from decoupler.model.settings import METHODS
from geometry.layout import FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Skip(Network):
    """y = W₂ [tanh(W₁ [x, 1]), x, 1]: what a linear map leaves is the hidden layer's."""

    hidden: FloatArray  #: W₁, (n_hidden, n_in + 1), bias last

    @classmethod
    def fitted(cls, task: Task) -> tuple[Self, Outcome]:
        """By the trainer that the task names."""
        from decoupler.training.weights import TrainingSet, one_torch_thread, starting_weights  # loads torch

        samples = TrainingSet(task, cls.sees_inputs)
        hidden, output = starting_weights(samples)
        with one_torch_thread():
            point, outcome = named(METHODS[task.training.trainer])(samples, hidden, output)
        # in the order of a file's, since products round by it
        layers = (np.array(part.numpy(), order="C") for part in (point.hidden, point.output))
        return cls(**dict(zip(("hidden", "output"), layers, strict=True))), outcome

    def activations(self, inputs: FloatArray) -> FloatArray:
        xp = namespace(inputs)
        X = xp.concat([inputs, xp.ones_like(inputs[:, :1])], axis=1)
        if not len(self.hidden):
            return X
        hidden = xp.tanh(rowwise(X, self.hidden.T))
        return xp.concat([hidden, X if self.sees_inputs else X[:, -1:]], axis=1)

    def slopes(self, inputs: FloatArray) -> FloatArray:
        n_hidden, n_in = self.hidden.shape[0], inputs.shape[1]
        s = 1.0 - self.activations(inputs)[:, :n_hidden] ** 2
        found = (self.output[:, :n_hidden] * s[:, None, :]) @ self.hidden[:, :-1]
        return found + self.output[:, n_hidden : n_hidden + n_in] if self.sees_inputs else found

    @property
    def below(self) -> int:
        return int(np.count_nonzero(self.hidden))


@dataclass(frozen=True, kw_only=True, eq=False)
class Plain(Skip):
    """y = W₂ [tanh(W₁ [x, 1]), 1], as in the paper."""

    sees_inputs: ClassVar[bool] = False
