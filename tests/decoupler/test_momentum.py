"""Eq. 15 against a recursion written out by hand."""

import torch

from decoupler.training.momentum import Momentum


def test_follows_eq_15():
    """v(N+1) = v(N) + α[(1−η) g(N) + η g(N−1)] on f = Σ c v²/2 with g = −c v and g(−1) = 0, to rounding."""
    alpha, eta = 0.3, 0.4
    c = torch.tensor([0.5, 1.0, 2.0], dtype=torch.float64)
    parameter = torch.nn.Parameter(torch.tensor([1.0, -2.0, 3.0], dtype=torch.float64))
    optimizer = Momentum([parameter], learning_rate=alpha, momentum=eta)
    by_hand, g_before = parameter.detach().clone(), torch.zeros(3, dtype=torch.float64)
    for _ in range(20):
        optimizer.zero_grad()
        (c * parameter**2 / 2).sum().backward()
        optimizer.step()
        g = -c * by_hand
        by_hand = by_hand + alpha * ((1 - eta) * g + eta * g_before)
        g_before = g
        torch.testing.assert_close(parameter.detach(), by_hand, rtol=1e-13, atol=0)


def test_closure_is_called_and_its_loss_returned():
    parameter = torch.nn.Parameter(torch.tensor([2.0], dtype=torch.float64))
    optimizer = Momentum([parameter], learning_rate=0.5, momentum=0.0)

    def closure():
        optimizer.zero_grad()
        loss = (parameter**2).sum()
        loss.backward()
        return loss

    assert optimizer.step(closure).item() == 4.0
    assert parameter.item() == 0.0  # 2 − 0.5·(2·2)
