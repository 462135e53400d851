"""Eq. 15 against a recursion written out by hand."""

import torch

from decoupler import TrainingConfig
from decoupler.training.momentum import momentum_step


def test_follows_eq_15():
    """v(N+1) = v(N) + α[(1−η) g(N) + η g(N−1)] on f = Σ c v²/2 with g = −c v and g(−1) = 0, to rounding."""
    config = TrainingConfig(trainer="momentum", learning_rate=0.3, momentum=0.4)
    c = torch.tensor([0.5, 1.0, 2.0], dtype=torch.float64)
    v = by_hand = torch.tensor([1.0, -2.0, 3.0], dtype=torch.float64)
    before = g_before = torch.zeros(3, dtype=torch.float64)
    for _ in range(20):
        gradient = c * v
        v, before = momentum_step(v, gradient, before, config), gradient
        g = -c * by_hand
        by_hand, g_before = by_hand + 0.3 * ((1 - 0.4) * g + 0.4 * g_before), g
        torch.testing.assert_close(v, by_hand, rtol=1e-13, atol=0)
