"""A network whose hidden layer is a convolution: every unit has the same nodes, which see it and its neighbours."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from decoupler.data.columns import eye, namespace
from decoupler.inverse.strain_maps import units_around
from decoupler.model.network import Network, Outcome, Task
from geometry.layout import FloatArray

LEAST_SLOPE = 1e-12  #: slope, and change, of the mean squared error at which there is no more to gain


@dataclass(frozen=True, kw_only=True, eq=False)
class Convolution(Network):
    """y = W [tanh(K [x of 3 × 3 units, 1]) of every unit, x, 1]."""

    kernel: FloatArray  #: K, (n_hidden, 9 k + 1) of k inputs a unit, bias last
    near: NDArray[np.int64]  #: (units, 9): units around each; the number of units where there is none

    @classmethod
    def fitted(cls, task: Task) -> tuple[Self, Outcome]:
        """By L-BFGS on the kernel, with the last layer that is best for each: variable projection."""
        import torch

        from decoupler.training.weights import one_torch_thread

        rows, cols = task.shape
        near, training = units_around(rows, cols, 1, rows * cols), task.training
        seen = 9 * task.inputs.shape[1] // len(near) + 1
        start = np.random.default_rng(training.seed).normal(scale=seen**-0.5, size=(task.form.hidden, seen))
        X, Y, kernel = (torch.from_numpy(values) for values in (task.inputs, task.targets, start))
        learning: Any = kernel.requires_grad_()  # a tensor in an array's place, so that `activations` has derivatives
        found: Any = cls(output=task.targets, kernel=learning, near=near)
        most = training.max_iterations
        optimiser: Any = torch.optim.LBFGS(
            [kernel],
            max_iter=most,
            tolerance_grad=LEAST_SLOPE,
            tolerance_change=LEAST_SLOPE,
            line_search_fn="strong_wolfe",
        )
        errors = list[float]()

        def projected() -> Any:
            A = found.activations(X)
            W = torch.linalg.solve(A.T @ A + task.ridge * eye(A.shape[1], A), A.T @ Y)
            return W, ((A @ W - Y) ** 2).mean()

        def closure() -> float:
            optimiser.zero_grad()
            _, mse = projected()
            mse.backward()
            errors.append(mse.item())
            task.progress(len(errors) - 1, errors[-1])
            return errors[-1]

        with one_torch_thread(), torch.enable_grad():
            optimiser.step(closure)
            W, mse = (values.detach() for values in projected())
        network = cls(output=W.numpy().T.copy(), kernel=kernel.detach().numpy(), near=near)
        iterations = optimiser.state[kernel]["n_iter"]
        return network, Outcome(iterations, mse.item(), "stagnation" if iterations < most else "iterations")

    def activations(self, inputs: FloatArray) -> FloatArray:
        n, xp = len(inputs), namespace(inputs)
        units = inputs.reshape(n, len(self.near), -1)
        around = xp.concat([units, xp.zeros_like(units[:, :1])], axis=1)[:, self.near].reshape(n, len(self.near), -1)
        hidden = xp.tanh(around @ self.kernel[:, :-1].T + self.kernel[:, -1])
        return xp.concat([hidden.reshape(n, -1), inputs, xp.ones_like(inputs[:, :1])], axis=1)

    @property
    def below(self) -> int:
        return self.kernel.size
