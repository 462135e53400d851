"""The paper's momentum rule (its eq. 15) as a torch optimiser."""

from collections.abc import Callable, Iterable
from typing import Any

import torch


class Momentum(torch.optim.Optimizer):
    """v(N+1) = v(N) + α[(1−η) g(N) + η g(N−1)], with g the negative gradient and g(−1) = 0.

    Parameters
    ----------
    params : iterable of parameters
        The weights v.
    learning_rate : float
        α.
    momentum : float
        η: the share of the previous gradient in a step.

    Notes
    -----
    Eq. 15 of Song et al., Micromachines 2018, 9(5), 236. It averages two gradients; unlike the usual momentum
    it keeps no velocity, so it damps oscillations and is no faster than gradient descent downhill.
    """

    def __init__(self, params: Iterable[torch.nn.Parameter], learning_rate: float, momentum: float) -> None:
        super().__init__(params, {"learning_rate": learning_rate, "momentum": momentum})

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None) -> Any:
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            alpha, eta = group["learning_rate"], group["momentum"]
            for v in group["params"]:
                if v.grad is None:
                    continue
                before = self.state[v].get("gradient")
                v.add_(v.grad, alpha=-alpha * (1.0 - eta))
                if before is not None:
                    v.add_(before, alpha=-alpha * eta)
                self.state[v]["gradient"] = v.grad.clone()
        return loss
